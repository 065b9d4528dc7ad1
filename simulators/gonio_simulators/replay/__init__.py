"""A recorded wire log, served back as the device that it was recorded from: ``gonio replay``.

How requests are matched, and why so, is in `docs/decisions/replay.md`.
"""

"""The acquisition window: the headless runner of `gonio.acquire`, seen and steered live.

No acquisition logic lives here.  `session` runs the bench in plain threads, `live` keeps what was measured,
`window` and its panels draw both; `app` is the entry point of ``gonio gui``.
"""

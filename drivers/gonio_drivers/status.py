"""Progress of an action that runs in a thread; it lives in the core, since more than drivers need it."""

from __future__ import annotations

from gonio.status import ThreadStatus

__all__ = ["ThreadStatus"]

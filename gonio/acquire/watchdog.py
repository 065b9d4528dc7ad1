"""Does the scan still show signs of life?

Our own drivers have a deadline for every reply and every motion.  A driver of somebody else's may not, and a
call that never returns would let a scan stand for a night without a word.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from gonio.errors import DeviceError


class Watchdog:
    """Barks when nobody has fed it for too long; a context manager.

    Parameters
    ----------
    limit_s
        Real seconds without `feed`.
    bark
        Called in a thread of its own with the seconds that have passed.
    """

    def __init__(self, limit_s: float, bark: Callable[[float], None]) -> None:
        self._limit_s = limit_s
        self._bark = bark
        self._fed_s = time.monotonic()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)

    def feed(self) -> None:
        """Show a sign of life; any thread."""
        self._fed_s = time.monotonic()

    def __enter__(self) -> Watchdog:
        self.feed()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        while True:
            left_s = self._fed_s + self._limit_s - time.monotonic()
            if self._ended.wait(max(left_s, 0.0)):
                return
            silent_s = time.monotonic() - self._fed_s
            if silent_s >= self._limit_s:
                self._bark(silent_s)
                self.feed()


def silence(silent_s: float, doing: str) -> DeviceError:
    """Return what a silence is told as, `doing` being what the scan was at."""
    return DeviceError(
        "the rig",
        f"gave no sign of life for {silent_s:.0f} s ({doing})",
        "look which device hangs; switch it off and on",
    )

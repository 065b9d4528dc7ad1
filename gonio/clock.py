"""Instrument time: the real clock, or the simulated bench's, which may run fast.

Settling, time constants and move durations are instrument seconds.  On real hardware they are real seconds;
on the simulated bench one real second is `speed` instrument seconds.  Deadlines of the wire (how long a
reply may take) are real seconds and do not use this clock.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

_WAKING_S = 2e-4


@dataclass(frozen=True, slots=True)
class Clock:
    """Monotonic instrument time in seconds, zero when the clock is made.

    Parameters
    ----------
    speed
        Instrument seconds per real second, 1.0 for real hardware.
    """

    speed: float = 1.0
    _origin_s: float = field(default_factory=time.perf_counter)

    def now_s(self) -> float:
        """Return instrument seconds since this clock was made."""
        return (time.perf_counter() - self._origin_s) * self.speed

    def sleep(self, duration_s: float) -> None:
        """Wait `duration_s` instrument seconds; return at once for zero or less.

        Waking up takes a system 0.1 ms, on a fast clock a second or so: the end of the wait is spent looking.
        """
        end_s = time.perf_counter() + duration_s / self.speed
        while (left_s := end_s - time.perf_counter()) > 0:
            time.sleep(max(left_s - _WAKING_S, 0.0))

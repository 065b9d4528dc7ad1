"""Bench time: how many seconds have passed on the simulated bench."""

from __future__ import annotations

import time


class BenchClock:
    """Monotonic bench seconds since the clock was made; one real second is `speed` bench seconds.

    Parameters
    ----------
    speed
        Bench seconds per real second, above zero.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = float(speed)
        # perf_counter, as monotonic ticks only every 16 ms on some systems: 16 bench seconds at speed 1000
        self._origin_s = time.perf_counter()
        self._held_s: float | None = None

    def now_s(self) -> float:
        """Return bench seconds since this clock was made."""
        if self._held_s is not None:
            return self._held_s
        return (time.perf_counter() - self._origin_s) * self.speed

    def hold(self) -> None:
        """Let the clock show the present instant until `release`.

        An instrument takes all that one reply says at one instant.  At speed 4000 the 50 us in which a reply
        is put together are 0.2 bench seconds: a position read at their beginning and an idle flag read at
        their end would tell of an arm that came to rest where it never stood.
        """
        self._held_s = self.now_s()

    def release(self) -> None:
        """Let the clock run again; the time meanwhile has passed."""
        self._held_s = None


class ManualClock(BenchClock):
    """A bench clock that stands still until it is told how far to go on; for calculations and tests."""

    def __init__(self, now_s: float = 0.0) -> None:
        super().__init__()
        self._now_s = now_s

    def now_s(self) -> float:
        """Return the bench seconds that were advanced so far."""
        return self._now_s

    def advance(self, duration_s: float) -> None:
        """Let `duration_s` bench seconds pass."""
        self._now_s += duration_s

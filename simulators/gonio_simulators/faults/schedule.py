"""When does a fault happen: by chance or by count at its opportunities, or at bench times."""

from __future__ import annotations

import math
import random

from gonio_simulators.faults.spec import When

_HOUR_S = 3600.0


class Trigger:
    """Decides for one fault at one place.

    Parameters
    ----------
    when
        What the specification says.
    rng
        A generator of its own, so that no other fault shifts its numbers.
    start_s
        Bench time from which a rate counts.
    """

    def __init__(self, when: When, rng: random.Random, *, start_s: float = 0.0) -> None:
        self._when = when
        self._rng = rng
        self._count = 0
        self._due_s = math.inf
        if when.mode == "at":
            self._due_s = when.value
        elif when.mode == "rate":
            self._due_s = start_s + self._gap_s()

    @property
    def due_s(self) -> float:
        """Bench time of the next one; infinite if it is not a matter of time."""
        return self._due_s

    def at_opportunity(self, now_s: float) -> bool:
        """Count an opportunity and say whether the fault takes it."""
        mode, value = self._when.mode, self._when.value
        if mode == "probability":
            return self._rng.random() < value
        if mode in ("at", "rate"):
            return self.take_due(now_s)
        self._count += 1
        return self._count == value if mode == "nth" else self._count % value == 0

    def take_due(self, now_s: float) -> bool:
        """Say whether one has become due, and take it."""
        if now_s < self._due_s:
            return False
        self._due_s = self._due_s + self._gap_s() if self._when.mode == "rate" else math.inf
        return True

    def _gap_s(self) -> float:
        """Time to the next of a Poisson process."""
        rate = self._when.value
        return self._rng.expovariate(rate / _HOUR_S) if rate > 0 else math.inf

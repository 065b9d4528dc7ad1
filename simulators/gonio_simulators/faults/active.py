"""One fault at one place: does it strike now, with which values, and the note that it did."""

from __future__ import annotations

import random

from gonio_simulators.clock import BenchClock
from gonio_simulators.faults.log import FaultLog
from gonio_simulators.faults.schedule import Trigger
from gonio_simulators.faults.spec import FaultSpec


class ActiveFault:
    """A specification at one of its places, with a random generator and a count of its own.

    Parameters
    ----------
    spec
        What was asked for.
    place
        A role, an axis, a detector, or the lamp.
    seed
        Tells this fault's numbers from all others'.
    clock, log
        Bench time, and where injections are noted.
    """

    def __init__(self, spec: FaultSpec, place: str, seed: str, clock: BenchClock, log: FaultLog) -> None:
        self.name = spec.kind.name
        self.place = place
        self.on = spec.kind.opportunity
        self.on_the_line = spec.kind.place in ("line", "cs260")
        self.rng = random.Random(seed)
        self._spec = spec
        self._clock = clock
        self._log = log
        self._trigger = Trigger(spec.when, random.Random(f"{seed} when"), start_s=clock.now_s())
        self._by_itself = spec.kind.self_timed and spec.when.mode in ("at", "rate")

    def strikes(self) -> bool:
        """Count an opportunity and say whether the fault takes it."""
        return not self._by_itself and self._trigger.at_opportunity(self._clock.now_s())

    def due_s(self) -> float | None:
        """Bench time at which it strikes by itself; None if it waits for opportunities."""
        return self._trigger.due_s if self._by_itself else None

    def take_due(self) -> bool:
        """Say whether it strikes by itself now."""
        return self._by_itself and self._trigger.take_due(self._clock.now_s())

    def record(self, details: str = "", time_s: float | None = None) -> None:
        """Note that it struck, now or at a bench time of the past."""
        self._log.record(self._clock.now_s() if time_s is None else time_s, self.name, self.place, details)

    def number(self, key: str) -> float:
        """Return the value of a numeric key."""
        value = self._spec.options[key]
        assert isinstance(value, int | float)
        return value

    def flag(self, key: str) -> bool:
        """Return the value of a key that is true or false."""
        return self._spec.options[key] is True

    def text(self, key: str) -> str:
        """Return the value of a key that is a word; ``random`` is drawn from the other words."""
        value = self._spec.options[key]
        if value == "random":
            return self.rng.choice([c for c in self._spec.kind.keys[key].choices if c != "random"])
        assert isinstance(value, str)
        return value

    def sign(self) -> float:
        """Return -1 or 1 at random."""
        return self.rng.choice((-1.0, 1.0))

    def part(self) -> float:
        """Return the part of a move that passes before; at random away from its very ends."""
        part = self.number("part")
        return part if part >= 0 else self.rng.uniform(0.1, 0.9)

"""Where was the arm at every instant of every motion, and who moved it: the driver or a hand?"""

from __future__ import annotations

import itertools

from gonio_simulators.bench.motor import Fault, Motor

STEP_DEG = 1e-3
"""More than a whole step of the counter, less than any tolerance."""


class PathWatch:
    """Follows one motor; `broken` lists what a driver must never have caused."""

    def __init__(self, motor: Motor, *, legal_deg: tuple[float, float], blind_zone_deg: float) -> None:
        self.motor = motor
        self.broken: list[str] = []
        self.disturbed = False  # by a hand, since the last homing or verified move
        self._legal_deg = legal_deg
        self._zone_deg = blind_zone_deg
        self._by_hand = self._tripped = False
        self._began_legally = True
        self._known_fault = Fault.NONE
        for name in ("move_absolute", "home"):
            self._observe(name)

    def by_hand(self) -> None:
        """What moves from now on is moved by somebody else, until the next command."""
        self._by_hand = self.disturbed = True

    def tripped(self) -> None:
        """A switch that answers now does so by itself, wherever the arm is."""
        self._tripped = True

    def passed(self, start_s: float, end_s: float) -> None:
        """Look at the path between two times, in which no command was given."""
        motor = self.motor
        times = {start_s, end_s}
        times.update(
            t
            for piece in motor._pieces
            for t in (piece.start_s, piece.start_s + piece.duration_s)
            if start_s < t < end_s
        )
        angles = [motor.angle_at(t) for t in sorted(times)]  # monotonic between two of them
        if not self._by_hand:
            for before_deg, after_deg in itertools.pairwise(angles):
                self._look(before_deg, after_deg)
        self._look_at_switches()

    def _look(self, before_deg: float, after_deg: float) -> None:
        zone_deg = self._zone_deg - STEP_DEG
        inwards = abs(after_deg) < abs(before_deg) - 1e-9 or before_deg * after_deg < 0
        if zone_deg > 0 and abs(after_deg) < zone_deg and inwards:
            self.broken.append(
                f"{self.motor.hardware.name} was driven from {before_deg:.4f} to {after_deg:.4f} deg, "
                f"into the blind zone of {self._zone_deg:g} deg"
            )

    def _look_at_switches(self) -> None:
        fault = self.motor._fault
        if fault is self._known_fault:
            return
        self._known_fault = fault
        met = fault in (Fault.LOW_LIMIT, Fault.HIGH_LIMIT)
        if met and not self._by_hand and not self._tripped and self._began_legally:
            self.broken.append(
                f"{self.motor.hardware.name} met the {fault.value} at {self.motor.angle_deg():.4f} deg "
                "in a move that began at a legal place"
            )

    def _observe(self, name: str) -> None:
        original = getattr(self.motor, name)

        def observed(*arguments: int) -> None:
            low, high = self._legal_deg
            here_deg = self.motor.angle_deg()
            inside = low - STEP_DEG <= here_deg <= high + STEP_DEG
            self._began_legally = inside and abs(here_deg) >= self._zone_deg - STEP_DEG
            self._by_hand = self._tripped = False
            original(*arguments)
            self._known_fault = self.motor._fault  # one that is still there is no new one

        setattr(self.motor, name, observed)

"""What happens to lamp and detectors that is neither drift nor noise: steps, ramps, a rail, an outage.

Each is a function of bench time, so that the lock-in can integrate over it exactly; each begins at the time
at which it is told, never in a past that has been integrated already.
"""

from __future__ import annotations

from dataclasses import dataclass

from gonio_simulators.bench.lockin import DetectorSignal


@dataclass(frozen=True, slots=True)
class _Step:
    start_s: float
    ramp_s: float
    size: float  # relative change

    def factor(self, time_s: float) -> float:
        """1 before, 1 + size after, straight in between."""
        if time_s < self.start_s:
            return 1.0
        if time_s >= self.start_s + self.ramp_s:
            return 1.0 + self.size
        return 1.0 + self.size * (time_s - self.start_s) / self.ramp_s


@dataclass(frozen=True, slots=True)
class _Rail:
    start_s: float
    end_s: float
    level_v: float


class LightDisturbance:
    """The disturbances of one bench."""

    def __init__(self) -> None:
        self._lamp: list[_Step] = []
        self._gains: dict[str, list[_Step]] = {}
        self._dark: list[tuple[float, float]] = []
        self._rails: dict[str, list[_Rail]] = {}

    def lamp_changes(self, start_s: float, *, ramp_s: float, size: float) -> None:
        """Change the lamp's power by a relative size, for good."""
        self._lamp.append(_Step(start_s, ramp_s, size))

    def lamp_goes_out(self, start_s: float, end_s: float) -> None:
        """Darken the lamp for a while."""
        self._dark.append((start_s, end_s))

    def gain_changes(self, detector: str, start_s: float, size: float) -> None:
        """Change a detector's gain by a relative size, for good."""
        self._gains.setdefault(detector, []).append(_Step(start_s, 0.0, size))

    def saturate(self, detector: str, start_s: float, end_s: float, level_v: float) -> None:
        """Hold a detector's signal at a level, whatever the light, for a while."""
        self._rails.setdefault(detector, []).append(_Rail(start_s, end_s, level_v))

    def lamp_power(self, time_s: float) -> float:
        """Return the lamp's power relative to what it would be."""
        if any(start <= time_s < end for start, end in self._dark):
            return 0.0
        power = 1.0
        for step in self._lamp:
            power *= step.factor(time_s)
        return power

    def seen_by(self, detector: str, signal: DetectorSignal, time_s: float) -> DetectorSignal:
        """Return what a detector makes of its signal: its gain, and its rail if it is over-range."""
        for rail in self._rails.get(detector, ()):
            if rail.start_s <= time_s < rail.end_s:
                return DetectorSignal(rail.level_v, 0.0, 0.0)
        gain = 1.0
        for step in self._gains.get(detector, ()):
            gain *= step.factor(time_s)
        return signal if gain == 1.0 else DetectorSignal(*(gain * value for value in signal))

    def changes_between(self, start_s: float, end_s: float) -> list[tuple[float, float]]:
        """Return the start and end of each change in an interval; a jump is a change of no length."""
        steps = [*self._lamp, *(s for gains in self._gains.values() for s in gains)]
        changes = [(s.start_s, s.start_s + s.ramp_s) for s in steps]
        changes += [(t, t) for interval in self._dark for t in interval]
        changes += [(t, t) for rails in self._rails.values() for r in rails for t in (r.start_s, r.end_s)]
        return [(a, b) for a, b in changes if b > start_s and a < end_s]

"""Faults of lamp, detectors, lock-in and monochromator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gonio_simulators.bench.bench import Bench
from gonio_simulators.bench.monochromator import Stuck
from gonio_simulators.faults.active import ActiveFault


class LightFaults:
    """Faults of lamp, detectors and lock-in; they strike when somebody looks at the outputs, or by time."""

    def __init__(self, bench: Bench, faults: Sequence[ActiveFault]) -> None:
        self._bench = bench
        self._faults = tuple(faults)
        self._detectors = frozenset(bench.detector_names)
        if faults:
            bench.lockin.before_look = self.look

    def look(self) -> None:
        """An opportunity for each fault; a detector has one only while the light goes to it."""
        selected = self._bench.selected_detector
        for fault in self._faults:
            if fault.place in self._detectors and fault.place != selected:
                continue
            if fault.strikes():
                self.strike_now(fault)

    def strike_now(self, fault: ActiveFault) -> None:
        """Let a fault begin at this bench time."""
        bench, now_s = self._bench, self._bench.clock.now_s()
        if fault.name == "lockin-overload":
            at, size = fault.text("at"), fault.number("size")
            bench.lockin.spike(size, at_input=at == "input")
            fault.record(f"at={at} size={size:g}")
            return
        disturbance = bench.disturb_light()
        if fault.name == "lamp-drift":
            size, ramp_s = fault.number("size"), fault.number("ramp_s")
            disturbance.lamp_changes(now_s, ramp_s=ramp_s, size=size)
            fault.record(f"size={size:g} ramp_s={ramp_s:g}", now_s)
        elif fault.name == "lamp-out":
            hold_s = fault.number("hold_s")
            disturbance.lamp_goes_out(now_s, now_s + hold_s)
            fault.record(f"hold_s={hold_s:g}", now_s)
        elif fault.name == "detector-change":
            size = fault.number("size")
            disturbance.gain_changes(fault.place, now_s, size)
            fault.record(f"size={size:g}", now_s)
        else:
            hold_s, level_v = fault.number("hold_s"), fault.number("level_v")
            disturbance.saturate(fault.place, now_s, now_s + hold_s, level_v)
            fault.record(f"hold_s={hold_s:g} level_v={level_v:g}", now_s)


class StuckFaults:
    """Mechanics of the monochromator that do not do what they are told."""

    def __init__(self, bench: Bench, faults: Sequence[ActiveFault]) -> None:
        self._clock = bench.clock
        self._faults: Mapping[str, list[ActiveFault]] = {
            what: [f for f in faults if f.name == f"{what}-stuck"]
            for what in ("filter", "grating", "shutter", "wavelength")
        }
        self._until: dict[str, tuple[float, Stuck]] = {}
        if faults:
            bench.monochromator.interfere = self.interfere

    def interfere(self, what: str) -> Stuck | None:
        """Say whether a change that is asked for sticks."""
        now_s = self._clock.now_s()
        held = self._until.get(what)
        if held is not None and now_s < held[0]:
            return held[1]
        found: Stuck | None = None
        for fault in self._faults[what]:
            if fault.strikes() and found is None:
                part = fault.number("part") if what == "wavelength" else 0.0
                found = Stuck(fault.flag("silent"), int(fault.number("code")), part)
                hold_s = fault.number("hold_s")
                self._until[what] = (now_s + hold_s, found)
                fault.record(f"silent={found.silent} hold_s={hold_s:g}")
        return found

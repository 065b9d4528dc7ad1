"""Faults of a motor: alarms, switches, lost steps and hands, in mid-move or while it stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gonio_simulators.bench.motor import Disturbance, Fault, Motor
from gonio_simulators.faults.active import ActiveFault

Schedule = Callable[[float, Callable[[], None]], None]
"""Calls a function at a bench time."""

_CAUSES = {
    "over-temperature": Fault.OVER_TEMPERATURE,
    "position-error": Fault.STALL,
    "encoder": Fault.ENCODER,
}

_READS_ENCODER = frozenset(("polarizer",))
"""Axes whose position is that of an encoder: the ELL14's motor has no steps that could be counted."""


class AxisFaults:
    """The faults of one axis; plugged in as `Motor.disturb`."""

    def __init__(self, motor: Motor, faults: Sequence[ActiveFault], schedule: Schedule) -> None:
        self._motor = motor
        self._faults = tuple(faults)
        self._schedule = schedule
        motor.disturb = self.disturb

    def disturb(self, homing: bool) -> Disturbance | None:
        """Return what goes wrong in a move that begins; the first fault that strikes has it."""
        found: Disturbance | None = None
        for fault in self._faults:
            if homing and not _may_end_homing(fault):
                continue
            if fault.strikes() and found is None:
                found = self._disturbance(fault)
        return found

    def strike_now(self, fault: ActiveFault) -> None:
        """Turn the knob, or push, whatever the motor does."""
        motor = self._motor
        size_deg = fault.sign() * fault.number("size_deg")
        steps = size_deg * motor.hardware.steps_per_deg
        state = "moving" if motor.is_moving() else "idle"
        if fault.text("by") == "push":
            motor.displace(steps)
        else:
            motor.turn_by_hand(steps, fault.number("turn_s"))
        fault.record(f"size_deg={size_deg:g} while={state}")

    def _disturbance(self, fault: ActiveFault) -> Disturbance | None:
        if fault.name == "knob":
            return self._hand(fault)
        part = fault.part()

        def happened(time_s: float) -> None:
            fault.record(f"{what} at_deg={self._motor.angle_at(time_s):.4f} part={part:.3f}", time_s)

        if fault.name == "alarm":
            cause = fault.text("cause")
            what = f"cause={cause}"
            return Disturbance(part, happened, _CAUSES[cause], hold_s=fault.number("hold_s"))
        if fault.name == "limit":
            what = "switch"
            return Disturbance(part, happened, Fault.LOW_LIMIT)
        silent = fault.flag("silent")
        what = f"silent={silent}"
        if not silent:
            return Disturbance(part, happened, Fault.STALL)
        readback = "truth" if self._motor.hardware.name in _READS_ENCODER else fault.text("readback")
        what = f"{what} readback={readback}"
        return Disturbance(part, happened, slips=readback == "target")

    def _hand(self, fault: ActiveFault) -> Disturbance | None:
        motor = self._motor
        if not fault.flag("moving") or fault.text("by") == "push":
            delay_s = fault.rng.uniform(0.0, fault.number("idle_s"))
            # the end of the move is known only once it has begun
            self._schedule(
                motor.clock.now_s(),
                lambda: self._schedule(motor.motion_s[1] + delay_s, lambda: self.strike_now(fault)),
            )
            return None
        size_deg = fault.sign() * fault.number("size_deg")
        part = fault.part()

        def happened(time_s: float) -> None:
            fault.record(f"size_deg={size_deg:g} while=moving part={part:.3f}", time_s)

        steps = size_deg * motor.hardware.steps_per_deg
        return Disturbance(part, happened, hand_steps=steps, hand_s=fault.number("turn_s"))


def _may_end_homing(fault: ActiveFault) -> bool:
    """A home routine looks for its switch: it trusts no counter, and other switches do not end it."""
    return fault.name == "alarm" or (fault.name == "stall" and not fault.flag("silent"))

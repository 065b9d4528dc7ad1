"""What a stepping motor is to its axis, and in how many moves it approaches a target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Self

from pydantic import model_validator

from gonio.config import Number
from gonio.rig import AxisConfig


@dataclass(frozen=True, slots=True)
class DriveState:
    """What one poll of a drive said."""

    position_steps: int
    moving: bool
    referenced: bool
    fault: str | None  # what ended or prevents a move, in words; None if nothing does
    remedy: str = ""


class Drive(Protocol):
    """One motor on its line; positions are steps.  Every method raises `DeviceError`."""

    @property
    def device(self) -> str:
        """Name for messages: axis, make, number, address."""
        ...

    @property
    def start_latency_s(self) -> float:
        """Instrument seconds for which the drive may still say idle after it has accepted a move."""
        ...

    @property
    def reports_reference(self) -> bool:
        """Whether the controller itself says that its count has lost its reference.

        If not, a position that has changed while the axis stood still is taken for a lost reference.
        """
        ...

    def state(self) -> DriveState:
        """Ask for position, motion and faults."""
        ...

    def clear_faults(self) -> None:
        """Acknowledge faults of an earlier move, so that a fault seen from now on belongs to the next."""
        ...

    def move_to(self, position_steps: int) -> None:
        """Begin a move and return; never repeated when the reply fails."""
        ...

    def home(self) -> None:
        """Begin the search for the reference switch and return."""
        ...

    def finish_home(self) -> None:
        """Do what is left to do when the search has ended without a fault."""
        ...

    def stop(self) -> None:
        """Decelerate and stop."""
        ...

    def resume(self) -> None:
        """Make sure that this is the same drive as before and set again what it forgets when it is switched
        off; called after its line was opened anew.  A drive that was switched off must say so afterwards by
        `state` (``referenced`` False).
        """
        ...

    def confirm(self, position_steps: int) -> str | None:
        """Return why the count `position_steps` cannot be trusted though `state` looks well, None if it can.

        Called at rest, once at the end of each motion; a drive whose `state` says everything returns None
        without asking.
        """
        ...


class MotorConfig(AxisConfig):
    """What a driver must know of an axis driven by steps."""

    steps_per_deg: Number  # negative if the angle falls while the steps rise
    zero_deg: Number = 0.0  # angle at step 0, the home switch

    @model_validator(mode="after")
    def _steps_are_fine_enough(self) -> Self:
        if self.steps_per_deg == 0.0:
            raise ValueError("steps_per_deg = 0: give the steps of one degree, negative if the angle falls")
        half_step_deg = 0.5 / abs(self.steps_per_deg)
        if self.tolerance_deg < half_step_deg:
            raise ValueError(
                f"tolerance_deg = {self.tolerance_deg:g} deg is below half a step, {half_step_deg:.3g} deg: "
                "no move could arrive; raise it"
            )
        return self


def approach_legs(config: AxisConfig, from_deg: float, target_deg: float) -> tuple[float, ...]:
    """Return the targets, in degrees, of the moves that lead to `target_deg`, itself the last.

    The lost motion of the gears is taken up by ending every approach in the same direction: towards zero,
    that is from the side on which an overshoot by `backlash_deg` goes away from the blind zone.  An axis that
    comes from that side anyway, from at least `backlash_deg` away, goes directly.

    Where the overshoot would leave the limits (at 180 deg with limits 15...180 deg) there is no room: the
    axis goes directly, and so always arrives there from the other side.
    """
    if config.backlash_deg == 0.0:
        return (target_deg,)
    outward = -1.0 if target_deg < 0 else 1.0
    overshoot_deg = target_deg + outward * config.backlash_deg
    low, high = config.limits_deg
    comes_from_outside = (from_deg - target_deg) * outward >= config.backlash_deg
    if comes_from_outside or not low <= overshoot_deg <= high:
        return (target_deg,)
    return (overshoot_deg, target_deg)

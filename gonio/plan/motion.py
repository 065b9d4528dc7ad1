"""How long the axes take from one position to the next, and what that costs on the wire.

The rule of the approach is that of the drivers: every target is reached in the direction towards zero, with
an overshoot by the backlash if the axis does not come from that side anyway, and directly where the overshoot
would leave the limits.  Both axes move at once; the slower one counts.
"""

from __future__ import annotations

from gonio.latency import PassTime
from gonio.rig import AxisConfig, RigConfig

Angles = tuple[float, float]  # theta_i, theta_mes

_POLLS_PER_LEG = 1.5  # the one that finds it arrived, and half of one that came just before
_AT_START = 1  # each axis is asked where it stands, whether it will move or not
_PER_LEG = 1  # the command


def legs_deg(axis: AxisConfig, from_deg: float, to_deg: float) -> tuple[float, ...]:
    """Return the lengths of the moves from one angle to another, degrees; empty if the axis stays."""
    if from_deg == to_deg:
        return ()
    distance = abs(to_deg - from_deg)
    if axis.backlash_deg == 0.0:
        return (distance,)
    outward = -1.0 if to_deg < 0 else 1.0
    overshoot_deg = to_deg + outward * axis.backlash_deg
    low, high = axis.limits_deg
    if (from_deg - to_deg) * outward >= axis.backlash_deg or not low <= overshoot_deg <= high:
        return (distance,)
    return (abs(overshoot_deg - from_deg), axis.backlash_deg)


def move_time(rig: RigConfig, start: Angles, end: Angles) -> PassTime:
    """Return what a move of both axes takes, in instrument seconds and exchanges with the stage."""
    stage = rig.stage
    slowest_s, exchanges = 0.0, 2.0 * _AT_START
    for axis, from_deg, to_deg in zip((stage.theta_i, stage.theta_mes), start, end, strict=True):
        legs = legs_deg(axis, from_deg, to_deg)
        # settling once, at the end
        duration_s = sum(axis.move_duration_s(leg) - axis.settle_s for leg in legs)
        slowest_s = max(slowest_s, duration_s + (axis.settle_s if legs else 0.0))
        exchanges += len(legs) * (_PER_LEG + _POLLS_PER_LEG)
    return PassTime(slowest_s, {"stage": exchanges})

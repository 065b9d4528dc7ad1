"""Where an axis must not stand, and which way it must not go."""

from __future__ import annotations

import numpy as np

from gonio.errors import RefusedError
from gonio.rig.tables import AxisConfig


def check_target(axis: str, config: AxisConfig, target_deg: float, *, rig_name: str) -> None:
    """Raise `RefusedError` if `target_deg` is not a number, beyond the limits or inside the blind zone."""
    low, high = config.limits_deg
    if not np.isfinite(target_deg):
        raise RefusedError(f"{axis} = {target_deg} deg is not an angle; give a finite number of degrees")
    zone = config.blind_zone_deg
    if abs(target_deg) < zone:
        edge = zone if high >= zone else -zone
        raise RefusedError(
            f"{axis} = {target_deg:g} deg is inside the blind zone (|{axis}| < {zone:g} deg) of rig "
            f"'{rig_name}'; start the sweep at {edge:g}"
        )
    if not low <= target_deg <= high:
        raise RefusedError(
            f"{axis} = {target_deg:g} deg is outside the limits {low:g}...{high:g} deg of rig '{rig_name}'; "
            "choose an angle between them"
        )


def check_path(axis: str, config: AxisConfig, from_deg: float, target_deg: float, *, rig_name: str) -> None:
    """Raise `RefusedError` if the straight way between two angles sweeps through the blind zone.

    An axis that stands inside the zone (after a limit switch or by hand) may leave it on its own side.
    """
    zone = config.blind_zone_deg
    crosses = from_deg * target_deg < 0
    if zone > 0 and crosses:
        raise RefusedError(
            f"{axis}: the way from {from_deg:g} to {target_deg:g} deg sweeps through the blind zone "
            f"(|{axis}| < {zone:g} deg) of rig '{rig_name}'; measure the two sides "
            "in separate scans, or turn the sample instead"
        )

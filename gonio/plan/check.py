"""Can this rig measure this plan, and how long will it take?  No hardware is touched."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gonio.errors import RefusedError
from gonio.plan.model import Plan, Position
from gonio.plan.motion import Angles
from gonio.plan.timetable import PlannedReference, Timetable, timetable
from gonio.rig import RigConfig, check_path


@dataclass(frozen=True, slots=True)
class Refusal:
    """Something the plan asks for that the rig must not or cannot do; `str()` says where and why."""

    reason: str
    position: Position | None = None
    wavelength_nm: float | None = None

    def __str__(self) -> str:
        if self.position is None:
            return self.reason
        at = self.position
        return (
            f"position {at.index + 1} (theta_i = {at.theta_i_deg:g} deg, theta_mes = {at.theta_mes_deg:g} "
            f"deg, {at.polarization}): {self.reason}"
        )


def check(plan: Plan, rig: RigConfig) -> list[Refusal]:
    """Return every refused wavelength, position and path of the plan, empty if the rig can measure it.

    Paths are those between consecutive steps, references in the [baseline] position included.  The way to the
    first step starts where the axes happen to stand; the driver checks it.
    """
    refusals = list(_refused_wavelengths(plan, rig))
    baseline: Angles = (rig.baseline.theta_i_deg, rig.baseline.theta_mes_deg)
    known = {baseline: _refused_angles(rig, *baseline)}
    if known[baseline]:
        refusals.append(Refusal(f"the [baseline] position of the rig file: {known[baseline]}"))
    previous: Angles | None = None
    previous_is_baseline = False
    for position in _stops(plan, rig, detected=not refusals):
        angles = baseline if position is None else (position.theta_i_deg, position.theta_mes_deg)
        if angles not in known:
            known[angles] = _refused_angles(rig, *angles)
        if known[angles]:
            if position is not None:
                refusals.append(Refusal(known[angles], position))
            continue  # it is not visited, so the next path starts from the one before
        reason = _refused_path(rig, previous, angles) if previous and previous != angles else ""
        if reason and position is None:
            refusals.append(Refusal(f"the way back to the [baseline] position: {reason}"))
        elif reason:
            start = "from the [baseline] position, " if previous_is_baseline else ""
            refusals.append(Refusal(start + reason, position))
        previous, previous_is_baseline = angles, position is None
    return refusals


def _stops(plan: Plan, rig: RigConfig, *, detected: bool) -> Iterator[Position | None]:
    """Yield where the axes stop, None for the baseline position."""
    if detected and plan.references.periodic_kinds:
        for step in timetable(plan, rig).steps:
            yield None if isinstance(step.task, PlannedReference) else step.task
        return
    # without a detector for every wavelength no pass has a duration, and so no period an end
    yield None
    yield from plan.positions()
    yield None


def _refused_wavelengths(plan: Plan, rig: RigConfig) -> Iterator[Refusal]:
    try:
        rig.detector_for(plan.wavelength_nm)
    except RefusedError:
        for wavelength in plan.wavelength_nm.tolist():
            try:
                rig.detector_for(np.array([wavelength]))
            except RefusedError as error:
                yield Refusal(str(error), wavelength_nm=wavelength)


def _refused_angles(rig: RigConfig, theta_i_deg: float, theta_mes_deg: float) -> str:
    reasons: list[str] = []
    for check_axis, target_deg in (("theta_i", theta_i_deg), ("theta_mes", theta_mes_deg)):
        try:
            rig.check_axis_target(check_axis, target_deg)  # type: ignore[arg-type]
        except RefusedError as error:
            reasons.append(str(error))
    return "; ".join(reasons)


def _refused_path(rig: RigConfig, start: Angles, end: Angles) -> str:
    reasons: list[str] = []
    axes = (("theta_i", rig.stage.theta_i), ("theta_mes", rig.stage.theta_mes))
    for (axis, config), from_deg, to_deg in zip(axes, start, end, strict=True):
        try:
            check_path(axis, config, from_deg, to_deg, rig_name=rig.name)
        except RefusedError as error:
            reasons.append(str(error))
    return "; ".join(reasons)


def refused_visit(rig: RigConfig, before: Angles | None, angles: Angles) -> str:
    """Return why the rig must not go to a position, or not from the one before; empty if it may."""
    reason = _refused_angles(rig, *angles)
    if not reason and before is not None and before != angles:
        reason = _refused_path(rig, before, angles)
    return reason


# -- room ---------------------------------------------------------------------------------------------------

BYTES_PER_READING = 300
"""Journal and `.h5` together, and a rebuilt `.h5` beside the old one."""


def bytes_needed(table: Timetable, n_columns: int) -> int:
    """Return the room that a scan may take on the disk while it runs, bytes."""
    return len(table.steps) * n_columns * BYTES_PER_READING + 1_000_000


def refused_room(needed: int, folder: Path) -> str:
    """Return why the folder has no room for so many bytes, empty if it has."""
    free = shutil.disk_usage(folder.absolute()).free
    if free >= needed:
        return ""
    return (
        f"the scan takes up to {needed / 1e6:.0f} MB and the disk of {folder.absolute()} has "
        f"{free / 1e6:.0f} MB left; free some space or choose another disk"
    )

"""Can this rig measure this plan, and how long will it take?  No hardware is touched."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from gonio.devices import FloatArray
from gonio.errors import RefusedError
from gonio.plan.model import Plan, Position, When
from gonio.rig import AxisConfig, RigConfig, check_path


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

    Paths are those between consecutive positions, from the baseline position to the first and back from the
    last.  The way to the first baseline reading starts where the axes happen to stand; the driver checks it.
    """
    refusals = list(_refused_wavelengths(plan, rig))
    baseline_deg = (rig.baseline.theta_i_deg, rig.baseline.theta_mes_deg)
    baseline_reason = _refused_angles(rig, *baseline_deg)
    if baseline_reason:
        refusals.append(Refusal(f"the [baseline] position of the rig file: {baseline_reason}"))
    known: dict[tuple[float, float], str] = {}
    previous = None if baseline_reason else baseline_deg
    for position in plan.positions():
        angles = (position.theta_i_deg, position.theta_mes_deg)
        if angles not in known:
            known[angles] = _refused_angles(rig, *angles)
        if known[angles]:
            refusals.append(Refusal(known[angles], position))
            continue  # it is not visited, so the next path starts from the one before
        reason = _refused_path(rig, previous, angles) if previous and previous != angles else ""
        if reason:
            refusals.append(Refusal(reason, position))
        previous = angles
    if previous and not baseline_reason:
        reason = _refused_path(rig, previous, baseline_deg)
        if reason:
            refusals.append(Refusal(f"the way back to the [baseline] position: {reason}"))
    return refusals


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


def _refused_path(rig: RigConfig, start: tuple[float, float], end: tuple[float, float]) -> str:
    reasons: list[str] = []
    axes = (("theta_i", rig.stage.theta_i), ("theta_mes", rig.stage.theta_mes))
    for (axis, config), from_deg, to_deg in zip(axes, start, end, strict=True):
        try:
            check_path(axis, config, from_deg, to_deg, rig_name=rig.name)
        except RefusedError as error:
            reasons.append(str(error))
    return "; ".join(reasons)


# -- time ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Durations:
    """Estimated instrument seconds of a plan's parts."""

    position_s: FloatArray  # (n_position,) motion from the one before, then the pass over the wavelengths
    start_references_s: FloatArray  # one entry per reference reading, the first with the motion
    end_references_s: FloatArray

    @property
    def total_s(self) -> float:
        """Sum of all parts."""
        return float(self.position_s.sum() + self.start_references_s.sum() + self.end_references_s.sum())


def reference_sequence(
    plan: Plan, when: When
) -> list[tuple[Literal["dark", "baseline"], Literal["any", "s", "p"]]]:
    """Return the reference readings due at `when` as (kind, polarization), in measuring order.

    The dark signal has no polarization (the shutter is closed): it is taken once, for ``any``.
    """
    sequence: list[tuple[Literal["dark", "baseline"], Literal["any", "s", "p"]]] = []
    if when in plan.references.dark:
        sequence.append(("dark", "any"))
    if when in plan.references.baseline:
        sequence.extend(("baseline", polarization) for polarization in plan.polarization)
    return sequence


def durations(plan: Plan, rig: RigConfig) -> Durations:
    """Return the estimated instrument time of every part of a plan that `check` accepts.

    Motion is the slower of the two axes, which move at once, with the overshoot that takes out the
    backlash; a pass over the wavelengths is what the spectrometer's driver says.  Not counted: homing,
    the turning of the polarizer (twice per sweep), and the first move to the baseline position, since
    nobody knows where the axes stand.
    """
    wavelength_nm = plan.wavelength_nm
    pass_s = rig.spectrometer.reading_duration_s(wavelength_nm, plan.reading.averages)
    positions = plan.positions()
    theta_i = np.array([p.theta_i_deg for p in positions])
    theta_mes = np.array([p.theta_mes_deg for p in positions])
    start_references = reference_sequence(plan, "start")
    end_references = reference_sequence(plan, "end")
    baseline = (rig.baseline.theta_i_deg, rig.baseline.theta_mes_deg)
    before = baseline if start_references else (float(theta_i[0]), float(theta_mes[0]))
    position_s = pass_s + _motion_s(
        rig, np.concatenate([[before[0]], theta_i]), np.concatenate([[before[1]], theta_mes])
    )
    start_s, end_s = (
        np.array(
            [
                rig.spectrometer.reading_duration_s(wavelength_nm, plan.references.averages_of(kind))
                for kind, _ in sequence
            ],
            dtype=np.float64,
        )
        for sequence in (start_references, end_references)
    )
    if end_references:
        end_s[0] += _motion_s(
            rig, np.array([theta_i[-1], baseline[0]]), np.array([theta_mes[-1], baseline[1]])
        )[0]
    return Durations(position_s, start_s, end_s)


def _motion_s(rig: RigConfig, theta_i_deg: FloatArray, theta_mes_deg: FloatArray) -> FloatArray:
    """Return the time of each move along a list of k + 1 positions, (k,) seconds."""
    stage = rig.stage
    slower = [
        max(_axis_s(stage.theta_i, to_i - from_i), _axis_s(stage.theta_mes, to_mes - from_mes))
        for (from_i, to_i), (from_mes, to_mes) in zip(
            pairwise(theta_i_deg.tolist()), pairwise(theta_mes_deg.tolist()), strict=True
        )
    ]
    return np.array(slower, dtype=np.float64)


def _axis_s(axis: AxisConfig, distance_deg: float) -> float:
    if distance_deg == 0.0:
        return 0.0
    if axis.backlash_deg == 0.0:
        return axis.move_duration_s(distance_deg)
    # half of the moves overshoot and come back; which half depends on the driver, and the longer is counted
    return axis.move_duration_s(abs(distance_deg) + axis.backlash_deg) + axis.move_duration_s(
        axis.backlash_deg
    )


def estimate(plan: Plan, rig: RigConfig) -> float:
    """Return the estimated instrument time of the scan in seconds, references included; see `durations`."""
    return durations(plan, rig).total_s

"""Which steps a scan consists of, and how long those take that are left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gonio.plan.model import Plan, Position
from gonio.plan.timetable import PlannedReference, PlannedStep, ReferencePolarization, timetable
from gonio.rig import RigConfig
from gonio.store.records import ReferenceKind


@dataclass(frozen=True, slots=True)
class ReferenceStep:
    """One pass over the wavelengths in the baseline position; a dark's polarization is ``any``.

    `when` is ``start``, ``end`` or ``before K`` with the number of a position; a pass that is `descending`
    begins at the longest wavelength.
    """

    kind: ReferenceKind
    when: str
    polarization: ReferencePolarization
    duration_s: float
    descending: bool = False

    @property
    def key(self) -> tuple[str, str, str]:
        """What tells it from the scan's other references."""
        return self.kind, self.when, self.polarization


@dataclass(frozen=True, slots=True)
class PositionStep:
    """One position of the plan: motion, then a pass over the wavelengths."""

    position: Position
    duration_s: float
    descending: bool = False

    @property
    def key(self) -> int:
        """The position's number."""
        return self.position.index


Step = ReferenceStep | PositionStep


def steps_of(plan: Plan, rig: RigConfig) -> list[Step]:
    """Return every step of the plan in measuring order; see `gonio.plan.timetable`."""
    table = timetable(plan, rig)
    return [
        as_step(step, duration_s)
        for step, duration_s in zip(table.steps, table.duration_s.tolist(), strict=True)
    ]


def as_step(planned: PlannedStep, duration_s: float) -> Step:
    """Return a planned step as one to be done; `duration_s` on the instrument's clock."""
    task = planned.task
    if isinstance(task, PlannedReference):
        return ReferenceStep(task.kind, task.when, task.polarization, duration_s, planned.descending)
    return PositionStep(task, duration_s, planned.descending)


def describe(step: Step) -> str:
    """Return what a step measures, in words."""
    if isinstance(step, PositionStep):
        at = step.position
        return f"theta_i = {at.theta_i_deg:g} deg, theta_mes = {at.theta_mes_deg:g} deg, {at.polarization}"
    if step.kind == "dark":
        return f"dark reading ({step.when})"
    return f"100 % baseline ({step.when}), {step.polarization}"


class Pace:
    """Estimates the time left: the model's, scaled by how much longer the steps so far took than their model.

    The model knows which moves are long, the measurement knows what a reading really takes.  The scale
    starts at one and is believed as steps accumulate, the first step counting as much as the model.
    Pauses are left out.
    """

    def __init__(self, steps: Sequence[Step], now_s: float) -> None:
        self._left_model_s = sum(step.duration_s for step in steps)
        self._weight_s = max(max((step.duration_s for step in steps), default=0.0), 1e-9)
        self._done_model_s = 0.0
        self._began_s = now_s
        self._paused_s = 0.0

    def step_done(self, step: Step) -> None:
        """Count a step."""
        self._done_model_s += step.duration_s
        self._left_model_s -= step.duration_s

    def expect(self, left_model_s: float, longest_s: float) -> None:
        """Say anew what is left, where a source decides on the way."""
        self._left_model_s = left_model_s
        self._weight_s = max(self._weight_s, longest_s)

    def paused(self, duration_s: float) -> None:
        """Leave out a pause."""
        self._paused_s += duration_s

    def left_s(self, now_s: float, step: Step | None, fraction: float) -> float:
        """Return the estimated seconds left when `fraction` of `step` is done."""
        within_s = step.duration_s * fraction if step is not None else 0.0
        measured_s = now_s - self._began_s - self._paused_s
        pace = (measured_s + self._weight_s) / (self._done_model_s + within_s + self._weight_s)
        return max(self._left_model_s - within_s, 0.0) * pace

"""What is done when: the references and positions of a plan in their order, and how long each takes on a rig.

A step is a move of the axes, a turn of the polarizer where it is due, a pass over the wavelengths, a look
whether all stood still, and a record on the disk, which is written while the axes move on.  Its time has two
parts: instrument seconds (motion, settling, averaging) and real seconds (wires and disk, from the rig's
``[latency]``).  They differ on a simulated bench whose clock runs fast.

Not counted: homing, and the way to the first step, since nobody knows where the axes stand.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gonio.devices import Beam, FloatArray, Polarization
from gonio.plan.channels import Channels, channels
from gonio.plan.model import Plan, Position
from gonio.plan.motion import Angles, move_time
from gonio.plan.tables import Kind
from gonio.rig import RigConfig

ReferencePolarization = Literal["any", "s", "p"]

_TURN_EXCHANGES = 3  # where it stands, the turn, where it stands then
_STILL = {
    "stage": 2,
    "polarizer": 1,
}  # exchanges that prove, behind a pass, that nothing has turned meanwhile


@dataclass(frozen=True, slots=True)
class PlannedReference:
    """A dark or baseline reading; `when` is ``start``, ``end`` or ``before K`` with the number of a
    position.
    """

    kind: Kind
    when: str
    polarization: ReferencePolarization


Task = PlannedReference | Position


@dataclass(frozen=True, slots=True)
class PlannedStep:
    """One step: what is measured, whether its pass runs from long to short wavelengths, and its time."""

    task: Task
    descending: bool
    instrument_s: float
    real_s: float


@dataclass(frozen=True, slots=True)
class Timetable:
    """Every step of a scan in measuring order."""

    steps: tuple[PlannedStep, ...]
    clock_speed: float

    @property
    def duration_s(self) -> FloatArray:
        """Duration of each step on the instrument's clock, (n_step,) seconds."""
        return np.array([s.instrument_s + s.real_s * self.clock_speed for s in self.steps], dtype=np.float64)

    @property
    def instrument_s(self) -> float:
        """What motion, settling and averaging take together, instrument seconds."""
        return float(sum(step.instrument_s for step in self.steps))

    @property
    def real_s(self) -> float:
        """What wires and disk take together, real seconds."""
        return float(sum(step.real_s for step in self.steps))

    @property
    def total_s(self) -> float:
        """Duration of the scan on the instrument's clock, seconds."""
        return self.instrument_s + self.real_s * self.clock_speed

    def count(self, kind: Kind) -> int:
        """Return how many references of a kind there are."""
        tasks = (step.task for step in self.steps)
        return sum(isinstance(task, PlannedReference) and task.kind == kind for task in tasks)


def reference_sequence(plan: Plan, when: Literal["start", "end"]) -> list[tuple[Kind, ReferencePolarization]]:
    """Return the reference readings due at `when` as (kind, polarization), in measuring order.

    The dark signal has no polarization (the shutter is closed): it is taken once, for ``any``.
    """
    sequence: list[tuple[Kind, ReferencePolarization]] = []
    if when in plan.references.dark:
        sequence.append(("dark", "any"))
    if when in plan.references.baseline:
        sequence.extend(("baseline", polarization) for polarization in plan.polarization)
    return sequence


def timetable(plan: Plan, rig: RigConfig) -> Timetable:
    """Return the steps of a plan on a rig that `check` accepts.

    The same plan and rig give the same steps, so that an interrupted scan finds its place again.  References
    that are due every so many minutes are placed by the time that this model says.
    """
    course = Course(plan, rig)
    steps = course.start()
    for position in plan.positions():
        steps.extend(course.to(position))
    steps.extend(course.end())
    return Timetable(tuple(steps), rig.clock_speed())


class Course:
    """The steps of a scan one after the other, for whoever does not know all positions before."""

    def __init__(self, plan: Plan, rig: RigConfig) -> None:
        references = plan.references
        self._plan = plan
        self._model = _Model(plan, rig)
        self._kinds = references.periodic_kinds
        self._every_s = 60.0 * (references.every_minutes or np.inf)
        self._every = references.every_positions or np.inf
        self._since_s, self._since = 0.0, 0

    def start(self) -> list[PlannedStep]:
        """Return the references at the start."""
        return self._references("start")

    def to(self, position: Position) -> list[PlannedStep]:
        """Return the references that are due before a position, and the position."""
        model = self._model
        steps: list[PlannedStep] = []
        if self._since and self._kinds and self._due(position):
            due = _periodic(self._plan, self._kinds, position, model.polarization)
            steps.extend(model.step(task) for task in due)
            self._since_s, self._since = 0.0, 0
        step = model.step(position)
        self._since_s += model.seconds(step)
        self._since += 1
        return [*steps, step]

    def end(self) -> list[PlannedStep]:
        """Return the references at the end."""
        return self._references("end")

    def seconds(self, step: PlannedStep) -> float:
        """Return the duration of a step on the instrument's clock."""
        return self._model.seconds(step)

    def _due(self, position: Position) -> bool:
        model = self._model
        return self._since >= self._every or (
            self._since_s + model.seconds(model.next(position)) > self._every_s
        )

    def _references(self, when: Literal["start", "end"]) -> list[PlannedStep]:
        return [
            self._model.step(PlannedReference(kind, when, polarization))
            for kind, polarization in reference_sequence(self._plan, when)
        ]


def _periodic(
    plan: Plan, kinds: tuple[Kind, ...], before: Position, standing: Polarization | None
) -> Iterator[PlannedReference]:
    """Yield the references before a position, the polarizer turning as seldom as it can."""
    when = f"before {before.index}"
    if "dark" in kinds:
        yield PlannedReference("dark", when, "any")
    if "baseline" in kinds:
        rest = [p for p in plan.polarization if p not in (standing, before.polarization)]
        first = [p for p in plan.polarization if p == standing and p != before.polarization]
        for polarization in [*first, *rest, before.polarization]:
            yield PlannedReference("baseline", when, polarization)


class _Model:
    """The rig's state on paper, and what the next step costs from there."""

    def __init__(self, plan: Plan, rig: RigConfig) -> None:
        self.clock_speed = rig.clock_speed()
        self.polarization: Polarization | None = None
        self._plan, self._rig = plan, rig
        self._channels: Channels = channels(plan, rig)
        self._at: Angles | None = None
        self._after: tuple[float, int] | None = None
        self._seen: set[Beam] = set()
        self._passes = 0
        self._pass_time = functools.cache(self._pass_time_of)
        self._move_time = functools.cache(self._move_time_of)

    def seconds(self, step: PlannedStep) -> float:
        """Return the duration of a step on the instrument's clock."""
        return step.instrument_s + step.real_s * self.clock_speed

    def step(self, task: Task) -> PlannedStep:
        """Return a step and stand where it ends."""
        found = self.next(task)
        self._at = self._angles_of(task)
        self._seen.add(_beam_of(task))
        self._passes += 1
        if task.polarization != "any":
            self.polarization = task.polarization
        last = 0 if found.descending else -1
        self._after = (
            float(self._channels.wavelength_nm[last]), int(self._channels.detector_index[last])
        )  # fmt: skip
        return found

    def next(self, task: Task) -> PlannedStep:
        """Return what a step would cost from here."""
        angles, beam, latency = self._angles_of(task), _beam_of(task), self._rig.latency
        move_s, real_s = self._move_time(self._at or angles, angles)
        instrument_s = move_s
        if task.polarization not in ("any", self.polarization):
            # the first one too: where the rotator stands after homing is as good as elsewhere
            instrument_s += self._rig.polarizer.turn_s
            real_s += latency.of({"polarizer": _TURN_EXCHANGES})
        descending = self._plan.order.alternate_wavelengths and self._passes % 2 == 1
        pass_s, pass_real_s = self._pass_time(self._after, descending, beam, beam not in self._seen)
        real_s += pass_real_s + latency.of(_STILL)
        if isinstance(task, Position):  # the axes are on their way to the next one while it is stored
            real_s += max(0.0, latency.record_s - move_s / self.clock_speed)
        else:
            real_s += latency.record_s
        return PlannedStep(task, descending, instrument_s + pass_s, real_s)

    def _angles_of(self, task: Task) -> Angles:
        if isinstance(task, Position):
            return task.theta_i_deg, task.theta_mes_deg
        return self._rig.baseline.theta_i_deg, self._rig.baseline.theta_mes_deg

    def _move_time_of(self, start: Angles, end: Angles) -> tuple[float, float]:
        found = move_time(self._rig, start, end)
        return found.instrument_s, self._rig.latency.of(found.exchanges)

    def _pass_time_of(
        self, after: tuple[float, int] | None, descending: bool, beam: Beam, first: bool
    ) -> tuple[float, float]:
        way = slice(None, None, -1) if descending else slice(None)
        columns = self._channels
        if beam == "sample":
            averages = columns.averages[way]
        else:
            kind: Kind = "dark" if beam == "dark" else "baseline"
            averages = np.full(len(columns), self._plan.references.averages_of(kind), dtype=np.uint32)
        found = self._rig.spectrometer.pass_time(
            columns.wavelength_nm[way], columns.detector_index[way], averages,
            beam=beam, after=after, first=first,
        )  # fmt: skip
        return found.instrument_s, self._rig.latency.of(found.exchanges)


def _beam_of(task: Task) -> Beam:
    if isinstance(task, Position):
        return "sample"
    return "dark" if task.kind == "dark" else "direct"


def estimate(plan: Plan, rig: RigConfig) -> float:
    """Return the estimated duration of the scan on the instrument's clock, seconds; see `timetable`."""
    return timetable(plan, rig).total_s

"""What a running scan has to do next: the steps of a plan, or those that a source decides on the way."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from gonio.acquire.session import Session
from gonio.acquire.sourcing import Asked
from gonio.acquire.steps import Pace, PositionStep, Step, as_step
from gonio.plan.model import Plan, Position
from gonio.plan.timetable import Course, PlannedStep
from gonio.rig import RigConfig
from gonio.store.records import DecisionRecord


class Agenda(Protocol):
    """Gives the steps that are not done yet, one after the other."""

    pace: Pace
    n_done: int  # steps of the whole scan that were done before

    @property
    def n_positions(self) -> int:
        """Positions of the whole scan; where a source decides, at most."""
        ...

    @property
    def n_steps(self) -> int:
        """Steps of the whole scan, references and those done before included; likewise."""
        ...

    @property
    def following(self) -> Step | None:
        """The step that `next` will return, if it is certain already."""
        ...

    def next(self) -> Step | None:
        """Return the step to do now, None at the end; `RefusedError` if a source cannot be followed."""
        ...


class PlanAgenda:
    """The steps of a plan, all of them known."""

    def __init__(self, steps: Sequence[Step], session: Session, now_s: float) -> None:
        self.n_steps = len(steps)
        self.n_positions = sum(isinstance(step, PositionStep) for step in steps)
        self._left = deque(step for step in steps if step.key not in session.done)
        self.n_done = self.n_steps - len(self._left)
        self.pace = Pace(self._left, now_s)

    @property
    def following(self) -> Step | None:
        """The first of those left."""
        return self._left[0] if self._left else None

    def next(self) -> Step | None:
        """Return the first of those left and strike it off."""
        return self._left.popleft() if self._left else None


class SourceAgenda:
    """The steps that a source decides on, with the references that the plan has between them.

    Parameters
    ----------
    first
        What the source asks for first, for the estimate of the time; None if it is in the session's history.
    keep
        Puts a decision on the disk; called before the step that carries it out is returned.
    """

    def __init__(
        self,
        source: Asked,
        plan: Plan,
        rig: RigConfig,
        session: Session,
        now_s: float,
        *,
        first: Position | None,
        keep: Callable[[DecisionRecord], None],
    ) -> None:
        assert session.history is not None
        assert session.header.source is not None
        self._source, self._session, self._history, self._keep = source, session, session.history, keep
        self._most = session.header.source.max_positions
        self._course = Course(plan, rig)
        self._left: deque[Step] = deque()
        self._n_known = self._n_positions = 0
        self._positions_s = 0.0  # of those known
        self._ended = False
        self._add(self._course.start())
        self._typical_s, self._end_s, self._n_end = _sketch(plan, rig, [*self._history.decided, first][0])
        self._add_decided()
        self.n_done = self._n_known - len(self._left)
        self.pace = Pace(self._left, now_s)
        self._expect()

    @property
    def n_positions(self) -> int:
        """All that the source may ask for, until it has ended."""
        return self._n_positions if self._ended else self._most

    @property
    def n_steps(self) -> int:
        """Those known, and until the source has ended all that may follow."""
        if self._ended:
            return self._n_known
        return self._n_known + self._most - self._n_positions + self._n_end

    @property
    def following(self) -> Step | None:
        """The next step of what is decided; what comes behind depends on readings to be made."""
        return self._left[0] if self._left else None

    def next(self) -> Step | None:
        """Return the next step; the source is asked if nothing is left of what it decided."""
        if not self._left and not self._ended:
            position = self._source.decide(self._history.decided, self._history.measured)
            if position is None:
                self._ended = True
                self._add(self._course.end())
            else:
                self._keep(
                    DecisionRecord(
                        position.index, position.theta_i_deg, position.theta_mes_deg, position.polarization
                    )
                )
                self._add_decided()
        self._expect()
        return self._left.popleft() if self._left else None

    def _add_decided(self) -> None:
        for position in self._history.decided[self._n_positions :]:
            steps = self._course.to(position)
            self._n_positions += 1
            self._positions_s += self._course.seconds(steps[-1])
            self._add(steps)

    def _add(self, planned: Sequence[PlannedStep]) -> None:
        self._n_known += len(planned)
        steps = [as_step(step, self._course.seconds(step)) for step in planned]
        self._left.extend(step for step in steps if step.key not in self._session.done)

    def _expect(self) -> None:
        """Tell the pace what is left at most: the positions to come take as long as those before."""
        if self._n_positions:
            self._typical_s = self._positions_s / self._n_positions
        left_s = sum(step.duration_s for step in self._left)
        if not self._ended:
            left_s += (self._most - self._n_positions) * self._typical_s + self._end_s
        self.pace.expect(left_s, self._typical_s)


def _sketch(plan: Plan, rig: RigConfig, position: Position | None) -> tuple[float, float, int]:
    """Return the duration of a position and of the references at the end, seconds, and how many these are."""
    course = Course(plan, rig)
    course.start()
    position_s = 0.0 if position is None else course.seconds(course.to(position)[-1])
    end = course.end()
    return position_s, sum(course.seconds(step) for step in end), len(end)

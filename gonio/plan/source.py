"""Where the next position comes from: a plan that is fixed, or a source that looks at the data so far.

A `PositionSource` is a function of what was measured: asked again with the same readings it gives the same
position, so that a scan whose process died finds its place by asking again.  A fixed plan is the source that
does not look.  How a scan keeps a source's decisions: docs/decisions/position-sources.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gonio.devices import FloatArray
from gonio.errors import RefusedError, StoreError
from gonio.plan.check import Refusal, refused_visit
from gonio.plan.model import Plan, Position
from gonio.plan.motion import Angles
from gonio.rig import RigConfig


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What a source is told of one position; arrays are (m,), in the columns of the scan.

    `r` is corrected with the references that had been measured when the position was: it is not touched again
    for the source when later references refine it in the file, or a resumed scan would be asked another
    question. A position that had to be skipped is here too, with NaN.
    """

    position: Position  # as it was asked for
    theta_i_deg: float  # read back
    theta_mes_deg: float
    wavelength_nm: FloatArray
    r: FloatArray
    r_sd: FloatArray
    quality: NDArray[np.uint16]


class PositionSource(Protocol):
    """Decides what is measured next."""

    @property
    def max_positions(self) -> int:
        """Most positions it will ever ask for: the file has room for so many, and says how many were
        planned.
        """
        ...

    def next(self, measured: Sequence[Measured]) -> Position | None:
        """Return the next position, numbered ``len(measured)``, or None when enough is known.

        Must depend on `measured` alone: not on time, on chance without a fixed seed, or on earlier calls.
        """
        ...


@dataclass(frozen=True, slots=True)
class PlanSource:
    """The positions of a plan, whatever is measured."""

    positions: tuple[Position, ...]

    @classmethod
    def of(cls, plan: Plan) -> PlanSource:
        """Return the source of a plan's positions."""
        return cls(plan.positions())

    @property
    def max_positions(self) -> int:
        """Number of positions."""
        return len(self.positions)

    def next(self, measured: Sequence[Measured]) -> Position | None:
        """Return the position behind those measured."""
        return self.positions[len(measured)] if len(measured) < len(self.positions) else None


@dataclass(frozen=True, slots=True)
class UntilSource:
    """The positions of a plan in their order, until what was measured is enough.

    Attributes
    ----------
    enough
        Called with all that was measured after each position; true ends the scan.  It must depend on nothing
        else.
    """

    positions: tuple[Position, ...]
    enough: Callable[[Sequence[Measured]], bool]

    @classmethod
    def of(cls, plan: Plan, enough: Callable[[Sequence[Measured]], bool]) -> UntilSource:
        """Return the source of a plan's positions."""
        return cls(plan.positions(), enough)

    @property
    def max_positions(self) -> int:
        """Number of the plan's positions."""
        return len(self.positions)

    @property
    def text(self) -> str:
        """What the scan file says of it."""
        criterion = getattr(self.enough, "__qualname__", type(self.enough).__qualname__)
        return f"{len(self.positions)} positions in the order of the plan, until {criterion}"

    def next(self, measured: Sequence[Measured]) -> Position | None:
        """Return the position behind those measured; None if there is none, or enough is known."""
        if len(measured) >= len(self.positions) or (measured and self.enough(measured)):
            return None
        return self.positions[len(measured)]


def decide(
    source: PositionSource,
    rig: RigConfig,
    decided: Sequence[Position],
    measured: Sequence[Measured],
) -> tuple[Position | None, bool]:
    """Return the position to measure next, and whether it is a new decision that must be kept first.

    Parameters
    ----------
    decided
        Every position that was kept as decided, the measured ones first.
    measured
        What was measured at them, in order.

    Raises
    ------
    RefusedError
        The source asks for something that the rig must not do, for a wrong number, or for more than it said.
    """
    if len(decided) > len(measured):
        return decided[len(measured)], False  # its decision is safe, the scan died before its reading was
    position = source.next(measured)
    if position is None:
        return None, False
    index = len(measured)
    if position.index != index:
        raise RefusedError(
            f"the source of positions gave number {position.index} where {index} is next; its positions must "
            "count from zero in the order in which it gives them"
        )
    if index >= source.max_positions:
        raise RefusedError(
            f"the source of positions asks for position {index + 1}, more than its max_positions = "
            f"{source.max_positions}; the file has room for so many, raise it"
        )
    before: Angles | None = None
    if decided:
        before = decided[-1].theta_i_deg, decided[-1].theta_mes_deg
    reason = refused_visit(rig, before, (position.theta_i_deg, position.theta_mes_deg))
    if reason:
        raise RefusedError(f"the source of positions asks for {Refusal(reason, position)}")
    return position, True


def check_same(
    source: PositionSource, measured: Sequence[Measured], pending: Sequence[Position] = ()
) -> None:
    """Make sure that a source decides as it did when the scan was begun.

    Parameters
    ----------
    measured
        What was measured, in order.
    pending
        What was decided behind that; only the first depends on nothing else than `measured`.

    Raises
    ------
    StoreError
        It gives another position for the same readings: it is another source, another version of it, or
        depends on something else.
    """
    decided = [*((found.position, "measured") for found in measured), *((p, "decided") for p in pending[:1])]
    for index, (position, what) in enumerate(decided):
        again = source.next(measured[:index])
        if again != position:
            shown = "no position" if again is None else _shown(again)
            raise StoreError(
                f"the source of positions gives {shown} for position {index + 1}, which was {what} at "
                f"{_shown(position)}; resume the scan with the source and version that began it"
            )


def _shown(position: Position) -> str:
    return (
        f"theta_i = {position.theta_i_deg:g} deg, theta_mes = {position.theta_mes_deg:g} deg, "
        f"{position.polarization}"
    )

"""A source of positions that sees the data: it goes on where it was, whenever the process dies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.errors import RefusedError, StoreError
from gonio.plan import Plan, Position, parse_plan
from gonio.plan.source import Measured, PlanSource, PositionSource, check_same, decide
from gonio.rig import RigConfig, load_rig

RIG = load_rig()
PLAN = "[[wavelengths]]\nvalues_nm = [500.0]\n[[sweeps]]\ntheta_i_deg = 30\ntheta_mes_deg = [20, 40, 60]\n"


def reading(position: Position, r: float) -> Measured:
    one = np.full(1, r)
    return Measured(
        position, position.theta_i_deg + 0.002, position.theta_mes_deg - 0.003, np.full(1, 500.0),
        one, 0.01 * one, np.zeros(1, dtype=np.uint16),
    )  # fmt: skip


def lobe(position: Position) -> float:
    return float(np.exp(-(((position.theta_mes_deg - 72.3) / 8.0) ** 2)))


@dataclass(frozen=True)
class Climber:
    """Goes uphill with halving steps until they are fine enough: what is next depends on every reading."""

    max_positions: int = 40

    def next(self, measured: Sequence[Measured]) -> Position | None:
        step, at = 16.0, 30.0
        best, best_at = -1.0, at
        for found in measured:
            if found.r[0] > best:
                best, best_at = float(found.r[0]), found.position.theta_mes_deg
                at = best_at + step
            else:
                step = -0.5 * step
                at = best_at + step
        return None if abs(step) < 0.5 else Position(len(measured), 45.0, at, "s")


class Bench:
    """What a scan keeps: decisions first, then readings; it may die between any two of them."""

    def __init__(self, source: PositionSource, rig: RigConfig) -> None:
        self.source, self.rig = source, rig
        self.decided: list[Position] = []
        self.measured: list[Measured] = []

    def run(self, writes: int) -> bool:
        """Write at most so many records; say whether the scan is complete."""
        for _ in range(writes):
            position, is_new = decide(self.source, self.rig, self.decided, self.measured)
            if position is None:
                return True
            if is_new:
                self.decided.append(position)
            else:
                self.measured.append(reading(position, lobe(position)))
        return False


@given(deaths=st.lists(st.integers(0, 5), max_size=12))
def test_a_scan_that_died_anywhere_ends_with_the_same_positions(deaths: list[int]) -> None:
    rig = RIG
    whole, broken = Bench(Climber(), rig), Bench(Climber(), rig)
    assert whole.run(1000)
    for writes in deaths:
        broken.run(writes)
        broken.source = Climber()  # another process: nothing is remembered but the records
    assert broken.run(1000)
    assert broken.decided == whole.decided
    assert [m.position for m in broken.measured] == whole.decided
    assert abs(whole.decided[-1].theta_mes_deg - 72.3) < 8.0
    check_same(Climber(), broken.measured)


def test_a_plan_is_the_source_that_does_not_look(a_rig: RigConfig) -> None:
    plan: Plan = parse_plan(PLAN)
    bench = Bench(PlanSource.of(plan), a_rig)
    assert bench.run(1000)
    assert tuple(bench.decided) == plan.positions()
    assert bench.source.max_positions == plan.n_positions


def test_a_source_that_decides_otherwise_is_found_out(a_rig: RigConfig) -> None:
    bench = Bench(Climber(), a_rig)
    bench.run(8)
    with pytest.raises(StoreError, match=r"gives theta_i = 30 deg, .* for position 1, which was measured at"):
        check_same(PlanSource.of(parse_plan(PLAN)), bench.measured)


@dataclass(frozen=True)
class Always:
    position: Position
    max_positions: int = 2

    def next(self, measured: Sequence[Measured]) -> Position | None:
        return self.position


@pytest.mark.parametrize(
    ("position", "words"),
    [
        (Position(0, 30.0, 12.0, "s"), "asks for position 1 .*blind zone"),
        (Position(0, 30.0, 181.0, "s"), "outside the limits"),
        (Position(4, 30.0, 40.0, "s"), "gave number 4 where 0 is next"),
    ],
)
def test_what_the_rig_must_not_do_is_refused_before_it_is_kept(
    a_rig: RigConfig, position: Position, words: str
) -> None:
    with pytest.raises(RefusedError, match=words):
        decide(Always(position), a_rig, [], [])


def test_more_positions_than_announced_are_refused(a_rig: RigConfig) -> None:
    first, second = Position(0, 30.0, 40.0, "s"), Position(1, 30.0, 41.0, "s")
    kept = [reading(first, 1.0), reading(second, 1.0)]
    with pytest.raises(RefusedError, match="max_positions = 2"):
        decide(Always(Position(2, 30.0, 42.0, "s")), a_rig, [first, second], kept)

"""In which order positions are measured, and what orders cost."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.plan import Plan, estimate, order_costs, parse_plan, resolved
from gonio.plan.order import Place, arrange
from gonio.plan.tables import Order
from gonio.rig import RigConfig

PLAN = """
[[wavelengths]]
values_nm = [500.0]
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = [15.0, 30.0, 45.0]
[[sweeps]]
theta_i_deg = 50.0
theta_mes_deg = [20.0, 40.0]
"""


def angles(plan: Plan) -> list[tuple[float, float, str]]:
    return [(p.theta_i_deg, p.theta_mes_deg, p.polarization) for p in plan.positions()]


def ordered(text: str) -> list[tuple[float, float, str]]:
    return angles(parse_plan(PLAN + text))


def test_serpentine_begins_each_sweep_where_the_last_one_ended() -> None:
    assert ordered('[order]\nkind = "serpentine"\n') == [
        (20, 15, "s"), (20, 30, "s"), (20, 45, "s"), (20, 45, "p"), (20, 30, "p"), (20, 15, "p"),
        (50, 20, "p"), (50, 40, "p"), (50, 40, "s"), (50, 20, "s"),
    ]  # fmt: skip


def test_nested_with_the_polarizer_innermost_and_the_arm_falling() -> None:
    text = '[order]\nkind = "nested"\nnesting = ["theta_i", "theta_mes", "polarization"]\ndescending = true\n'
    assert ordered(text)[:4] == [(20, 45, "s"), (20, 45, "p"), (20, 30, "s"), (20, 30, "p")]


def test_random_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    one, again, other = (ordered(f'[order]\nkind = "random"\nseed = {seed}\n') for seed in (1, 1, 2))
    assert one == again
    assert one != other
    assert sorted(one) == sorted(other) == sorted(ordered(""))


def test_a_random_order_without_a_seed_stores_the_one_it_uses() -> None:
    plan = parse_plan(PLAN + '[order]\nkind = "random"\n')
    assert "seed = 0" in plan.to_toml()


def test_repeats_of_the_plan_and_of_each_position() -> None:
    once = ordered("")
    assert ordered("[repeats]\ncount = 2\n") == once + once
    assert ordered('[repeats]\ncount = 2\nof = "position"\n') == [place for place in once for _ in range(2)]
    there = ordered('[order]\nkind = "serpentine"\n')
    assert ordered('[order]\nkind = "serpentine"\n[repeats]\ncount = 2\n') == there + there[::-1]


def test_each_repeat_of_a_random_order_is_shuffled_anew() -> None:
    found = ordered('[order]\nkind = "random"\n[repeats]\ncount = 2\n')
    assert found[:10] != found[10:]
    assert sorted(found[:10]) == sorted(found[10:])


places = st.lists(
    st.tuples(st.integers(0, 4), st.integers(15, 30), st.sampled_from(["s", "p"])).map(
        lambda t: Place(float(t[0]), float(t[1]), t[2])  # type: ignore[arg-type]
    ),
    unique=True,
    min_size=1,
    max_size=25,
)
orders = st.one_of(
    st.builds(Order, kind=st.sampled_from(["as_written", "optimised"])),
    st.builds(lambda seed: Order(kind="random", seed=seed), st.integers(0, 2**63 - 1)),
    st.builds(
        Order,
        kind=st.sampled_from(["nested", "serpentine"]),
        nesting=st.permutations(["theta_i", "polarization", "theta_mes"]).map(tuple),
        descending=st.booleans(),
        alternate_wavelengths=st.booleans(),
    ),
)


@given(places=places, order=orders, repeats=st.integers(1, 3), of=st.sampled_from(["plan", "position"]))
def test_no_order_loses_or_doubles_a_position(
    places: list[Place], order: Order, repeats: int, of: str
) -> None:
    found = arrange(places, order, repeats=repeats, of=of)
    assert sorted(found) == sorted(places * repeats)


@given(places=places)
def test_to_and_fro_the_slowest_axis_turns_once_per_value(places: list[Place]) -> None:
    found = arrange(places, Order(kind="serpentine"), repeats=1, of="plan")
    turns = sum(a.theta_i_deg != b.theta_i_deg for a, b in pairwise(found))
    assert turns == len({place.theta_i_deg for place in places}) - 1


def test_optimised_is_the_cheapest_order_and_is_stored_resolved(a_rig: RigConfig) -> None:
    plan = parse_plan(PLAN + '[order]\nkind = "optimised"\n')
    best = resolved(plan, a_rig)
    assert best.order.kind in ("nested", "serpentine")
    assert sorted(angles(best)) == sorted(angles(plan))
    assert parse_plan(best.to_toml()) == best
    assert resolved(best, a_rig) is best
    costs = order_costs(plan, a_rig)
    assert costs[0].total_s == estimate(best, a_rig) == min(cost.total_s for cost in costs)


def test_the_plans_own_order_comes_first_and_others_follow_by_time(a_rig: RigConfig) -> None:
    plan = parse_plan(PLAN)
    costs = order_costs(plan, a_rig)
    assert costs[0].order == plan.order
    assert costs[0].total_s == estimate(plan, a_rig)
    assert [c.total_s for c in costs[1:]] == sorted(c.total_s for c in costs[1:])
    assert costs[1].total_s < costs[0].total_s


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('kind = "random"\nnesting = ["theta_i", "polarization", "theta_mes"]', "nesting has no meaning"),
        ('kind = "serpentine"\nseed = 3', "seed has no meaning"),
        ('kind = "serpentine"\nnesting = ["theta_i", "theta_i", "theta_mes"]', "once each"),
        ('kind = "zigzag"', "'serpentine'"),
        ('knid = "random"', "did you mean 'kind'"),
    ],
)
def test_an_order_that_makes_no_sense_is_refused(text: str, words: str) -> None:
    from gonio.errors import ConfigError

    with pytest.raises(ConfigError, match=words):
        parse_plan(PLAN + "[order]\n" + text + "\n")


def test_the_examples_folder_shows_an_optimised_plan() -> None:
    root = Path(__file__).parents[3]
    assert 'kind = "optimised"' in (root / "examples/plans/complete.toml").read_text(encoding="utf-8")

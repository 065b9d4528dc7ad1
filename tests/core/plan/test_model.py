"""What a plan file means, and what it must not say."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.errors import ConfigError
from gonio.plan import Plan, load_plan, parse_plan

ROOT = Path(__file__).parents[3]

GOOD = """
[[wavelengths]]
start_nm = 300.0
stop_nm = 400.0
step_nm = 10
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = [15.0, 18.0]
"""


def test_the_papers_plan_is_146_positions_in_s_and_p_at_121_wavelengths() -> None:
    plan = Plan.paper()
    positions = plan.positions()
    assert len(positions) == plan.n_positions == 2 * 146
    np.testing.assert_array_equal(plan.wavelength_nm, np.arange(300.0, 1501.0, 10.0))
    for theta_i, count, last_theta_o in ((20, 31, 85), (30, 34, 84), (45, 38, 81), (55, 43, 86)):
        for polarization in ("s", "p"):
            mine = [p for p in positions if p.theta_i_deg == theta_i and p.polarization == polarization]
            assert len(mine) == count
            assert mine[0].theta_mes_deg == 15.0
            assert mine[-1].theta_o_deg == last_theta_o
            assert np.all(np.diff([p.theta_mes_deg for p in mine]) == 3.0)


def test_the_order_is_s_then_p_within_each_incidence_and_indices_count_up() -> None:
    positions = Plan.paper().positions()
    assert [p.index for p in positions] == list(range(len(positions)))
    runs = [(p.theta_i_deg, p.polarization) for p in positions]
    changes = [runs[0], *(b for a, b in pairwise(runs) if a != b)]
    assert changes == [(t, p) for t in (20.0, 30.0, 45.0, 55.0) for p in ("s", "p")]


def test_the_example_is_the_built_in_plan() -> None:
    assert load_plan(ROOT / "examples/plans/hpl.toml") == Plan.paper()
    built_in = (ROOT / "gonio/data/hpl.toml").read_text(encoding="utf-8")
    assert (ROOT / "examples/plans/hpl.toml").read_text(encoding="utf-8") == built_in


@pytest.mark.parametrize("path", sorted((ROOT / "examples/plans").glob("*.toml")), ids=lambda p: p.name)
def test_every_example_is_a_valid_plan(path: Path) -> None:
    assert load_plan(path).n_positions > 0


def test_defaults_are_s_and_p_with_references_at_both_ends() -> None:
    plan = parse_plan(GOOD)
    assert plan.polarization == ("s", "p")
    assert plan.references.dark == plan.references.baseline == ("start", "end")
    assert plan.reading.averages == 1
    assert plan.references.averages == 4


def test_several_ranges_and_lists_are_one_ascending_list() -> None:
    plan = parse_plan(GOOD.replace("[[sweeps]]", "[[wavelengths]]\nvalues_nm = [450.5, 500.0]\n[[sweeps]]"))
    np.testing.assert_array_equal(plan.wavelength_nm, [*np.arange(300, 401, 10), 450.5, 500.0])


def test_a_range_stops_at_the_last_step_below_its_stop() -> None:
    plan = parse_plan(GOOD.replace("step_nm = 10", "step_nm = 30"))
    np.testing.assert_array_equal(plan.wavelength_nm, [300.0, 330.0, 360.0, 390.0])


def test_decimal_steps_do_not_gather_rounding_errors() -> None:
    plan = parse_plan(GOOD.replace("step_nm = 10", "step_nm = 0.1"))
    assert len(plan.wavelength_nm) == 1001
    assert plan.wavelength_nm.tolist() == [float(f"{300 + i / 10:.1f}") for i in range(1001)]


MISTAKES = {
    "empty file": ("", ["wavelengths is missing"]),
    "not toml": ("title = x y\n", ["not valid TOML", "line 1"]),
    "unknown key": ("titel = 'x'\n" + GOOD, ["titel is an unknown key", "did you mean 'title'"]),
    "wrong unit": (
        GOOD.replace("theta_i_deg", "theta_i_rad"),
        ["sweeps[1].theta_i_rad is an unknown key", "did you mean 'theta_i_deg'"],
    ),
    "micrometres": (GOOD.replace("start_nm", "start_um"), ["wavelengths[1].start_um", "'start_nm'"]),
    "text for a number": (
        GOOD.replace("theta_i_deg = 20.0", 'theta_i_deg = "20"'),
        ["sweeps[1].theta_i_deg = '20'", "number"],
    ),
    "not a number": (GOOD.replace("20.0", "nan"), ["sweeps[1].theta_i_deg", "finite"]),
    "reversed range": (
        GOOD.replace("300.0", "500.0"),
        ["start_nm = 500 nm is above stop_nm = 400 nm", "swap"],
    ),
    "zero step": (GOOD.replace("step_nm = 10", "step_nm = 0"), ["step_nm = 0 nm must be positive"]),
    "negative step": (GOOD.replace("step_nm = 10", "step_nm = -1"), ["step_nm = -1 nm must be positive"]),
    "negative wavelength": (GOOD.replace("300.0", "-300.0"), ["wavelengths[1].start_nm = -300.0"]),
    "huge count": (
        GOOD.replace("step_nm = 10", "step_nm = 1e-6"),
        ["makes 100000001 wavelengths", "more than 100000"],
    ),
    "absurd count": (GOOD.replace("step_nm = 10", "step_nm = 1e-300"), ["wavelengths, more than 100000"]),
    "half a range": (
        GOOD.replace("stop_nm = 400.0\n", ""),
        ["wavelengths[1]", "all of start_nm, stop_nm and step_nm"],
    ),
    "range and list": (GOOD.replace("step_nm = 10", "step_nm = 10\nvalues_nm = [1.0]"), ["not both"]),
    "duplicated wavelength": (
        GOOD + "[[wavelengths]]\nvalues_nm = [400.0, 500.0]\n",
        ["400 nm is listed twice"],
    ),
    "descending wavelengths": (
        GOOD + "[[wavelengths]]\nvalues_nm = [350.0]\n",
        ["350 nm comes after 400 nm", "ascending"],
    ),
    "no sweep": ("sweeps = []\n" + GOOD.partition("[[sweeps]]")[0], ["sweeps is missing"]),
    "empty angles": (GOOD.replace("[15.0, 18.0]", "[]"), ["the list of angles is empty"]),
    "one number for angles": (GOOD.replace("[15.0, 18.0]", "15.0"), ["theta_mes_deg = 15.0", "a list"]),
    "mistyped range": (
        GOOD.replace("[15.0, 18.0]", "{ start = 15, stop = 18, stepp = 1 }"),
        ["stepp is an unknown key", "did you mean 'step'"],
    ),
    "text among angles": (GOOD.replace("18.0]", "'x']"), ["theta_mes_deg.values[2] = 'x'"]),
    "repeated position": (GOOD.replace("18.0]", "15.0]"), ["theta_mes = 15 deg is already in sweeps[1]"]),
    "repeated sweep": (
        GOOD + "[[sweeps]]\ntheta_i_deg = 20.0\ntheta_mes_deg = [18.0]\n",
        ["sweeps[2]", "theta_mes = 18 deg is already in sweeps[1]"],
    ),
    "incidence from behind": (GOOD.replace("20.0", "120.0"), ["theta_i_deg = 120.0", "between -90 and 90"]),
    "capital S": ('polarization = ["S"]\n' + GOOD, ["polarization[1] = 'S'", "'s' or 'p'"]),
    "not a list": ('polarization = "s"\n' + GOOD, ["polarization = 's'", 'such as ["s", "p"]']),
    "s twice": ('polarization = ["s", "s"]\n' + GOOD, ["'s' is listed twice"]),
    "no polarization": ("polarization = []\n" + GOOD, ["list of polarizations is empty"]),
    "no baseline": (GOOD + "[references]\nbaseline = []\n", ["references.baseline", "baseline reading"]),
    "unknown time": (GOOD + '[references]\ndark = ["middle"]\n', ["references.dark[1] = 'middle'"]),
    "no average": (GOOD + "[reading]\naverages = 0\n", ["reading.averages = 0", "greater than or equal"]),
    "half an average": (GOOD + "[reading]\naverages = 1.5\n", ["reading.averages = 1.5"]),
}


@pytest.mark.parametrize(("text", "expected"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_gets_one_clear_message(text: str, expected: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_plan(text, source="my.toml")
    message = str(caught.value)
    for part in expected:
        assert part in message
    lines = message.splitlines()
    assert all(line.startswith("my.toml: ") for line in lines)
    wrong_key = "unknown key" in message and "missing; add it" in message  # a wrong key is also a missing one
    assert len(lines) == (2 if wrong_key else 1)


def test_too_many_positions_are_refused_with_their_number() -> None:
    text = GOOD.replace("[15.0, 18.0]", "{ start = 15.0, stop = 105.0, step = 0.001 }")
    for i in range(6):
        text += (
            f"[[sweeps]]\ntheta_i_deg = {30 + i}\ntheta_mes_deg = {{start = 15, stop = 105, step = 0.001}}\n"
        )
    with pytest.raises(ConfigError, match=r"1260014 positions are more than 1000000"):
        parse_plan(text)


def test_too_many_readings_are_refused_with_their_number() -> None:
    text = GOOD.replace("step_nm = 10", "step_nm = 0.01") + "[reading]\naverages = 50000\n"
    with pytest.raises(ConfigError, match=r"2000200000 readings"):
        parse_plan(text)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.toml: there is no such file"):
        load_plan(tmp_path / "nowhere.toml")


angles = st.floats(-89.0, 89.0).map(lambda a: round(a, 3) + 0.0)


@given(
    incidences=st.lists(angles, min_size=1, max_size=4, unique=True),
    theta_mes=st.lists(angles, min_size=1, max_size=8, unique=True),
    wavelength_nm=st.lists(st.floats(200.0, 2500.0).map(lambda w: round(w, 3)), min_size=1, unique=True),
    polarization=st.sampled_from([("s",), ("p",), ("s", "p"), ("p", "s")]),
    title=st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=20),
    averages=st.integers(1, 9),
)
def test_to_toml_and_back_is_the_same_plan(
    incidences: list[float],
    theta_mes: list[float],
    wavelength_nm: list[float],
    polarization: tuple[str, ...],
    title: str,
    averages: int,
) -> None:
    plan = Plan.model_validate(
        {
            "title": title,
            "polarization": polarization,
            "wavelengths": [{"values_nm": sorted(wavelength_nm)}],
            "sweeps": [
                {"theta_i_deg": incidences[0], "theta_mes_deg": {"start": 1.0, "stop": 2.0, "step": 0.25}},
                *({"theta_i_deg": t, "theta_mes_deg": theta_mes} for t in incidences[1:]),
            ],
            "reading": {"averages": averages},
        }
    )
    again = parse_plan(plan.to_toml())
    assert again == plan
    assert again.positions() == plan.positions()
    np.testing.assert_array_equal(again.wavelength_nm, plan.wavelength_nm)

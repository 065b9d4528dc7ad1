"""Positions one by one, from a plan or a CSV file; what is out of plane; every feature to TOML and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.errors import ConfigError
from gonio.plan import Plan, load_plan, parse_plan, positions_from_csv

WAVELENGTHS = "[[wavelengths]]\nvalues_nm = [500.0]\n"


def places(plan: Plan) -> list[tuple[float, float, str]]:
    return [(p.theta_i_deg, p.theta_mes_deg, p.polarization) for p in plan.positions()]


def with_csv(folder: Path, csv: str, *, top: str = "") -> Plan:
    (folder / "list.csv").write_text(csv, encoding="utf-8")
    plan = folder / "plan.toml"
    plan.write_text(top + WAVELENGTHS + '[[positions]]\nfile = "list.csv"\n', encoding="utf-8")
    return load_plan(plan)


def test_rows_are_measured_in_every_polarization_unless_they_name_one() -> None:
    plan = parse_plan(
        WAVELENGTHS + "[[positions]]\ntheta_i_deg = [20, 30]\ntheta_mes_deg = [40, 60]\n"
        '[[positions]]\ntheta_i_deg = [50, 45]\ntheta_mes_deg = [100, 90]\npolarization = ["p", "s"]\n'
    )
    assert places(plan) == [
        (20, 40, "s"), (30, 60, "s"), (20, 40, "p"), (30, 60, "p"), (50, 100, "p"), (45, 90, "s"),
    ]  # fmt: skip
    assert plan.n_positions == 6


def test_a_csv_file_is_stored_in_the_plan_so_that_it_is_not_needed_again(tmp_path: Path) -> None:
    csv = "# my list\ntheta_mes_deg, theta_i_deg, polarization\n40, 20, p\n\n60.5,30,s\n"
    plan = with_csv(tmp_path, csv)
    (tmp_path / "list.csv").unlink()
    assert places(plan) == [(20, 40, "p"), (30, 60.5, "s")]
    again = parse_plan(plan.to_toml())
    assert again == plan
    assert 'copied_from = "list.csv"' in plan.to_toml()


def test_a_list_for_python_is_read_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("theta_i_deg,theta_mes_deg\n20,40\n", encoding="utf-8")
    listed = positions_from_csv(tmp_path / "a.csv")
    plan = Plan.model_validate({"wavelengths": [{"values_nm": [500.0]}], "positions": [listed]})
    assert places(plan) == [(20, 40, "s"), (20, 40, "p")]


CSV_MISTAKES = {
    "": ["is empty"],
    "theta_i_deg\n20\n": ["column theta_mes_deg is missing"],
    "theta_i_deg,theta_mess_deg\n20,30\n": [
        "'theta_mess_deg' is an unknown column",
        "did you mean 'theta_mes_deg'",
    ],
    "theta_i_deg,theta_mes_deg,theta_i_deg\n1,2,3\n": ["theta_i_deg is there twice"],
    "theta_i_deg,theta_mes_deg\n": ["lists no position"],
    "theta_i_deg,theta_mes_deg\n20,x\n": ["line 2", "theta_mes_deg = 'x'"],
    "theta_i_deg,theta_mes_deg\n20,nan\n": ["line 2", "theta_mes_deg = 'nan'"],
    "theta_i_deg,theta_mes_deg\n20,5,40\n": ["line 2 has 3 values for 2 columns", "decimal sign"],
    "theta_i_deg,theta_mes_deg,polarization\n20,40,S\n": ["line 2", "polarization = 'S'", "s or p"],
    "theta_i_deg,theta_mes_deg\n20,40\n20,40\n": ["positions[1] row 2", "already in positions[1] row 1"],
    "theta_i_deg,theta_mes_deg\n120,40\n": ["theta_i_deg[1] = 120 deg", "between -90 and 90"],
    "theta_i_deg,theta_mes_deg,phi_o_deg\n20,40,0\n": ["phi_o_deg", "outside the plane of incidence"],
}


@pytest.mark.parametrize(("csv", "words"), CSV_MISTAKES.items())
def test_a_mistake_in_a_csv_file_is_explained_with_its_line(
    tmp_path: Path, csv: str, words: list[str]
) -> None:
    with pytest.raises(ConfigError) as caught:
        with_csv(tmp_path, csv)
    for word in words:
        assert word in str(caught.value)


MISTAKES = {
    "theta_i_deg = [20]\ntheta_mes_deg = [40, 50]\n": ["different lengths (theta_i_deg 1, theta_mes_deg 2)"],
    "theta_i_deg = []\ntheta_mes_deg = []\n": ["lists no position"],
    "theta_i_deg = [20]\ntheta_mes_deg = [40]\nfile = 'x.csv'\n": ["either file = 'x.csv' or the columns"],
    "file = 'x.csv'\n": ["is read only when the plan itself is read from a file", "load_plan"],
    "theta_i_deg = 20\ntheta_mes_deg = [40]\n": ["must be a list of angles"],
    "theta_i_dg = [20]\ntheta_mes_deg = [40]\n": ["unknown key", "did you mean 'theta_i_deg'"],
}


@pytest.mark.parametrize(("table", "words"), MISTAKES.items())
def test_a_mistake_in_a_list_is_explained(table: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_plan(WAVELENGTHS + "[[positions]]\n" + table)
    for word in words:
        assert word in str(caught.value)


def test_a_missing_csv_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(WAVELENGTHS + '[[positions]]\nfile = "no.csv"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"no\.csv: there is no such file"):
        load_plan(tmp_path / "plan.toml")


def test_a_polarization_without_baselines_is_refused(tmp_path: Path) -> None:
    csv = "theta_i_deg,theta_mes_deg,polarization\n20,40,p\n"
    with pytest.raises(ConfigError, match=r"'p' is not in the plan's polarization = \['s'\]"):
        with_csv(tmp_path, csv, top='polarization = ["s"]\n')


@pytest.mark.parametrize(
    "text",
    [
        "phi_o_deg = 10.0\n" + WAVELENGTHS + "[[sweeps]]\ntheta_i_deg = 20\ntheta_mes_deg = [40]\n",
        WAVELENGTHS + "[[sweeps]]\ntheta_i_deg = 20\ntheta_mes_deg = [40]\nphi_o_deg = 90.0\n",
        WAVELENGTHS + "[[positions]]\ntheta_i_deg = [20]\ntheta_mes_deg = [40]\nphi_o_deg = [0.0]\n",
        WAVELENGTHS
        + "[[sweeps]]\ntheta_i_deg = 20\ntheta_mes_deg = { start = 9, stop = 18, step = 3, phi_o_deg = 1 }\n",
    ],
)
def test_out_of_plane_is_refused_with_what_the_instrument_can_do(text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_plan(text)
    assert "phi_o_deg asks for a direction outside the plane of incidence" in str(caught.value)
    assert "theta_i_deg and theta_mes_deg" in str(caught.value)


# -- round trip
# -----------------------------------------------------------------------------------------------

angle = st.floats(-89.0, 89.0).map(lambda a: round(a, 3) + 0.0)
duration = st.floats(0.01, 1e4).map(lambda t: round(t, 3))
averaged = st.one_of(
    st.just({}), st.builds(lambda n: {"averages": n}, st.integers(1, 99)),
    st.builds(lambda t: {"integration_s": t}, duration),
)  # fmt: skip
WHEN = st.sampled_from([["start"], ["end"], ["start", "end"]])


@st.composite
def plans(draw: st.DrawFn) -> dict[str, Any]:
    """A plan with any of its features."""
    edges = sorted(draw(st.lists(st.integers(200, 2000), min_size=2, max_size=6, unique=True)))
    polarization = draw(st.sampled_from([["s"], ["p"], ["s", "p"], ["p", "s"]]))
    cells = draw(st.lists(st.tuples(angle, angle), min_size=1, max_size=8, unique=True))
    listed: dict[str, Any] = {
        "theta_i_deg": [c[0] for c in cells], "theta_mes_deg": [c[1] + 100.0 for c in cells],
    }  # fmt: skip
    if draw(st.booleans()):
        listed["polarization"] = [draw(st.sampled_from(polarization)) for _ in cells]
    if draw(st.booleans()):
        listed["copied_from"] = "some.csv"
    period = draw(
        st.one_of(
            st.just({}),
            st.builds(lambda t: {"every_minutes": t}, duration),
            st.builds(lambda n: {"every_positions": n}, st.integers(1, 50)),
        )
    )
    if period:
        period["periodic"] = draw(st.sampled_from([["dark"], ["baseline"], ["baseline", "dark"]]))
    order = draw(
        st.one_of(
            st.builds(lambda kind: {"kind": kind}, st.sampled_from(["as_written", "optimised", "random"])),
            st.builds(lambda seed: {"kind": "random", "seed": seed}, st.integers(0, 2**63 - 1)),
            st.builds(
                lambda kind, nesting, falls: {"kind": kind, "nesting": nesting, "descending": falls},
                st.sampled_from(["nested", "serpentine"]),
                st.permutations(["theta_i", "polarization", "theta_mes"]),
                st.booleans(),
            ),
        )
    )
    return {
        "title": draw(st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=10)),
        "polarization": polarization,
        "overlap_nm": float(draw(st.integers(0, 200))),
        "wavelengths": [{"values_nm": [float(edge)], **draw(averaged)} for edge in edges],
        "sweeps": [{"theta_i_deg": draw(angle), "theta_mes_deg": {"start": -9.0, "stop": -8.0, "step": 0.5}}],
        "positions": [listed] if draw(st.booleans()) else [],
        "reading": draw(averaged),
        "references": {
            "dark": draw(WHEN),
            "baseline": draw(WHEN),
            "averages": draw(st.integers(1, 9)),
            **period,
        },
        "order": {**order, "alternate_wavelengths": draw(st.booleans())},
        "repeats": {"count": draw(st.integers(1, 3)), "of": draw(st.sampled_from(["plan", "position"]))},
    }


@given(tables=plans())
def test_every_feature_survives_toml(tables: dict[str, Any]) -> None:
    plan = Plan.model_validate(tables)
    again = parse_plan(plan.to_toml())
    assert again == plan
    assert again.positions() == plan.positions()
    assert len(plan.positions()) == plan.n_positions
    np.testing.assert_array_equal(again.wavelength_nm, plan.wavelength_nm)
    assert parse_plan(again.to_toml()) == again

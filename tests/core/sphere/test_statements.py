"""The uncertainty and the geometry as a user states them: what is understood, and what is asked back."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.sphere import Geometry, parse_geometry, parse_uncertainty

WHITE = np.array([0.7, 0.8])

STATEMENTS = {
    "1 % relative, k=2": ("relative", 0.01, 2.0),
    "1% rel k = 2": ("relative", 0.01, 2.0),
    "± 1 percent relative (k=1)": ("relative", 0.01, 1.0),
    "0,5 % relative; k=2": ("relative", 0.005, 2.0),
    "0.01 relative, k=1": ("relative", 0.01, 1.0),
    "k=3, 1.5 % relative": ("relative", 0.015, 3.0),
    "1 % absolute, k=1": ("absolute", 0.01, 1.0),
    "0.5 %R absolute, k=2": ("absolute", 0.005, 2.0),
    "1 percentage point absolute, k=2": ("absolute", 0.01, 2.0),
    "0.005 absolute, 95 %": ("absolute", 0.005, 2.0),
    "1 % relative, level 95 %": ("relative", 0.01, 2.0),
    "1 % relative, 95 % confidence": ("relative", 0.01, 2.0),
    "1 % relative, 95.45 %": ("relative", 0.01, 2.0),
    "1 % relative, k=2, 95 %": ("relative", 0.01, 2.0),
    "1 % absolute, standard uncertainty": ("absolute", 0.01, 1.0),
    "1 % of the value, relative, K=2": ("relative", 0.01, 2.0),
    "1e-2 relative, k=2": ("relative", 0.01, 2.0),
}


@pytest.mark.parametrize(("text", "meaning"), STATEMENTS.items())
def test_statements(text: str, meaning: tuple[str, float, float]) -> None:
    found = parse_uncertainty(text)
    assert (found.kind, found.value, found.coverage) == meaning
    expected = meaning[1] / meaning[2] * (WHITE if meaning[0] == "relative" else np.ones(2))
    np.testing.assert_allclose(found.standard(WHITE), expected, rtol=1e-14)


def test_one_percent_means_four_things_and_each_is_given_in_numbers() -> None:
    with pytest.raises(ConfigError) as caught:
        parse_uncertainty("1 %", WHITE)
    said = str(caught.value)
    assert "relative or absolute and with which coverage?" in said
    assert "mean reflectance of 0.75" in said
    # expanded at 95 %, k = 2: 2 u, where u = 1 % of 0.75 or 0.01, over the coverage factor
    for line in (
        "'1 % relative, k=1':  0.75 ± 0.015 at 95 %",
        "'1 % relative, k=2':  0.75 ± 0.0075 at 95 %",
        "'1 % absolute, k=1':  0.75 ± 0.02 at 95 %",
        "'1 % absolute, k=2':  0.75 ± 0.01 at 95 %",
    ):
        assert line in said


@pytest.mark.parametrize(
    ("text", "problem", "readings"),
    [
        ("1 % relative", "with which coverage?", ["0.75 ± 0.015", "0.75 ± 0.0075"]),
        ("1 % relative, expanded", "with which coverage?", ["0.75 ± 0.015", "0.75 ± 0.0075"]),
        ("0.01, k=2", "relative or absolute?", ["0.75 ± 0.0075", "0.75 ± 0.01"]),
        ("1 %, 95 %", "relative or absolute?", ["0.75 ± 0.0075", "0.75 ± 0.01"]),
    ],
)
def test_what_is_left_open_is_asked_back(text: str, problem: str, readings: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_uncertainty(text, WHITE)
    said = str(caught.value)
    assert problem in said
    numbers = [line.split("':  ")[1] for line in said.splitlines()[1:-1]]
    assert numbers == [f"{reading} at 95 %" for reading in readings]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "begins with no number"),
        ("good", "begins with no number"),
        ("-1 % relative, k=2", "begins with no number"),
        ("nan relative, k=2", "begins with no number"),
        ("1 % relative absolute, k=2", "says relative and absolute"),
        ("1 % relative, k=1, k=2", "says two coverage factors"),
        ("1 % relative, k=3, 95 %", "k = 3 and 95 % contradict each other"),
        ("1 % relative, 99 %", "a level of 99 % is not known here"),
        ("1 % relative, k=0", "k = 0 is no coverage factor"),
        ("1 % relative, k=200", "k = 200 is no coverage factor"),
        ("0 % relative, k=2", "0 is no uncertainty"),
        ("300 % absolute, k=2", "3 is no uncertainty"),
        ("1 %R relative, k=2", "a part of the reflectance itself, and so absolute"),
        ("1 % relative, k=2, or so", "'orso' is not understood"),
        ("1 % of full scale, relative, k=2", "'fullscale' is not understood"),
        ("column k_g_u", "with which coverage?"),
    ],
)
def test_statements_that_are_none(text: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_uncertainty(text, WHITE)
    assert problem in str(caught.value)
    assert f"--sphere-u '{text}'" in str(caught.value)


def test_a_statement_too_long_for_one_is_refused_at_once() -> None:
    for parse in (parse_uncertainty, parse_geometry):
        for text in ("column " + " " * 50_000 + "x, k=1", "8" * 50_000 + ":di", "included " * 5000):
            with pytest.raises(ConfigError, match=r"\d+ characters"):
                parse(text)


def test_a_column_of_the_file_in_its_unit() -> None:
    stated = parse_uncertainty("column U / %, k=2")
    assert (stated.kind, stated.column, stated.coverage) == ("column", "U / %", 2.0)
    columns = {"U / %": np.array([0.4, 0.8])}
    np.testing.assert_allclose(stated.standard(WHITE, columns, 0.01), [0.002, 0.004], rtol=1e-14)
    with pytest.raises(ConfigError, match="has no column 'U / %'; it has other"):
        stated.standard(WHITE, {"other": WHITE}, 0.01)
    with pytest.raises(ConfigError, match="empty or not positive at 1 of 2 wavelengths"):
        stated.standard(WHITE, {"U / %": np.array([0.4, np.nan])}, 0.01)


GEOMETRIES = {
    "8:di": Geometry(8.0, "included"), "8/di": Geometry(8.0, "included"),
    "8°:di": Geometry(8.0, "included"),
    "di:8": Geometry(8.0, "included"), "d/8, specular included": Geometry(8.0, "included"),
    "SCI": Geometry(8.0, "included"), "8:h included": Geometry(8.0, "included"),
    "8:de": Geometry(8.0, "excluded"), "DE/8": Geometry(8.0, "excluded"), "sce": Geometry(8.0, "excluded"),
    "8 deg / hemispherical, specular excluded": Geometry(8.0, "excluded"),
    "10:di": Geometry(10.0, "included"), "di:6.5": Geometry(6.5, "included"),
    "0:de": Geometry(0.0, "excluded"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "geometry"), GEOMETRIES.items())
def test_geometries(text: str, geometry: Geometry) -> None:
    assert parse_geometry(text) == geometry
    assert parse_geometry(geometry.text) == geometry
    assert geometry.coefficient == ("k_g" if geometry.specular == "included" else "k_d")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("8:d", "does not say whether the specular beam is included or excluded"),
        ("8:h", "does not say"),
        ("8:di excluded", "says both"),
        ("95:di", "an incidence of 95 deg is not within 0...90 deg"),
        ("8", "is no geometry"),
        ("45:0", "is no geometry"),
        ("", "is no geometry"),
    ],
)
def test_geometries_that_are_none(text: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_geometry(text)
    assert problem in str(caught.value)
    assert "8:de (excluded, compared with k_d)" in str(caught.value)

"""The table of material levels: differences that are known, and the command that prints it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gonio import fresnel
from gonio.cli.main import main
from gonio.facade import Optics, Scene, Sun, street
from gonio.facade.levels import compare_levels

SCENE = """
title = "Sun on a glossy wall"
[irradiance]
dni_w_m2 = 800.0
dhi_w_m2 = 0.0
[sun]
azimuth_deg = 270.0
elevation_deg = 20.0
angular_diameter_deg = 0.0
[materials.glossy]
rho_d = 0.0
rho_s = 1.0
alpha = 1e6
n2 = 1.5
[materials.black]
albedo = 0.0
[street]
azimuth_deg = 0.0
width_m = 10.0
length_m = 10.0
height_left_m = 4.0
height_right_m = 30.0
left = "black"
right = "glossy"
ground = "black"
infinite = true
[[receivers]]
surface = "left"
rows = 4
columns = 1
"""


def facing_mirror(slant_deg: float) -> Scene:
    """A black facade of 4 m whose only light comes from a mirror of 30 m, 10 m before it."""
    left, wall, ground = street(
        width_m=10.0, length_m=10.0, height_left_m=4.0, height_right_m=30.0, azimuth_deg=0.0, left="black",
        right="glossy", ground="black",
    )  # fmt: skip
    return Scene(
        (replace(left, rows=4, columns=1), wall, ground),
        {"black": Optics(0.0), "glossy": Optics(0.0, 1.0, 1e6, 1.5)},
        Sun(270.0 - slant_deg, 20.0, 0.0),
        800.0,
        0.0,
        infinite=True,
    )


def test_levels_of_a_mirror_differ_by_fresnel_alone() -> None:
    slant_deg = 70.0
    scene = facing_mirror(slant_deg)
    table = compare_levels(scene, rel_tol=0.01, seed=4)
    cosine = float(np.cos(np.radians(20.0)) * np.cos(np.radians(slant_deg)))
    at = float(np.degrees(np.arccos(cosine)))
    r, r8 = (float(fresnel.reflectance(1.5, angle, "unpolarized")) for angle in (at, 8.0))
    # the whole of the low facade lies in the image of the sun: E = DNI cos R
    lobe, mirror = table["lobe"], table["mirror"]
    assert lobe.value[0] == pytest.approx(800.0 * cosine * r, abs=4.0 * lobe.standard_error[0] + 1e-9)
    expected = 800.0 * cosine * (r8 - r)
    assert mirror.difference[0] == pytest.approx(expected, abs=4.0 * mirror.difference_error[0] + 1e-9)
    assert mirror.difference[0] == pytest.approx(expected, rel=0.02)
    # one mirror: nothing for polarization to do, and no rays spent on it
    assert table["polarised"].same_as == "lobe"
    assert table["polarised"].difference[0] == 0.0
    assert table.sufficient(0) == "lobe"
    assert table.percent(mirror)[0] == pytest.approx(100.0 * (r8 - r) / r, rel=0.02)
    text = table.text()
    for words in ("diffuse only", "two coefficients", "full lobe", "polarised", "reference", "= lobe"):
        assert words in text
    assert "within 1 %: 'full lobe' is enough for the mean of 'left'" in text


def test_differences_are_known_better_than_values(canyon: Callable[..., Scene]) -> None:
    weak = Optics(0.72, 0.05, 100.0, 1.5)
    table = compare_levels(canyon(wall=weak, dni=800.0, dhi=100.0, rows=4), rel_tol=0.02, seed=1)
    lobe = table["diffuse"]
    assert np.all(lobe.difference_error < 0.5 * lobe.standard_error)
    assert table.sufficient(0) == "diffuse"


def test_the_command_prints_the_table_and_writes_nothing(tmp_path: Path, capsys) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "scene.toml"
    file.write_text(SCENE, encoding="utf-8")
    assert main(["facade", str(file), "--levels", "--rel-tol", "0.05"]) == 0
    out = capsys.readouterr().out
    assert "two coefficients" in out
    assert "W/m2" in out
    assert [p.name for p in tmp_path.iterdir()] == ["scene.toml"]
    assert main(["facade", str(file), "--levels", "--rel-tol", "0.9"]) == 1
    assert "--rel-tol 0.9 is outside 1e-5...0.5" in capsys.readouterr().err
    assert main(["facade", str(file)]) == 2
    assert "give -o OUT.h5" in capsys.readouterr().err

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gonio.errors import SceneError
from gonio.facade import Optics, Scene, Sun, Surface, module, panel, parse_scene, simulate, street
from gonio.facade.geometry import heading

HEAD = """
[sun]
azimuth_deg = 90.0
elevation_deg = 40.0
[irradiance]
dni_w_m2 = 800.0
dhi_w_m2 = 100.0
[materials.wall]
albedo = 0.6
[materials.glass]
k_d = 0.0
k_s = 0.1
[street]
azimuth_deg = 0.0
width_m = 10.0
length_m = 30.0
height_left_m = 8.0
height_right_m = 12.0
left = "wall"
right = "wall"
ground = "wall"
"""
WINDOW = """
[[modules]]
name = "window"
surface = "right"
at_m = [3.0, 1.0]
size_m = [2.0, 1.5]
"""
PANEL = """
[[modules]]
name = "panel"
centre_m = [0.0, 0.0, 5.0]
size_m = [2.0, 1.0]
azimuth_deg = 180.0
material = "glass"
"""


def test_a_window_is_a_surface_after_its_host() -> None:
    scene = parse_scene(HEAD + WINDOW + 'material = "glass"\nrows = 2\ncolumns = 3\n' + PANEL)
    assert [s.name for s in scene.surfaces] == ["left", "right", "ground", "window", "panel"]
    right, window = scene.surfaces[1], scene.surfaces[3]
    assert (window.material, window.rows, window.columns, window.turned) == ("glass", 2, 3, True)
    # along the azimuth (north) and up; the street's right facade begins at its south end, x = +5
    assert window.origin_m == pytest.approx((5.0, -12.0, 1.0))
    assert window.u_m == pytest.approx((0.0, 2.0, 0.0))
    assert window.v_m == pytest.approx((0.0, 0.0, 1.5))
    assert window.normal == pytest.approx(right.normal)
    assert [r.name for r in scene.receivers] == ["window", "panel"]
    plain = parse_scene(HEAD + WINDOW)
    assert (plain.surfaces[3].material, plain.surfaces[3].rows) == ("wall", 1)


def test_a_module_may_carry_a_module_and_need_not_be_a_receiver() -> None:
    text = HEAD + WINDOW + 'receiver = false\n[[receivers]]\nsurface = "window"\nrows = 3\ncolumns = 1\n'
    text += WINDOW.replace('"window"', '"handle"').replace('"right"', '"window"').replace(
        "at_m = [3.0, 1.0]\nsize_m = [2.0, 1.5]", "at_m = [0.1, 0.1]\nsize_m = [0.1, 0.1]"
    )  # fmt: skip
    scene = parse_scene(text)
    assert [(r.name, r.rows) for r in scene.receivers] == [("window", 3), ("handle", 1)]
    assert scene.surfaces[4].origin_m == pytest.approx((5.0, -11.9, 1.1))


@pytest.mark.parametrize(
    ("azimuth_deg", "tilt_deg"), [(0.0, 90.0), (180.0, 30.0), (250.0, 0.0), (77.0, 180.0), (123.0, 111.0)]
)
def test_a_panel_looks_where_it_is_turned(azimuth_deg: float, tilt_deg: float) -> None:
    s = panel(
        "p",
        centre_m=(1.0, 2.0, 3.0),
        size_m=(2.0, 1.5),
        azimuth_deg=azimuth_deg,
        tilt_deg=tilt_deg,
        material="m",
    )
    tilt = math.radians(tilt_deg)
    ahead = np.array(heading(azimuth_deg))
    assert s.normal == pytest.approx(math.sin(tilt) * ahead + [0, 0, math.cos(tilt)], abs=1e-12)
    centre = np.array(s.origin_m) + 0.5 * np.array(s.u_m) + 0.5 * np.array(s.v_m)
    assert centre == pytest.approx([1.0, 2.0, 3.0])
    assert s.area_m2 == pytest.approx(3.0)
    assert s.u_m[2] == 0.0  # columns run level,
    # and to the right of somebody who stands before it
    assert np.array(s.u_m) @ np.array(heading(azimuth_deg - 90.0)) == pytest.approx(2.0)
    assert s.v_m[2] == pytest.approx(1.5 * math.sin(tilt), abs=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (WINDOW.replace("[3.0, 1.0]", "[29.0, 1.0]"),
         r"modules\[1\]: module 'window' covers 29...31 m along and 1...2.5 m up, which is not inside "
         "'right' of 30 m x 12 m"),
        (WINDOW.replace("[3.0, 1.0]", "[3.0, -0.1]"), "covers 3...5 m along and -0.1...1.4 m up"),
        (WINDOW.replace("1.5]", "0.0]"), r"modules\[1\].size_m\[2\] = 0.0"),
        (WINDOW.replace('"right"', '"roof"'), "surface = 'roof' is not a surface of the scene; choose"),
        (WINDOW + WINDOW.replace('"window"', '"other"').replace("[3.0, 1.0]", "[4.5, 2.0]"),
         r"modules\[2\]: modules 'window' and 'other' overlap on 'right' by 0.5 m along and 0.5 m up"),
        (WINDOW + WINDOW.replace("[3.0, 1.0]", "[9.0, 1.0]"), "two surfaces or meshes are called 'window'"),
        (WINDOW + 'centre_m = [0.0, 0.0, 0.0]\n', "gives at_m, centre_m, surface; give surface and at_m"),
        (WINDOW.replace('surface = "right"\nat_m = [3.0, 1.0]\n', ""), "gives no place; give surface"),
        (WINDOW.replace("at_m = [3.0, 1.0]\n", ""), "lacks at_m"),
        (PANEL.replace('material = "glass"\n', ""), "lacks material"),
        (PANEL + "tilt_deg = 200.0\n", r"modules\[1\].tilt_deg = 200.0"),
        (PANEL + "sides = 3\n", r"modules\[1\].sides = 3"),
        (PANEL + "rows = 2\nreceiver = false\n", "has rows and columns but receiver = false"),
        (PANEL.replace('"glass"', '"gold"'), "made of 'gold', which is not among the materials"),
        (WINDOW + "receiver = 1\n", r"modules\[1\].receiver = 1"),
    ],
)  # fmt: skip
def test_modules_out_of_place_are_refused(text: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        parse_scene(HEAD + text)


def test_modules_may_touch_each_other_and_the_edges_of_their_host() -> None:
    first = WINDOW.replace("[3.0, 1.0]", "[0.0, 0.0]").replace("[2.0, 1.5]", "[0.3, 12.0]")
    second = (
        WINDOW.replace('"window"', '"w2"')
        .replace("[3.0, 1.0]", "[0.3, 0.0]")
        .replace("[2.0, 1.5]", "[29.7, 12.0]")
    )
    assert len(parse_scene(HEAD + first + second).surfaces) == 5


def test_in_an_endless_street_a_module_runs_along_all_of_it() -> None:
    endless = HEAD + "infinite = true\n"
    with pytest.raises(
        SceneError, match=r"give it at_m\[0\] = 0 and size_m\[0\] = 30, or set street.infinite"
    ):
        parse_scene(endless + WINDOW)
    scene = parse_scene(endless + WINDOW.replace("[3.0, 1.0]", "[0.0, 1.0]").replace("[2.0,", "[30.0,"))
    assert scene.surfaces[3].u_m == scene.surfaces[1].u_m
    with pytest.raises(SceneError, match="surface 'panel' does not run along the infinite street"):
        parse_scene(endless + PANEL)


@pytest.mark.parametrize("infinite", [False, True])
def test_a_module_hides_its_host_and_nothing_else(infinite: bool) -> None:
    # the shadow of the left wall, 4 m high and 8 m away, ends 4 m - 8 m / 4 = 2 m up the right one
    elevation_deg = math.degrees(math.atan(0.25))
    walls = street(
        width_m=8.0, length_m=6.0, height_left_m=4.0, height_right_m=4.0, azimuth_deg=0.0, left="matt",
        right="matt", ground="matt",
    )  # fmt: skip
    left, right, ground = (replace(s, rows=1, columns=1) for s in walls)
    low = module("low", right, at_m=(0.0, 0.0), size_m=(6.0, 2.0))
    scenes = [
        Scene(surfaces, {"matt": Optics(0.5)}, Sun(270.0, elevation_deg, 0.0), 500.0, 0.0, infinite=infinite)
        for surfaces in ((left, right, ground), (left, right, ground, low))
    ]
    bare, covered = (simulate(s, rel_tol=0.02, seed=3) for s in scenes)
    lit = 500.0 * math.cos(math.radians(elevation_deg))

    def direct(result: object, name: str) -> float:
        return float(result[name].contributions["direct"].value[0, 0])  # type: ignore[index]

    assert direct(bare, "right") == pytest.approx(0.5 * lit, rel=0.02)
    assert direct(covered, "right") == pytest.approx(lit, rel=1e-9)  # what is left of it is all in the sun
    assert direct(covered, "low") == pytest.approx(0.0, abs=1e-9)
    for name in ("left", "ground"):
        a, b = bare[name], covered[name]
        error = float(np.hypot(a.mean.standard_error, b.mean.standard_error))
        assert abs(float(a.mean.value - b.mean.value)) < 4.5 * error + 1e-9
    # area-weighted, host and module receive what the bare host did
    whole = 0.5 * (float(covered["right"].mean.value) + float(covered["low"].mean.value))
    assert whole == pytest.approx(float(bare["right"].mean.value), rel=0.03)


def test_what_is_probably_not_meant_is_said() -> None:
    scene = parse_scene(
        HEAD
        + WINDOW.replace("[3.0, 1.0]", "[0.0, 0.0]").replace("[2.0, 1.5]", "[30.0, 12.0]")
        + PANEL.replace("5.0]", "-5.0]")
        + '[[receivers]]\nsurface = "right"\nrows = 2\ncolumns = 2\n'
        + '[[boxes]]\nname = "block"\ncentre_m = [0.0, 0.0, 0.0]\nsize_m = [6.0, 30.0, 3.0]\n'
        + 'material = "wall"\n'
        + '[[receivers]]\nsurface = "ground"\nrows = 5\ncolumns = 2\n'
    )
    assert "receiver 'right' lies wholly under other surfaces: nothing reaches it" in scene.notes
    assert any("receiver 'ground': 6 of 10 patches lie wholly under other" in note for note in scene.notes)
    assert any("receiver 'panel' lies 4.5 m and more below the ground" in note for note in scene.notes)
    assert scene.remarks() == scene.notes[-3:]
    assert parse_scene(HEAD + WINDOW + PANEL).remarks() == ()


def test_a_panel_of_two_sides_is_read_on_its_front() -> None:
    sheet = panel(
        "sheet",
        centre_m=(0.0, 0.0, 5.0),
        size_m=(2.0, 1.0),
        azimuth_deg=90.0,
        material="matt",
        tilt_deg=90.0,
        sides=2,
    )
    floor = Surface("floor", (-9, -9, 0), (18, 0, 0), (0, 18, 0), "matt")
    for azimuth_deg, lit in ((90.0, True), (270.0, False)):
        scene = Scene((floor, sheet), {"matt": Optics(0.3)}, Sun(azimuth_deg, 30.0, 0.0), 400.0, 0.0)
        direct = simulate(scene, rel_tol=0.05)["sheet"].contributions["direct"].value
        assert direct == pytest.approx(400.0 * math.cos(math.radians(30.0)) if lit else 0.0, rel=1e-9)

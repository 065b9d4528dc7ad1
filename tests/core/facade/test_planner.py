"""What the planner leaves out, and whether its bounds hold."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gonio import fresnel
from gonio.brdf.lobe import lobe_above_horizon
from gonio.errors import SceneError
from gonio.facade import Optics, Scene, Sun, Surface, street
from gonio.facade.bands import Band
from gonio.facade.bounds import rms_bound
from gonio.facade.pilot import Outcome, engine, means
from gonio.facade.planner import choose, full
from gonio.facade.reach import is_grey, lobe_meets_lobe
from gonio.facade.reduce import at_level

GLOSSY = Optics(0.72, 1.0, 80.0, 1.5)
GROUND = Optics(0.2)


def test_an_integrating_sphere_sees_the_same_at_every_level(canyon: Callable[..., Scene]) -> None:
    scene = canyon(wall=GLOSSY, ground=GROUND, dni=1.0)
    k_s = float(fresnel.reflectance(1.5, 8.0, "unpolarized")) * float(lobe_above_horizon(80.0, 8.0))
    diffuse = at_level(scene, {"left": "diffuse", "right": "mirror"})
    assert diffuse.materials["left"] == Optics(0.72 + k_s, 0.0, 1e9, 1.0)
    assert diffuse.materials["right"].k_s(85.0) == pytest.approx(k_s, rel=1e-14)
    assert diffuse.materials["right"].rho_d == 0.72
    assert diffuse.materials["ground"] == GROUND
    assert scene.materials["left"] == GLOSSY
    whole = replace(scene, horizon="renormalize")
    assert at_level(whole, {"left": "diffuse"}).materials["left"].rho_d == pytest.approx(
        0.72 + float(fresnel.reflectance(1.5, 8.0, "unpolarized")), rel=1e-14
    )


def test_a_material_that_keeps_energy_keeps_it_at_every_level() -> None:
    strong = Optics(0.9, 10.0, 0.0, 1.5)  # 10 R(8 deg) = 0.4: the diffuse part has 0.6
    plate = Surface("plate", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), "m", 1, 1)
    scene = Scene((plate,), {"m": strong}, Sun(0.0, 45.0), 1.0, 1.0)
    for level in ("diffuse", "mirror"):
        found = at_level(scene, {"m": level}).materials["m"]  # type: ignore[dict-item]
        assert found.rho_d + float(found.k_s(8.0)) <= 1.0 + 1e-15


def test_levels_of_unknown_materials_are_refused(canyon: Callable[..., Scene]) -> None:
    with pytest.raises(SceneError, match=r"no material 'roof' to simplify; it has left, right, ground"):
        at_level(canyon(), {"roof": "diffuse"})
    with pytest.raises(
        SceneError, match=r"'shiny' is not a level of a material; choose among diffuse, mirror"
    ):
        at_level(canyon(), {"left": "shiny"})  # type: ignore[dict-item]


def test_polarization_needs_two_lobes_that_see_each_other(canyon: Callable[..., Scene]) -> None:
    assert lobe_meets_lobe(canyon(wall=GLOSSY))
    assert not lobe_meets_lobe(canyon(right=GLOSSY))
    assert lobe_meets_lobe(canyon(right=GLOSSY, ground=Optics(0.1, 1.0, 1e6, 1.33)))
    back_to_back = tuple(replace(s, turned=not s.turned) for s in canyon(wall=GLOSSY).surfaces[:2])
    scene = replace(canyon(wall=GLOSSY), surfaces=back_to_back)
    assert not lobe_meets_lobe(scene)
    assert lobe_meets_lobe(replace(scene, surfaces=tuple(replace(s, sides=2) for s in back_to_back)))


def refuses(scene: Scene, rel_tol: float, /) -> Outcome:
    raise AssertionError("there is nothing to decide")


@pytest.mark.parametrize("wall", [Optics(0.72), Optics(0.72, 3.0, 10.0, 1.0)])
def test_matte_scenes_are_decided_without_a_ray(canyon: Callable[..., Scene], wall: Optics) -> None:
    choice = choose(canyon(wall=wall, dni=1.0), 0.01, refuses)
    assert choice.levels == {"left": "diffuse", "right": "diffuse", "ground": "diffuse"}
    assert choice.stat_tol == 0.01
    assert not choice.omissions
    assert not choice.polarised


def two_walls(optics: Optics, **light: float) -> Scene:
    """A street of 12 m between two walls of one material, with receivers on all three surfaces."""
    surfaces = street(
        width_m=12.0, length_m=20.0, height_left_m=9.0, height_right_m=14.0, azimuth_deg=0.0, left="clad",
        right="clad", ground="ground",
    )  # fmt: skip
    options = {"dni": 700.0, "dhi": 100.0} | light
    return Scene(
        tuple(replace(s, rows=2, columns=2) for s in surfaces),
        {"clad": optics, "ground": GROUND},
        Sun(235.0, 30.0),
        options["dni"],
        options["dhi"],
    )


@pytest.mark.parametrize(
    ("optics", "rel_tol", "level"),
    [
        (Optics(0.6, 0.02, 50.0, 1.5), 0.05, "diffuse"),
        (Optics(0.6, 0.15, 50.0, 1.5), 0.05, "diffuse"),
        (Optics(0.0, 1.0, 1e6, 1.5), 0.01, None),
    ],
)
def test_bounds_hold_against_everything(optics: Optics, rel_tol: float, level: str | None) -> None:
    scene = two_walls(optics)
    choice = choose(scene, rel_tol, seed=3, threads=1)
    assert (choice.levels["clad"] == "diffuse") == (level == "diffuse"), choice.text
    assert 0.0 < choice.stat_tol <= rel_tol
    exact = engine(seed=11, threads=1)(full(scene, 0.003).scene, 0.003)
    planned = engine(seed=3, threads=1)(choice.scene, choice.stat_tol)
    (x, sx), (y, sy) = means(planned), means(exact)
    for number, receiver in enumerate(exact.irradiance.receivers):
        bounds = [o for o in choice.omissions if o.receiver == receiver.name]
        bound = sum(o.bound_w_m2 for o in bounds)
        allowed = bound + 3.0 * math.hypot(sx[number], sy[number])
        assert abs(x[number] - y[number]) <= allowed, receiver.name
        assert sum(o.bound_percent for o in bounds) <= 50.0 * rel_tol * (1.0 + 1e-12)
        assert math.hypot(choice.stat_tol, 0.01 * sum(o.bound_percent for o in bounds)) <= rel_tol * 1.000001
    for o in choice.omissions:
        assert o.what in choice.text


def test_bands_that_differ_little_become_one() -> None:
    def banded(spread: float) -> Scene:
        scene = two_walls(Optics(0.5))
        tables = [{**scene.materials, "clad": Optics(0.5 + s)} for s in (-spread, spread)]
        bands = (Band(380.0, 700.0, 0.5, 0.5, tables[0]), Band(700.0, 1100.0, 0.5, 0.5, tables[1]))
        return replace(scene, bands=bands)

    little, much = (choose(banded(spread), 0.01, seed=1, threads=1) for spread in (0.01, 0.45))
    assert not little.scene.bands
    assert any("2 bands as one average" in o.what for o in little.omissions)
    assert len(much.scene.bands) == 2
    assert "kept: 2 bands as one average" in much.text
    same = choose(banded(0.0), 0.01, refuses)
    assert is_grey(banded(0.0))
    assert not same.scene.bands
    assert not same.omissions


def test_a_choice_depends_on_the_seed_alone() -> None:
    scene = two_walls(Optics(0.6, 0.1, 50.0, 1.5))
    a, b = (choose(scene, 0.02, seed=5, threads=n) for n in (1, 2))
    assert a.omissions == b.omissions
    assert a.text == b.text


def test_without_light_nothing_is_needed() -> None:
    choice = choose(two_walls(GLOSSY, dni=0.0, dhi=0.0), 0.01, refuses)
    assert choice.levels["clad"] == "diffuse"
    assert "there is no light" in choice.text


@pytest.mark.parametrize("cells", [1, 40])
@pytest.mark.parametrize("common", [0.0, 1.0])
def test_the_bound_of_a_difference_covers_it(cells: int, common: float) -> None:
    rng = np.random.default_rng(5)
    weight = np.full(cells, 1.0 / cells)
    for size in (0.0, 1.0, 4.0):
        for _ in range(300):
            noise = rng.standard_normal((cells, 16)) + common * rng.standard_normal((1, 16))
            rms, limit, bound = rms_bound(size + 2.0 * noise, weight)
            assert bound >= size
            assert bound <= rms + limit + 1e-12

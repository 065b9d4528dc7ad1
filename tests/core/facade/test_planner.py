"""What the planner leaves out, and whether its bounds hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from gonio import fresnel
from gonio.brdf.lobe import lobe_above_horizon
from gonio.errors import SceneError
from gonio.facade import Optics, Scene, Sun, Surface
from gonio.facade.pilot import Outcome
from gonio.facade.planner import choose
from gonio.facade.reach import lobe_meets_lobe
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

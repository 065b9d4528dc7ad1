"""How is a material simplified?  Four levels, and the scene that results.

=============  ========================================================================================
level          what a surface does
=============  ========================================================================================
`diffuse`      Lambert with the global coefficient ``k_g = k_d + k_s`` of an integrating sphere at 8 deg
`mirror`       Lambert with ``k_d`` and a mirror of the constant reflectance ``k_s``, both at 8 deg
`lobe`         the four parameters as fitted; light is unpolarised at every reflection
`polarised`    the same; light that goes from lobe to lobe keeps its polarization
=============  ========================================================================================

Polarization belongs to the light, not to one material: one material at `polarised` makes all lobes so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, get_args

from gonio.errors import SceneError
from gonio.facade.optics import Optics

if TYPE_CHECKING:
    from gonio.facade.scene import Scene

Level = Literal["diffuse", "mirror", "lobe", "polarised"]
LEVELS: tuple[Level, ...] = get_args(Level)
"""Cheapest first."""

SPHERE_DEG = 8.0
"""Incidence at which integrating spheres measure."""

MIRROR_ALPHA = 1e9
"""Exponent of a lobe that is a mirror: 0.003 deg wide, a hundredth of the sun."""

UNFELT = 1e-12
"""Reflectance of a lobe that only keeps its surface among those where photons start (`at_level`, `shy`)."""


def at_level(
    scene: Scene, levels: Mapping[str, Level], *, one_band: bool = False, shy: bool = False
) -> Scene:
    """Return the scene with simpler materials, in its average band or in all.

    Parameters
    ----------
    scene
        Not changed.
    levels
        By material; the others stay as fitted.  `Scene.polarised` follows from the highest level: true with a
        material at ``"polarised"``, false if all glossy materials have a lower one, else as it was.
    one_band
        Whether the bands are replaced by their average.
    shy
        Leave a lobe of 1e-12 on materials made diffuse.  Photons then start at the same points as in the
        scene as it was, and the difference of the two has no noise of its own.

    Raises
    ------
    SceneError
        A material that the scene does not have, or an unknown level.
    """
    for name, level in levels.items():
        if name not in scene.materials:
            raise SceneError(
                f"the scene has no material '{name}' to simplify; it has {', '.join(scene.materials)}"
            )
        if level not in LEVELS:
            raise SceneError(f"'{level}' is not a level of a material; choose among {', '.join(LEVELS)}")

    def lowered(materials: Mapping[str, Optics]) -> dict[str, Optics]:
        return {
            name: simplified(optics, levels[name], horizon=scene.horizon, energy=scene.energy, shy=shy)
            if name in levels
            else optics
            for name, optics in materials.items()
        }

    polarised = scene.polarised
    if any(level == "polarised" for level in levels.values()):
        polarised = True
    elif all(name in levels for name in glossy_materials(scene)):
        polarised = False
    return replace(
        scene,
        materials=lowered(scene.materials),
        bands=()
        if one_band
        else tuple(replace(band, materials=lowered(band.materials)) for band in scene.bands),
        polarised=polarised,
    )


def simplified(
    optics: Optics, level: Level, *, horizon: str = "absorb", energy: str = "conserving", shy: bool = False
) -> Optics:
    """Return a material at a level; a Lambert surface is the same at all.

    Global coefficients above 1, which ``energy="published"`` permits, are cut to 1 in a Lambert surface.
    """
    if level in ("lobe", "polarised") or not has_lobe(optics):
        return optics
    k_d, k_s = sphere_coefficients(optics, horizon=horizon, energy=energy)
    if level == "mirror":
        return Optics(k_d, k_s, MIRROR_ALPHA, 1.0, constant=True)
    return Optics(min(k_d + k_s, 1.0), UNFELT if shy else 0.0, MIRROR_ALPHA, 1.0, constant=shy)


def sphere_coefficients(
    optics: Optics, *, horizon: str = "absorb", energy: str = "conserving"
) -> tuple[float, float]:
    """Return ``(k_d, k_s)`` at 8 deg (paper Eq 19-21), without what the horizon cuts off if it absorbs."""
    k_d, k_s = optics.rho_d, float(optics.k_s(SPHERE_DEG))
    if energy == "conserving":
        k_s = min(k_s, 1.0)
        k_d = min(k_d, 1.0 - k_s)
    if horizon == "absorb" and k_s > 0.0:
        from gonio.brdf.lobe import lobe_above_horizon

        k_s *= float(lobe_above_horizon(optics.alpha, SPHERE_DEG))
    return k_d, k_s


def has_lobe(optics: Optics) -> bool:
    """Say whether the lobe returns anything: R is 0 at every incidence for n2 = 1."""
    return optics.rho_s > 0.0 and (optics.constant or optics.n2 != 1.0)


def used_materials(scene: Scene) -> list[str]:
    """Return the materials of the scene's surfaces and meshes, in the order of `Scene.materials`."""
    names = {s.material for s in scene.surfaces}
    for mesh in scene.meshes:
        names |= {mesh.materials[int(k)] for k in set(mesh.face_material.tolist())}
    return [name for name in scene.materials if name in names]


def glossy_materials(scene: Scene) -> list[str]:
    """Return the used materials that have a lobe, in the average or in a band."""
    tables = [scene.materials, *(band.materials for band in scene.bands)]
    return [name for name in used_materials(scene) if any(has_lobe(table[name]) for table in tables)]

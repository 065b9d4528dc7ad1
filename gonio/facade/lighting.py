"""What light does a scene give the kernels?"""

from __future__ import annotations

import math

import numpy as np

from gonio.facade import sky
from gonio.facade.layout import Light
from gonio.facade.scene import Scene


def light_of(scene: Scene) -> Light:
    """Return sun, sky and the choices of energy and horizon.

    The radiance of the sun's disc is uniform and such that a plane facing its centre receives the DNI; the
    mean cosine over the disc, ``(1 + cos r) / 2`` for a half angle r, is divided out.
    """
    disc = 2.0 * math.sin(math.radians(scene.sun.angular_diameter_deg) / 4.0) ** 2
    return Light(
        sun=np.array(scene.sun.direction),
        disc=disc,
        dni=scene.direct_w_m2 / (1.0 - 0.5 * disc),
        dhi=float(scene.dhi_w_m2),
        sky=sky.coefficients(scene.sky, scene.sun, scene.dhi_w_m2, broadband_w_m2=_broadband(scene)),
        conserving=scene.energy == "conserving",
        renormalize=scene.horizon == "renormalize",
    )


def light_notes(scene: Scene) -> tuple[str, ...]:
    """Return which sky it is, what of it was moved into its model's range, and what the horizon hides.

    What the scene's own notes say already is left out.
    """
    found: list[str] = []
    sun = scene.sun
    radius_deg = 0.5 * sun.angular_diameter_deg
    if not sun.is_up:
        unused = f"; the given DNI of {scene.dni_w_m2:.1f} W/m2 is not used" if scene.dni_w_m2 > 0.0 else ""
        found.append(f"the sun is below the horizon: no direct light{unused}")
    elif scene.dni_w_m2 > 0.0 and sun.elevation_deg < radius_deg:
        x = sun.elevation_deg / radius_deg
        hidden = (math.acos(x) - x * math.sqrt(1.0 - x * x)) / math.pi
        found.append(
            f"the sun's centre is {sun.elevation_deg:.3f} deg above the horizon, which hides "
            f"{100.0 * hidden:.1f} % of its disc; the DNI is that of the whole disc"
        )
    outside = scene.sky.extraterrestrial_w_m2
    if _broadband(scene)[0] > 1.04 * outside:  # the orbit makes 3.4 %
        found.append(
            f"DNI = {_broadband(scene)[0]:.0f} W/m2 is more than arrives outside the atmosphere "
            f"({outside:.0f} W/m2); check its unit"
        )
    found += sky.notes(scene.sky, sun, _broadband(scene))
    return tuple(note for note in found if note not in scene.notes)


def _broadband(scene: Scene) -> tuple[float, float]:
    return scene.broadband_w_m2 or (scene.dni_w_m2, scene.dhi_w_m2)

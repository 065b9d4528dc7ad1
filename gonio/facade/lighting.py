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
        sky=sky.coefficients(
            scene.sky or sky.Sky(), scene.sun, scene.dhi_w_m2, broadband_w_m2=_broadband(scene)
        ),
        conserving=scene.energy == "conserving",
        renormalize=scene.horizon == "renormalize",
    )


def light_notes(scene: Scene) -> tuple[str, ...]:
    """Return which sky it is and what of it was moved into its model's range."""
    return sky.notes(scene.sky or sky.Sky(), scene.sun, _broadband(scene))


def _broadband(scene: Scene) -> tuple[float, float]:
    return scene.broadband_w_m2 or (scene.dni_w_m2, scene.dhi_w_m2)

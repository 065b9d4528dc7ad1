"""On which sides of the surfaces do photons start?"""

from __future__ import annotations

import numpy as np

from gonio.facade import layout
from gonio.facade.layout import FloatArray, Geometry, Light

_MATTE = 0.25
"""Weight of a matte side when photons are followed to the end: they must first find a lobe."""


def chances(g: Geometry, light: Light, source: int, *, follow: bool) -> FloatArray | None:
    """Return the cumulative probabilities to start on each side, (2 m,) float64; ``None`` without any.

    Side 0 and 1 of the first primitive, of the second, ...; in proportion to the power a side can receive,
    and without `follow`, which starts on lobes only, to the part of it that takes the lobe.  A surface seen
    edge-on by the centre of the sun still gets the part of the disc it sees.

    Parameters
    ----------
    source
        `gonio.facade.layout.SUN` or `SKYLIGHT`.
    """
    normal = np.stack([g.normal, -g.normal], axis=1)  # (m, 2, 3): both sides
    if source == layout.SKYLIGHT:
        weight = (0.5 + 0.5 * normal[:, :, 2]) * (light.dhi > 0.0)
        cosine = np.full(weight.shape, 0.5)
    else:
        rim = np.sqrt(light.disc * (2.0 - light.disc))
        weight = np.maximum(0.0, normal @ light.sun + rim) * (light.dni > 0.0)
        cosine = np.clip(normal @ light.sun, 0.0, 1.0)
    weight[g.sides == 1, 1] = 0.0
    optics = g.materials[g.optics]
    shiny = optics[:, layout.RHO_S] > 0.0
    weight *= g.area[:, None]
    if follow:
        weight *= np.where(shiny, 1.0, _MATTE)[:, None]
    else:
        n2 = optics[:, layout.N2, None]
        q = np.sqrt((n2 - 1.0) * (n2 + 1.0) + cosine**2)
        with np.errstate(invalid="ignore"):  # n2 = 1 at grazing incidence
            r_s, r_p = (cosine - q) / (cosine + q), (n2**2 * cosine - q) / (n2**2 * cosine + q)
        r = np.where(n2 == 1.0, 0.0, 0.5 * (r_s**2 + r_p**2))
        weight *= optics[:, layout.RHO_S, None] * np.where(optics[:, layout.CONSTANT, None] > 0.0, 1.0, r)
    if not np.any(weight > 0.0):
        return None
    weight = weight.ravel()
    chance = np.cumsum(weight)
    chance /= chance[-1]
    chance[np.flatnonzero(weight)[-1] :] = 1.0
    return np.asarray(chance)

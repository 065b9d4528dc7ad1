"""How much sun does a glossy wall throw on the wall opposite?  A quadrature of one reflection, without rays.

The street is endless and runs north, everything but the lobe of the right wall is black.  A direction of the
lobe falls by the same slope wherever on the wall it starts, so the places it starts from and lands at are an
overlap of two intervals; what is left is an integral over the lobe's two angles, done by the midpoint rule in
coordinates where the lobe is uniform.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def irradiance(
    *,
    width: float,
    left_height: float,
    right_height: float,
    bands: int,
    sun: tuple[float, float, float],
    dni: float,
    k_s: float,
    alpha: float,
    nodes: int = 1000,
) -> FloatArray:
    """Return the irradiance of the left wall's bands, (bands,), from the ground up.

    Parameters
    ----------
    sun
        Unit vector towards the sun (its size is neglected): x east, y north, z up; it must stand in the west,
        over the left wall, so that ``sun[0] < 0``.
    k_s
        Reflectance of the lobe at this incidence, before the surface cuts it.
    """
    s = np.array(sun)
    cosine = -s[0]  # of the incidence on the right wall, whose normal is -x
    mirror = np.array([s[0], -s[1], -s[2]])  # of the direction in which the light leaves
    low = max(left_height - width * s[2] / cosine, 0.0)  # the left wall shades what is below
    if low >= right_height:
        return np.zeros(bands)
    u, turn = ((np.arange(nodes) + 0.5) / nodes for _ in range(2))
    e = np.log(u) / (alpha + 1.0)  # u = cos^(alpha+1) is uniform
    along, aside = np.exp(e), np.sqrt(-np.expm1(2.0 * e))
    first = np.cross(mirror, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    second = np.cross(mirror, first)
    p, q = np.cos(2.0 * math.pi * turn), np.sin(2.0 * math.pi * turn)
    direction = [
        along[:, None] * mirror[i] + aside[:, None] * (p * first[i] + q * second[i])[None] for i in (0, 2)
    ]
    leaves = direction[0] < 0.0  # the rest goes under the surface and is absorbed
    rise = width * direction[1][leaves] / -direction[0][leaves]
    height = left_height / bands
    found = np.empty(bands)
    for band in range(bands):
        b = band * height
        overlap = np.minimum(right_height, b + height - rise) - np.maximum(low, b - rise)
        found[band] = np.sum(np.maximum(overlap, 0.0)) / nodes**2 / height
    return np.asarray(dni * cosine * k_s * found)

"""How bright is the sky in a direction?

All sky models of the product are one formula (CIE S 011, Perez et al. 1993),

    L = scale (1 + a exp(b / cos z)) (k + c exp(d gamma) + e cos^2 gamma),   cos z = d_z > 0,

with gamma the angle to the sun; `gonio.facade.sky` gives the seven numbers.
"""

from __future__ import annotations

import math
from typing import Any

from gonio.facade.layout import LEAST_COSINE
from gonio.facade.sampling import compiled
from gonio.facade.vectors import dot

SCALE, A, B, K, C, D, E = 0, 1, 2, 3, 4, 5, 6
"""Columns of `gonio.facade.layout.Light.sky`."""


@compiled
def sky_radiance(light: Any, d: Any) -> float:
    """Return the radiance of the sky in the unit direction `d`, W/m2/sr; 0 below the horizon."""
    if d[2] <= 0.0:
        return 0.0
    s = light.sky
    value = s[SCALE]
    if s[A] != 0.0:
        value *= 1.0 + s[A] * math.exp(s[B] / max(d[2], LEAST_COSINE))
    if s[C] != 0.0 or s[E] != 0.0:
        cosine = min(max(dot(d, light.sun), -1.0), 1.0)
        gamma = math.acos(cosine)
        value *= s[K] + s[C] * math.exp(s[D] * gamma) + s[E] * cosine * cosine
    else:
        value *= s[K]
    return max(value, 0.0)  # type: ignore[no-any-return]

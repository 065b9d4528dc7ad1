"""In which direction does a ray leave, so that few points tell much about a street?

In a street most edges run along it, and what a ray meets depends on its direction projected across.  Cosine
distributed directions are therefore drawn as

    d = sin(psi) along + cos(psi) (sin(phi) across + cos(phi) normal),

with ``sin(phi)`` uniform in -1...1 and psi of density ``2/pi cos^2(psi)``, independent of each other: in an
endless street one coordinate of the point decides alone, and Sobol points fill that best.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.facade.sampling import compiled

_NODES = 1 << 14


@cache
def angle_table() -> NDArray[np.float64]:
    """Return t = 2 psi at equal steps of the cumulative probability, ``t + sin t = pi (2 u - 1)``, (n,)."""
    m = np.pi * np.linspace(-1.0, 1.0, _NODES + 1)
    low, high = np.full_like(m, -np.pi), np.full_like(m, np.pi)
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = middle + np.sin(middle) > m
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return 0.5 * (low + high)


@compiled
def strip_direction(table: Any, normal: Any, along: Any, across: Any, a: float, b: float) -> Any:
    """Return a direction of density cos(theta)/pi about `normal`; `a` decides across, `b` along.

    One Halley step mends the interpolated angle: to 1e-12 but in the outermost 1e-4 of directions along the
    street, where it may be a few percent off in its distance from the plane.
    """
    at = b * (table.shape[0] - 1)
    node = int(at)
    part = at - node
    t = table[node] + part * (table[node + 1] - table[node])
    sine, cosine = math.sin(t), math.cos(t)
    miss = t + sine - math.pi * (2.0 * b - 1.0)
    slope = 1.0 + cosine
    bottom = 2.0 * slope * slope + miss * sine
    if bottom > 0.0:
        t -= 2.0 * miss * slope / bottom
    x, c = math.sin(0.5 * t), math.cos(0.5 * t)
    y = c * (2.0 * a - 1.0)
    z = 2.0 * c * math.sqrt(a * (1.0 - a))
    return (
        x * along[0] + y * across[0] + z * normal[0],
        x * along[1] + y * across[1] + z * normal[1],
        x * along[2] + y * across[2] + z * normal[2],
    )

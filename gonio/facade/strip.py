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

_NODES = 1 << 12


@cache
def angle_table() -> NDArray[np.float64]:
    """Return sine and cosine of psi at equal steps of its cumulative probability u, (n, 2).

    ``2 psi + sin 2 psi = pi (2 u - 1)``.
    """
    m = np.pi * np.linspace(-1.0, 1.0, _NODES + 1)
    low, high = np.full_like(m, -np.pi), np.full_like(m, np.pi)
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = middle + np.sin(middle) > m
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    psi = 0.25 * (low + high)
    return np.ascontiguousarray(np.stack([np.sin(psi), np.cos(psi)], axis=1))


@compiled
def strip_direction(table: Any, normal: Any, along: Any, across: Any, a: float, b: float) -> Any:
    """Return a direction of density cos(theta)/pi about `normal`; `a` decides across, `b` along.

    Sine and cosine of psi are interpolated on the chord: off by 1e-7 at most, but in the outermost 5e-4
    of directions along the street, which may be a few percent off in their distance from the plane.
    """
    at = b * (table.shape[0] - 1)
    node = int(at)
    part = at - node
    x = table[node, 0] + part * (table[node + 1, 0] - table[node, 0])
    c = table[node, 1] + part * (table[node + 1, 1] - table[node, 1])
    scale = 1.0 / math.sqrt(x * x + c * c)
    x *= scale
    c *= scale
    y = c * (2.0 * a - 1.0)
    z = 2.0 * c * math.sqrt(a * (1.0 - a))
    return (
        x * along[0] + y * across[0] + z * normal[0],
        x * along[1] + y * across[1] + z * normal[1],
        x * along[2] + y * across[2] + z * normal[2],
    )

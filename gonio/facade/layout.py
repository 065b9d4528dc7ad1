"""What do the kernels read and write?

Here and not beside them, so that reading a result need not load numba.  Do not rename or move the two classes
lightly: the compiled code that users have on disk refers to them by name.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

DIRECT, SKY, DIFFUSE, SPECULAR, LOST = 0, 1, 2, 3, 4
"""Columns of what backward paths collect."""

EMITTED, ABSORBED, UNDER_HORIZON, ESCAPED, CREATED, UNFINISHED = 0, 1, 2, 3, 4, 5
"""Columns of the photons' energy account; `UNDER_HORIZON` is a part of `ABSORBED`."""


class Surfaces(NamedTuple):
    """Parallelograms in the order of the tree's leaves; all (n, 3) float64 in metres unless noted."""

    origin: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    normal: NDArray[np.float64]  # unit
    dual_u: NDArray[np.float64]  # 1/m: a = dual_u . (p - origin)
    dual_v: NDArray[np.float64]
    area: NDArray[np.float64]  # (n,) m2
    material: NDArray[np.float64]  # (n, 4): rho_d, rho_s, alpha, n2
    patch: NDArray[np.int64]  # (n, 3): first patch or -1, rows, columns
    low: NDArray[np.float64]  # (nodes, 3) boxes of the tree, depth first
    high: NDArray[np.float64]
    link: NDArray[np.int64]  # (nodes, 3): node after a miss, first surface, count (0: inner)


class Light(NamedTuple):
    """Sun and sky, and how reflections are idealised."""

    sun: NDArray[np.float64]  # (3,) unit vector towards the sun's centre
    disc: float  # 2 sin^2(half angle / 2) = 1 - cos(half angle) of the sun's disc
    dni: float  # W/m2, on a plane that faces the sun; 0 when it is below the horizon
    dhi: float  # W/m2, of an unobstructed horizontal plane; radiance dhi/pi everywhere above the horizon
    conserving: bool
    renormalize: bool
    periodic: bool

"""What do the kernels read and write?

Here and not beside them, so that reading a result need not load numba.  Do not rename or move the classes
lightly: the compiled code that users have on disk refers to them by name.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

DIRECT, SKY, DIFFUSE, SPECULAR, LOST = 0, 1, 2, 3, 4
"""Columns of what backward paths collect."""

EMITTED, ABSORBED, UNDER_HORIZON, ESCAPED, CREATED, UNFINISHED, HANDED, EXPOSED = 0, 1, 2, 3, 4, 5, 6, 7
"""Columns of the photons' energy account; `UNDER_HORIZON` is a part of `ABSORBED`, `HANDED` is what goes over
to the exchange between patches, `EXPOSED` counts the points of a patch that can emit."""

SUN, SKYLIGHT, PATCH = 0, 1, 2
"""What photons come from."""

RHO_D, RHO_S, ALPHA, N2, CONSTANT = 0, 1, 2, 3, 4
"""Columns of `Geometry.materials`; with `CONSTANT` 1 the lobe returns rho_s at every incidence (R = 1)."""


LEAST_COSINE = 0.01
"""Of the zenith angle in the sky's gradation, whose exponent has a pole at the horizon (as in gendaylit)."""


class Geometry(NamedTuple):
    """What rays can hit: m primitives in the order of the tree's leaves, metres from the scene's centre.

    A primitive is the parallelogram ``origin + a u + b v``, 0 <= a, b <= 1, or its half ``a + b <= 1``.  Its
    front is where `normal` points.  From behind it is black, or reflects as its front if it has two sides.
    """

    origin: FloatArray  # (m, 3) m
    u: FloatArray  # (m, 3) m
    v: FloatArray  # (m, 3) m
    normal: FloatArray  # (m, 3) unit
    dual_u: FloatArray  # (m, 3) 1/m: a = dual_u . (p - origin)
    dual_v: FloatArray  # (m, 3) 1/m: b = dual_v . (p - origin)
    area: FloatArray  # (m,) m2, of the triangle if it is one
    triangle: NDArray[np.uint8]  # (m,) 1: only a + b <= 1
    sides: NDArray[np.uint8]  # (m,) 1 or 2 reflecting sides
    plane: IntArray  # (m,) shared by the primitives of one plane: a ray from one hits none of them
    rank: IntArray  # (m,) where coplanar primitives overlap, the one of highest rank is hit
    optics: IntArray  # (m,) row of `materials`
    patch: IntArray  # (m, 2, 3) of front and back: first patch or -1, rows (along v), columns (along u)
    cover_first: IntArray  # (m + 1,) of `cover`
    cover: IntArray  # coplanar primitives that hide a part of this one
    materials: FloatArray  # (k, 5): rho_d, rho_s, alpha, n2, constant
    nodes: NDArray[np.float32]  # (nodes, 7, 8) the tree's boxes and links, see gonio.facade.bvh
    leaves: NDArray[np.float32]  # (leaves, 15, 4) the primitives of the leaves, rounded
    record: FloatArray  # (m, 16) each primitive's equations, see gonio.facade.bvh
    extent: float  # m, radius of the scene
    periodic: bool  # u is common to all primitives and a is unlimited: an endless street


class Patches(NamedTuple):
    """The cells between which light is exchanged, n of them, first those of each primitive's front.

    Patch i is ``a0 + s da, b0 + t db`` of its primitive for 0 <= s, t <= 1; on a triangle ``s + t <= 1``, and
    da, db are negative in the cells that stand on their head.
    """

    primitive: IntArray  # (n,)
    back: NDArray[np.uint8]  # (n,) 1: on the back of a primitive with two sides
    cell: FloatArray  # (n, 4): a0, b0, da, db
    area: FloatArray  # (n,) m2
    receiver: IntArray  # (n,) cell of the result that this patch is a part of, -1: of none


class Light(NamedTuple):
    """Sun and sky, and how reflections are idealised."""

    sun: FloatArray  # (3,) unit vector towards the sun's centre
    disc: float  # 2 sin^2(half angle / 2) = 1 - cos(half angle) of the sun's disc
    dni: float  # W/m2, on a plane that faces the sun; 0 when it is below the horizon
    dhi: float  # W/m2, of an unobstructed horizontal plane
    sky: FloatArray  # (7,) radiance of the sky, see gonio.facade.sky
    conserving: bool
    renormalize: bool

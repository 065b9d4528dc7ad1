"""Which primitives lie in one plane, and which of them hide a part of another?

A module on a wall, a box on the ground: their faces share a plane.  A ray that starts in a plane cannot come
back to it, so it skips the whole plane and needs no offset.  And the hidden part of a face, under a module of
higher rank or under a face that touches it from the other side, must take no part in its patch's average.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.facade.layout import FloatArray, IntArray

TOLERANCE = 1e-9
"""Distance from the plane in units of the scene's radius that still counts as coplanar."""


def planes(origin: FloatArray, u: FloatArray, v: FloatArray, normal: FloatArray, extent: float) -> IntArray:
    """Return the number of the plane of each primitive, (m,)."""
    m = len(origin)
    plane = np.full(m, -1, np.int64)
    found = 0
    for i in range(m):
        if plane[i] >= 0:
            continue
        offset = np.max(
            [np.abs((p - origin[i]) @ normal[i]) for p in (origin, origin + u, origin + v)], axis=0
        )
        same = (offset <= TOLERANCE * extent) & (plane < 0)
        same[i] = True
        plane[same] = found
        found += 1
    return plane


def covers(
    origin: FloatArray,
    u: FloatArray,
    v: FloatArray,
    normal: FloatArray,
    plane: IntArray,
    sides: NDArray[np.uint8],
    *,
    triangle: NDArray[np.uint8],
    periodic: bool,
) -> tuple[IntArray, IntArray]:
    """Return, as (m + 1,) starts and their list, the coplanar primitives that hide a part of each one.

    Those declared later (of higher rank), and those that face the other way and touch it; in an endless
    street (`periodic`) u has no ends, and a module runs along all of it.
    """
    m = len(origin)
    first = np.zeros(m + 1, np.int64)
    found: list[int] = []
    for i in range(m):
        for j in np.flatnonzero(plane == plane[i]):
            facing = float(normal[i] @ normal[j]) > 0.0
            if j != i and (j > i or not facing):
                found.append(int(j))
        first[i + 1] = len(found)
    return first, np.array(found, np.int64)

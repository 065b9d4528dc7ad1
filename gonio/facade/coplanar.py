"""Which primitives lie in one plane, and which of them hide a part of another?

A module on a wall, a box on the ground: their faces share a plane.  A ray that starts in a plane cannot come
back to it, so it skips the whole plane and needs no offset.  And the hidden part of a face, under a module of
higher rank or under a face that touches it from the other side, must take no part in its patch's average.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gonio.facade.layout import FloatArray, IntArray

TOLERANCE = 1e-9
"""Distance from the plane in units of the scene's radius that still counts as coplanar."""

TILT = 1e-5
"""Angle between normals, rad, that may: a fine mesh of a small body in a large scene is not flat."""

_CELL = 1e-4  # width of the cells of normals (and of offsets, in radii) in which planes are looked up


def planes(origin: FloatArray, u: FloatArray, v: FloatArray, normal: FloatArray, extent: float) -> IntArray:
    """Return the number of the plane of each primitive, (m,), in the order of their first members.

    A primitive belongs to the plane of a larger one when all its corners lie in it within `TOLERANCE` and
    its normal within `TILT`.  It is compared with that one only, so no chain of small steps joins planes that
    are apart.
    """
    m = len(origin)
    size = np.linalg.norm(np.cross(u, v).reshape(-1, 3), axis=1)
    largest_first = np.argsort(-size, kind="stable")
    slots = 1 << max(4, int(2 * m).bit_length())
    found = _planes(origin, u, v, normal, extent, largest_first, slots)
    _, first, number = np.unique(found, return_index=True, return_inverse=True)
    place = np.empty(len(first), np.int64)
    place[np.argsort(first)] = np.arange(len(first))
    return np.asarray(place[number.reshape(-1)])


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

    Those declared later (of higher rank) that overlap it, and those that face the other way and overlap it; a
    common edge is no overlap.  In an endless street (`periodic`) u has no ends, and a module runs along all
    of it.
    """
    m = len(origin)
    members = np.bincount(plane, minlength=1)
    shared = np.flatnonzero(members[plane] > 1)
    corners = _corners(origin[shared], u[shared], v[shared], triangle[shared], periodic=periodic)
    tolerance = TOLERANCE * float(np.max(np.linalg.norm(corners, axis=2), initial=0.0))
    along = u[shared] if periodic else _longest(corners, plane[shared])
    along = along / np.linalg.norm(along, axis=1)[:, None]
    flat = np.empty((len(shared), 4, 2))
    flat[:, :, 0] = 0.0 if periodic else np.einsum("mci,mi->mc", corners, along)
    across = np.cross(_reference(normal[shared], plane[shared]), along).reshape(-1, 3)
    flat[:, :, 1] = np.einsum("mci,mi->mc", corners, across)
    if periodic:  # bands: a square as wide as the street is long, so that only its width decides
        flat[:, :, 0] = np.array([0.0, 1.0, 1.0, 0.0]) * max(1.0, tolerance * 1e3)
    low = flat[:, :, 0].min(axis=1)
    order = np.lexsort((low, plane[shared]))
    pairs = np.empty((0, 2), np.int64)
    count = _overlaps(flat, low, plane[shared], order, tolerance, pairs)
    pairs = np.empty((count, 2), np.int64)
    _overlaps(flat, low, plane[shared], order, tolerance, pairs)
    a, b = shared[pairs.min(axis=1)], shared[pairs.max(axis=1)]
    opposed = np.einsum("ij,ij->i", normal[a], normal[b]) < 0.0
    under, above = np.concatenate([a, b[opposed]]), np.concatenate([b, a[opposed]])
    by_primitive = np.lexsort((above, under))
    first = np.concatenate([[0], np.cumsum(np.bincount(under, minlength=m)[:m])]).astype(np.int64)
    return first, above[by_primitive].astype(np.int64)


def _corners(
    origin: FloatArray, u: FloatArray, v: FloatArray, triangle: NDArray[np.uint8], *, periodic: bool
) -> FloatArray:
    """Return the corners in turn, (m, 4, 3); a triangle has one twice."""
    fourth = np.where((triangle > 0)[:, None] & (not periodic), v, u + v)
    return np.asarray(origin[:, None] + np.stack([np.zeros_like(u), u, fourth, v], 1))


def _reference(normal: FloatArray, plane: IntArray) -> FloatArray:
    """Return for each primitive the normal of the first one of its plane: one sense of rotation for all."""
    _, first, number = np.unique(plane, return_index=True, return_inverse=True)
    return np.asarray(normal[first[number.reshape(-1)]])


def _longest(corners: FloatArray, plane: IntArray) -> FloatArray:
    """Return for each primitive the longest edge of the first one of its plane, (m, 3), to sort along."""
    _, first, number = np.unique(plane, return_index=True, return_inverse=True)
    edges = np.roll(corners[first], -1, axis=1) - corners[first]
    best = np.argmax(np.linalg.norm(edges, axis=2), axis=1) if len(first) else np.zeros(0, np.int64)
    return np.asarray(edges[np.arange(len(first)), best][number.reshape(-1)])


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _planes(origin: Any, u: Any, v: Any, normal: Any, extent: float, largest_first: Any, slots: int) -> Any:
    """Return for each primitive the one whose plane it shares: itself, or a larger one."""
    m = len(origin)
    found = np.full(m, -1, np.int64)
    head = np.full(slots, -1, np.int64)
    following = np.full(m, -1, np.int64)
    low = np.empty(4, np.int64)
    high = np.empty(4, np.int64)
    key = np.empty(4, np.float64)
    for j in largest_first:
        offset = (
            normal[j, 0] * origin[j, 0] + normal[j, 1] * origin[j, 1] + normal[j, 2] * origin[j, 2]
        ) / extent
        for turn in range(2):
            sign = 1.0 - 2.0 * turn
            for i in range(3):
                key[i] = sign * normal[j, i]
            key[3] = sign * offset
            for i in range(4):
                low[i] = int(np.floor((key[i] - 1.2 * TILT) / _CELL))
                high[i] = int(np.floor((key[i] + 1.2 * TILT) / _CELL))
            for a in range(low[0], high[0] + 1):
                for b in range(low[1], high[1] + 1):
                    for c in range(low[2], high[2] + 1):
                        for d in range(low[3], high[3] + 1):
                            k = head[_slot(a, b, c, d, slots)]
                            while k >= 0 and found[j] < 0:
                                if _within(origin, u, v, normal, k, j, sign, TOLERANCE * extent):
                                    found[j] = k
                                k = following[k]
        if found[j] < 0:
            found[j] = j
            a = int(np.floor(normal[j, 0] / _CELL))
            b = int(np.floor(normal[j, 1] / _CELL))
            c = int(np.floor(normal[j, 2] / _CELL))
            slot = _slot(a, b, c, int(np.floor(offset / _CELL)), slots)
            following[j] = head[slot]
            head[slot] = j
    return found


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _slot(a: int, b: int, c: int, d: int, slots: int) -> Any:
    """Return the place of a cell in a table of `slots`, a power of two."""
    key = (a * 73856093) ^ (b * 19349663) ^ (c * 83492791) ^ (d * 2971215073)
    key ^= key >> 17
    return key & (slots - 1)


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _within(origin: Any, u: Any, v: Any, normal: Any, k: int, j: int, sign: float, tolerance: float) -> Any:
    """Say whether primitive `j` lies in the plane of `k`."""
    start = 0.0
    for i in range(3):
        if abs(sign * normal[j, i] - normal[k, i]) > TILT:
            return False
        start += normal[k, i] * (origin[j, i] - origin[k, i])
    first, second = start, start
    for i in range(3):
        first += normal[k, i] * u[j, i]
        second += normal[k, i] * v[j, i]
    return abs(start) <= tolerance and abs(first) <= tolerance and abs(second) <= tolerance


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _overlaps(flat: Any, low: Any, plane: Any, order: Any, tolerance: float, pairs: Any) -> Any:
    """Write the pairs of polygons that overlap, as many as fit into `pairs`; return how many there are."""
    count = 0
    high = np.empty(len(flat), np.float64)
    floor = np.empty(len(flat), np.float64)
    top = np.empty(len(flat), np.float64)
    for i in range(len(flat)):
        high[i], floor[i], top[i] = flat[i, 0, 0], flat[i, 0, 1], flat[i, 0, 1]
        for c in range(1, 4):
            high[i] = max(high[i], flat[i, c, 0])
            floor[i] = min(floor[i], flat[i, c, 1])
            top[i] = max(top[i], flat[i, c, 1])
    for at in range(len(order)):
        i = order[at]
        for beyond in range(at + 1, len(order)):
            j = order[beyond]
            if plane[j] != plane[i] or low[j] >= high[i] - tolerance:
                break
            if floor[j] >= top[i] - tolerance or floor[i] >= top[j] - tolerance:
                continue
            if _apart(flat, i, j, tolerance) or _apart(flat, j, i, tolerance):
                continue
            if count < len(pairs):
                pairs[count, 0], pairs[count, 1] = i, j
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _apart(flat: Any, i: int, j: int, tolerance: float) -> Any:
    """Say whether an edge of polygon `i` has all of polygon `j` outside."""
    area = 0.0
    for c in range(4):
        n = (c + 1) % 4
        area += flat[i, c, 0] * flat[i, n, 1] - flat[i, n, 0] * flat[i, c, 1]
    turn = 1.0 if area > 0.0 else -1.0
    for c in range(4):
        n = (c + 1) % 4
        x, y = flat[i, n, 0] - flat[i, c, 0], flat[i, n, 1] - flat[i, c, 1]
        length = np.sqrt(x * x + y * y)
        if length == 0.0:
            continue
        deepest = -np.inf
        for k in range(4):
            inward = (
                (x * (flat[j, k, 1] - flat[i, c, 1]) - y * (flat[j, k, 0] - flat[i, c, 0])) * turn / length
            )
            deepest = max(deepest, inward)
        if deepest <= tolerance:
            return True
    return False

"""The tree that finds what a ray hits: eight children a node, up to eight primitives a leaf.

A node holds the boxes of its children in float32, rounded outwards, and their numbers: a node, or leaf
``-1 - number``; children that do not exist have a box that nothing meets.  A leaf holds its primitives in
float32, in blocks of four; ``record`` holds all in float64, in the order of the tree.  `gonio.facade.lanes`
says what the rows are.  Few primitives, or those of an endless street (whose boxes have no ends), are one
leaf without nodes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gonio.facade.lanes import BLOCK_ROWS, NODE_ROWS
from gonio.facade.layout import FloatArray, IntArray

DEEPEST = 48
"""Levels above which nodes are divided by area; below, in halves, so that the stack cannot overflow."""

_BOXES, _PRIMITIVES = 8, 4  # of a node, of a leaf
_BINS = 16
_PAD = 2.5e-7  # of the scene's radius: float32 coordinates are off by a quarter of that
_ROUNDING = 16.0 * 2.0**-53  # coordinates of a hit, in units of the coordinates
_FULL = 8  # primitives of a leaf
_FINE = 8  # primitives; fuller leaves are divided as long as their node has room


class Tree(NamedTuple):
    """Boxes and links, what the leaves hold, and the order of the primitives in them."""

    nodes: NDArray[np.float32]  # (nodes, 7, 8)
    leaves: NDArray[np.float32]  # (leaves, 15, 4)
    record: FloatArray  # (m, 16): n, c; dual_u, c_u; dual_v, c_v; rounding; limit of a + b; plane; rank
    order: IntArray  # (m,)


def build(
    origin: FloatArray,
    u: FloatArray,
    v: FloatArray,
    normal: FloatArray,
    dual_u: FloatArray,
    dual_v: FloatArray,
    triangle: NDArray[np.uint8],
    plane: IntArray,
    extent: float,
    *,
    periodic: bool,
) -> Tree:
    """Return the tree of m primitives, whose coordinates are at most `extent` from the origin."""
    m = len(origin)
    order = np.arange(m, dtype=np.int64)
    if periodic or m <= _FULL:
        leaf = np.array([[0, m]], np.int32)[: m > 0]
        nodes = _aligned((0, NODE_ROWS, _BOXES), np.float32)
    else:
        far = np.where(triangle[:, None] > 0, origin + u, origin + u + v)
        corners = np.stack([origin, origin + u, origin + v, far])
        box = np.empty((m, 6), np.float32)
        box[:, :3] = corners.min(axis=0) - _PAD * extent
        box[:, 3:] = corners.max(axis=0) + _PAD * extent
        room = np.empty((m, NODE_ROWS, _BOXES), np.float32)
        leaf = np.empty((m, 2), np.int32)
        used, ends = _divide(box, order, room, room.view(np.int32), leaf)
        nodes, leaf = _aligned((used, NODE_ROWS, _BOXES), np.float32), leaf[:ends]
        nodes[:] = room[:used]
    record = _aligned((m, 16), np.float64)
    record[:, 0:3] = normal[order]
    record[:, 4:7] = dual_u[order]
    record[:, 8:11] = dual_v[order]
    for i in (0, 4, 8):
        record[:, i + 3] = np.einsum("ij,ij->i", record[:, i : i + 3], origin[order])
    record[:, 7] *= -1.0
    record[:, 11] *= -1.0
    largest = np.sqrt(
        np.max([np.einsum("ij,ij->i", x, x) for x in (dual_u, dual_v, dual_u + dual_v)], axis=0)
    )
    record[:, 12] = _ROUNDING * largest[order]
    record[:, 13] = np.where(triangle[order] > 0, 1.0, 2.0)
    record[:, 14] = plane[order]
    record[:, 15] = order
    return Tree(nodes, _packed(record, 2.0 * largest[order], leaf, periodic=periodic), record, order)


def _packed(
    record: FloatArray, largest: FloatArray, leaf: NDArray[np.int32], *, periodic: bool
) -> NDArray[np.float32]:
    """Return the leaves' primitives in float32, (blocks, 15, 4)."""
    each = (leaf[:, 1] + _PRIMITIVES - 1) // _PRIMITIVES
    ends = np.cumsum(each)
    leaves = _aligned((int(each.sum()), BLOCK_ROWS, _PRIMITIVES), np.float32)
    leaves[:] = 0.0
    of = np.repeat(np.arange(len(leaf)), each)  # the leaf of each block
    at = np.arange(len(of)) - (ends - each)[of]  # its number in the leaf
    first = leaf[of, 0] + _PRIMITIVES * at
    count = np.minimum(leaf[of, 1] - _PRIMITIVES * at, _PRIMITIVES)
    block = np.repeat(np.arange(len(of)), count)
    lane = np.arange(len(block)) - (np.cumsum(count) - count)[block]
    where = first[block] + lane
    leaves[block, :12, lane] = record[where, :12]
    leaves[block, 12, lane] = largest[where]
    leaves[block, 13, lane] = record[where, 13]
    leaves.view(np.int32)[:, 14, :3] = np.stack([first, (1 << count) - 1, at + 1 < each[of]], 1)
    if periodic:
        leaves[:, 4:8] = 0.0  # a = 0: any place along the street will do
    return leaves


def _aligned(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Return an array that begins with a cache line, of 64 bytes."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    room = np.empty(size + 64, np.uint8)
    start = -room.ctypes.data % 64
    return np.asarray(room[start : start + size].view(dtype).reshape(shape))


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _divide(box: Any, order: Any, bounds: Any, child: Any, leaf: Any) -> Any:
    """Fill nodes and leaves from the boxes, which are sorted as `order` is; return how many there are."""
    task = np.empty((len(order) + 8, 4), np.int64)  # node, first, end, depth
    part = np.empty((8, 2), np.int64)
    size = np.empty((8, 6), np.float32)
    room = np.empty((3, _BINS, 7), np.float64)
    task[0, 0], task[0, 1], task[0, 2], task[0, 3] = 0, 0, len(order), 0
    tasks, nodes, leaves, blocks = 1, 1, 0, 0
    while tasks > 0:
        tasks -= 1
        node, first, end, depth = task[tasks, 0], task[tasks, 1], task[tasks, 2], task[tasks, 3]
        part[0, 0], part[0, 1] = first, end
        _around(box, first, end, size[0])
        parts = 1
        while parts < 8:
            widest, which = -1.0, -1
            for i in range(parts):
                n = part[i, 1] - part[i, 0]
                area = _area(size[i]) + (
                    1e30 if n > 8 else 0.0
                )  # leaves hold eight: what is fuller goes first
                if n > _FINE and area > widest:
                    widest, which = area, i
            if which < 0:
                break
            a, b = part[which, 0], part[which, 1]
            middle = a + (b - a) // 2 if depth >= DEEPEST else _split(box, order, a, b, room)
            part[which, 1] = middle
            part[parts, 0], part[parts, 1] = middle, b
            _around(box, a, middle, size[which])
            _around(box, middle, b, size[parts])
            parts += 1
        for i in range(parts, 8):
            child[node, 6, i] = -1
            for j in range(6):
                bounds[node, j, i] = np.inf if j < 3 else -np.inf
        for i in range(parts):
            for j in range(6):
                bounds[node, j, i] = size[i, j]
            a, b = part[i, 0], part[i, 1]
            if b - a <= _FULL:
                child[node, 6, i] = -1 - blocks
                leaf[leaves, 0], leaf[leaves, 1] = a, b - a
                leaves += 1
                blocks += (b - a + 3) // 4
            else:
                child[node, 6, i] = nodes
                task[tasks, 0], task[tasks, 1], task[tasks, 2], task[tasks, 3] = nodes, a, b, depth + 1
                tasks += 1
                nodes += 1
    return nodes, leaves


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _around(box: Any, first: int, end: int, out: Any) -> None:
    """Write to `out` the box around boxes ``first`` to ``end - 1``."""
    for j in range(6):
        out[j] = box[first, j]
    for i in range(first + 1, end):
        for j in range(3):
            out[j] = min(out[j], box[i, j])
            out[j + 3] = max(out[j + 3], box[i, j + 3])


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _area(box: Any) -> Any:
    """Return half the surface of a box."""
    x = np.float64(box[3]) - box[0]
    y = np.float64(box[4]) - box[1]
    z = np.float64(box[5]) - box[2]
    return x * y + y * z + z * x


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _split(box: Any, order: Any, first: int, end: int, room: Any) -> int:
    """Divide boxes ``first`` to ``end - 1`` in place where the surface-area heuristic is least.

    Binned by twice their centres along each axis (Wald 2007, "On fast construction of SAH-based bounding
    volume hierarchies").  Returns where the second part begins.
    """
    low = np.inf, np.inf, np.inf
    high = -np.inf, -np.inf, -np.inf
    for i in range(first, end):
        x, y, z = box[i, 0] + box[i, 3], box[i, 1] + box[i, 4], box[i, 2] + box[i, 5]
        low = min(low[0], x), min(low[1], y), min(low[2], z)
        high = max(high[0], x), max(high[1], y), max(high[2], z)
    for axis in range(3):
        for i in range(_BINS):
            for j in range(3):
                room[axis, i, j] = np.inf
                room[axis, i, j + 3] = -np.inf
            room[axis, i, 6] = 0.0
    scale = _per_bin(low[0], high[0]), _per_bin(low[1], high[1]), _per_bin(low[2], high[2])
    for i in range(first, end):
        for axis in range(3):
            if scale[axis] > 0.0:
                into = room[axis, _bin(box[i, axis] + box[i, axis + 3], low[axis], scale[axis])]
                for j in range(3):
                    into[j] = min(into[j], box[i, j])
                    into[j + 3] = max(into[j + 3], box[i, j + 3])
                into[6] += 1.0
    best, best_axis, best_bin = np.inf, -1, 0
    right = np.empty(_BINS, np.float64)
    grown = np.empty(6, np.float64)
    for axis in range(3):
        if scale[axis] == 0.0:
            continue
        for j in range(6):
            grown[j] = np.inf if j < 3 else -np.inf
        total = 0.0
        for i in range(_BINS - 1, 0, -1):
            total += room[axis, i, 6]
            for j in range(3):
                grown[j] = min(grown[j], room[axis, i, j])
                grown[j + 3] = max(grown[j + 3], room[axis, i, j + 3])
            right[i] = _area(grown) * total if total > 0.0 else np.inf
        for j in range(6):
            grown[j] = np.inf if j < 3 else -np.inf
        total = 0.0
        for i in range(_BINS - 1):
            total += room[axis, i, 6]
            for j in range(3):
                grown[j] = min(grown[j], room[axis, i, j])
                grown[j + 3] = max(grown[j + 3], room[axis, i, j + 3])
            if total > 0.0:
                cost = _area(grown) * total + right[i + 1]
                if cost < best:
                    best, best_axis, best_bin = cost, axis, i
    if best_axis < 0:  # all centres in one place
        return first + (end - first) // 2
    i, k = first, end - 1
    while i <= k:
        if _bin(box[i, best_axis] + box[i, best_axis + 3], low[best_axis], scale[best_axis]) <= best_bin:
            i += 1
            continue
        for j in range(6):
            box[i, j], box[k, j] = box[k, j], box[i, j]
        order[i], order[k] = order[k], order[i]
        k -= 1
    return i


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _per_bin(low: float, high: float) -> float:
    """Return bins per metre, 0 where all is in one place."""
    return _BINS * (1.0 - 1e-6) / (high - low) if high > low else 0.0


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _bin(x: float, low: float, scale: float) -> int:
    return min(int((x - low) * scale), _BINS - 1)

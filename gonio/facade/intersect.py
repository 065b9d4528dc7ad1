"""What does a ray hit?

A ray starts on a primitive and skips all that lie in its plane, so there is no offset to tune.  Edges are
wider by 1e-9 of their length, and by what rounding moves the hit, which grows towards grazing incidence:
surfaces that share an edge overlap a little instead of leaking.

The tree and its leaves are filters (`gonio.facade.lanes`); what they let through is tested here in float64.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gonio.facade.lanes import (
    BLOCK_ROWS,
    NODE_ROWS,
    as_int32,
    boxes,
    candidates,
    float_bits,
    frame,
    lowest,
    pointer,
)
from gonio.facade.sampling import compiled

_EDGE = 1e-9
_TIE = 2e-9  # of the scene's radius: how far apart coplanar primitives may lie, so rank decides
_NOISE = 1e-10  # of the scene's radius: a ray that starts no further from a plane starts in it
_PARALLEL = 1e-12  # sine of the angle to a plane below which a ray does not meet it
_SINGLE_REACH = 32.0 * 2.0**-24
_ONE = np.int64(1)
_LOW = np.int64(0xFFFFFFFF)
_SHIFT = np.int64(32)
_NODE, _CHILDREN = np.int64(NODE_ROWS * 8), np.int64(48)  # float32 of a node, and where its children begin
_LEAF, _FIRST = np.int64(BLOCK_ROWS * 4), np.int64(56)


@compiled
def nearest(g: Any, p: Any, d: Any, own: int) -> Any:
    """Return ``(primitive or -1, distance in m, a, b)`` of the nearest hit of the ray ``p + t d``, t > 0.

    `own` is the primitive the ray starts on, -1 for none; whatever lies in its plane is not hit.  A ray that
    starts on an edge of `own` and leaves through the surface that adjoins there hits it at t = 0.
    """
    return _first_hit(_tree(g), g.extent, g.periodic, p, d, own, np.int64(0))


@compiled
def occluded(g: Any, p: Any, d: Any, own: int) -> bool:
    """Say whether the ray ``p + t d``, t > 0, hits anything; `own` as for `nearest`."""
    return _first_hit(_tree(g), g.extent, g.periodic, p, d, own, np.int64(1))[0] >= 0  # type: ignore[no-any-return]


@compiled
def _tree(g: Any) -> Any:
    """Return what the search reads: sizes, and addresses, which it need not check or count references to."""
    sizes = g.nodes.shape[0], g.leaves.shape[0]
    tree = pointer(g.nodes), pointer(g.leaves), pointer(g.record)
    return sizes, tree, (pointer(g.origin), pointer(g.u), pointer(g.v))


@compiled
def _first_hit(tree: Any, extent: float, periodic: bool, p: Any, d: Any, own: int, anything: Any) -> Any:
    """Return the nearest hit as `nearest` does, or with `anything` the first that is found."""
    (n_nodes, n_leaves), (nodes, leaves, record), edges = tree
    found = np.int64(-1)
    best = math.inf
    best_a = 0.0
    best_b = 0.0
    if n_leaves == 0:
        return found, best, best_a, best_b
    child, leaf = as_int32(nodes), as_int32(leaves)
    entries, distances, latest = frame()
    plane = record[16 * own + 14] if own >= 0 else -1.0
    tie = 0.0
    limit = np.float32(math.inf)
    limit_bits = float_bits(limit)

    size = abs(p[0]) + abs(p[1]) + abs(p[2]) + extent
    reach = np.float32(_SINGLE_REACH * size)
    p32 = (np.float32(p[0]), np.float32(p[1]), np.float32(p[2]))
    d32 = (np.float32(d[0]), np.float32(d[1]), np.float32(d[2]))
    row_x, ray_x = _slab(p[0], d[0], 0)
    row_y, ray_y = _slab(p[1], d[1], 8)
    row_z, ray_z = _slab(p[2], d[2], 16)
    rows = row_x, row_y, row_z
    ray = ray_x, ray_y, ray_z

    entries[0] = np.int64(0) if n_nodes > 0 else _LOW  # the root, or leaf 0 (-1)
    count = 1
    while count > 0:
        count -= 1
        key = entries[count]
        if (key >> _SHIFT) > limit_bits:
            continue
        at = np.int64(np.int32(key & _LOW))
        while at >= 0:
            mask = boxes(nodes, at, rows, ray, limit, distances)
            if mask == 0:
                break
            children = _CHILDREN + at * _NODE
            lane = lowest(mask)
            mask &= mask - _ONE
            if mask == 0:
                at = np.int64(child[children + lane])
                continue
            key = _key(distances[lane], child[children + lane])
            base = count
            while mask != 0:  # nearest on top
                lane = lowest(mask)
                other = _key(distances[lane], child[children + lane])
                mask &= mask - _ONE
                if other < key:
                    key, other = other, key
                place = count
                while place > base and entries[place - 1] < other:
                    entries[place] = entries[place - 1]
                    place -= 1
                entries[place] = other
                count += 1
            at = np.int64(np.int32(key & _LOW))
        if at >= 0:
            continue
        block = -_ONE - at
        more = True
        while more:
            mask = candidates(leaves, block, p32, d32, reach, limit, latest)
            info = block * _LEAF + _FIRST
            mask &= leaf[info + 1]
            more = leaf[info + 2] != 0
            block += _ONE
            while mask != 0:
                lane = lowest(mask)
                k = leaf[info] + lane
                mask &= mask - _ONE
                if record[16 * k + 14] == plane:
                    continue
                hit, t, a, b, steep = _meets(record, edges, k, p, d, own, extent, periodic, size, best + tie)
                if not hit:
                    continue
                if anything != 0:
                    return k, t, a, b
                if found >= 0 and t >= best - tie:
                    if record[16 * k + 14] != record[16 * found + 14]:
                        if t >= best:
                            continue
                    elif record[16 * k + 15] < record[16 * found + 15]:
                        continue
                found, best, best_a, best_b = k, t, a, b
                tie = _TIE * extent * min(steep, 1e4)
                if latest[lane] < limit:  # not best: the tree need not wait for the float64 test
                    limit = latest[lane]
                    limit_bits = float_bits(limit)
    return found, best, best_a, best_b


@compiled
def _key(distance: Any, child: Any) -> Any:
    """Return a number that sorts as the distance does, with the child below it."""
    return (np.int64(distance) << _SHIFT) | (np.int64(child) & _LOW)


@compiled
def _slab(o: float, d: float, place: int) -> Any:
    """Return, for one axis, the place of the near sides in a node, and the ray as `boxes` reads it."""
    inverse = np.float32(1.0 / math.copysign(max(abs(d), 1e-18), d))
    at = o * np.float64(inverse)
    slack = 2.4e-7 * abs(at)
    near_place = np.int64(place) if d >= 0.0 else np.int64(place + 24)
    return near_place, (inverse, np.float32(at + slack), np.float32(at - slack))


@compiled
def _meets(
    record: Any,
    edges: Any,
    k: int,
    p: Any,
    d: Any,
    own: int,
    extent: float,
    periodic: bool,
    size: float,
    farthest: float,
) -> Any:
    """Return ``(hit, t, a, b, 1/sine)`` of primitive `k` for 0 < t <= farthest."""
    r = 16 * k
    slope = record[r] * d[0] + record[r + 1] * d[1] + record[r + 2] * d[2]
    if abs(slope) < _PARALLEL:
        return False, 0.0, 0.0, 0.0, 0.0
    height = record[r + 3] - (record[r] * p[0] + record[r + 1] * p[1] + record[r + 2] * p[2])
    steep = 1.0 / slope
    t = height * steep
    if own >= 0 and abs(height) <= _NOISE * extent:
        # on an edge of `own`: does the ray leave its side of this plane?
        origin, u, v = edges
        part = 1.0 / 3.0 if record[16 * own + 13] == 1.0 else 0.5
        side = -record[r + 3]
        for i in range(3):
            side += record[r + i] * (origin[3 * own + i] + part * (u[3 * own + i] + v[3 * own + i]))
        if side * slope >= 0.0 or abs(side) <= _NOISE * extent:
            return False, 0.0, 0.0, 0.0, 0.0
        t = max(t, 0.0)
    elif t <= 0.0:
        return False, 0.0, 0.0, 0.0, 0.0
    steep = abs(steep)
    if t > farthest:
        return False, 0.0, 0.0, 0.0, 0.0
    x = p[0] + t * d[0]
    y = p[1] + t * d[1]
    z = p[2] + t * d[2]
    edge = _EDGE + record[r + 12] * (size + t) * steep
    b = record[r + 8] * x + record[r + 9] * y + record[r + 10] * z + record[r + 11]
    if b < -edge or b > 1.0 + edge:
        return False, 0.0, 0.0, 0.0, 0.0
    a = record[r + 4] * x + record[r + 5] * y + record[r + 6] * z + record[r + 7]
    if periodic:
        return True, t, a - math.floor(a), b, steep
    inside = a >= -edge and a <= 1.0 + edge and a + b <= record[r + 13] + 2.0 * edge
    return inside, t, a, b, steep

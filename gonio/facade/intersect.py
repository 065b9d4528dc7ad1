"""What does a ray hit?

A ray starts on a primitive and skips all that lie in its plane, so there is no offset to tune.  Edges are
wider by 1e-9 of their length: surfaces that share an edge overlap a little instead of leaking.
"""

from __future__ import annotations

import math
from typing import Any

from gonio.facade.sampling import compiled
from gonio.facade.vectors import along, dot, row

_EDGE = 1e-9
_TIE = 1e-9  # of the scene's radius: hits that are no further apart are at one place, and rank decides


@compiled
def nearest(g: Any, p: Any, d: Any, own: int) -> Any:
    """Return ``(primitive or -1, distance in m, a, b)`` of the nearest hit of the ray ``p + t d``, t > 0.

    `own` is the primitive the ray starts on, -1 for none; whatever lies in its plane is not hit.
    """
    best = math.inf
    found = -1
    best_a = 0.0
    best_b = 0.0
    tie = _TIE * g.extent
    plane = g.plane[own] if own >= 0 else -1
    for k in range(g.origin.shape[0]):
        if g.plane[k] == plane:
            continue
        hit, t, a, b = _meets(g, k, p, d, best + tie)
        if hit and (t < best - tie or found < 0 or g.rank[k] > g.rank[found]):
            best, found, best_a, best_b = t, k, a, b
    return found, best, best_a, best_b


@compiled
def occluded(g: Any, p: Any, d: Any, own: int) -> bool:
    """Say whether the ray ``p + t d``, t > 0, hits anything; `own` as for `nearest`."""
    plane = g.plane[own] if own >= 0 else -1
    for k in range(g.origin.shape[0]):  # noqa: SIM110 - compiled code knows no generators
        if g.plane[k] != plane and _meets(g, k, p, d, math.inf)[0]:
            return True
    return False


@compiled
def _meets(g: Any, k: int, p: Any, d: Any, farthest: float) -> Any:
    """Return ``(hit, t, a, b)`` of primitive `k` for 0 < t <= farthest."""
    n = row(g.normal, k)
    o = row(g.origin, k)
    slope = dot(n, d)
    if slope == 0.0:
        return False, 0.0, 0.0, 0.0
    t = (n[0] * (o[0] - p[0]) + n[1] * (o[1] - p[1]) + n[2] * (o[2] - p[2])) / slope
    if t <= 0.0 or t > farthest:
        return False, 0.0, 0.0, 0.0
    x = along(p, t, d)
    r = (x[0] - o[0], x[1] - o[1], x[2] - o[2])
    b = dot(row(g.dual_v, k), r)
    if b < -_EDGE or b > 1.0 + _EDGE:
        return False, 0.0, 0.0, 0.0
    a = dot(row(g.dual_u, k), r)
    if g.periodic:
        return True, t, a - math.floor(a), b
    inside = a >= -_EDGE and a <= 1.0 + _EDGE and (g.triangle[k] == 0 or a + b <= 1.0 + _EDGE)
    return inside, t, a, b

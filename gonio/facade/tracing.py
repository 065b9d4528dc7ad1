"""What does a ray hit, and how much of the light is reflected there?

Surfaces are parallelograms ``o + a u + b v`` with ``0 <= a, b <= 1``; in a periodic scene every ``u`` lies
along the street and ``a`` is unlimited, so that one stored cell stands for an endless street.  The normal ``u
x v`` points to the reflecting side, the other side is black.  All geometry is float64, and a ray skips the
surface it starts on, so there is no offset to tune.

Light is unpolarised at every reflection (R is the mean of S and P).  A material is ``(rho_d, rho_s, alpha,
n2)`` and redistributes the incident power as it was fitted (a differential scattering function, not a BRDF):

    k_d/pi cos(theta_o) + k_s(theta_i) (alpha+1)/(2 pi) cos_+(theta_s)^alpha,   k_s = rho_s R(n2, theta_i),

with theta_i always at the side the light comes from, also in paths that are traced backwards.
"""

from __future__ import annotations

import math
from typing import Any

from gonio.facade.sampling import compiled

MAX_BOUNCES = 10_000

_EDGE = 1e-9  # in units of the edge length: surfaces that share an edge overlap a little instead of leaking


@compiled
def fresnel_mean(cosine: float, n2: float) -> float:
    """Return the mean of R_s and R_p from air to index `n2` (paper Eq 11-12): 0 for n2 = 1, 1 at 90 deg."""
    if n2 == 1.0:
        return 0.0
    c = min(max(cosine, 0.0), 1.0)
    q2 = (n2 - 1.0) * (n2 + 1.0) + c * c
    if q2 <= 0.0:  # an index below one reflects totally beyond its critical angle
        return 1.0
    q = math.sqrt(q2)
    s = (c - q) / (c + q)
    p = (n2 * n2 * c - q) / (n2 * n2 * c + q)
    return 0.5 * (s * s + p * p)


@compiled
def coefficients(g: Any, k: int, cosine: float, conserving: bool) -> Any:
    """Return ``(k_d, k_s)`` of surface `k` at incidence `cosine`.

    Conserving: the diffuse part takes what the lobe leaves; otherwise both are as published, whatever their
    sum.
    """
    k_d = g.material[k, 0]
    k_s = 0.0
    if g.material[k, 1] > 0.0:
        k_s = g.material[k, 1] * fresnel_mean(cosine, g.material[k, 3])
    if conserving:
        k_s = min(k_s, 1.0)
        k_d = min(k_d, 1.0 - k_s)
    return k_d, k_s


@compiled
def lobe_density(cosine_s: float, alpha: float) -> float:
    """Return ``(alpha+1)/(2 pi) cos_+^alpha``, 1/sr."""
    if cosine_s <= 0.0:
        return 0.0
    return (alpha + 1.0) / (2.0 * math.pi) * math.exp(alpha * math.log(min(cosine_s, 1.0)))


@compiled
def dot(a: Any, b: Any) -> float:
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]  # type: ignore[no-any-return]


@compiled
def along(p: Any, t: float, d: Any) -> Any:
    """Return ``p + t d``."""
    return p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]


@compiled
def mirrored(d: Any, n: Any) -> Any:
    """Return the direction `d` mirrored at a plane of unit normal `n`."""
    t = 2.0 * dot(d, n)
    return d[0] - t * n[0], d[1] - t * n[1], d[2] - t * n[2]


@compiled
def row(array: Any, k: int) -> Any:
    """Return row `k` of an (n, 3) array as three numbers (a view would count references in every thread)."""
    return array[k, 0], array[k, 1], array[k, 2]


@compiled
def on_surface(g: Any, k: int, a: float, b: float) -> Any:
    """Return the point ``o + a u + b v`` of surface `k`."""
    return along(along(row(g.origin, k), a, row(g.u, k)), b, row(g.v, k))


@compiled
def _enters(g: Any, node: int, p: Any, inverse: Any, farthest: float) -> bool:
    enter = 0.0
    leave = farthest
    for axis in range(3):
        one = (g.low[node, axis] - p[axis]) * inverse[axis]
        two = (g.high[node, axis] - p[axis]) * inverse[axis]
        # 0 * inf, a ray inside the plane of a side: NaN fails both comparisons and limits nothing
        if one < two:
            enter = one if one > enter else enter
            leave = two if two < leave else leave
        elif two <= one:
            enter = two if two > enter else enter
            leave = one if one < leave else leave
    return enter <= leave


@compiled
def nearest(g: Any, periodic: bool, p: Any, d: Any, own: int, any_hit: bool) -> Any:
    """Return ``(surface or -1, distance, a, b)`` of the nearest hit, or of the first found with `any_hit`.

    `own` is the surface the ray starts on, -1 for none.
    """
    best = math.inf
    found = -1
    best_a = 0.0
    best_b = 0.0
    inverse = (1.0 / d[0], 1.0 / d[1], 1.0 / d[2])
    node = 0
    nodes = g.low.shape[0]
    while node < nodes:
        if not _enters(g, node, p, inverse, best):
            node = g.link[node, 0]
            continue
        first = g.link[node, 1]
        for k in range(first, first + g.link[node, 2]):
            if k == own:
                continue
            n = row(g.normal, k)
            o = row(g.origin, k)
            slope = dot(n, d)
            if slope == 0.0:
                continue
            t = (n[0] * (o[0] - p[0]) + n[1] * (o[1] - p[1]) + n[2] * (o[2] - p[2])) / slope
            if t <= 0.0 or t >= best:
                continue
            x = along(p, t, d)
            r = (x[0] - o[0], x[1] - o[1], x[2] - o[2])
            b = dot(row(g.dual_v, k), r)
            if b < -_EDGE or b > 1.0 + _EDGE:
                continue
            a = dot(row(g.dual_u, k), r)
            if not periodic and (a < -_EDGE or a > 1.0 + _EDGE):
                continue
            best, found, best_a, best_b = t, k, a, b
            if any_hit:
                return found, best, best_a, best_b
        node += 1
    return found, best, best_a, best_b

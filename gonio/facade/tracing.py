"""How much of the light is reflected where a ray hits, and to which patch does the place belong?

Light is unpolarised at every reflection (R is the mean of S and P).  A material is ``(rho_d, rho_s, alpha,
n2)`` and redistributes the incident power as it was fitted (a differential scattering function, not a BRDF):

    k_d/pi cos(theta_o) + k_s(theta_i) (alpha+1)/(2 pi) cos_+(theta_s)^alpha,   k_s = rho_s R(n2, theta_i),

with theta_i always at the side the light comes from, also in paths that are traced backwards.
"""

from __future__ import annotations

import math
from typing import Any

from gonio.facade.layout import ALPHA, CONSTANT, N2, RHO_D, RHO_S
from gonio.facade.sampling import compiled
from gonio.facade.vectors import along, dot, negative, row

MAX_BOUNCES = 10_000


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
    """Return ``(k_d, k_s)`` of primitive `k` for unpolarised light at incidence `cosine`."""
    m = g.optics[k]
    if g.materials[m, RHO_S] == 0.0:
        return g.materials[m, RHO_D], 0.0
    r = 1.0 if g.materials[m, CONSTANT] > 0.0 else fresnel_mean(cosine, g.materials[m, N2])
    return shared(g, k, r, conserving)


@compiled
def shared(g: Any, k: int, r: float, conserving: bool) -> Any:
    """Return ``(k_d, k_s)`` of primitive `k` where the interface reflects the part `r`.

    Conserving: the diffuse part takes what the lobe leaves; otherwise both are as published, whatever their
    sum.
    """
    m = g.optics[k]
    k_d = g.materials[m, RHO_D]
    k_s = g.materials[m, RHO_S] * r
    if conserving:
        k_s = min(k_s, 1.0)
        k_d = min(k_d, 1.0 - k_s)
    return k_d, k_s


@compiled
def glossy(g: Any, k: int) -> bool:
    """Say whether primitive `k` has a lobe."""
    return g.materials[g.optics[k], RHO_S] > 0.0  # type: ignore[no-any-return]


@compiled
def exponent(g: Any, k: int) -> float:
    """Return alpha of primitive `k`."""
    return g.materials[g.optics[k], ALPHA]  # type: ignore[no-any-return]


@compiled
def facing(g: Any, k: int, d: Any) -> Any:
    """Return ``(normal, back)`` of the side of `k` that light along `d` meets; back -1: it is black."""
    n = row(g.normal, k)
    if dot(n, d) < 0.0:
        return n, 0
    if g.sides[k] == 2:
        return negative(n), 1
    return n, -1


@compiled
def patch_at(g: Any, k: int, back: int, a: float, b: float) -> int:
    """Return the patch of the point ``(a, b)`` of primitive `k`, -1 if it has none."""
    first = g.patch[k, back, 0]
    if first < 0:
        return -1
    rows = g.patch[k, back, 1]
    columns = g.patch[k, back, 2]
    i = min(max(int(a * columns), 0), columns - 1)
    j = min(max(int(b * rows), 0), rows - 1)
    if g.triangle[k] == 0:
        return first + j * columns + i  # type: ignore[no-any-return]
    j = min(j, rows - 1 - i)
    head = 1 if (a * columns - i) + (b * rows - j) > 1.0 and j < rows - 1 - i else 0
    return first + i * (2 * rows - i) + 2 * j + head  # type: ignore[no-any-return]


@compiled
def point_of(g: Any, patches: Any, i: int, s: float, t: float) -> Any:
    """Return ``(point, hidden)`` at ``(s, t)``, each uniform in 0...1, of patch `i`.

    On a triangle the unit square is folded along its diagonal.  Hidden points lie under a coplanar primitive.
    """
    k = patches.primitive[i]
    if g.triangle[k] == 1 and s + t > 1.0:
        s = 1.0 - s
        t = 1.0 - t
    a = patches.cell[i, 0] + s * patches.cell[i, 2]
    b = patches.cell[i, 1] + t * patches.cell[i, 3]
    p = on_surface(g, k, a, b)
    return p, hidden(g, k, p)


@compiled
def hidden(g: Any, k: int, p: Any) -> bool:
    """Say whether the point `p` of primitive `k` lies under another one of its plane."""
    for at in range(g.cover_first[k], g.cover_first[k + 1]):
        other = g.cover[at]
        r = (p[0] - g.origin[other, 0], p[1] - g.origin[other, 1], p[2] - g.origin[other, 2])
        a = dot(row(g.dual_u, other), r)
        b = dot(row(g.dual_v, other), r)
        if g.periodic:
            a -= math.floor(a)
        if a >= 0.0 and b >= 0.0 and a <= 1.0 and b <= 1.0 and (g.triangle[other] == 0 or a + b <= 1.0):
            return True
    return False


@compiled
def on_surface(g: Any, k: int, a: float, b: float) -> Any:
    """Return the point ``o + a u + b v`` of primitive `k`."""
    return along(along(row(g.origin, k), a, row(g.u, k)), b, row(g.v, k))


@compiled
def lobe_density(cosine_s: float, alpha: float) -> float:
    """Return ``(alpha+1)/(2 pi) cos_+^alpha``, 1/sr."""
    if cosine_s <= 0.0:
        return 0.0
    return (alpha + 1.0) / (2.0 * math.pi) * math.exp(alpha * math.log(min(cosine_s, 1.0)))

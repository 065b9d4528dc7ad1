"""How does polarised light reflect?

A photon carries q = Q/I and u = U/I and a unit vector e perpendicular to its direction d; Q > 0 is light that
swings along e, U > 0 along the diagonal of e and d x e.  V stays 0: the amplitudes r_s and r_p of a
dielectric seen from outside are real.  At a surface e turns into s, perpendicular to the plane of incidence;
with p = d x s on both sides (Verdet's convention: r_s and r_p have opposite signs at normal incidence) the
Mueller matrix is

    I' = a + b q,   Q' = b + a q,   U' = r_s r_p u,   a = (r_s^2 + r_p^2)/2,   b = (r_s^2 - r_p^2)/2.

The lobe spreads light about the mirror direction m; e follows from m to d by the rotation that turns m into d
(parallel transport: the smallest one).  Sun and sky enter unpolarised, and diffuse reflection depolarises.
"""

from __future__ import annotations

import math
from typing import Any

from gonio.facade.sampling import compiled
from gonio.facade.vectors import along, dot


@compiled
def cross(a: Any, b: Any) -> Any:
    """Return the vector product of two vectors."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@compiled
def perpendicular(d: Any) -> Any:
    """Return a unit vector perpendicular to the unit vector `d`."""
    if abs(d[2]) < 0.9:
        length = math.sqrt(d[0] * d[0] + d[1] * d[1])
        return d[1] / length, -d[0] / length, 0.0
    length = math.sqrt(d[1] * d[1] + d[2] * d[2])
    return 0.0, d[2] / length, -d[1] / length


@compiled
def amplitudes(cosine: float, n2: float) -> Any:
    """Return ``(r_s, r_p)`` from air to index `n2` >= 1 (paper Eq 11-12 before they are squared)."""
    if n2 == 1.0:
        return 0.0, 0.0
    c = min(max(cosine, 0.0), 1.0)
    q = math.sqrt((n2 - 1.0) * (n2 + 1.0) + c * c)
    return (c - q) / (c + q), (n2 * n2 * c - q) / (n2 * n2 * c + q)


@compiled
def into_plane(q: float, u: float, e: Any, d: Any, n: Any) -> Any:
    """Return ``(q, u, s)``: the light along `d` referred to s, perpendicular to the plane of `d` and `n`."""
    s = cross(d, n)
    length2 = dot(s, s)
    if length2 < 1e-24:  # normal incidence: every plane is a plane of incidence
        return q, u, e
    scale = 1.0 / math.sqrt(length2)
    s = (s[0] * scale, s[1] * scale, s[2] * scale)
    if q == 0.0 and u == 0.0:
        return q, u, s
    cosine = dot(e, s)
    sine = dot(cross(d, e), s)
    cosine2 = cosine * cosine - sine * sine
    sine2 = 2.0 * cosine * sine
    return q * cosine2 + u * sine2, u * cosine2 - q * sine2, s


@compiled
def reflected(q: float, u: float, r_s: float, r_p: float) -> Any:
    """Return ``(R, q, u)``: the reflected part of I, and the light after reflection; q, u refer to s."""
    a = 0.5 * (r_s * r_s + r_p * r_p)
    b = 0.5 * (r_s * r_s - r_p * r_p)
    r = a + b * q
    if r <= 0.0:
        return 0.0, 0.0, 0.0
    return r, (b + a * q) / r, r_s * r_p * u / r


@compiled
def carried(e: Any, m: Any, d: Any) -> Any:
    """Return `e` after the smallest rotation that turns the unit vector `m` into `d`, 90 degrees at most."""
    t = -dot(e, d) / (1.0 + dot(m, d))
    return along(e, t, (m[0] + d[0], m[1] + d[1], m[2] + d[2]))

r"""The aperture as one point of the sample sees it, and where in it the lobe is.

Seen from a sample point, the aperture is a rectangle in a plane at distance `D` along the arm::

      v (out of plane)                     p = D (u s + v t + a),   dOmega = ds dt / (1 + s^2 + t^2)^(3/2)
      ^    +---------+                     s = tan(gamma), t = tan(kappa): a node is a pair of angles
      |    |    a    | aperture
      o---------> u  +                     a: along the arm, u: in the plane of incidence, towards larger
      theta_o
     sample point
"""

from __future__ import annotations

import math
from dataclasses import dataclass

RIM_NEAR = 0.3
"""The lobe's rim spoils panels also from a little outside: up to this far, in units of the distance."""


@dataclass(frozen=True, slots=True)
class View:
    """The aperture as one point of the sample sees it; lengths in units of the distance to its plane.

    `mirror` are the components of the mirror direction along u, v and a.
    """

    s: tuple[float, float]
    t: tuple[float, float]
    cos_u: float  # component of u and a along the sample's normal
    cos_a: float
    mirror: tuple[float, float, float]


def view(
    *,
    width_mm: float,
    height_mm: float,
    distance_mm: float,
    theta_o_rad: float,
    point_mm: tuple[float, float],
    mirror: tuple[float, float, float],
) -> View | None:
    """Return the aperture as seen from a point (x, y) of the sample, cut at the horizon; None if nothing is
    left.

    Axes of the sample: x in the plane of incidence towards the mirror side, y out of it, z the normal;
    `mirror` is a unit vector in these axes and `theta_o_rad` the signed angle of the arm from z.
    """
    x, y = point_mm
    sin_o, cos_o = math.sin(theta_o_rad), math.cos(theta_o_rad)
    plane = distance_mm - x * sin_o
    if plane <= 0:
        return None  # this point lies behind the aperture
    s_low = (-0.5 * width_mm - x * cos_o) / plane
    s_high = (0.5 * width_mm - x * cos_o) / plane
    # above the sample: cos_o - s sin_o > 0
    if sin_o > 0:
        s_high = min(s_high, cos_o / sin_o)
    elif sin_o < 0:
        s_low = max(s_low, cos_o / sin_o)
    elif cos_o <= 0:
        return None
    if s_low >= s_high:
        return None
    return View(
        s=(s_low, s_high),
        t=((-0.5 * height_mm - y) / plane, (0.5 * height_mm - y) / plane),
        cos_u=-sin_o,
        cos_a=cos_o,
        mirror=(mirror[0] * cos_o - mirror[2] * sin_o, mirror[1], mirror[0] * sin_o + mirror[2] * cos_o),
    )


def _cosine(seen: View, s: float, t: float) -> float:
    m_u, m_v, m_a = seen.mirror
    return (s * m_u + t * m_v + m_a) / math.sqrt(1.0 + s * s + t * t)


def largest_cosine(seen: View) -> float:
    """Largest cosine to the mirror direction over the rectangle.

    The angle to a direction has no local minimum but the direction itself, so it is either inside or on the
    border.
    """
    m_u, m_v, m_a = seen.mirror
    (s0, s1), (t0, t1) = seen.s, seen.t
    if m_a > 0 and s0 <= m_u / m_a <= s1 and t0 <= m_v / m_a <= t1:
        return 1.0
    best = -1.0
    for s in seen.s:
        c = s * m_u + m_a
        t = m_v * (1.0 + s * s) / c if c > 0 else t0
        best = max(best, *(_cosine(seen, s, x) for x in (t0, min(max(t, t0), t1), t1)))
    for t in seen.t:
        c = t * m_v + m_a
        s = m_u * (1.0 + t * t) / c if c > 0 else s0
        best = max(best, *(_cosine(seen, x, t) for x in (s0, min(max(s, s0), s1), s1)))
    return min(best, 1.0)


def cut_by_cone(
    limits: tuple[float, float], m_side: float, m_a: float, sin_reach: float
) -> tuple[float, float]:
    """Angles that a cone of given half angle about the mirror direction leaves of a side of the rectangle."""
    low, high = math.atan(limits[0]), math.atan(limits[1])
    length = math.hypot(m_side, m_a)
    if sin_reach >= length:
        return low, high
    middle, reach = math.atan2(m_side, m_a), math.asin(sin_reach / length)
    return min(max(low, middle - reach), high), max(min(high, middle + reach), low)


def rim_near(seen: View) -> bool:
    """Whether the rectangle reaches the plane at 90 deg to the mirror direction, or nearly so."""
    m_u, m_v, m_a = seen.mirror
    return min(s * m_u + t * m_v for s in seen.s for t in seen.t) + m_a < RIM_NEAR


def rim_crossings(seen: View) -> list[float]:
    """Angles kappa at which the rim meets the two sides of constant s."""
    m_u, m_v, m_a = seen.mirror
    if m_v == 0:
        return []
    return [math.atan(-(m_a + s * m_u) / m_v) for s in seen.s]

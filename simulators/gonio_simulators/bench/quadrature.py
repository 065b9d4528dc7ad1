r"""Power into the aperture from one point of the sample, by direct two-dimensional quadrature.

Seen from a sample point, the aperture is a rectangle in a plane at distance `D` along the arm::

      v (out of plane)                     p = D (u s + v t + a),   dOmega = ds dt / (1 + s^2 + t^2)^(3/2)
      ^    +---------+                     s = tan(gamma), t = tan(kappa): a node is a pair of angles
      |    |    a    | aperture
      o---------> u  +                     a: along the arm, u: in the plane of incidence, towards larger
      theta_o
     sample point

The integrand is the differential scattering function with the full angle to the mirror direction in three
dimensions; what lies behind the sample's plane gets nothing.  The closed form that the fit uses appears
nowhere here.

Nodes follow the lobe: the domain is first cut to where the lobe exceeds exp(-45) of its largest value in the
aperture, then divided into Gauss-Legendre panels of at most six lobe widths ``1/sqrt(alpha + 1)``.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

NODES = 16
PANEL_RAD = 0.5
PANEL_LOBE_WIDTHS = 6.0
NEGLIGIBLE = 45.0  # exp(-45) = 3e-20
EDGE_POWER = 6
"""Nodes near the rim of the lobe follow ``x = y**EDGE_POWER``: cos_+^alpha is not smooth there."""

RIM_NEAR = 0.3
"""The rim spoils the panels also from a little outside: up to this far, in units of the distance."""

SMOOTH_RIM_ALPHA = 30.0
"""From this exponent on the rim carries nothing."""

SHARED_NODES = 3.0
"""Ratio of alpha + 1 up to which exponents share their nodes."""


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


def diffuse_power(seen: View) -> float:
    """Return the integral of cos(theta)/pi over the aperture: what rho_d = 1 sends into it."""
    gamma, w_gamma = _panels(math.atan(seen.s[0]), math.atan(seen.s[1]), PANEL_RAD)
    kappa, w_kappa = _panels(math.atan(seen.t[0]), math.atan(seen.t[1]), PANEL_RAD)
    s, t = np.tan(gamma), np.tan(kappa)[:, np.newaxis]
    one_s, one_t = 1.0 + s * s, 1.0 + t * t
    length2 = one_s + t * t
    # one more length than the solid angle's three halves, from cos(theta) = p_z / |p|
    values = (seen.cos_a + seen.cos_u * s) / (length2 * length2) * (one_s * w_gamma) * one_t
    return float(w_kappa @ values.sum(axis=1)) / math.pi


def lobe_power(seen: View, alpha: float) -> float:
    """Return the integral of (alpha + 1)/(2 pi) cos_+(theta_s)^alpha over the aperture.

    Parameters
    ----------
    seen
        The aperture from one point of the sample.
    alpha
        Exponent of the lobe, 0...1e8; relative error below 1e-10 for values above 1e-30.
    """
    return float(lobe_powers(seen, np.array([alpha]))[0])


def lobe_powers(seen: View, alphas: FloatArray) -> FloatArray:
    """Return `lobe_power` for each exponent, shape (n_alpha,); exponents of like size share their nodes."""
    result = np.zeros(len(alphas))
    peak = _largest_cosine(seen)
    if peak <= 0:
        return result
    order = np.argsort(alphas)
    start = 0
    while start < len(order):
        first = float(alphas[order[start]])
        group = [i for i in order[start:] if alphas[i] + 1.0 <= SHARED_NODES * (first + 1.0)]
        result[group] = _group_powers(seen, np.asarray(alphas, dtype=np.float64)[group], peak)
        start += len(group)
    return result


def _group_powers(seen: View, alphas: FloatArray, peak: float) -> FloatArray:
    """Ascending exponents on the domain of the broadest lobe and the panels of the narrowest."""
    broad, narrow = float(alphas[0]), float(alphas[-1])
    log_low = math.log(peak) - NEGLIGIBLE / broad if broad > 0 else -math.inf
    sin_reach = math.sqrt(-math.expm1(2.0 * log_low)) if math.isfinite(log_low) else 1.0
    m_u, m_v, m_a = seen.mirror
    gamma_low, gamma_high = _cut(seen.s, m_u, m_a, sin_reach)
    kappa_low, kappa_high = _cut(seen.t, m_v, m_a, sin_reach)
    panel = min(PANEL_RAD, PANEL_LOBE_WIDTHS / math.sqrt(narrow + 1.0))
    if broad < SMOOTH_RIM_ALPHA and m_u != 0 and _rim_near(seen):
        kappa, w_kappa = _panels(kappa_low, kappa_high, panel, _rim_crossings(seen))
        gamma, w_gamma = _up_to_rim(seen, np.tan(kappa), gamma_low, gamma_high)
    else:
        kappa, w_kappa = _panels(kappa_low, kappa_high, panel)
        gamma, w_gamma = _panels(gamma_low, gamma_high, panel)
    s, t = np.tan(gamma), np.tan(kappa)[:, np.newaxis]
    one_s, one_t = 1.0 + s * s, 1.0 + t * t
    length2 = one_s + t * t
    length = np.sqrt(length2)
    weight = (one_s * w_gamma) * (one_t * w_kappa[:, np.newaxis]) / (length2 * length)
    # 1 - cos(theta_s) = |omega - m|^2 / 2 keeps the digits of a narrow lobe
    versine = 0.5 * ((s / length - m_u) ** 2 + (t / length - m_v) ** 2 + (1.0 / length - m_a) ** 2)
    inside = versine < 1.0
    log_cosine = np.log1p(-np.where(inside, versine, 0.0))
    weight *= inside  # the lobe's half space is open: even cos^0 is nothing outside
    powers = np.array([np.vdot(weight, np.exp(alpha * log_cosine)) for alpha in alphas])
    return powers * (alphas + 1.0) / (2.0 * math.pi)


def _cosine(seen: View, s: float, t: float) -> float:
    m_u, m_v, m_a = seen.mirror
    return (s * m_u + t * m_v + m_a) / math.sqrt(1.0 + s * s + t * t)


def _largest_cosine(seen: View) -> float:
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


def _cut(limits: tuple[float, float], m_side: float, m_a: float, sin_reach: float) -> tuple[float, float]:
    """Angles that a cone of given half angle about the mirror direction leaves of a side of the rectangle."""
    low, high = math.atan(limits[0]), math.atan(limits[1])
    length = math.hypot(m_side, m_a)
    if sin_reach >= length:
        return low, high
    middle, reach = math.atan2(m_side, m_a), math.asin(sin_reach / length)
    return min(max(low, middle - reach), high), max(min(high, middle + reach), low)


def _rim_near(seen: View) -> bool:
    """Whether the rectangle reaches the plane at 90 deg to the mirror direction, or nearly so."""
    m_u, m_v, m_a = seen.mirror
    return min(s * m_u + t * m_v for s in seen.s for t in seen.t) + m_a < RIM_NEAR


def _rim_crossings(seen: View) -> list[float]:
    """Angles kappa at which the rim meets the two sides of constant s."""
    m_u, m_v, m_a = seen.mirror
    if m_v == 0:
        return []
    return [math.atan(-(m_a + s * m_u) / m_v) for s in seen.s]


def _up_to_rim(seen: View, t: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    """Nodes (n_t, n_gamma) and weights where the lobe's rim cuts the rectangle: one row for each t."""
    m_u, m_v, m_a = seen.mirror
    rim = np.arctan(-(m_a + t * m_v) / m_u)[:, np.newaxis]
    if m_u > 0:
        start, end = np.clip(rim, low, high), np.full_like(rim, high)
    else:
        start, end = np.clip(rim, low, high), np.full_like(rim, low)
    y, w = _gauss(2 * NODES)
    y, w = 0.5 * (1.0 + y), 0.5 * w
    gamma = start + (end - start) * y**EDGE_POWER
    return gamma, np.abs(end - start) * EDGE_POWER * y ** (EDGE_POWER - 1) * w


def _panels(
    low: float, high: float, length: float, cuts: list[float] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights on panels of at most `length`, cut also at `cuts`."""
    if cuts:
        edges = [low, *sorted(c for c in cuts if low < c < high), high]
        parts = [_panels(a, b, length) for a, b in itertools.pairwise(edges)]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
    x, w = _gauss(NODES)
    n = max(1, math.ceil((high - low) / length))
    half = 0.5 * (high - low) / n
    if n == 1:
        return 0.5 * (low + high) + half * x, half * w
    middles = low + half * (2.0 * np.arange(n) + 1.0)
    return (middles[:, np.newaxis] + half * x).ravel(), np.tile(half * w, n)


@lru_cache(maxsize=8)
def _gauss(n: int) -> tuple[FloatArray, FloatArray]:
    x, w = np.polynomial.legendre.leggauss(n)
    return x, w

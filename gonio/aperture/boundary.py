r"""How does the lobe integral change with its exponent?  From the aperture's border alone.

In polar angles about the mirror direction ``(alpha + 1) cos(theta)^alpha sin(theta) dtheta`` is a total
differential, so the integral over any region is one along its border::

    L = [mirror direction inside] - 1/(2 pi) ∮ cos_+(theta)^(alpha + 1) dphi
    d^k L / d alpha^k = -1/(2 pi) ∮ cos_+(theta)^(alpha + 1) ln(cos(theta))^k dphi

Along a side of constant t, ``dphi = sin(u) dpsi / sin(theta)^2`` with u = t - delta; along the upper and
lower edge, ``tan(psi) = (h / 2R) cos(t)``, it is ``(h / 2R) cos(delta) cos(psi)^2 dt / sin(theta)^2``.  If
the mirror direction is inside, all terms have one sign: a lobe that is caught but for 1e-30 has a derivative
with all its digits, which no difference of integrals has.
"""

from __future__ import annotations

import numpy as np

from gonio.aperture.receiver import FloatArray
from gonio.brdf.quadrature import band_limits, gauss_legendre, one_side, radians


def lobe_derivative(
    order: int,
    alpha: FloatArray,
    delta_deg: FloatArray,
    half_width_rad: np.longdouble,
    height_ratio: float,
    theta_o_deg: FloatArray | None,
) -> FloatArray:
    """Return ``d^order L / d alpha^order``, order 1 or more, for arguments of one shape (n,).

    `height_ratio` is half the aperture's height over its distance.
    """
    value = np.where(
        np.isfinite(alpha + delta_deg + (0.0 if theta_o_deg is None else theta_o_deg)), 0.0, np.nan
    )
    delta = radians(delta_deg)
    low, high = band_limits(delta, half_width_rad, theta_o_deg)
    lit = np.isfinite(value) & (high > low)
    short = delta.astype(np.float64)
    power = alpha + 1.0
    for side, edge in ((-1.0, low), (1.0, high)):
        start, end = (low, high) if side > 0.0 else (-high, -low)
        start = np.maximum(start, 0)
        rows = np.flatnonzero(lit & (end > start))
        if rows.size:
            u, weight, log_cos = one_side(power[rows], start[rows], end[rows])
            tangent = height_ratio * np.cos(side * u + short[rows, None])
            cos2 = 1.0 / (1.0 + tangent**2)
            term = _term(order, power[rows, None], u, log_cos, tangent**2)
            scale = 2.0 * height_ratio * np.cos(short[rows])
            value[rows] -= scale * np.sum(weight * cos2 * term, axis=1) / (2.0 * np.pi)
        rows = np.flatnonzero(lit)
        if rows.size:
            value[rows] -= _side(
                order, power[rows], side, edge[rows].astype(np.float64), short[rows], height_ratio
            ) / (2.0 * np.pi)
    return value


def _side(
    order: int, power: FloatArray, side: float, u: FloatArray, delta: FloatArray, height_ratio: float
) -> FloatArray:
    """Return the integral along the side of constant t, (n,)."""
    top = np.arctan(height_ratio * np.cos(u + delta))
    nodes, weights = gauss_legendre(64)
    top = np.minimum(top, np.arccos(np.exp(-40.0 / power)))  # beyond, below the rounding of the sum
    psi = 0.5 * top[:, None] * (1.0 + nodes)
    log_cos = np.log1p(-2.0 * np.sin(0.5 * u) ** 2)[:, None]
    term = _term(order, power[:, None], u[:, None], log_cos, np.tan(psi) ** 2)
    return np.asarray(side * np.sin(u) * top * np.sum(weights * term, axis=1))


def _term(
    order: int, power: FloatArray, u: FloatArray, log_cos: FloatArray, tangent2: FloatArray
) -> FloatArray:
    """Return ``cos(theta)^power ln(cos(theta))^order / sin(theta)^2``, `tangent2` being ``tan(psi)^2``."""
    logarithm = log_cos - 0.5 * np.log1p(tangent2)
    sin2 = (np.sin(u) ** 2 + tangent2) / (1.0 + tangent2)
    ratio = np.where(sin2 > 1e-30, logarithm / np.where(sin2 > 1e-30, sin2, 1.0), -0.5)
    return np.asarray(np.exp(power * logarithm) * ratio * logarithm ** (order - 1))

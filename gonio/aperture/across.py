r"""What passes the aperture out of the plane of incidence, for light of many origins and directions?

A point at y of the lit spot sees the aperture between ``tan(psi) = (±h/2 - y) tau``, ``tau = cos(t) / D``,
D the distance of the aperture's plane from the point.  Light tilted by b out of the plane has its mirror
direction at -b; at constant t, an angle u from the mirror direction in plane, the lobe is

    cos(theta_s) = cos(b) cos(u) cos(psi) - sin(b) sin(psi) = cos(u) rho cos(psi - psi0),
    rho = sqrt(1 + sin(b)^2 v),   tan(psi0) = -tan(b) sqrt(1 + v),   v = tan(u)^2.

With ``chi = psi - psi0``, ``G = (alpha + 1)/(2 pi) ∫_0^chi cos^(alpha + 1)`` (an incomplete beta function)
and ``C = cos(chi)^(alpha + 1) / (2 pi)``, the integral over psi and its integral over the edge's tangent T
are closed::

    Phi(T) = rho^alpha (cos(psi0) G + sin(psi0) C)            ∫ cos(theta_s)^alpha cos(psi) dpsi
    ∫ Phi dT = rho^alpha (G sin(chi) + C cos(chi)) / cos(psi)

The mean over y of the spot is thus a difference of the latter, that over b a sum.  Both spots and tilts are
symmetric, so the lower edge gives as much as the upper one.  The mean depends on the position through tau
alone and but weakly on v; it is expanded in Chebyshev polynomials of tau times powers of v.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from gonio.aperture.receiver import FloatArray
from gonio.brdf.quadrature import gauss_legendre, lobe_norm

_POWERS = 6
_WIDEST_V = 100.0  # 84 deg from the mirror direction
_SMOOTH = 1.5  # lobe widths of the spot's height, or of the tilts, that few nodes integrate


def across_mean(
    alpha: FloatArray,
    tau: FloatArray,
    v: FloatArray,
    half_height_mm: float,
    spot_half_height_mm: float,
    half_divergence_rad: float,
) -> FloatArray:
    """Return the mean over the spot's height and the tilts, (n_alpha, n_v, n_tau).

    Parameters
    ----------
    alpha
        (n_alpha,), sharing one rule for the tilts: fit for the largest of them.
    tau
        (n_tau,), 1/mm.
    v
        (n_alpha, n_v), squared tangent of the in-plane angle to the mirror direction.
    half_height_mm, spot_half_height_mm, half_divergence_rad
        Half height of the aperture, half height of the beam, half angle of the cone.
    """
    tilts, shares = _tilt_rule(half_divergence_rad, float(np.max(alpha)))
    total = np.zeros((alpha.size, v.shape[1], tau.size))
    a = alpha[:, None, None]
    widest = spot_half_height_mm * float(np.max(tau)) * np.sqrt(np.max(alpha) + 1.0)
    for b, share in zip(tilts, shares, strict=True):
        if spot_half_height_mm == 0.0:
            total += share * _edge(a, half_height_mm * tau, b, v)[0]
        elif widest < _SMOOTH:
            for node, weight in zip(*gauss_legendre(10), strict=True):
                edge = (half_height_mm + spot_half_height_mm * node) * tau
                total += (0.5 * share * weight) * _edge(a, edge, b, v)[0]
        else:
            top = _edge(a, (half_height_mm + spot_half_height_mm) * tau, b, v)[1]
            bottom = _edge(a, (half_height_mm - spot_half_height_mm) * tau, b, v)[1]
            total += share * (top - bottom) / (2.0 * spot_half_height_mm * tau)
    return 2.0 * total


def _edge(alpha: FloatArray, tangent: FloatArray, b: float, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Phi and its integral over the tangent for one tilt, each (n_alpha, n_v, n_tau)."""
    w = v[:, :, None]
    tan0 = -np.tan(b) * np.sqrt(1.0 + w)
    cos0 = 1.0 / np.sqrt(1.0 + tan0**2)
    tan_chi = (tangent - tan0) / (1.0 + tangent * tan0)
    cos2 = 1.0 / (1.0 + tan_chi**2)
    sin_chi, cos_chi = tan_chi * np.sqrt(cos2), np.sqrt(cos2)
    g = 0.5 * np.sign(tan_chi) * lobe_norm(alpha) * special.betainc(0.5, 0.5 * alpha + 1.0, tan_chi**2 * cos2)
    c = np.exp(-0.5 * (alpha + 1.0) * np.log1p(tan_chi**2)) / (2.0 * np.pi)
    scale = np.exp(0.5 * alpha * np.log1p(np.sin(b) ** 2 * w))
    phi = scale * cos0 * (g + tan0 * c)
    return phi, scale * (g * sin_chi + c * cos_chi) * np.sqrt(1.0 + tangent**2)


def _tilt_rule(half_rad: float, alpha: float) -> tuple[FloatArray, FloatArray]:
    """Return tilts and weights, adding to 1, of panels of at most three lobe widths."""
    if half_rad == 0.0:
        return np.zeros(1), np.ones(1)
    nodes, weights = gauss_legendre(12)
    count = max(1, int(np.ceil(2.0 * half_rad * np.sqrt(alpha + 1.0) / 3.0)))
    edges = np.linspace(-half_rad, half_rad, count + 1)
    middle, half = 0.5 * (edges[1:] + edges[:-1])[:, None], 0.5 * np.diff(edges)[:, None]
    return (middle + half * nodes).ravel(), np.broadcast_to(0.5 * weights / count, (count, 12)).ravel()


def across_coefficients(
    alpha: FloatArray,
    tau_range: tuple[float, float],
    half_height_mm: float,
    spot_half_height_mm: float,
    half_divergence_rad: float,
) -> FloatArray:
    """Return the coefficients of T_q(tau) v^p, (P, n_alpha, Q); P is 1 without divergence.

    Without divergence the mean does not depend on v.  Q is doubled until the last coefficients are below the
    rounding of the sum.
    """
    powers = 1 if half_divergence_rad == 0.0 else _POWERS
    angle = np.pi * (np.arange(powers) + 0.5) / powers
    widest = widest_v(alpha)
    v = 0.5 * widest[:, None] * (1.0 + np.cos(angle)) if powers > 1 else np.zeros((alpha.size, 1))
    groups = np.ceil(np.log2(alpha + 1.0)).astype(int)
    low, high = tau_range
    count = 8
    while True:
        theta = np.pi * (np.arange(count) + 0.5) / count
        tau = 0.5 * (low + high) + 0.5 * (high - low) * np.cos(theta)
        values = np.empty((alpha.size, powers, count))
        for group in np.unique(groups):
            rows = groups == group
            values[rows] = across_mean(
                alpha[rows], tau, v[rows], half_height_mm, spot_half_height_mm, half_divergence_rad
            )
        transform = 2.0 / count * np.cos(np.outer(np.arange(count), theta))
        transform[0] *= 0.5
        series = values @ transform.T  # (n_alpha, powers, Q)
        size = np.max(np.abs(values), axis=(1, 2))
        if high == low or count >= 256 or np.all(np.abs(series[:, :, -2:]) <= 1e-14 * size[:, None, None]):
            break
        count *= 2
    if powers == 1:
        return np.ascontiguousarray(series.transpose(1, 0, 2))
    # polynomial through the nodes of v, by powers of v
    vander = (v / widest[:, None])[:, :, None] ** np.arange(powers)
    by_power = np.linalg.solve(vander, series) / (widest[:, None] ** np.arange(powers))[:, :, None]
    return np.ascontiguousarray(by_power.transpose(1, 0, 2))


def widest_v(alpha: FloatArray) -> FloatArray:
    """Return the largest v the coefficients hold for, (n_alpha,); beyond it use that.

    ``cos(u)^alpha = (1 + v)^(-alpha / 2)`` is exp(-45) there, or u is 84 degrees.
    """
    return np.minimum(np.expm1(np.minimum(90.0 / np.maximum(alpha, 1e-3), 50.0)), _WIDEST_V)

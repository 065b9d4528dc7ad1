"""The numerical pieces shared by every integral of a cosine lobe.

A lobe ``cos_+(theta_s)^alpha`` factors in detector-centred angles, ``cos(t - delta)^alpha
cos(psi)^alpha``.  The integral across the plane of incidence is closed (`across_integral`); the one in plane
is `band_integral`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

FloatArray = NDArray[np.float64]
LongArray = NDArray[np.longdouble]

_PI = 4 * np.arctan(np.longdouble(1))
_NODES = 64
_NEGLIGIBLE = 40.0  # exp(-40) of the largest value in the band is below the rounding of the sum
_RIM_ALPHA = 30.0  # from this exponent on cos_+^alpha is smooth where it ends
_RIM_NEAR_RAD = 0.6
_STEEP_RAD = 0.8  # from here on the cosine takes its digits from the angle to the rim
_CHUNK = 2048  # band integrals evaluated together; bounds the scratch memory to a few MB


@functools.cache
def gauss_legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights on (-1, 1), each (count,)."""
    nodes, weights = special.roots_legendre(count)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights


def gamma_ratio(b: ArrayLike) -> FloatArray:
    """Return ``Gamma(b) / Gamma(b + 1/2)`` for b >= 1/2 to rounding error.

    Differences of log-gamma lose digits as b grows (5e-10 at 1e6).  Above 20 the Stirling series of the ratio
    is used: ``ln Gamma(b + 1/2) - ln Gamma(b) = ln(b)/2 - 1/(8b) + 1/(192 b^3) - 1/(640 b^5) + 17/(14336 b^7)
    - ...``
    """
    b = np.asarray(b, np.float64)
    small = np.where(b < 20.0, b, 1.0)
    direct = special.gamma(small) / special.gamma(small + 0.5)
    y = 1.0 / np.where(b < 20.0, 20.0, b)
    y2 = y * y
    series = y * (-1 / 8 + y2 * (1 / 192 + y2 * (-1 / 640 + y2 * (17 / 14336 + y2 * (-31 / 18432)))))
    return np.asarray(np.where(b < 20.0, direct, np.sqrt(y) * np.exp(-series)))


def lobe_norm(alpha: ArrayLike) -> FloatArray:
    """Return ``(alpha + 1)/(2 pi) * ∫ cos(psi)^(alpha + 1) dpsi`` over all psi."""
    a = np.asarray(alpha, np.float64)
    return np.asarray((a + 1.0) / (2.0 * np.sqrt(np.pi)) * gamma_ratio(0.5 * a + 1.0))


def across_integral(alpha: FloatArray, tangent: FloatArray) -> FloatArray:
    """Return ``(alpha + 1)/(2 pi) * ∫ cos(psi)^(alpha + 1) dpsi`` over ``|tan(psi)| <= tangent``.

    ``∫ = B(1/2, b) I_x(1/2, b)``, ``b = (alpha + 2)/2``, ``x = sin^2(psi_max)`` (DLMF 8.17).
    """
    x = tangent**2 / (1.0 + tangent**2)
    return np.asarray(lobe_norm(alpha) * special.betainc(0.5, 0.5 * alpha + 1.0, x))


def radians(angle_deg: ArrayLike) -> LongArray:
    """Return radians with the digits that a difference of two angles needs.

    In the flank of a lobe the value changes by ``alpha u`` per radian: at alpha 1e8 one rounding of an angle
    of 8 degrees is 1e-11 of the value.  Where the platform has no longer type this is plain float64.
    """
    return np.asarray(np.asarray(angle_deg, np.longdouble) * (_PI / 180), np.longdouble)


def band_integral(
    alpha: ArrayLike,
    delta_deg: ArrayLike,
    half_width_rad: np.longdouble | float,
    theta_o_deg: ArrayLike | None,
    across: Callable[[FloatArray, FloatArray], FloatArray],
) -> FloatArray:
    """Return ``∫ cos_+(t - delta)^alpha across(alpha, t) dt`` over ``|t| <= half_width``, above the horizon.

    Parameters
    ----------
    alpha, delta_deg, theta_o_deg
        As `gonio.aperture.Aperture.lobe_integral`; they broadcast.
    half_width_rad
        Half width of the band in t, at most pi/4.
    across
        Vectorised smooth weight; gets `alpha` as (n, 1) and t as (n, nodes).
    """
    theta_o = 0.0 if theta_o_deg is None else theta_o_deg
    arrays = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (alpha, delta_deg, theta_o)))
    a, delta_deg_, out_deg = (x.reshape(-1) for x in arrays)
    value = np.where(np.isfinite(a + delta_deg_ + out_deg), 0.0, np.nan)
    delta = radians(delta_deg_)
    low, high = band_limits(delta, half_width_rad, None if theta_o_deg is None else out_deg)
    for side in (-1.0, 1.0):
        # each side of the mirror direction by itself, mirrored to positive angles
        start, end = (low, high) if side > 0.0 else (-high, -low)
        start = np.maximum(start, 0)
        lit = np.flatnonzero(np.isfinite(value) & (end > start))
        for first in range(0, lit.size, _CHUNK):
            rows = lit[first : first + _CHUNK]
            u, weight, log_lobe = one_side(a[rows], start[rows], end[rows])
            t = side * u + delta[rows].astype(np.float64)[:, None]
            value[rows] += np.sum(
                np.exp(a[rows, None] * log_lobe) * weight * across(a[rows, None], t), axis=1
            )
    return value.reshape(arrays[0].shape)


def band_limits(
    delta: LongArray, half_width_rad: np.longdouble | float, theta_o_deg: FloatArray | None
) -> tuple[LongArray, LongArray]:
    """Return where a band begins and ends, (n,) radians from the mirror direction; empty if it does not."""
    low, high = -half_width_rad - delta, half_width_rad - delta
    if theta_o_deg is not None:
        out_deg = theta_o_deg.astype(np.longdouble)
        low, high = (
            np.maximum(low, radians(-90 - out_deg) - delta),
            np.minimum(high, radians(90 - out_deg) - delta),
        )
    return np.maximum(low, -_PI / 2), np.minimum(high, _PI / 2)  # the edge of cos_+


def one_side(
    alpha: FloatArray, start: LongArray, end: LongArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return nodes for ``cos(u)^alpha`` times a smooth function over u = start...end, within 0...pi/2.

    Arguments are (n,), radians from the mirror direction; returned are u, weights and ``ln cos(u)``, (n, 64).
    """
    u0, u1 = start.astype(np.float64), end.astype(np.float64)
    y0, y1 = (_PI / 2 - start).astype(np.float64), (_PI / 2 - end).astype(np.float64)  # angles to the rim
    # cos(x) = cos(x0) exp(-40/alpha) ends what carries the value; versines keep the digits of a narrow lobe,
    # angles to the rim those of a far flank
    versine = 2.0 * np.sin(0.5 * u0) ** 2
    with np.errstate(divide="ignore", over="ignore"):
        fall = -np.expm1(-_NEGLIGIBLE / alpha)
    u1 = np.minimum(u1, 2.0 * np.arcsin(np.sqrt(np.minimum(0.5 * (versine + (1.0 - versine) * fall), 1.0))))
    y1 = np.maximum(y1, np.arcsin(np.sin(y0) * (1.0 - fall)))
    nodes, weights = gauss_legendre(_NODES)
    steep = u0 > _STEEP_RAD
    half = 0.5 * np.where(steep, y0 - y1, u1 - u0)[:, None]
    y = y0[:, None] - half * (1.0 + nodes)
    u = np.where(steep[:, None], 0.5 * np.pi - y, 0.5 * (u0 + u1)[:, None] + half * nodes)
    scale = np.broadcast_to(half, u.shape)
    # A wide lobe is not smooth at the rim: nodes at equal steps of the sixth root of the angle to it.
    rim = (alpha < _RIM_ALPHA) & (y1 < _RIM_NEAR_RAD)
    if np.any(rim):
        s0, s1 = (np.maximum(x[rim], 0.0)[:, None] ** (1.0 / 6.0) for x in (y0, y1))
        s = 0.5 * (s0 + s1) + 0.5 * (s0 - s1) * nodes
        scale = scale.copy()
        y[rim] = s**6
        scale[rim] = 0.5 * (s0 - s1) * 6.0 * s**5
        u[rim] = 0.5 * np.pi - y[rim]
    log_lobe = np.where(
        u < _STEEP_RAD, np.log1p(-2.0 * np.sin(0.5 * u) ** 2), np.log(np.sin(np.maximum(y, 1e-300)))
    )
    return u, scale * weights, np.asarray(log_lobe)


def band_integral_table(
    alpha: FloatArray,
    delta_deg: FloatArray,
    half_width_rad: np.longdouble | float,
    theta_o_deg: FloatArray,
    across: Callable[[FloatArray, FloatArray], FloatArray],
) -> FloatArray:
    """Return `band_integral` of every alpha with every position, (n_alpha, n_position), to 1e-13 absolute.

    Where neither the horizon nor the edge of cos_+ cuts the band, all positions share one grid in t: panels
    of at most three lobe widths with 16 Gauss-Legendre nodes, and `across` is evaluated once per grid.  The
    few positions that are cut go through `band_integral`.
    """
    half = float(half_width_rad)
    half_deg = np.rad2deg(half)
    # cos_+^alpha is not smooth at its edge; 16 nodes need the edge well outside the band
    cut = (np.abs(delta_deg) + half_deg >= 78.0) | (np.abs(theta_o_deg) + half_deg >= 90.0)
    # the lobe at the nearest edge of the band bounds the value; below exp(-60) it is left at zero
    nearest = np.deg2rad(np.minimum(np.maximum(np.abs(delta_deg) - half_deg, 0.0), 90.0))
    with np.errstate(divide="ignore"):
        log_bound = alpha[:, None] * np.log1p(-2.0 * np.sin(0.5 * nearest) ** 2)
    seen = log_bound > -60.0
    table = np.zeros((alpha.size, delta_deg.size))
    nodes, weights = gauss_legendre(16)
    # panel numbers are rounded up to powers of two, so that many alphas share one grid and its logarithms
    needed = np.maximum(2.0 * half * np.sqrt(alpha + 1.0) / 3.0, 1.0)
    panels = 2 ** np.ceil(np.log2(needed)).astype(int)
    for count in np.unique(panels):
        rows = np.flatnonzero(panels == count)
        at = np.flatnonzero(np.any(seen[rows], axis=0) & ~cut)
        edges = np.linspace(-half, half, count + 1)
        step = 0.5 * np.diff(edges)[:, None]
        t = (0.5 * (edges[1:] + edges[:-1])[:, None] + step * nodes).ravel()
        share = (step * weights).ravel() * across(alpha[rows, None], t[None, :])
        log_lobe = np.log1p(-2.0 * np.sin(0.5 * (np.deg2rad(delta_deg[at, None]) - t)) ** 2)
        for row, weight in zip(rows, share, strict=True):
            carries = seen[row, at]
            table[row, at[carries]] = np.exp(alpha[row] * log_lobe[carries]) @ weight
    rows, columns = np.nonzero(seen & cut)
    table[rows, columns] = band_integral(
        alpha[rows], delta_deg[columns], half_width_rad, theta_o_deg[columns], across
    )
    return table

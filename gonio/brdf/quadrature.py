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

_NODES = 64
_NEGLIGIBLE = 40.0  # exp(-40) of the largest value in the band is below the rounding of the sum
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


def band_integral(
    alpha: ArrayLike,
    delta_deg: ArrayLike,
    half_width_rad: float,
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
    a, delta, out_deg = (x.reshape(-1) for x in arrays)
    low, high = np.full(a.shape, -half_width_rad), np.full(a.shape, half_width_rad)
    if theta_o_deg is not None:
        low = np.maximum(low, np.deg2rad(-90.0 - out_deg))
        high = np.minimum(high, np.deg2rad(90.0 - out_deg))
    # the edge of cos_+, where the angle to the mirror direction is 90 deg in plane
    low = np.maximum(low, np.deg2rad(delta - 90.0))
    high = np.minimum(high, np.deg2rad(delta + 90.0))
    value = np.where(np.isfinite(a + delta + out_deg), 0.0, np.nan)
    for start in range(0, a.size, _CHUNK):
        part = np.flatnonzero((high > low)[start : start + _CHUNK]) + start
        if part.size:
            value[part] = _band(a[part], np.deg2rad(delta[part]), low[part], high[part], across)
    return value.reshape(arrays[0].shape)


def _band(
    alpha: FloatArray,
    delta: FloatArray,
    low: FloatArray,
    high: FloatArray,
    across: Callable[[FloatArray, FloatArray], FloatArray],
) -> FloatArray:
    """Integrate the part of [low, high] that carries the value; all arguments (n,), radians."""
    nearest = np.clip(delta, low, high)
    # cos(x) = cos(x0) exp(-40/alpha) ends the interval; versines keep the digits for large alpha
    versine = 2.0 * np.sin(0.5 * (nearest - delta)) ** 2
    with np.errstate(divide="ignore", over="ignore"):
        fall = -np.expm1(-_NEGLIGIBLE / alpha)
    reach = 2.0 * np.arcsin(np.sqrt(np.minimum(0.5 * (versine + (1.0 - versine) * fall), 1.0)))
    low, high = np.maximum(low, delta - reach), np.minimum(high, delta + reach)
    nodes, weights = gauss_legendre(_NODES)
    middle, half = 0.5 * (low + high)[:, None], 0.5 * (high - low)[:, None]
    u = (middle - delta[:, None]) + half * nodes  # angle to the mirror direction
    log_lobe = alpha[:, None] * np.log1p(-2.0 * np.sin(0.5 * u) ** 2)
    scale = np.broadcast_to(half, u.shape)
    # A wide lobe off to one side: cos_+^alpha is not smooth where it ends, so put the nodes at equal steps of
    # the sixth root of the angle to that end.
    edge = (alpha < 30.0) & ((low >= delta) | (high <= delta))
    if np.any(edge):
        side = np.where(high[edge] <= delta[edge], -1.0, 1.0)[:, None]
        far = np.where(side > 0.0, (high - delta)[edge, None], (delta - low)[edge, None])
        near = np.where(side > 0.0, (low - delta)[edge, None], (delta - high)[edge, None])
        s0, s1 = (np.maximum(0.5 * np.pi - x, 0.0) ** (1.0 / 6.0) for x in (far, near))
        s = 0.5 * (s0 + s1) + 0.5 * (s1 - s0) * nodes
        y = s**6
        u[edge] = side * (0.5 * np.pi - y)
        log_lobe[edge] = alpha[edge, None] * np.log(np.sin(y))
        scale = scale.copy()
        scale[edge] = 0.5 * (s1 - s0) * 6.0 * s**5
    total = np.exp(log_lobe) * scale * across(alpha[:, None], u + delta[:, None])
    return np.asarray(total @ weights)


def band_integral_table(
    alpha: FloatArray,
    delta_deg: FloatArray,
    half_width_rad: float,
    theta_o_deg: FloatArray,
    across: Callable[[FloatArray, FloatArray], FloatArray],
) -> FloatArray:
    """Return `band_integral` of every alpha with every position, (n_alpha, n_position), to 1e-13 absolute.

    Where neither the horizon nor the edge of cos_+ cuts the band, all positions share one grid in t: panels
    of at most three lobe widths with 16 Gauss-Legendre nodes, and `across` is evaluated once per grid.  The
    few positions that are cut go through `band_integral`.
    """
    half_deg = np.rad2deg(half_width_rad)
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
    needed = np.maximum(2.0 * half_width_rad * np.sqrt(alpha + 1.0) / 3.0, 1.0)
    panels = 2 ** np.ceil(np.log2(needed)).astype(int)
    for count in np.unique(panels):
        rows = np.flatnonzero(panels == count)
        at = np.flatnonzero(np.any(seen[rows], axis=0) & ~cut)
        edges = np.linspace(-half_width_rad, half_width_rad, count + 1)
        half = 0.5 * np.diff(edges)[:, None]
        t = (0.5 * (edges[1:] + edges[:-1])[:, None] + half * nodes).ravel()
        share = (half * weights).ravel() * across(alpha[rows, None], t[None, :])
        log_lobe = np.log1p(-2.0 * np.sin(0.5 * (np.deg2rad(delta_deg[at, None]) - t)) ** 2)
        for row, weight in zip(rows, share, strict=True):
            carries = seen[row, at]
            table[row, at[carries]] = np.exp(alpha[row] * log_lobe[carries]) @ weight
    rows, columns = np.nonzero(seen & cut)
    table[rows, columns] = band_integral(
        alpha[rows], delta_deg[columns], half_width_rad, theta_o_deg[columns], across
    )
    return table

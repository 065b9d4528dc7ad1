"""What is a cosine lobe, and how much of it is above the horizon?"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from gonio.angles import cos_deg, sin_deg
from gonio.brdf.quadrature import gamma_ratio

FloatArray = NDArray[np.float64]


def cosine_power(alpha: ArrayLike, one_minus_cos: ArrayLike) -> FloatArray:
    """Return ``cos_+(theta_s)^alpha`` from ``1 - cos(theta_s)``; its edge at 90 deg is left out."""
    a, versine = np.asarray(alpha, np.float64), np.asarray(one_minus_cos, np.float64)
    front = versine < 1.0
    power = np.exp(a * np.log1p(-np.where(front, versine, 0.0)))
    return np.asarray(np.where(front, power, 0.0))


def lobe_dsf(alpha: ArrayLike, one_minus_cos: ArrayLike) -> FloatArray:
    """Return ``(alpha + 1)/(2 pi) cos_+(theta_s)^alpha``, 1/sr, from ``1 - cos(theta_s)``."""
    return np.asarray(
        (np.asarray(alpha, np.float64) + 1.0) / (2.0 * np.pi) * cosine_power(alpha, one_minus_cos)
    )


def lobe_brdf(alpha: ArrayLike, one_minus_cos: ArrayLike) -> FloatArray:
    """Return ``(alpha + 2)/(2 pi) cos_+(theta_s)^alpha``, 1/sr: the modified Phong normalisation.

    As a BRDF it reflects all of normal incidence: ``∫ (alpha + 2)/(2 pi) cos^(alpha + 1) dOmega = 1``.
    """
    return np.asarray(
        (np.asarray(alpha, np.float64) + 2.0) / (2.0 * np.pi) * cosine_power(alpha, one_minus_cos)
    )


def lobe_above_horizon(alpha: ArrayLike, theta_i_deg: ArrayLike) -> FloatArray:
    """Return the fraction of the energy of `lobe_dsf` above the sample plane.

    With the in-plane angle t from the mirror direction the horizon is ``t = 90 deg - theta_i`` for every psi,
    so the psi integral factors out and ``∫ cos(t)^alpha dt`` leaves ``(1 + I_x(1/2, (alpha + 1)/2)) / 2``,
    ``x = cos(theta_i)^2``.  It is 1 at normal incidence and 1/2 at grazing.
    """
    x = cos_deg(theta_i_deg) ** 2
    return np.asarray(0.5 + 0.5 * special.betainc(0.5, 0.5 * (np.asarray(alpha, np.float64) + 1.0), x))


def lobe_above_horizon_dlog_alpha(alpha: ArrayLike, theta_i_deg: ArrayLike) -> FloatArray:
    """Return the derivative of `lobe_above_horizon` by log(alpha), from central differences (1e-9)."""
    a, step = np.asarray(alpha, np.float64), 1e-4
    up, down = (
        lobe_above_horizon(a * np.exp(step), theta_i_deg),
        lobe_above_horizon(a * np.exp(-step), theta_i_deg),
    )
    return np.asarray((up - down) / (2.0 * step))


def lobe_brdf_albedo(alpha: ArrayLike, theta_i_deg: ArrayLike) -> FloatArray:
    """Return the directional albedo of `lobe_brdf`, ``∫ lobe_brdf cos(theta_o) dOmega``.

    In the angles (t, psi) of `lobe_above_horizon`, ``cos(theta_o) = cos(t + theta_i) cos(psi)``: the part of
    cos(theta_i) is a lobe of exponent alpha + 1 above the horizon, the part with sin(theta_i) integrates to
    ``sin(theta_i)^(alpha + 2) / (alpha + 1)``.  It is 1 at normal incidence and falls from there.
    """
    a = np.asarray(alpha, np.float64)
    sine = sin_deg(theta_i_deg)
    # (alpha + 2)/(2 pi) * ∫ cos(psi)^(alpha + 2) dpsi over all psi
    across = (a + 2.0) / (2.0 * np.sqrt(np.pi)) * gamma_ratio(0.5 * (a + 3.0))
    with np.errstate(divide="ignore"):
        power = np.exp((a + 2.0) * np.log(np.abs(sine)))
    return np.asarray(
        cos_deg(theta_i_deg) * lobe_above_horizon(a + 1.0, theta_i_deg) + across * power / (a + 1.0)
    )

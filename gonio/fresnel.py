"""Fresnel power reflectances of a smooth interface from air into a denser transparent medium.

Equations 11 and 12 of Raybaud et al. (Energy and Buildings 263, 2022, 112034), rewritten without cancellation:
with ``c = cos(theta_i)`` and ``q = sqrt(n2^2 - sin(theta_i)^2)``

    r_s = (c - q) / (c + q)           = -(n2^2 - 1) / (c + q)^2
    r_p = (n2^2 c - q) / (n2^2 c + q) = (n2^2 - 1) ((n2^2 + 1) c^2 - 1) / (n2^2 c + q)^2

so that R is exactly 0 at n2 = 1, keeps all digits of ``(n2 - 1)^2`` near it, vanishes for P exactly where
``tan(theta_i) = n2`` (Brewster), and is exactly 1 at 90 degrees.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.angles import cos_deg
from gonio.errors import GonioError

FloatArray = NDArray[np.float64]
Polarization = Literal["s", "p", "unpolarized"]
RatioFunction = Callable[[ArrayLike, ArrayLike, Polarization], FloatArray]


def reflectance(n2: ArrayLike, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
    """Return the Fresnel power reflectance R.

    Parameters
    ----------
    n2
        Refractive index of the medium relative to air, >= 1, any shape; NaN gives NaN.
    theta_i_deg
        Incidence from the normal, 0...90 degrees, broadcast against `n2`.
    polarization
        ``"s"``, ``"p"`` or ``"unpolarized"``, the mean of both.

    Raises
    ------
    GonioError
        An index below 1, where light would be reflected totally: the model is of light in air.
    """
    n, c = _checked(n2, theta_i_deg)
    s, p = _reduced_amplitudes(n, c)
    contrast = (n - 1.0) * (n + 1.0)
    return _mixed((contrast * s) ** 2, (contrast * p) ** 2, polarization)


def reflectance_ratio(n2: ArrayLike, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
    """Return ``R(theta_i) / R(0)``, which stays finite and smooth down to n2 = 1 where both vanish.

    Shapes, limits and errors as `reflectance`; ``R(0) = ((n2 - 1) / (n2 + 1))^2``.
    """
    n, c = _checked(n2, theta_i_deg)
    s, p = _reduced_amplitudes(n, c)
    scale = (n + 1.0) ** 2
    return _mixed((scale * s) ** 2, (scale * p) ** 2, polarization)


def reflectance_ratio_dn2(n2: ArrayLike, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
    """Return the derivative of `reflectance_ratio` with respect to `n2` (below 90 degrees, or n2 > 1)."""
    n, c = _checked(n2, theta_i_deg)
    s, p = _reduced_amplitudes(n, c)
    q = np.sqrt((n - 1.0) * (n + 1.0) + c**2)
    scale = (n + 1.0) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        log_s = 2.0 / (n + 1.0) - 2.0 * n / (q * (c + q))
        below = n**2 * c + q
        dp = 2.0 * (n + 1.0) * p + scale * (
            2.0 * n * (c / below) ** 2 - 2.0 * p * (2.0 * n * c + n / q) / below
        )
    return _mixed(2.0 * (scale * s) ** 2 * log_s, 2.0 * scale * p * dp, polarization)


def reflectance_dn2(n2: ArrayLike, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
    """Return dR/dn2; zero at n2 = 1, where R starts as ``(n2 - 1)^2``."""
    n = np.asarray(n2, np.float64)
    normal = ((n - 1.0) / (n + 1.0)) ** 2
    slope = 4.0 * (n - 1.0) / (n + 1.0) ** 3
    ratio = reflectance_ratio(n, theta_i_deg, polarization)
    with np.errstate(invalid="ignore"):
        change = normal * reflectance_ratio_dn2(n, theta_i_deg, polarization)
    return np.asarray(slope * ratio + np.where(normal == 0.0, 0.0, change))


def brewster_deg(n2: ArrayLike) -> FloatArray:
    """Return the incidence, degrees, at which P light is not reflected: ``atan(n2)``."""
    return np.asarray(np.rad2deg(np.arctan(np.asarray(n2, np.float64))))


def _checked(n2: ArrayLike, theta_i_deg: ArrayLike) -> tuple[FloatArray, FloatArray]:
    n = np.asarray(n2, np.float64)
    if np.any(n < 1.0):
        raise GonioError(
            f"n2 = {float(np.nanmin(n)):.6g} is below 1, the index of air; "
            "the Fresnel term describes light that meets a denser medium: give an index of at least 1"
        )
    theta = np.abs(np.asarray(theta_i_deg, np.float64))
    if np.any(theta > 90.0):
        raise GonioError(
            f"theta_i = {float(np.nanmax(theta)):.6g} deg is behind the sample; incidence runs from 0 to 90 deg"
        )
    return n, cos_deg(theta)


def _reduced_amplitudes(n: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ``-r_s / (n^2 - 1)`` and ``r_p / (n^2 - 1)``; any finite number where n = 1 at 90 degrees."""
    q2 = (n - 1.0) * (n + 1.0) + c**2  # n^2 - sin^2, equal to c^2 exactly at n = 1
    q = np.sqrt(q2)
    # the squares are expanded so that c = 0 leaves exactly n^2 - 1, and R is exactly 1
    below_s = c**2 + 2.0 * c * q + q2
    below_p = (n**2 * c) ** 2 + 2.0 * n**2 * c * q + q2
    no_interface = below_s == 0.0
    s = 1.0 / np.where(no_interface, 1.0, below_s)
    p = ((n**2 + 1.0) * c**2 - 1.0) / np.where(no_interface, 1.0, below_p)
    return s, p


def _mixed(s: FloatArray, p: FloatArray, polarization: Polarization) -> FloatArray:
    if polarization == "s":
        return np.asarray(s)
    if polarization == "p":
        return np.asarray(p)
    if polarization == "unpolarized":
        return np.asarray(0.5 * (s + p))
    raise unknown_polarization(polarization)


def unknown_polarization(polarization: str) -> GonioError:
    """Return the error for a polarization that is none."""
    return GonioError(f"polarization = {polarization!r} is not known; use 's', 'p' or 'unpolarized'")

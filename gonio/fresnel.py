"""Fresnel power reflectances of a smooth interface from air into a denser transparent medium.

Equations 11 and 12 of Raybaud et al. (Energy and Buildings 263, 2022, 112034), rewritten without
cancellation: with ``c = cos(theta_i)`` and ``q = sqrt(n2^2 - sin(theta_i)^2)``

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
Amplitude = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


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
    contrast = (n - 1.0) * (n + 1.0)
    return _mixed(lambda a: a(n, c, contrast) ** 2, polarization)


def reflectance_at_cosine(n2: ArrayLike, cos_i: ArrayLike, polarization: Polarization) -> FloatArray:
    """Return `reflectance` at an incidence given by its cosine, 0...1, that of a half vector, say."""
    n, c = _checked(n2, 0.0)[0], np.asarray(cos_i, np.float64)
    contrast = (n - 1.0) * (n + 1.0)
    return _mixed(lambda a: a(n, c, contrast) ** 2, polarization)


def reflectance_ratio(n2: ArrayLike, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
    """Return ``R(theta_i) / R(0)``, which stays finite and smooth down to n2 = 1 where both vanish.

    Shapes, limits and errors as `reflectance`; ``R(0) = ((n2 - 1) / (n2 + 1))^2``.
    """
    n, c = _checked(n2, theta_i_deg)
    return _mixed(lambda a: a(n, c, (n + 1.0) ** 2) ** 2, polarization)


def reflectance_ratio_dn2(n2: ArrayLike, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
    """Return the derivative of `reflectance_ratio` with respect to `n2` (below 90 degrees, or n2 > 1)."""
    n, c = _checked(n2, theta_i_deg)
    scale = (n + 1.0) ** 2

    def slope(amplitude: Amplitude) -> FloatArray:
        derivative = _AMPLITUDE_DN2[amplitude]
        return 2.0 * amplitude(n, c, scale) * (amplitude(n, c, 2.0 * (n + 1.0)) + derivative(n, c, scale))

    with np.errstate(divide="ignore", invalid="ignore"):
        return _mixed(slope, polarization)


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
            f"theta_i = {float(np.nanmax(theta)):.6g} deg is behind the sample; "
            "incidence runs from 0 to 90 deg"
        )
    return n, cos_deg(theta)


def _s_amplitude(n: FloatArray, c: FloatArray, factor: FloatArray) -> FloatArray:
    """Return ``factor / (c + q)^2``, that is ``-factor r_s / (n^2 - 1)``; finite also for n = 1 at 90 deg."""
    q2 = (n - 1.0) * (n + 1.0) + c**2  # n^2 - sin^2, equal to c^2 exactly at n = 1
    # the square is expanded so that c = 0 leaves exactly n^2 - 1, and R is exactly 1
    below = c**2 + 2.0 * c * np.sqrt(q2) + q2
    return np.asarray(factor / np.where(below == 0.0, 1.0, below))


def _p_amplitude(n: FloatArray, c: FloatArray, factor: FloatArray) -> FloatArray:
    """Return ``factor ((n^2 + 1) c^2 - 1) / (n^2 c + q)^2``, that is ``factor r_p / (n^2 - 1)``."""
    q2 = (n - 1.0) * (n + 1.0) + c**2
    below = (n**2 * c) ** 2 + 2.0 * n**2 * c * np.sqrt(q2) + q2
    return np.asarray(factor * ((n**2 + 1.0) * c**2 - 1.0) / np.where(below == 0.0, 1.0, below))


def _s_amplitude_dn2(n: FloatArray, c: FloatArray, factor: FloatArray) -> FloatArray:
    q = np.sqrt((n - 1.0) * (n + 1.0) + c**2)
    return np.asarray(-2.0 * factor * n / (q * (c + q) ** 3))


def _p_amplitude_dn2(n: FloatArray, c: FloatArray, factor: FloatArray) -> FloatArray:
    q = np.sqrt((n - 1.0) * (n + 1.0) + c**2)
    below = n**2 * c + q
    above = (n**2 + 1.0) * c**2 - 1.0
    return np.asarray(2.0 * factor * (n * c**2 - above * (2.0 * n * c + n / q) / below) / below**2)


_AMPLITUDE_DN2: dict[Amplitude, Amplitude] = {_s_amplitude: _s_amplitude_dn2, _p_amplitude: _p_amplitude_dn2}


def _mixed(of: Callable[[Amplitude], FloatArray], polarization: Polarization) -> FloatArray:
    """Return a function of the amplitude for S or P, or the mean of both."""
    if polarization == "s":
        return np.asarray(of(_s_amplitude))
    if polarization == "p":
        return np.asarray(of(_p_amplitude))
    if polarization == "unpolarized":
        return np.asarray(0.5 * (of(_s_amplitude) + of(_p_amplitude)))
    raise unknown_polarization(polarization)


def unknown_polarization(polarization: str) -> GonioError:
    """Return the error for a polarization that is none."""
    return GonioError(f"polarization = {polarization!r} is not known; use 's', 'p' or 'unpolarized'")

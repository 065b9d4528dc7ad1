"""How may n2 depend on the wavelength?  The forms that all wavelengths of a fit can share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.errors import FitError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Dispersion:
    """n2 as a function of few coefficients that all wavelengths share; wavelengths in micrometres.

    Attributes
    ----------
    name, coefficients
        As in files and tables.
    value
        ``(c (g,), wavelength_um (m,)) -> n2 (m,)``; NaN where the form gives none.
    slope
        Derivatives of `value` by the coefficients, (m, g).
    begin
        ``(n2 (m,), weight (m,), wavelength_um (m,)) -> c (g,)``: a weighted fit to separate indices.
    """

    name: str
    coefficients: tuple[str, ...]
    value: Callable[[FloatArray, FloatArray], FloatArray]
    slope: Callable[[FloatArray, FloatArray], FloatArray]
    begin: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


def _polynomial(name: str, count: int) -> Dispersion:
    """Return ``n2 = A + B / l^2 + C / l^4``, the first `count` terms (Cauchy 1836)."""

    def slope(c: FloatArray, um: FloatArray) -> FloatArray:
        return np.asarray(um[:, None] ** (-2.0 * np.arange(c.size)), np.float64)

    def value(c: FloatArray, um: FloatArray) -> FloatArray:
        return slope(c, um) @ c

    def begin(n2: FloatArray, weight: FloatArray, um: FloatArray) -> FloatArray:
        root = np.sqrt(weight)
        columns = slope(np.zeros(count), um)
        return np.asarray(np.linalg.lstsq(columns * root[:, None], n2 * root, rcond=1e-12)[0], np.float64)

    return Dispersion(name, ("n2_A", "n2_B", "n2_C")[:count], value, slope, begin)


def _sellmeier_value(c: FloatArray, um: FloatArray) -> FloatArray:
    squared = 1.0 + c[0] * um**2 / (um**2 - c[1])
    return np.where((squared >= 1.0) & (um**2 > c[1]), np.sqrt(np.maximum(squared, 1.0)), np.nan)


def _sellmeier_slope(c: FloatArray, um: FloatArray) -> FloatArray:
    from_resonance = um**2 - c[1]
    per_b = um**2 / from_resonance
    return np.stack([per_b, c[0] * per_b / from_resonance], axis=1) / (2.0 * _sellmeier_value(c, um)[:, None])


def _sellmeier_begin(n2: FloatArray, weight: FloatArray, um: FloatArray) -> FloatArray:
    """Return B and C from ``1/(n2^2 - 1) = 1/B - C/(B l^2)``, a straight line in 1/l^2."""
    contrast = np.maximum(n2**2 - 1.0, 1e-3)
    root = np.sqrt(weight) * contrast**2 / n2  # of 1/contrast, from that of n2
    columns = np.stack([np.ones_like(um), um**-2.0], axis=1)
    a, b = np.linalg.lstsq(columns * root[:, None], root / contrast, rcond=1e-12)[0]
    mean = float(np.sum(weight * contrast) / np.sum(weight))
    resonance = -b / a if a > 0.0 else 0.0
    # a resonance inside the wavelengths, or none: begin without one
    if not (a > 0.0 and resonance < 0.8 * float(np.min(um)) ** 2):
        return np.array([mean, 0.0])
    return np.array([1.0 / a, resonance])


DISPERSIONS: dict[str, Dispersion] = {
    "constant": _polynomial("constant", 1),
    "cauchy": _polynomial("cauchy", 2),
    "cauchy3": _polynomial("cauchy3", 3),
    "sellmeier": Dispersion(
        "sellmeier", ("n2_B", "n2_C"), _sellmeier_value, _sellmeier_slope, _sellmeier_begin
    ),
}
"""By name: one index for all; Cauchy with two or three terms; Sellmeier ``n2^2 = 1 + B l^2 / (l^2 - C)``."""


def dispersion_of(name: str, wavelength_nm: FloatArray) -> Dispersion:
    """Return a form by its name, for the wavelengths that it is to join.

    Raises
    ------
    FitError
        An unknown name, wavelengths that are not known, or fewer than the form has coefficients.
    """
    if name not in DISPERSIONS:
        raise FitError(
            f"n2 = {name!r} is not known; use 'free', one of {', '.join(map(repr, DISPERSIONS))}, a number, "
            "or one number per wavelength"
        )
    form = DISPERSIONS[name]
    if name != "constant" and not np.all(np.isfinite(wavelength_nm)):
        raise FitError(f"n2 = {name!r} needs the wavelengths; give wavelength_nm, or use n2 = 'constant'")
    different = len(np.unique(wavelength_nm[np.isfinite(wavelength_nm)]))
    if name != "constant" and different < len(form.coefficients):
        raise FitError(
            f"n2 = {name!r} has {len(form.coefficients)} coefficients, but there are {different} different "
            "wavelengths to tell them; use a form with fewer, such as 'constant'"
        )
    return form

"""What is the mean of a quantity over wavelengths, when a part of its error is common to them?

The wavelengths' own errors (noise, dark and baseline) average out; the fit's modes (a shared index, the
distance of the aperture, ...) move all wavelengths together and do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.quantity import quantity_named

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

FloatArray = NDArray[np.float64]
_COEFFICIENTS = ("k_d", "k_s", "k_g")


def mode_shifts(fit: FitResult, name: str, theta_i_deg: float) -> FloatArray:
    """Return the shift of a quantity by one standard uncertainty of each of the fit's g modes, (g, m).

    Parameters
    ----------
    name
        A parameter or a coefficient, see `gonio.fitting.quantity.quantity_named`.
    """
    if len(fit.modes) == 0:
        return np.zeros((0, len(fit.wavelength_nm)))
    kind = fit.kind
    basic = fit.basic.copy()
    linear = len(kind.linear)
    middle = [1.5 if shape == "n2" else 0.0 for shape in kind.shape]
    basic[:, linear:] = np.where(np.isfinite(basic[:, linear:]), basic[:, linear:], middle)
    gradient = quantity_named(kind, name, theta_i_deg).slopes(basic)
    # without a lobe its shape is undefined and its strength held at zero: no mode moves them
    gradient = np.where(np.isfinite(fit.basic), gradient, 0.0)
    modes = np.where(np.isfinite(fit.modes), fit.modes, 0.0)
    return np.asarray(np.einsum("gma,ma->gm", modes, gradient))


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """A quantity over wavelength.

    Attributes
    ----------
    value, half
        (m,): the value and half its 95 % interval.
    common
        (g, m): the part of `half` that each mode makes, with its sign.
    """

    value: FloatArray
    half: FloatArray
    common: FloatArray

    def mean(self, use: NDArray[np.bool_] | NDArray[np.intp]) -> tuple[float, float]:
        """Return the plain mean over the wavelengths with a value, and half its 95 % interval.

        NaN without any value; the half is NaN if one of the wavelengths has none.
        """
        value, half, common = self.value[use], self.half[use], self.common[:, use]
        known = np.isfinite(value)
        if not np.any(known):
            return float("nan"), float("nan")
        own = np.maximum(half[known] ** 2 - np.sum(common[:, known] ** 2, axis=0), 0.0)
        own = np.where(np.isfinite(half[known]), own, np.nan)
        shared = np.sum(np.mean(common[:, known], axis=1) ** 2)
        return float(np.mean(value[known])), float(np.sqrt(np.sum(own) / np.sum(known) ** 2 + shared))


def columns_of(fit: FitResult, theta_i_deg: float) -> dict[str, Column]:
    """Return the parameters, and k_d, k_s and k_g at an incidence, by name."""
    found = {
        name: Column(fit.value[:, i], fit.quantile * fit.se[:, i], _common(fit, name, theta_i_deg))
        for i, name in enumerate(fit.parameters)
    }
    k = fit.hemispherical(theta_i_deg)
    for name in _COEFFICIENTS:
        coefficient = getattr(k, name)
        found[name] = Column(
            coefficient.value, fit.quantile * coefficient.se, _common(fit, name, theta_i_deg)
        )
    return found


def _common(fit: FitResult, name: str, theta_i_deg: float) -> FloatArray:
    quantile = np.nan_to_num(fit.quantile)
    return np.asarray(quantile * mode_shifts(fit, name, theta_i_deg))

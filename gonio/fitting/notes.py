"""A sentence for everything about a wavelength's fit that its numbers alone would hide."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gonio.fitting.assemble import Findings

_OUTLIER = 6.0  # standard deviations; among a million Gaussian readings none
_INSEPARABLE = 0.95
_BY_CHANCE = 4.0  # standard errors; so far off is no chance, even at one wavelength of many


def write_notes(found: Findings, position: NDArray[np.intp]) -> list[str]:
    """Return one text per fitted wavelength, parts joined by "; "; `position` (n,) numbers the positions."""
    scale = np.sqrt(found.chi2 / found.dof)
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = np.abs(found.residual) / (found.sigma * scale)
    rounding = np.nanmax(np.abs(found.residual), axis=0) < 1e-11 * np.abs(found.basic[:, 0])
    return [
        "; ".join(_of(found, k, position, deviation[:, k], bool(rounding[k])))
        for k in range(len(found.value))
    ]


def _of(
    found: Findings, k: int, position: NDArray[np.intp], deviation: NDArray[np.float64], rounding: bool
) -> list[str]:
    rho_d, rho_s = found.value[k, :2]
    parts: list[str] = []
    if not found.converged[k]:
        parts.append("the search did not converge")
    if not found.lobe[k]:
        parts.append("no lobe is seen above the noise: fitted as Lambertian, alpha and n2 are undefined")
    else:
        parts.extend(_shape_notes(found, k))
        if rho_s < 0.0:
            parts.append(f"rho_s = {rho_s:.3g} is negative, unphysical: a dip where the lobe should be")
        elif np.isfinite(rho_s) and rho_s - _BY_CHANCE * found.se[k, 1] > 1.0:
            parts.append(
                f"rho_s = {rho_s:.3g} is above 1, unphysical: more light in the lobe than n2 lets reflect"
            )
    rho_d_margin = _BY_CHANCE * found.se[k, 0]
    if rho_d + rho_d_margin < 0.0:
        parts.append(f"rho_d = {rho_d:.3g} is negative, unphysical: look at the dark readings")
    if rho_d - rho_d_margin > 1.0:
        parts.append(
            f"rho_d = {rho_d:.3g} is above 1, unphysical: look at the baseline and the aperture's distance"
        )
    outliers = np.flatnonzero(deviation > _OUTLIER)
    if outliers.size and not rounding:
        worst = outliers[np.argsort(-deviation[outliers])][:3]
        listed = ", ".join(f"{position[i]} ({deviation[i]:.0f} sd)" for i in worst)
        parts.append(f"{outliers.size} outlier(s) beyond {_OUTLIER:.0f} sd, at position {listed}")
    return parts


def _shape_notes(found: Findings, k: int) -> list[str]:
    parts: list[str] = []
    if found.single[k]:
        parts.append(
            "one incidence and one polarization tell only rho_s R(theta_i): rho_s and n2 are undetermined, "
            "measure another incidence or polarization"
        )
    low, high = found.lower[k, 2], found.upper[k, 2]
    if np.isposinf(high) and low <= 0.0:
        parts.append("alpha is not determined")
    elif np.isposinf(high):
        parts.append(f"alpha >= {low:.3g} (95 %): a narrower lobe would look the same through this aperture")
    elif low <= 0.0:
        parts.append(f"alpha <= {high:.3g} (95 %): the lobe is so wide that it looks diffuse")
    low, high = found.lower[k, 3], found.upper[k, 3]
    open_low, open_high = low <= 1.0, np.isposinf(high)
    if open_low and open_high:
        parts.append("n2 and rho_s are not determined, only their product rho_s R")
    elif open_low:
        parts.append(f"n2 <= {high:.3g} (95 %), with no lower bound but 1: rho_s has no upper bound")
    elif open_high:
        parts.append(f"n2 >= {low:.3g} (95 %) without an upper bound")
    variance = found.covariance[k, 1, 1] * found.covariance[k, 3, 3]
    if variance > 0.0:
        correlation = found.covariance[k, 1, 3] / np.sqrt(variance)
        if abs(correlation) > _INSEPARABLE:
            parts.append(f"rho_s and n2 are hardly separable (correlation {correlation:.3f})")
    return parts

"""A sentence for everything about a wavelength's fit that its numbers alone would hide."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gonio.fitting.assemble import Findings

_OUTLIER = 6.0  # standard deviations; among a million Gaussian readings none
_INSEPARABLE = 0.95
_SYSTEMATIC = 1e-6  # probability by chance, below which residuals of one sign in a row are the model's fault
_ALIKE = 3  # readings that share the largest value to the last digits
_BY_CHANCE = 4.0  # standard errors; so far off is no chance, even at one wavelength of many


def write_notes(found: Findings, position: NDArray[np.intp], y: NDArray[np.float64]) -> list[str]:
    """Return one text per fitted wavelength, parts joined by "; ".

    `position` (n,) numbers the positions, `y` (n, k) are the readings, NaN where unused.
    """
    scale = np.sqrt(found.scale)
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = np.abs(found.residual) / (found.sigma * scale)
    rounding = np.nanmax(np.abs(found.residual), axis=0) < 1e-11 * np.abs(found.basic[:, 0])
    return [
        "; ".join(
            _of(found, k, position, deviation[:, k], bool(rounding[k]))
            + _pattern_notes(found, k, y[:, k], bool(rounding[k]))
        )
        for k in range(len(found.value))
    ]


def write_remarks(found: Findings) -> tuple[str, ...]:
    """Return what is seen at all wavelengths together, but not at most of them alone."""
    alone = np.mean(np.nan_to_num(found.runs, nan=1.0) < _SYSTEMATIC)
    if alone > 0.5 or len(found.runs) < 2 or not found.runs_together < _SYSTEMATIC:
        return ()
    return (
        "over all wavelengths the residuals keep their sign along the sweeps: the lobe has another shape, an "
        "angle is off, or readings drift, by less than one wavelength shows; the intervals do not include it",
    )


def _of(
    found: Findings, k: int, position: NDArray[np.intp], deviation: NDArray[np.float64], rounding: bool
) -> list[str]:
    parts: list[str] = []
    if not found.converged[k] and found.lobe[k]:  # without a lobe the fit is linear
        parts.append("the search did not converge")
    if not found.lobe[k]:
        parts.append("no lobe is seen above the noise: fitted as Lambertian, alpha and n2 are undefined")
    else:
        parts.extend(_shape_notes(found, k))
    for column, name in enumerate(found.names):
        value, margin = found.value[k, column], _BY_CHANCE * found.se[k, column]
        if name.startswith("rho_s") and found.lobe[k]:
            if value < 0.0:
                parts.append(f"{name} = {value:.3g} is negative, unphysical: a dip where the lobe should be")
            elif np.isfinite(value) and value - margin > 1.0:
                parts.append(
                    f"{name} = {value:.3g} is above 1, unphysical: more light in the lobe than n2 lets "
                    "reflect"
                )
        if name.startswith("rho_d"):
            if value + margin < 0.0:
                parts.append(f"{name} = {value:.3g} is negative, unphysical: look at the dark readings")
            if value - margin > 1.0:
                parts.append(
                    f"{name} = {value:.3g} is above 1, unphysical: look at the baseline and the aperture's "
                    "distance"
                )
    outliers = np.flatnonzero(deviation > _OUTLIER)
    if outliers.size and not rounding:
        worst = outliers[np.argsort(-deviation[outliers])][:3]
        listed = ", ".join(f"{position[i]} ({deviation[i]:.0f} sd)" for i in worst)
        parts.append(f"{outliers.size} outlier(s) beyond {_OUTLIER:.0f} sd, at position {listed}")
    return parts


def _pattern_notes(found: Findings, k: int, y: NDArray[np.float64], rounding: bool) -> list[str]:
    parts: list[str] = []
    largest = float(np.nanmax(y))
    alike = int(np.sum(y >= largest - 1e-9 * abs(largest)))
    if alike >= _ALIKE:
        parts.append(f"{alike} readings share the largest value {largest:.4g}: saturated, or no measurement")
    if found.runs[k] < _SYSTEMATIC and not rounding:
        parts.append(
            "the residuals keep their sign along the sweeps: the model does not have this lobe's shape, an "
            "angle is off, or readings drift, which the intervals do not include"
        )
    return parts


def _shape_notes(found: Findings, k: int) -> list[str]:
    parts: list[str] = []
    if found.untold[k]:
        parts.append(
            "one incidence and one polarization tell only rho_s R(theta_i): rho_s and n2 are undetermined, "
            "measure another incidence or polarization"
        )
    for column, name in enumerate(found.names):
        low, high = found.lower[k, column], found.upper[k, column]
        if name.startswith(("alpha", "roughness")):
            parts.extend(_width_note(name, float(low), float(high)))
        elif name == "n2":
            parts.extend(_index_note(float(low), float(high)))
    if "n2" not in found.names:
        return parts
    if np.isfinite(found.other_n2[k]):
        parts.append(
            f"n2 = {found.other_n2[k]:.3g} fits as well, on the other side of Brewster's angle: rho_s and n2 "
            "are ambiguous and the intervals hold one choice, measure S too"
        )
    index = found.names.index("n2")
    for column, name in enumerate(found.names):
        variance = found.covariance[k, column, column] * found.covariance[k, index, index]
        if name.startswith("rho_s") and variance > 0.0:
            correlation = found.covariance[k, column, index] / np.sqrt(variance)
            if abs(correlation) > _INSEPARABLE:
                parts.append(f"{name} and n2 are hardly separable (correlation {correlation:.3f})")
    return parts


def _width_note(name: str, low: float, high: float) -> list[str]:
    """Say where the width of a lobe has no bound; a large alpha is a narrow lobe."""
    narrow, wide = np.isposinf(high), low <= 0.0
    if narrow and wide:
        return [f"{name} is not determined"]
    if not narrow and not wide:
        return []
    bound = f"{name} >= {low:.3g} (95 %)" if narrow else f"{name} <= {high:.3g} (95 %)"
    if narrow == name.startswith("alpha"):
        return [f"{bound}: a narrower lobe would look the same through this aperture"]
    return [f"{bound}: the lobe is so wide that it looks diffuse"]


def _index_note(low: float, high: float) -> list[str]:
    open_low, open_high = low <= 1.0, np.isposinf(high)
    if open_low and open_high:
        return ["n2 and rho_s are not determined, only their product rho_s R"]
    if open_low:
        return [f"n2 <= {high:.3g} (95 %), with no lower bound but 1: rho_s has no upper bound"]
    if open_high:
        return [f"n2 >= {low:.3g} (95 %) without an upper bound"]
    return []

"""Where do the fitted coefficients stand against the integrating sphere?

For every wavelength the degree of equivalence of ISO/IEC 17043,

    E_n = (k_g - k_sphere) / sqrt(U_fit**2 + U_sphere**2),

with both U expanded to 95 % (coverage factor 2 for the sphere, half of the 95 % interval for the fit).
``abs(E_n) <= 1`` says that the two agree within what they claim.  Not in U_fit: the aperture's distance and
size, the alignment, and whatever the model leaves out; the page names this beside the number.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.report.content import Content

if TYPE_CHECKING:
    from gonio.fitting import FitResult

FloatArray = NDArray[np.float64]

SPHERE_THETA_I_DEG = 8.0
ASSUMED_RELATIVE = 0.01  # the paper's section 4.1: "1 %", taken as relative, coverage factor 2
VALUE_NAME = "k_g"
STANDARD_NAME = "k_g_u"  # standard uncertainty, coverage factor 1


@dataclass(frozen=True, slots=True)
class Sphere:
    """The sphere's reflectance and expanded (coverage factor 2) uncertainty, each (n_wavelength,)."""

    wavelength_nm: FloatArray
    value: FloatArray
    expanded: FloatArray
    uncertainty_text: str


@dataclass(frozen=True, slots=True)
class Range:
    """The comparison within one detector's wavelengths; deviations are relative to the sphere."""

    detector: str
    low_nm: float
    high_nm: float
    count: int
    mean_deviation: float  # in reflectance
    mean_relative: float
    mean_sphere: float
    worst_e_n: float
    within: int  # wavelengths with |E_n| <= 1


@dataclass(frozen=True, slots=True)
class Comparison:
    """k_g of the fit minus the sphere's at each wavelength of the fit, NaN where either is missing."""

    wavelength_nm: FloatArray
    deviation: FloatArray
    expanded_fit: FloatArray
    expanded_sphere: FloatArray
    e_n: FloatArray
    ranges: tuple[Range, ...]

    @property
    def expanded(self) -> FloatArray:
        """Expanded uncertainty of the deviation, (n_wavelength,)."""
        return np.hypot(self.expanded_fit, self.expanded_sphere)


def sphere_of(content: Content) -> Sphere | None:
    """Return the sphere's spectrum with its uncertainty, or ``None`` if the file has none."""
    found = content.sphere
    if found is None:
        return None
    value, standard = found.column(VALUE_NAME), found.column(STANDARD_NAME)
    if value is None:
        return None
    if standard is not None:
        return Sphere(found.wavelength_nm, value, 2.0 * standard, "its stated uncertainty, coverage factor 2")
    return Sphere(
        found.wavelength_nm,
        value,
        ASSUMED_RELATIVE * np.abs(value),
        f"±{100 * ASSUMED_RELATIVE:g} % of its value assumed, coverage factor 2",
    )


def compare(content: Content, fit: FitResult) -> Comparison | None:
    """Return the comparison of the fit's k_g at 8 deg with the sphere; ``None`` without a sphere."""
    sphere = sphere_of(content)
    if sphere is None:
        return None
    fit = fit.only(fit.home)
    k_g = fit.hemispherical(theta_i_deg=SPHERE_THETA_I_DEG).k_g
    wavelength_nm = np.asarray(fit.wavelength_nm, dtype=np.float64)
    reference = _interpolate(wavelength_nm, sphere.wavelength_nm, sphere.value)
    expanded_sphere = _interpolate(wavelength_nm, sphere.wavelength_nm, sphere.expanded)
    expanded_fit = 0.5 * (k_g.upper - k_g.lower)
    deviation = k_g.value - reference
    with np.errstate(divide="ignore", invalid="ignore"):
        e_n = deviation / np.hypot(expanded_fit, expanded_sphere)
    e_n = np.where(np.isfinite(e_n), e_n, np.nan)
    return Comparison(
        wavelength_nm=wavelength_nm,
        deviation=deviation,
        expanded_fit=expanded_fit,
        expanded_sphere=expanded_sphere,
        e_n=e_n,
        ranges=_by_detector(content, wavelength_nm, deviation, reference, e_n),
    )


def _interpolate(at_nm: FloatArray, wavelength_nm: FloatArray, value: FloatArray) -> FloatArray:
    known = np.isfinite(value) & np.isfinite(wavelength_nm)
    if not np.any(known):
        return np.full(at_nm.shape, np.nan)
    order = np.argsort(wavelength_nm[known])
    return np.interp(at_nm, wavelength_nm[known][order], value[known][order], left=np.nan, right=np.nan)


def _by_detector(
    content: Content, wavelength_nm: FloatArray, deviation: FloatArray, reference: FloatArray, e_n: FloatArray
) -> tuple[Range, ...]:
    scan = content.scan
    edges = [-np.inf, *scan.detector_change_nm, np.inf]
    ranges = []
    for low, high in itertools.pairwise(edges):
        inside = (wavelength_nm >= low) & (wavelength_nm < high)
        known = inside & np.isfinite(e_n)
        if not np.any(known):
            continue
        own_nm = np.where(scan.home, scan.wavelength_nm, np.inf)
        nearest = int(np.argmin(np.abs(own_nm - wavelength_nm[known][0])))
        ranges.append(
            Range(
                detector=scan.detector_names[int(scan.detector_index[nearest])],
                low_nm=float(wavelength_nm[known].min()),
                high_nm=float(wavelength_nm[known].max()),
                count=int(known.sum()),
                mean_deviation=float(np.mean(deviation[known])),
                mean_relative=float(np.mean(deviation[known] / reference[known])),
                mean_sphere=float(np.mean(reference[known])),
                worst_e_n=float(e_n[known][np.argmax(np.abs(e_n[known]))]),
                within=int(np.count_nonzero(np.abs(e_n[known]) <= 1.0)),
            )
        )
    return tuple(ranges)

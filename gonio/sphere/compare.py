"""Where do the fitted coefficients stand against the integrating sphere?

At each wavelength, and for the means over parts of the spectrum,

    E_n = (k - k_sphere) / sqrt(U_fit**2 + U_common**2 + U_sphere**2),

k being k_g where the sphere kept the specular beam in, k_d where it let it out, at the sphere's incidence.

* U_fit, what each wavelength has for itself: noise, and the readings of dark and baseline.  Half the 95 %
  interval (Student's t); it averages out over a band.
* U_common, what the wavelengths of the fit share: its common modes (distance, alignment, ...), two standard
  uncertainties.  Zero where the fit states none; the table then says so.  It does not average out, each mode
  keeping its sign.
* U_sphere, two standard uncertainties of the sphere.  A sphere's error is nearly all systematic (standard,
  port, the substitution error): it is taken as common to all wavelengths and does not average out.

Parts of the spectrum never span a detector change, neither the scan's nor the sphere's own.  Between its
wavelengths the sphere is interpolated linearly, never across its own detector change nor beyond its ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.means import mode_shifts
from gonio.sphere.e_n import e_n
from gonio.sphere.stored import Sphere
from gonio.sphere.uncertainty import COVERAGE

if TYPE_CHECKING:
    from gonio.fitting import FitResult

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Part:
    """Means over a part of the spectrum in which nothing changes; reflectances as fractions.

    Attributes
    ----------
    detector
        Its name, or its number where the name is not known.
    low_nm, high_nm, count
        First and last wavelength that could be compared, and how many.
    value, reference
        Mean coefficient of the fit, and mean of the sphere.
    u_fit, u_common, u_sphere
        Expanded uncertainties of these means at 95 %; NaN where not known.
    e_n
        Of the means.
    within, judged
        How many wavelengths have ``abs(E_n) <= 1``, of those that have an E_n.
    worst_e_n
        The largest E_n of a single wavelength, with its sign.
    """

    detector: str
    low_nm: float
    high_nm: float
    count: int
    value: float
    reference: float
    u_fit: float
    u_common: float
    u_sphere: float
    e_n: float
    within: int
    judged: int
    worst_e_n: float

    @property
    def difference(self) -> float:
        """Fit minus sphere, in reflectance."""
        return self.value - self.reference

    @property
    def relative(self) -> float:
        """Fit minus sphere over the sphere; NaN where the sphere sees nothing."""
        return self.difference / self.reference if self.reference > 0.0 else float("nan")

    @property
    def expanded(self) -> float:
        """Expanded uncertainty of the difference."""
        return float(np.sqrt(self.u_fit**2 + self.u_common**2 + self.u_sphere**2))


@dataclass(frozen=True, slots=True, eq=False)
class SphereComparison:
    """A fit beside the sphere at the m wavelengths of the fit, each taken once.

    Attributes
    ----------
    wavelength_nm, value, reference, difference, e_n
        (m,), NaN where fit or sphere is missing.
    u_fit, u_common, u_sphere
        (m,), expanded at 95 %.
    common
        (g, m), shift of the coefficient by one standard uncertainty of each common mode of the fit.
    mode_names
        The g modes.
    side
        (m,) numbers of the pieces between detector changes.
    solid_angle_sr
        Of the aperture, for what an offset of the reading means.
    """

    sphere: Sphere
    wavelength_nm: FloatArray
    detectors: tuple[str, ...]
    value: FloatArray
    reference: FloatArray
    u_fit: FloatArray
    u_common: FloatArray
    u_sphere: FloatArray
    common: FloatArray
    mode_names: tuple[str, ...]
    side: NDArray[np.intp]
    solid_angle_sr: float

    @property
    def coefficient(self) -> str:
        """``k_g`` or ``k_d``."""
        return self.sphere.geometry.coefficient

    @property
    def difference(self) -> FloatArray:
        """Fit minus sphere, in reflectance."""
        return np.asarray(self.value - self.reference)

    @property
    def expanded(self) -> FloatArray:
        """Expanded uncertainty of the difference at each wavelength."""
        return np.sqrt(self.u_fit**2 + self.u_common**2 + self.u_sphere**2)

    @property
    def e_n(self) -> FloatArray:
        """E_n at each wavelength."""
        return e_n(self.difference, self.u_fit, self.u_common, self.u_sphere)

    def parts(self) -> tuple[Part, ...]:
        """Return the pieces between detector changes, in which something could be compared."""
        found = (self.over(self.side == k) for k in np.unique(self.side))
        return tuple(part for part in found if part is not None)

    def bands(self, bands: Sequence[tuple[float, float]]) -> tuple[Part, ...]:
        """Return the means over wavelength bands, nm, each cut at detector changes.

        The lower end belongs to a band, and the upper end to the last one.
        """
        at, last = self.wavelength_nm, bands[-1][1] if bands else np.nan
        found = []
        for low, high in bands:
            inside = (at >= low) & ((at < high) | ((high == last) & (at == high)))
            found += [self.over(inside & (self.side == k)) for k in np.unique(self.side)]
        return tuple(part for part in found if part is not None)

    def over(self, use: BoolArray) -> Part | None:
        """Return the means over some of the wavelengths, a mask (m,); None if none could be compared.

        The mask should not span a detector change: of several detectors the first is named.
        """
        use = use & np.isfinite(self.difference)
        if not np.any(use):
            return None
        n = int(np.count_nonzero(use))
        u_fit = float(np.sqrt(np.sum(self.u_fit[use] ** 2)) / n)
        u_common = COVERAGE * float(np.sqrt(np.sum(np.mean(self.common[:, use], axis=1) ** 2)))
        u_sphere = float(np.mean(self.u_sphere[use]))
        value, reference = float(np.mean(self.value[use])), float(np.mean(self.reference[use]))
        single = self.e_n[use]
        judged = single[np.isfinite(single)]
        first = int(np.argmax(use))
        return Part(
            detector=self.detectors[first],
            low_nm=float(self.wavelength_nm[use].min()),
            high_nm=float(self.wavelength_nm[use].max()),
            count=n,
            value=value,
            reference=reference,
            u_fit=u_fit,
            u_common=u_common,
            u_sphere=u_sphere,
            e_n=float(e_n(value - reference, u_fit, u_common, u_sphere)),
            within=int(np.count_nonzero(np.abs(judged) <= 1.0)),
            judged=int(judged.size),
            worst_e_n=float(judged[np.argmax(np.abs(judged))]) if judged.size else float("nan"),
        )

    def table(self) -> str:
        """Return the comparison for people; see `gonio.sphere.text`."""
        from gonio.sphere.text import comparison_text

        return comparison_text(self)


def compare(fit: FitResult, sphere: Sphere, *, detector_names: Sequence[str] = ()) -> SphereComparison:
    """Return the comparison of a fit with an integrating sphere.

    Parameters
    ----------
    fit
        Where two detectors measured a wavelength, the one on whose side it lies counts.
    sphere
        Of the same sample.
    detector_names
        In the order of the fit's detector index, as in `gonio.store.Scan`.
    """
    fit = fit.only(fit.home)
    at = np.asarray(fit.wavelength_nm, np.float64)
    coefficient = getattr(fit.hemispherical(sphere.geometry.theta_i_deg), sphere.geometry.coefficient)
    value = np.asarray(coefficient.value, np.float64)
    common = mode_shifts(fit, sphere.geometry.coefficient, sphere.geometry.theta_i_deg)
    half = 0.5 * np.asarray(coefficient.upper - coefficient.lower, np.float64)
    shared = np.sum(common**2, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.clip(1.0 - shared / np.square(coefficient.se), 0.0, 1.0)  # of the variance
    own = np.where(shared == 0.0, 1.0, own)
    names = dict(enumerate(detector_names))
    index = fit.detector_index.tolist()
    beyond_change = np.searchsorted(np.asarray(sphere.detector_change_nm, np.float64), at)
    keys = list(zip(index, beyond_change.tolist(), strict=True))
    order = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    return SphereComparison(
        sphere=sphere,
        wavelength_nm=at,
        detectors=tuple(names.get(k, f"detector {k}") for k in index),
        value=value,
        reference=interpolated(sphere, sphere.value, at),
        u_fit=half * np.sqrt(own),
        u_common=COVERAGE * np.sqrt(shared),
        u_sphere=COVERAGE * interpolated(sphere, sphere.standard, at),
        common=common,
        mode_names=tuple(fit.mode_names),
        side=np.array([order[key] for key in keys], np.intp),
        solid_angle_sr=float(fit.instrument.solid_angle_sr),
    )


def interpolated(sphere: Sphere, values: FloatArray, at_nm: FloatArray) -> FloatArray:
    """Return values of the sphere at wavelengths; NaN beyond its ends and across its detector change."""
    w = sphere.wavelength_nm
    if w.size < 1:
        return np.full(at_nm.shape, np.nan)
    found = np.interp(at_nm, w, values, left=np.nan, right=np.nan)
    if sphere.detector_change_nm and w.size > 1:
        change = np.asarray(sphere.detector_change_nm)
        right = np.clip(np.searchsorted(w, at_nm), 1, w.size - 1)
        on_point = np.isin(at_nm, w)
        crosses = np.searchsorted(change, w[right - 1]) != np.searchsorted(change, w[right])
        found = np.where(crosses & ~on_point, np.nan, found)
    return np.asarray(found)

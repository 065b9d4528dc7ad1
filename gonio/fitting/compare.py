"""What does the aperture model do to the result?  The same readings fitted through all four, side by side."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from gonio.aperture import ApertureName
from gonio.fitting.estimate import fit
from gonio.fitting.result import FitResult, PolarizationChoice
from gonio.overlap import home

if TYPE_CHECKING:
    from gonio.store import Scan

FloatArray = NDArray[np.float64]

COMPARED: tuple[ApertureName, ...] = ("point", "eq22", "published", "exact")
THETA_I_DEG = 8.0
"""Incidence of the hemispherical coefficients: the integrating sphere's."""

_COEFFICIENTS = ("k_d", "k_s", "k_g")
_SAME_INCIDENCE_DEG = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Variant:
    """The fit through one aperture model.

    Attributes
    ----------
    fit : the result, whose weights are those of every other variant
    solid_angle_sr : that this aperture model multiplies a constant intensity with
    values, half_widths : by name of the quantity, (m,): value, and half of the 95 % interval it claims
    aicc : (m,), corrected Akaike criterion, comparable among variants alone; NaN where there is no fit
    runs_p : (m,), probability of as few runs of one sign along theta_o by chance; NaN where there is no fit
    duration_s : seconds this fit took
    """

    fit: FitResult
    solid_angle_sr: float
    values: Mapping[str, FloatArray]
    half_widths: Mapping[str, FloatArray]
    aicc: FloatArray
    runs_p: FloatArray
    duration_s: float

    @property
    def aperture(self) -> ApertureName:
        """Name of the aperture model."""
        return self.fit.aperture


@dataclass(frozen=True, slots=True, eq=False)
class ApertureComparison:
    """The four fits, and what their biases are measured from.

    Attributes
    ----------
    variants : in the order of `COMPARED`; the exact one is last
    reference : by name of the quantity, (m,): the truth where the file knows it, else the exact fit
    reference_is_truth : which of the two
    keep : (m,), wavelengths that count: each once where two detectors measured it
    """

    variants: tuple[Variant, ...]
    reference: Mapping[str, FloatArray]
    reference_is_truth: bool
    keep: NDArray[np.bool_]

    def __getitem__(self, aperture: ApertureName) -> Variant:
        return next(v for v in self.variants if v.aperture == aperture)

    @property
    def exact(self) -> Variant:
        """The variant that integrates the aperture."""
        return self.variants[-1]

    def bias(self, aperture: ApertureName, quantity: str) -> FloatArray:
        """Return the relative bias of a quantity, (m,): ``value / reference - 1``.

        NaN where either is not determined, or the reference is zero (no lobe).
        """
        reference = self.reference[quantity]
        known = np.where(np.abs(reference) > 0.0, reference, np.nan)
        return np.asarray(self[aperture].values[quantity] / known - 1.0)

    def scale_bias(self, aperture: ApertureName) -> float:
        """Return the relative bias that the solid angle alone makes in every coefficient.

        A reading is a coefficient times the solid angle, so a model that assumes too large a one reads all
        coefficients low by their ratio, whatever the lobe.
        """
        return self.exact.solid_angle_sr / self[aperture].solid_angle_sr - 1.0

    def table(self) -> str:
        """Return the printable comparison: values with biases, quality of the fits, and what it means."""
        from gonio.fitting.compare_table import comparison_table

        return comparison_table(self)


def compare_apertures(
    scan: Scan,
    *,
    polarization: PolarizationChoice = "joint",
    truth: Mapping[str, FloatArray] | None = None,
    **options: Any,
) -> ApertureComparison:
    """Fit a scan through each aperture model with the same weights.

    The weights come from the residuals of an exact fit (or are those asked for): with weights of its own, a
    model that fits badly would take its errors for noise, and chi2 could not be compared.

    Parameters
    ----------
    scan
        A measured scan, `gonio.load`.
    truth
        Columns over ``wavelength_nm`` by name (parameters, and k_d, k_s, k_g at 8 degrees), as the simulated
        bench stores them; interpolated to the scan's wavelengths.  Without it biases count from the exact
        fit.
    options
        Further options of `gonio.fit`, the same for all four.

    Raises
    ------
    FitError
        As `gonio.fit`.
    """
    first = fit(scan, aperture="exact", polarization=polarization, **options)
    sd = np.full(scan.r.shape, np.nan)
    sd[_rows(scan, polarization)] = first.sigma
    weighed = dataclasses.replace(scan, r_sd=sd)
    options["weights"] = "r_sd"
    variants = []
    for aperture in COMPARED:
        start = time.perf_counter()
        result = fit(weighed, aperture=aperture, polarization=polarization, **options)
        variants.append(_variant(result, time.perf_counter() - start))
    known = _truth(truth, scan.wavelength_nm)
    exact = variants[-1].values
    reference = {name: known.get(name, np.full(scan.wavelength_nm.shape, np.nan)) for name in exact}
    told = any(np.any(np.isfinite(column)) for column in reference.values())
    return ApertureComparison(
        tuple(variants),
        reference if told else exact,
        told,
        home(scan.wavelength_nm, scan.detector_index),
    )


def _rows(scan: Scan, polarization: PolarizationChoice) -> NDArray[np.bool_]:
    """Return which positions take part, as `gonio.fit` chooses them, (n,)."""
    one = polarization in ("s", "p")
    return scan.polarization == polarization if one else np.isin(scan.polarization, ["s", "p"])


def _truth(columns: Mapping[str, FloatArray] | None, wavelength_nm: FloatArray) -> dict[str, FloatArray]:
    if columns is None or "wavelength_nm" not in columns:
        return {}
    at = columns["wavelength_nm"]
    return {
        name: np.interp(wavelength_nm, at, column, left=np.nan, right=np.nan)
        for name, column in columns.items()
        if name != "wavelength_nm" and not name.endswith("_u")
    }


def _variant(result: FitResult, duration_s: float) -> Variant:
    half = {name: 0.5 * (result.upper[:, k] - result.lower[:, k]) for k, name in enumerate(result.parameters)}
    values = {name: result.value[:, k] for k, name in enumerate(result.parameters)}
    k = result.hemispherical(THETA_I_DEG)
    for name, coefficient in zip(_COEFFICIENTS, (k.k_d, k.k_s, k.k_g), strict=True):
        values[name], half[name] = coefficient.value, result.quantile * coefficient.se
    return Variant(
        result,
        result.instrument.variant(result.aperture).solid_angle_sr,
        values,
        half,
        akaike(result),
        runs_probability(
            result.residual, result.theta_i_deg, result.theta_o_deg, result.polarization_of == "s"
        ),
        duration_s,
    )


def akaike(result: FitResult) -> FloatArray:
    """Return AICc, (m,), of weighted least squares with the scale of the variance fitted too.

    ``n ln(chi2 / n) + 2 K + 2 K (K + 1)/(n - K - 1)``, K the parameters and the scale (Hurvich and
    Tsai 1989). The weights' own part is left out, so that only fits with the same weights can be compared.
    """
    n = np.sum(np.isfinite(result.residual), axis=0).astype(np.float64)
    k = n - result.dof + 1.0
    good = (n > k + 1.0) & (result.chi2 > 0.0)
    n, k = np.where(good, n, 10.0), np.where(good, k, 1.0)
    value = n * np.log(np.where(good, result.chi2, 1.0) / n) + 2.0 * k + 2.0 * k * (k + 1.0) / (n - k - 1.0)
    return np.where(good, value, np.nan)


def runs_probability(
    residual: FloatArray, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: NDArray[np.bool_]
) -> FloatArray:
    """Return the probability of as few runs of residuals of one sign by chance, (m,).

    Wald and Wolfowitz (1940), along theta_o within each incidence and polarization; the counts of these
    sweeps are added.  A model of the wrong shape leaves residuals that keep their sign from position to
    position, and a small probability; so does a baseline error of one polarization.

    Parameters
    ----------
    residual
        (n, m), NaN where a reading was not used.
    theta_i_deg, theta_o_deg, is_s
        (n,) positions; incidences within half a degree are one.
    """
    excess, variance = np.zeros(residual.shape[1]), np.zeros(residual.shape[1])
    order = np.argsort(theta_i_deg, kind="stable")
    steps = np.concatenate([[0], np.cumsum(np.diff(theta_i_deg[order]) > _SAME_INCIDENCE_DEG)])
    sweep = np.empty(len(order), int)
    sweep[order] = steps
    for number in range(int(steps[-1]) + 1):
        for chosen in (is_s, ~is_s):
            rows = np.flatnonzero((sweep == number) & chosen)
            if not rows.size:
                continue
            sign = np.sign(np.nan_to_num(residual[rows[np.argsort(theta_o_deg[rows], kind="stable")]]))
            above, below = np.sum(sign > 0.0, axis=0), np.sum(sign < 0.0, axis=0)
            # a reading that was not used takes the sign before it, and begins no run
            last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(rows.size)[:, None], -1), axis=0)
            held = np.where(last >= 0, np.take_along_axis(sign, np.maximum(last, 0), axis=0), 0.0)
            runs = 1.0 + np.sum((held[1:] != held[:-1]) & (held[:-1] != 0.0), axis=0)
            count, product = (above + below).astype(np.float64), 2.0 * above * below
            both = product > 0.0
            count = np.where(both, count, 2.0)
            excess += np.where(both, runs - 1.0 - product / count, 0.0)
            variance += np.where(both, product * (product - count) / (count**2 * (count - 1.0)), 0.0)
    known = variance > 0.0
    z = (excess + 0.5) / np.sqrt(np.where(known, variance, 1.0))  # a count of k reaches to k + 1/2
    return np.where(known, special.ndtr(z), np.nan)

"""What does the aperture model do to the result?  The same readings fitted through all four, side by side."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import ApertureName
from gonio.fitting.estimate import fit
from gonio.fitting.result import FitResult, PolarizationChoice
from gonio.fitting.selection import akaike, runs_probability
from gonio.overlap import home

if TYPE_CHECKING:
    from gonio.store import Scan

FloatArray = NDArray[np.float64]

COMPARED: tuple[ApertureName, ...] = ("point", "eq22", "published", "exact")
THETA_I_DEG = 8.0
"""Incidence of the hemispherical coefficients: the integrating sphere's."""

_COEFFICIENTS = ("k_d", "k_s", "k_g")


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

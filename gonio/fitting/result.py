"""What a fit found: parameters, intervals, predictions, hemispherical coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from gonio import fresnel
from gonio.aperture import Aperture, ApertureName
from gonio.brdf.models import lobe_above_horizon, lobe_above_horizon_dlog_alpha
from gonio.fitting.problem import Problem
from gonio.overlap import home

FloatArray = NDArray[np.float64]
ApertureModel = ApertureName
PolarizationChoice = Literal["joint", "s", "p"]
IntervalMethod = Literal["wald", "nlparci"]

PARAMETERS = ("rho_d", "rho_s", "alpha", "n2")
CONFIDENCE = 0.95
_PER_WAVELENGTH = (
    "wavelength_nm", "detector_index", "value", "se", "lower", "upper", "covariance", "basic",
    "basic_covariance", "chi2", "dof", "rms", "condition",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Coefficient:
    """One quantity over wavelength, (m,) each: value, standard uncertainty, ends of the 95 % interval."""

    value: FloatArray
    se: FloatArray
    lower: FloatArray
    upper: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Hemispherical:
    """Hemispherical coefficients at one incidence, the mean of S and P (Eq 19-21).

    `k_s` and `k_g` count the lobe's energy above the horizon; `k_s_published` and `k_g_published` are the
    paper's ``rho_s R``, which counts the part below it too.
    """

    theta_i_deg: float
    k_d: Coefficient
    k_s: Coefficient
    k_g: Coefficient
    k_s_published: Coefficient
    k_g_published: Coefficient


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """Four parameters at m wavelengths, from n positions.

    Attributes
    ----------
    wavelength_nm, detector_index : (m,)
    parameters : names of the columns of `value`
    value, se, lower, upper : (m, 4); NaN where the data do not determine a parameter (see `notes`), infinite
    or 0
        where they bound it on one side only
    covariance : (m, 4, 4) of `value`: random part and common-mode part
    basic, basic_covariance : (m, 4), (m, 4, 4), the same result as (rho_d, k_n, log_alpha, n2) with
        ``k_n = rho_s R(0)``; these stay finite where `rho_s` does not
    chi2, dof : (m,), weighted sum of squared residuals and degrees of freedom; ``chi2 / dof`` has scaled
    `covariance` rms : (m,), root mean square residual, in r condition : (m,), condition number of the
    correlation matrix of `value` notes : m texts, empty where there is nothing to say residual : (n, m), data
    minus fit, in r; NaN where a reading was not used sigma : (n, m), standard deviation of a reading that the
    weights stand for, before scaling by chi2 theta_i_deg, theta_o_deg, polarization_of : (n,), the positions
    that were fitted
    """

    wavelength_nm: FloatArray
    detector_index: NDArray[np.uint8]
    parameters: tuple[str, str, str, str]
    value: FloatArray
    se: FloatArray
    lower: FloatArray
    upper: FloatArray
    covariance: FloatArray
    basic: FloatArray
    basic_covariance: FloatArray
    chi2: FloatArray
    dof: NDArray[np.int64]
    rms: FloatArray
    condition: FloatArray
    notes: tuple[str, ...]
    residual: FloatArray
    sigma: FloatArray
    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    polarization_of: NDArray[np.str_]
    aperture: ApertureModel
    polarization: PolarizationChoice
    intervals: IntervalMethod
    weights: str
    instrument: Aperture
    sample_name: str = ""

    @property
    def incidences_deg(self) -> tuple[float, ...]:
        """The incidences of the scan, ascending; read-backs closer than 0.05 degree are one."""
        theta = np.sort(self.theta_i_deg)
        first = np.concatenate([[True], np.diff(theta) > 0.05])
        return tuple(float(np.mean(part)) for part in np.split(theta, np.flatnonzero(first)[1:]))

    @property
    def correlation(self) -> FloatArray:
        """Correlation matrix of the parameters, (m, 4, 4); NaN where one is not determined."""
        sd = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.covariance / (sd[:, :, None] * sd[:, None, :]))

    def predict(
        self, theta_i_deg: ArrayLike, theta_o_deg: ArrayLike, polarization: ArrayLike | str
    ) -> FloatArray:
        """Return the reading r in the fit's aperture.

        Parameters
        ----------
        theta_i_deg, theta_o_deg, polarization
            Scalars or (k,), broadcast; polarization ``"s"``, ``"p"`` or ``"unpolarized"`` (mean of both).

        Returns
        -------
        ndarray
            (k, m), power in the aperture over incident power; NaN at wavelengths without a result.
        """
        theta_i, theta_o, which = np.broadcast_arrays(
            np.atleast_1d(np.asarray(theta_i_deg, np.float64)),
            np.atleast_1d(np.asarray(theta_o_deg, np.float64)),
            np.atleast_1d(np.asarray(polarization, np.str_)),
        )
        known = np.isin(which, ["s", "p", "unpolarized"])
        if not np.all(known):
            raise fresnel.unknown_polarization(str(which[~known][0]))
        receiver = self.instrument.variant(self.aperture)
        is_s = which != "p"
        basic = np.where(np.isfinite(self.basic), self.basic, [np.nan, np.nan, 1.0, 1.5])
        r = Problem.of(receiver, theta_i, theta_o, is_s).model(basic)
        mixed = which == "unpolarized"
        if np.any(mixed):
            other = Problem.of(receiver, theta_i[mixed], theta_o[mixed], np.zeros(int(np.sum(mixed)), bool))
            r[mixed] = 0.5 * (r[mixed] + other.model(basic))
        return r

    def hemispherical(self, theta_i_deg: float = 8.0) -> Hemispherical:
        """Return k_d, k_s, k_g at an incidence, degrees, by the delta method with the full covariance."""
        rho_d, k_n, log_alpha, n2 = self.basic.T
        safe_n2, safe_a = np.where(np.isfinite(n2), n2, 1.5), np.where(np.isfinite(log_alpha), log_alpha, 0.0)
        q = fresnel.reflectance_ratio(safe_n2, theta_i_deg, "unpolarized")
        dq = fresnel.reflectance_ratio_dn2(safe_n2, theta_i_deg, "unpolarized")
        kept = lobe_above_horizon(np.exp(safe_a), theta_i_deg)
        dkept = lobe_above_horizon_dlog_alpha(np.exp(safe_a), theta_i_deg)
        no_lobe = k_n == 0.0  # then k_g is k_d, and how much k_s may be is unknown
        unknown = np.where(no_lobe | np.isfinite(n2), 0.0, np.nan)  # one incidence: k_s elsewhere is unknown

        def coefficient(diffuse: float, fraction: FloatArray, slope: FloatArray, lobe: float) -> Coefficient:
            value, gradient = diffuse * rho_d, np.zeros_like(self.basic)
            gradient[:, 0] = diffuse
            if lobe:
                value = value + k_n * q * fraction + unknown
                shape = (
                    np.stack([q * fraction, k_n * q * slope, k_n * dq * fraction], axis=1) + unknown[:, None]
                )
                gradient[:, 1:] = np.where(no_lobe[:, None], 0.0 if diffuse else np.nan, shape)
            # what a coefficient does not depend on may be unknown
            covariance = np.where(
                gradient[:, :, None] * gradient[:, None, :] == 0.0, 0.0, self.basic_covariance
            )
            variance = np.einsum("ma,mab,mb->m", gradient, covariance, gradient)
            se = np.sqrt(np.where(variance >= 0.0, variance, np.nan))
            half = self.quantile * se
            return Coefficient(value, se, value - half, value + half)

        one, zero = np.ones_like(kept), np.zeros_like(kept)
        return Hemispherical(
            theta_i_deg,
            coefficient(1.0, kept, dkept, 0.0),
            coefficient(0.0, kept, dkept, 1.0),
            coefficient(1.0, kept, dkept, 1.0),
            coefficient(0.0, one, zero, 1.0),
            coefficient(1.0, one, zero, 1.0),
        )

    @property
    def home(self) -> NDArray[np.bool_]:
        """Mask (m,) that keeps each wavelength once where two detectors measured it; see `gonio.overlap`."""
        return home(self.wavelength_nm, self.detector_index)

    def only(self, columns: NDArray[np.bool_]) -> FitResult:
        """Return the result at some of the wavelengths, given as a mask (m,)."""
        along = {name: getattr(self, name)[columns] for name in _PER_WAVELENGTH}
        across = {name: getattr(self, name)[:, columns] for name in ("residual", "sigma")}
        notes = tuple(note for note, keep in zip(self.notes, columns.tolist(), strict=True) if keep)
        return replace(self, **along, **across, notes=notes)

    @property
    def quantile(self) -> FloatArray:
        """Student's t for the two-sided 95 % interval, (m,)."""
        dof = np.where(self.dof > 0, self.dof, np.nan)
        return np.asarray(special.stdtrit(dof, 0.5 + 0.5 * CONFIDENCE))

    def table(
        self,
        bands: Sequence[tuple[float, float]] | None = None,
        *,
        truth: Mapping[str, FloatArray] | None = None,
        sphere: Mapping[str, FloatArray] | None = None,
        detector_names: Sequence[str] = (),
    ) -> str:
        """Return a printable table by wavelength band; see `gonio.fitting.table.band_table`."""
        from gonio.fitting.table import band_table

        return band_table(self, bands, truth=truth, sphere=sphere, detector_names=detector_names)

    def save(self, path: Path | str, name: str | None = None) -> str:
        """Store in a scan file as ``/entry/fit_NAME``, replacing one of that name; return NAME.

        `name` is ``{aperture}_{polarization}`` unless given.  `StoreError` if the file cannot be written.
        """
        from gonio.fitting.file import save_fit

        return save_fit(self, path, name)

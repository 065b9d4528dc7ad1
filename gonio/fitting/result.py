"""What a fit found: parameters, intervals, predictions, hemispherical coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from gonio import fresnel
from gonio.aperture import Aperture, ApertureName, IncidentBeam, InstrumentFunction, Receiver
from gonio.fitting.columns import FitModel, readings
from gonio.fitting.kinds import coefficient_slopes, coefficients, model_named
from gonio.fitting.limits import is_lobe
from gonio.fitting.robust import Loss
from gonio.overlap import home
from gonio.spectral import Weight

if TYPE_CHECKING:
    from gonio.fitting.bands import BandAverage
    from gonio.sphere import Sphere, SphereComparison

FloatArray = NDArray[np.float64]
ApertureModel = ApertureName
PolarizationChoice = Literal["joint", "s", "p", "shared_n2"]
IntervalMethod = Literal["wald", "profile", "nlparci"]

CONFIDENCE = 0.95
_PER_WAVELENGTH = (
    "wavelength_nm", "detector_index", "value", "se", "lower", "upper", "covariance", "basic",
    "basic_covariance", "chi2", "dof", "rms", "condition",
)  # fmt: skip


def receiver_of(instrument: Aperture, beam: IncidentBeam | None, aperture: ApertureName) -> Receiver:
    """Return what turns a dsf into readings; only the exact aperture knows of a beam with an extent."""
    if beam is None or beam.is_line or aperture != "exact":
        return instrument.variant(aperture)
    return InstrumentFunction(instrument, beam)


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
    """p parameters of a model at m wavelengths, from n positions.

    Attributes
    ----------
    wavelength_nm, detector_index
        (m,)
    parameters
        Names of the columns of `value`.
    value, se, lower, upper
        (m, p); NaN where the data do not determine a parameter (see `notes`), infinite or 0 where they bound
        it on one side only.
    covariance
        (m, p, p) of `value`: random part and common-mode part.
    basic, basic_covariance
        (m, p), (m, p, p), the same result in the fit's own parameters, such as (rho_d, k_n, log_alpha, n2)
        with ``k_n = rho_s R(0)``; these stay finite where `rho_s` does not.
    modes, mode_names
        (g, m, p): the part of `basic_covariance` that wavelengths share, as shifts of `basic` by one standard
        uncertainty of each of g independent causes.
    shared_names, shared_value, shared_covariance
        (g,), (g, g): coefficients of a common n2, gains (minus 1) and offsets of detectors.
    chi2, dof
        (m,), weighted sum of squared residuals and degrees of freedom; ``chi2 / dof`` has scaled
        `covariance`.
    rms
        (m,), root mean square residual, in r.
    condition
        (m,), condition number of the correlation matrix of `value`.
    notes
        m texts, empty where there is nothing to say.
    remarks
        Sentences on the fit as a whole.
    residual
        (n, m), data minus fit, in r; NaN where a reading was not used.
    sigma
        (n, m), standard deviation of a reading that the weights stand for, before scaling by chi2.
    theta_i_deg, theta_o_deg, polarization_of
        (n,), the positions that were fitted.
    instrument, beam
        The aperture, and the beam that was taken into account; None for a line of light.
    n2
        ``"free"``, ``"given"``, or the dispersion that all wavelengths share.
    """

    wavelength_nm: FloatArray
    detector_index: NDArray[np.uint8]
    parameters: tuple[str, ...]
    value: FloatArray
    se: FloatArray
    lower: FloatArray
    upper: FloatArray
    covariance: FloatArray
    basic: FloatArray
    basic_covariance: FloatArray
    modes: FloatArray
    mode_names: tuple[str, ...]
    shared_names: tuple[str, ...]
    shared_value: FloatArray
    shared_covariance: FloatArray
    chi2: FloatArray
    dof: NDArray[np.int64]
    rms: FloatArray
    condition: FloatArray
    notes: tuple[str, ...]
    remarks: tuple[str, ...]
    residual: FloatArray
    sigma: FloatArray
    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    polarization_of: NDArray[np.str_]
    model: str
    aperture: ApertureModel
    polarization: PolarizationChoice
    intervals: IntervalMethod
    weights: str
    loss: Loss
    n2: str
    instrument: Aperture
    beam: IncidentBeam | None = None
    sample_name: str = ""

    @property
    def kind(self) -> type[FitModel]:
        """The fitted model's class."""
        return model_named(self.model, self.polarization)

    def of(self, parameter: str) -> NDArray[np.intp]:
        """Return the columns of `value` of a parameter: one, or those of S and P if each has its own."""
        return np.array(
            [k for k, name in enumerate(self.parameters) if name.partition("[")[0] == parameter], np.intp
        )

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
        s, p = which != "p", which != "s"
        found = np.zeros((which.size, len(self.basic)))
        # both at once: tabulating the lobe costs more per call than per position
        is_s = np.concatenate([np.ones(int(np.sum(s)), bool), np.zeros(int(np.sum(p)), bool)])
        at = np.concatenate([np.flatnonzero(s), np.flatnonzero(p)])
        receiver = receiver_of(self.instrument, self.beam, self.aperture)
        basic, known = self._whole_basic()
        if self.polarization == "shared_n2":  # its model needs both polarizations
            at, is_s = np.concatenate([at, at[:1], at[:1]]), np.concatenate([is_s, [True, False]])
        r = readings(self.kind.of(receiver, theta_i[at], theta_o[at], is_s), basic)
        count = int(np.sum(s) + np.sum(p))
        np.add.at(found, at[:count], r[:count])
        found[s & p] *= 0.5
        found[:, ~known] = np.nan
        return found

    def _whole_basic(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return `basic` with stand-ins where there is no lobe or no index, and where there is a result."""
        kind = self.kind
        linear = len(kind.linear)
        basic = self.basic.copy()
        known = np.all(np.isfinite(basic[:, :linear]), axis=1)
        middle = [1.5 if name == "n2" else 0.0 for name in kind.shape]
        basic[:, linear:] = np.where(np.isfinite(basic[:, linear:]), basic[:, linear:], middle)
        basic[~known, :linear] = 0.0
        return basic, known

    def hemispherical(self, theta_i_deg: float = 8.0) -> Hemispherical:
        """Return k_d, k_s, k_g at an incidence, degrees, by the delta method with the full covariance."""
        kind = self.kind
        basic, known = self._whole_basic()
        value = coefficients(kind, basic, theta_i_deg)
        slope = coefficient_slopes(kind, basic, theta_i_deg)
        linear = len(kind.linear)
        lobes = [k for k, name in enumerate(kind.linear) if is_lobe(name)]
        no_lobe = known & bool(lobes) & np.all(basic[:, lobes] == 0.0, axis=1)
        untold = known & ~no_lobe & np.any(~np.isfinite(self.basic[:, linear:]), axis=1)
        value[:, ~known] = np.nan
        value[1:, untold] = np.nan  # one incidence: k_s elsewhere is unknown

        def coefficient(*parts: int) -> Coefficient:
            total, gradient = np.sum(value[list(parts)], axis=0), np.sum(slope[list(parts)], axis=0)
            if 0 in parts:  # then k_g is k_d ...
                keep = [not is_lobe(name) for name in kind.linear] + [True] * len(kind.shape)
                gradient = np.where(no_lobe[:, None] & ~np.array(keep), 0.0, gradient)
            se = self._delta(gradient)
            if 0 not in parts:  # ... and how much k_s may be is unknown
                se = np.where(no_lobe, np.nan, se)
            if parts != (0,):
                se = np.where(untold, np.nan, se)
            half = self.quantile * se
            return Coefficient(total, se, total - half, total + half)

        return Hemispherical(
            theta_i_deg, coefficient(0), coefficient(1), coefficient(0, 1), coefficient(2), coefficient(0, 2)
        )

    def band_average(
        self, low_nm: float, high_nm: float, *, weight: Weight = "am15g", theta_i_deg: float = 8.0
    ) -> BandAverage:
        """Return k_d, k_s and k_g averaged over a band; see `gonio.fitting.bands.band_average`.

        `weight` is ``"am15g"`` (solar), ``"photopic"``, ``"flat"``, or a function of the wavelength in nm.
        """
        from gonio.fitting.bands import band_average

        return band_average(self, low_nm, high_nm, weight=weight, theta_i_deg=theta_i_deg)

    def _delta(self, gradient: FloatArray) -> FloatArray:
        """Return the standard uncertainty of a function of `basic` with that gradient, (m, p)."""
        # what a function does not depend on may be unknown
        covariance = np.where(gradient[:, :, None] * gradient[:, None, :] == 0.0, 0.0, self.basic_covariance)
        variance = np.einsum("ma,mab,mb->m", gradient, covariance, gradient)
        return np.sqrt(np.where(variance >= 0.0, variance, np.nan))

    @property
    def home(self) -> NDArray[np.bool_]:
        """Mask (m,) that keeps each wavelength once where two detectors measured it; see `gonio.overlap`."""
        return home(self.wavelength_nm, self.detector_index)

    def only(self, columns: NDArray[np.bool_]) -> FitResult:
        """Return the result at some of the wavelengths, given as a mask (m,)."""
        along = {name: getattr(self, name)[columns] for name in _PER_WAVELENGTH}
        across = {name: getattr(self, name)[:, columns] for name in ("residual", "sigma", "modes")}
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

    def compare(self, sphere: Sphere, *, detector_names: Sequence[str] = ()) -> SphereComparison:
        """Return the coefficients beside an integrating sphere; see `gonio.sphere.compare`."""
        from gonio.sphere import compare

        return compare(self, sphere, detector_names=detector_names)

    def save(self, path: Path | str, name: str | None = None) -> str:
        """Store in a scan file as ``/entry/fit_NAME``, replacing one of that name; return NAME.

        `name` is ``{aperture}_{polarization}`` unless given, followed by the model, n2 and loss where they
        are not those of a plain fit.  `StoreError` if the file cannot be written.
        """
        from gonio.fitting.file import save_fit

        return save_fit(self, path, name)

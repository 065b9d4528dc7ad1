"""From an optimum to a `FitResult`: covariance, intervals, and notes on what the data do not say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from gonio.aperture import Aperture, ApertureName, IncidentBeam
from gonio.fitting.ambiguous import other_index
from gonio.fitting.columns import BoolArray, FitModel, FloatArray, readings
from gonio.fitting.covariance import CommonMode, random_and_common, without_common
from gonio.fitting.dispersion import Dispersion
from gonio.fitting.ends import Ends, open_ends
from gonio.fitting.limits import diffuse_only, is_lobe, lobe_is_seen
from gonio.fitting.notes import write_notes, write_remarks
from gonio.fitting.result import CONFIDENCE, FitResult, IntervalMethod, PolarizationChoice
from gonio.fitting.robust import Loss, robust_scale, variance_factor
from gonio.fitting.selection import combined_runs_probability, runs_probability
from gonio.fitting.separate import SeparateSurfaces
from gonio.fitting.shared import Detectors, Shared, fit_shared
from gonio.fitting.solve import Solution
from gonio.fitting.weighing import Used, Weighed

_AS_WIDE = 5.0  # times Lambert's standard error of rho_d: beyond, a lobe and the diffuse part look alike


@dataclass(frozen=True, slots=True)
class Setting:
    """What was asked for and of which positions, (n,) and wavelengths, (m,): passed through to the result."""

    wavelength_nm: FloatArray
    detector_index: NDArray[np.uint8]
    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    polarization_of: NDArray[np.str_]
    position: NDArray[np.intp]  # numbers of the positions in the scan
    model: str
    aperture: ApertureName
    polarization: PolarizationChoice
    intervals: IntervalMethod
    weights: str
    loss: Loss
    n2: str
    instrument: Aperture
    beam: IncidentBeam | None
    sample_name: str


@dataclass(slots=True)
class Findings:
    """Everything known of k fitted wavelengths, before it is spread over all m."""

    names: tuple[str, ...]
    value: FloatArray  # (k, p)
    se: FloatArray
    lower: FloatArray
    upper: FloatArray
    covariance: FloatArray  # (k, p, p)
    basic: FloatArray
    basic_covariance: FloatArray
    modes: FloatArray  # (g, k, p)
    chi2: FloatArray  # (k,)
    dof: FloatArray
    residual: FloatArray  # (n, k), NaN where unused
    sigma: FloatArray
    scale: FloatArray  # (k,) variance of the residuals in units of sigma squared
    converged: BoolArray
    lobe: BoolArray  # a lobe is seen
    untold: BoolArray  # one incidence and polarization only
    runs: FloatArray  # (k,) probability by chance that the residuals change their sign so seldom
    runs_together: float  # that of all wavelengths
    other_n2: FloatArray  # (k,) an index outside the interval that fits as well, or NaN


def assemble(
    model: FitModel,
    kind: type[FitModel],
    weighed: Weighed,
    used: Used,
    *,
    free: BoolArray,
    untold: BoolArray,
    common: CommonMode | None,
    dispersion: Dispersion | None,
    detectors: Detectors | None,
    setting: Setting,
) -> FitResult:
    """Return the result over all m wavelengths; those that could not be fitted are NaN and have a note.

    Parameters
    ----------
    free
        Shape parameters that a wavelength was free to choose, (k, shape).
    untold
        Where the data tell only the product of rho_s and R, (k,).
    """
    found, shared = _findings(
        model, kind, weighed, used, free, untold, common, dispersion, detectors, setting
    )
    notes = write_notes(found, setting.position, np.where(used.use, used.y, np.nan))
    m = len(setting.wavelength_nm)

    def spread(values: FloatArray, fill: float = np.nan, axis: int = 0) -> FloatArray:
        shape = list(values.shape)
        shape[axis] = m
        whole = np.full(shape, fill, dtype=values.dtype)
        whole[(slice(None),) * axis + (used.columns,)] = values
        return whole

    every = [f"only {c} usable readings, too few to fit" for c in used.count]
    for at, note in zip(used.columns, notes, strict=True):
        every[at] = note
    rms = np.sqrt(np.nanmean(found.residual**2, axis=0))
    return FitResult(
        wavelength_nm=setting.wavelength_nm,
        detector_index=setting.detector_index,
        parameters=kind.parameters,
        value=spread(found.value),
        se=spread(found.se),
        lower=spread(found.lower),
        upper=spread(found.upper),
        covariance=spread(found.covariance),
        basic=spread(found.basic),
        basic_covariance=spread(found.basic_covariance),
        modes=spread(found.modes, axis=1),
        mode_names=() if shared is None else shared.mode_names,
        remarks=(*(() if shared is None else shared.remarks), *write_remarks(found)),
        shared_names=() if shared is None else shared.names,
        shared_value=np.zeros(0) if shared is None else shared.value,
        shared_covariance=np.zeros((0, 0)) if shared is None else shared.covariance,
        chi2=spread(found.chi2),
        dof=spread(found.dof, 0.0).astype(np.int64),
        rms=spread(rms),
        condition=spread(_condition(found.covariance)),
        notes=tuple(every),
        residual=spread(found.residual, axis=1),
        sigma=spread(found.sigma, axis=1),
        theta_i_deg=setting.theta_i_deg,
        theta_o_deg=setting.theta_o_deg,
        polarization_of=setting.polarization_of,
        model=setting.model,
        aperture=setting.aperture,
        polarization=setting.polarization,
        intervals=setting.intervals,
        weights=setting.weights,
        loss=setting.loss,
        n2=setting.n2,
        instrument=setting.instrument,
        beam=setting.beam,
        sample_name=setting.sample_name,
    )


def _findings(
    model: FitModel,
    kind: type[FitModel],
    weighed: Weighed,
    used: Used,
    free: BoolArray,
    untold: BoolArray,
    common: CommonMode | None,
    dispersion: Dispersion | None,
    detectors: Detectors | None,
    setting: Setting,
) -> tuple[Findings, Shared | None]:
    solution, w = weighed.solution, weighed.w * weighed.factor
    basic, y = solution.basic.copy(), used.y
    linear, p = len(kind.linear), basic.shape[1]
    count = used.count[used.columns]
    dof = (count - linear - np.sum(free, axis=1)).astype(np.float64)
    variance = solution.chi2 / dof
    if setting.loss != "squares":  # whose chi2 may be that of outliers
        variance = robust_scale(np.sqrt(weighed.w) * (y - readings(model, basic)), used.use, p) ** 2
    lobe, basic, dof = _without_lobe(model, y, w, basic, solution.chi2, variance, dof, count)
    held = np.zeros(basic.shape, bool)
    held[:, linear:] = ~free
    held[~lobe] |= [not name.startswith("rho_d") for name in (*kind.linear, *kind.shape)]

    shared = None
    if dispersion is not None or detectors is not None:
        random, _ = random_and_common(model, basic, w, held, None)
        n2 = p - 1 if "n2" in kind.shape else 0
        shared = fit_shared(
            model, y, w, Solution(basic, solution.chi2, solution.converged & lobe),
            free=free,
            lobe=lobe,
            n2_se=np.sqrt(np.maximum(random[:, n2, n2], 0.0)),
            dof=dof,
            wavelength_nm=setting.wavelength_nm[used.columns],
            detector_index=setting.detector_index[used.columns],
            dispersion=dispersion,
            detectors=Detectors(np.zeros(1), np.zeros(1)) if detectors is None else detectors,
        )  # fmt: skip
        solution, basic = shared.solution, shared.solution.basic.copy()
        y, w = (y - shared.offset) / shared.gain, w * shared.gain**2
        if dispersion is not None:
            held[:, p - 1] = True
            dof = dof + (lobe & free[:, -1])
    residual = np.where(used.use, y - readings(model, basic), 0.0)
    chi2 = np.sum(w * residual**2, axis=0)
    scale, w_cov, scatter = chi2 / dof, w, residual
    if common is not None:  # without what positions share
        scatter, taken = without_common(model, basic, w, residual, common)
    if setting.loss != "squares":
        u = np.sqrt(weighed.w) * residual
        s = robust_scale(u, used.use, p)
        u = u / np.where(s > 0.0, s, 1.0)
        scale, w_cov = s**2 * variance_factor(u, used.use, setting.loss, p), weighed.w
    elif common is not None:
        scale = np.sum(w * scatter**2, axis=0) / (dof - taken)
    t = np.asarray(special.stdtrit(dof, 0.5 + 0.5 * CONFIDENCE), np.float64)

    unit, from_common = random_and_common(model, basic, w_cov, held, common)
    ends = Ends.none(basic.shape[0], len(kind.shape))
    if setting.intervals == "wald":
        may = free & lobe[:, None]
        if dispersion is not None:
            may[:, -1] = False
        at_optimum = Solution(basic, chi2, solution.converged)
        ends = Ends.of(model, y, w, at_optimum, may, scale, t, unit)
        # a lobe inside one aperture: alpha is unbounded above, and the rest does not depend on it
        endless = np.isposinf(ends.upper) & may & np.array([n != "n2" for n in kind.shape], bool)
        if np.any(endless):
            held[:, linear:] |= endless
            unit, from_common = random_and_common(model, basic, w_cov, held, common)
    covariance, modes = scale[:, None, None] * unit + from_common, np.zeros((0, *basic.shape))
    if not np.all(lobe):
        _allow_for_unseen(model, weighed.solution.basic, w, basic, variance, t, lobe, covariance)
    given = held.copy()  # without uncertainty of their own, but known
    given[:, :linear] = False
    given &= lobe[:, None] & ~np.isposinf(np.pad(ends.upper, ((0, 0), (linear, 0))))
    given[untold] = False
    covariance = np.where(given[:, :, None] | given[:, None, :], 0.0, covariance)
    if shared is not None:
        modes = shared.modes * np.where(np.isnan(np.diagonal(covariance, axis1=1, axis2=2)), 0.0, 1.0)
        covariance = covariance + np.einsum("gka,gkb->kab", modes, modes)
    basic_nan = basic.copy()
    basic_nan[~lobe] = np.where([n.startswith("rho_d") or is_lobe(n) for n in (*kind.linear, *kind.shape)],
                                basic[~lobe], np.nan)  # fmt: skip
    if np.any(untold):
        basic_nan[untold, p - 1] = np.nan
    value = _published(kind, basic, lobe, untold)
    safe = np.where(np.isfinite(basic), basic, 1.0)
    published = _transformed(kind.published_jacobian(safe), covariance)
    se = np.sqrt(np.diagonal(published, axis1=1, axis2=2))
    half = t[:, None] * se
    lower, upper = value - half, value + half
    if setting.intervals == "wald":
        open_ends(kind, basic, covariance, ends, t, value, se, lower, upper, published)
    is_s = setting.polarization_of == "s"
    other_n2 = np.full(len(basic), np.nan)
    if "n2" in kind.shape and setting.intervals == "wald" and not issubclass(kind, SeparateSurfaces):
        only_p = lobe & free[:, kind.shape.index("n2")] & ~np.any(used.use & is_s[:, None], axis=0)
        n2_column = kind.parameters.index("n2")
        other_n2 = other_index(
            model, y, w, Solution(basic, chi2, solution.converged),
            lower[:, n2_column], upper[:, n2_column], scale, only_p & (dispersion is None),
        )  # fmt: skip
    where = setting.theta_i_deg, setting.theta_o_deg, is_s
    part = Findings(
        kind.parameters, value, se, lower, upper, published, basic_nan, covariance, modes, chi2, dof,
        np.where(used.use, residual, np.nan),
        np.where(used.use, 1.0 / np.sqrt(np.where(used.use, w_cov, 1.0)), np.nan),
        scale, solution.converged, lobe, untold,
        runs_probability(scatter, *where), combined_runs_probability(scatter, *where), other_n2,
    )  # fmt: skip
    return part, shared


def _without_lobe(
    model: FitModel,
    y: FloatArray,
    w: FloatArray,
    basic: FloatArray,
    chi2: FloatArray,
    variance: FloatArray,
    dof: FloatArray,
    count: NDArray[np.int64],
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Return where a lobe is seen, and the parameters and degrees of freedom with a plain fit elsewhere."""
    lobes = [name for name in model.linear if is_lobe(name)]
    if not lobes:
        return np.ones(len(basic), bool), basic, dof
    plain = diffuse_only(model, y, w, basic)
    diffuse_count = len(model.linear) - len(lobes)
    plain_chi2 = np.sum(w * (y - readings(model, plain)) ** 2, axis=0)
    lobe = lobe_is_seen(y, w, plain_chi2, chi2, variance, dof, basic.shape[1] - diffuse_count)
    return (
        lobe,
        np.where(lobe[:, None], basic, plain),
        np.where(lobe, dof, (count - diffuse_count).astype(np.float64)),
    )


def _allow_for_unseen(
    model: FitModel,
    full: FloatArray,
    w: FloatArray,
    plain: FloatArray,
    variance: FloatArray,
    quantile: FloatArray,
    lobe: BoolArray,
    covariance: FloatArray,
) -> None:
    """Widen the variance of rho_d where no lobe is seen: one may be there, only not above the noise.

    The interval then holds that of the optimum with a lobe too, at that lobe's shape.  Lambert's alone would
    cover a weak lobe's rho_d in a quarter of the scans.
    """
    rows = np.flatnonzero(~lobe)
    held = np.zeros(full.shape, bool)
    held[:, len(model.linear) :] = True
    unit, _ = random_and_common(model, full[rows], w[:, rows], held[rows], None)
    for column, name in enumerate(model.linear):
        if is_lobe(name):
            continue
        own = np.sqrt(covariance[rows, column, column])
        other = np.sqrt(variance[rows] * unit[:, column, column])
        reach = np.abs(full[rows, column] - plain[rows, column]) / quantile[rows] + other
        # a lobe as wide as the diffuse part itself says nothing about it
        told = np.isfinite(reach) & (other < _AS_WIDE * own)
        covariance[rows, column, column] = np.where(told, np.maximum(own, reach), own) ** 2


def _published(kind: type[FitModel], basic: FloatArray, lobe: BoolArray, untold: BoolArray) -> FloatArray:
    """Return the known parameters, NaN where they are undefined or untold."""
    basic = basic.copy()
    if np.any(untold):
        basic[untold, -1] = np.nan
    value = kind.published(basic)
    for column, name in enumerate(kind.parameters):
        if not name.startswith("rho_d"):
            value[~lobe, column] = 0.0 if is_lobe(name) else np.nan
    return value


def _transformed(transform: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return ``T C T'`` (k, p, p) in which an unknown covariance does not spread through the zeros of T."""
    unknown = np.isnan(np.diagonal(covariance, axis1=1, axis2=2))
    known = np.where(np.isnan(covariance), 0.0, covariance)
    result = np.einsum("kab,kbc,kdc->kad", transform, known, transform)
    lost = np.einsum("kab,kb->ka", (transform != 0.0).astype(np.float64), unknown.astype(np.float64)) > 0.0
    return np.where(lost[:, :, None] | lost[:, None, :], np.nan, result)


def _condition(covariance: FloatArray) -> FloatArray:
    """Return the condition number of the correlation matrix of the determined parameters, (k,)."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    known = np.isfinite(variance) & (variance > 0.0)
    sd = np.sqrt(np.where(known, variance, 1.0))
    both = known[:, :, None] & known[:, None, :]
    correlation = np.where(both, covariance / (sd[:, :, None] * sd[:, None, :]), np.eye(covariance.shape[1]))
    return np.asarray(np.linalg.cond(np.where(np.isfinite(correlation), correlation, 0.0)))

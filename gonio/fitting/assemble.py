"""From an optimum to a `FitResult`: covariance, intervals, and notes on what the data do not say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from gonio.aperture import Aperture, ApertureName
from gonio.fitting.covariance import CommonMode, random_and_common, without_common
from gonio.fitting.limits import lobe_is_seen, profile_limits
from gonio.fitting.notes import write_notes
from gonio.fitting.problem import N2_MIN, Problem, published_from_basic, published_jacobian
from gonio.fitting.result import CONFIDENCE, PARAMETERS, FitResult, IntervalMethod, PolarizationChoice
from gonio.fitting.solve import Solution

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(slots=True)
class Findings:
    """Everything known of k fitted wavelengths, before it is spread over all m."""

    value: FloatArray  # (k, 4)
    se: FloatArray
    lower: FloatArray
    upper: FloatArray
    covariance: FloatArray  # (k, 4, 4)
    basic: FloatArray
    basic_covariance: FloatArray
    chi2: FloatArray  # (k,)
    dof: FloatArray
    residual: FloatArray  # (n, k), NaN where unused
    sigma: FloatArray
    converged: BoolArray
    lobe: BoolArray  # a lobe is seen
    single: BoolArray  # one incidence and polarization only


def assemble(
    problem: Problem,
    solution: Solution,
    *,
    y: FloatArray,
    w: FloatArray,
    single: BoolArray,
    columns: NDArray[np.intp],
    count: NDArray[np.int64],
    common: CommonMode | None,
    wavelength_nm: FloatArray,
    detector_index: NDArray[np.uint8],
    theta_o_deg: FloatArray,
    position: NDArray[np.intp],
    aperture: ApertureName,
    polarization: PolarizationChoice,
    intervals: IntervalMethod,
    weights: str,
    instrument: Aperture,
    sample_name: str,
) -> FitResult:
    """Return the result over all m wavelengths; those outside `columns` are NaN and have a note."""
    found = _findings(problem, solution, y, w, single, count[columns], common, intervals)
    notes = write_notes(found, position)
    m = len(wavelength_nm)

    def spread(values: FloatArray, fill: float = np.nan, axis: int = 0) -> FloatArray:
        shape = list(values.shape)
        shape[axis] = m
        whole = np.full(shape, fill, dtype=values.dtype)
        whole[(slice(None),) * axis + (columns,)] = values
        return whole

    every = [f"only {c} usable readings, too few to fit" for c in count]
    for at, note in zip(columns, notes, strict=True):
        every[at] = note
    rms = np.sqrt(np.nanmean(found.residual**2, axis=0))
    return FitResult(
        wavelength_nm=wavelength_nm,
        detector_index=detector_index,
        parameters=PARAMETERS,
        value=spread(found.value),
        se=spread(found.se),
        lower=spread(found.lower),
        upper=spread(found.upper),
        covariance=spread(found.covariance),
        basic=spread(found.basic),
        basic_covariance=spread(found.basic_covariance),
        chi2=spread(found.chi2),
        dof=spread(found.dof, 0.0).astype(np.int64),
        rms=spread(rms),
        condition=spread(_condition(found.covariance)),
        notes=tuple(every),
        residual=spread(found.residual, axis=1),
        sigma=spread(found.sigma, axis=1),
        theta_i_deg=problem.theta_i_deg,
        theta_o_deg=theta_o_deg,
        polarization_of=np.where(problem.is_s, "s", "p"),
        aperture=aperture,
        polarization=polarization,
        intervals=intervals,
        weights=weights,
        instrument=instrument,
        sample_name=sample_name,
    )


def _findings(
    problem: Problem,
    solution: Solution,
    y: FloatArray,
    w: FloatArray,
    single: BoolArray,
    count: NDArray[np.int64],
    common: CommonMode | None,
    intervals: IntervalMethod,
) -> Findings:
    basic, chi2 = solution.basic.copy(), solution.chi2.copy()
    used = w > 0.0
    dof = (count - np.where(single, 3, 4)).astype(np.float64)
    lobe = lobe_is_seen(y, w, problem.diffuse, chi2, dof)
    without = np.flatnonzero(~lobe)
    if without.size:  # a Lambertian fit, with a lobe of no strength and no shape
        d, wx = problem.diffuse[:, None], w[:, without]
        basic[without, 0] = np.sum(wx * d * y[:, without], axis=0) / np.sum(wx * d * d, axis=0)
        basic[without, 1] = 0.0
        dof[without] = count[without] - 1
    residual = y - problem.model(basic)
    chi2 = np.sum(w * residual**2, axis=0)
    scale = chi2 / dof
    if common is not None:  # the scatter alone, without what positions share
        clean, taken = without_common(problem, basic, w, residual, common)
        scale = np.sum(w * clean**2, axis=0) / (dof - taken)
    t = np.asarray(special.stdtrit(dof, 0.5 + 0.5 * CONFIDENCE), np.float64)
    held = np.zeros((len(basic), 4), bool)
    held[:, 3] = single
    held[~lobe, 1:] = True
    inverse, shared = random_and_common(problem, basic, w, held, common)
    covariance = scale[:, None, None] * inverse + shared
    if intervals == "wald":
        limits = _limits(
            problem, y, w, Solution(basic, chi2, solution.converged), lobe, single, scale, t, inverse
        )
        # a lobe inside one aperture: alpha is unbounded above, and the rest does not depend on it
        mirror = lobe & np.isposinf(limits[1][:, 0])
        if np.any(mirror):
            held[mirror, 2] = True
            inverse, shared = random_and_common(problem, basic, w, held, common)
            covariance = scale[:, None, None] * inverse + shared
    value = published_from_basic(np.where(single[:, None] & (np.arange(4) == 3), np.nan, basic))
    transform = published_jacobian(basic)
    published = _transformed(transform, covariance)
    se = np.sqrt(np.diagonal(published, axis1=1, axis2=2))
    half = t[:, None] * se
    lower, upper = value - half, value + half
    if intervals == "wald":
        factor = np.exp(t * np.sqrt(covariance[:, 2, 2]))
        lower[:, 2], upper[:, 2] = value[:, 2] / factor, value[:, 2] * factor
        _open(se, lower, upper, published, basic, limits)
    value[~lobe, 2:] = np.nan
    value[~lobe, 1] = 0.0
    basic[~lobe, 2:] = np.nan
    basic[single, 3] = np.nan
    sigma = np.where(used, 1.0 / np.sqrt(np.where(used, w, 1.0)), np.nan)
    residual = np.where(used, residual, np.nan)
    return Findings(
        value, se, lower, upper, published, basic, covariance, chi2, dof, residual, sigma,
        solution.converged, lobe, single,
    )  # fmt: skip


def _transformed(transform: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return ``T C T'`` (k, 4, 4) in which an unknown covariance does not spread through the zeros of T."""
    unknown = np.isnan(np.diagonal(covariance, axis1=1, axis2=2))
    known = np.where(np.isnan(covariance), 0.0, covariance)
    result = np.einsum("kab,kbc,kdc->kad", transform, known, transform)
    lost = np.einsum("kab,kb->ka", (transform != 0.0).astype(np.float64), unknown.astype(np.float64)) > 0.0
    return np.where(lost[:, :, None] | lost[:, None, :], np.nan, result)


def _limits(
    problem: Problem,
    y: FloatArray,
    w: FloatArray,
    solution: Solution,
    lobe: BoolArray,
    single: BoolArray,
    scale: FloatArray,
    t: FloatArray,
    inverse: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return profile limits (lower, upper), (k, 2) each, of log_alpha and n2; NaN where Wald's stand."""
    lower, upper = np.full((len(t), 2), np.nan), np.full((len(t), 2), np.nan)
    for column in (0, 1):
        rows = np.flatnonzero(lobe & ~(single if column == 1 else np.zeros_like(single)))
        if not rows.size:
            continue
        part = Solution(solution.basic[rows], solution.chi2[rows], solution.converged[rows])
        se = np.sqrt(scale[rows] * inverse[rows, 2 + column, 2 + column])
        limits = profile_limits(
            problem, y[:, rows], w[:, rows], part,
            column=column, se=se, variance_scale=scale[rows], quantile=t[rows],
        )  # fmt: skip
        lower[rows, column], upper[rows, column] = limits.lower, limits.upper
    return lower, upper


def _open(
    se: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    covariance: FloatArray,
    basic: FloatArray,
    limits: tuple[FloatArray, FloatArray],
) -> None:
    """Put open-ended profile limits in place of Wald's; what has no bound has no se."""
    low, high = limits
    alpha = ~np.isnan(low[:, 0])
    lower[alpha, 2], upper[alpha, 2] = np.exp(low[alpha, 0]), np.exp(high[alpha, 0])
    n2 = ~np.isnan(low[:, 1])
    k_n = basic[n2, 1]
    lower[n2, 3] = np.where(np.isneginf(low[n2, 1]), 1.0, low[n2, 1])
    upper[n2, 3] = high[n2, 1]
    # rho_s = k_n / R(0) follows n2, the other way round
    ends = [
        k_n / (((n - 1.0) / (n + 1.0)) ** 2)
        for n in (np.minimum(high[n2, 1], 1e12), np.maximum(low[n2, 1], N2_MIN))
    ]
    lower[n2, 1] = np.where(k_n > 0.0, ends[0], np.where(np.isneginf(low[n2, 1]), -np.inf, ends[1]))
    upper[n2, 1] = np.where(k_n > 0.0, np.where(np.isneginf(low[n2, 1]), np.inf, ends[1]), ends[0])
    for column, rows in ((1, n2), (2, alpha), (3, n2)):
        se[rows, column] = np.nan
        covariance[rows, column, :] = covariance[rows, :, column] = np.nan


def _condition(covariance: FloatArray) -> FloatArray:
    """Return the condition number of the correlation matrix of the determined parameters, (k,)."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    known = np.isfinite(variance) & (variance > 0.0)
    sd = np.sqrt(np.where(known, variance, 1.0))
    both = known[:, :, None] & known[:, None, :]
    correlation = np.where(both, covariance / (sd[:, :, None] * sd[:, None, :]), np.eye(4))
    return np.asarray(np.linalg.cond(np.where(np.isfinite(correlation), correlation, 0.0)))

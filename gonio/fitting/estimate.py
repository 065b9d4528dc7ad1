"""From readings to a `FitResult`: select, solve, weigh, solve again, and say how far it can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.aperture import APERTURE_NAMES, Aperture, ApertureName
from gonio.errors import FitError
from gonio.fitting.assemble import assemble
from gonio.fitting.covariance import CommonMode, leverage, without_common
from gonio.fitting.noise import variance_function
from gonio.fitting.problem import Problem
from gonio.fitting.result import FitResult, IntervalMethod, PolarizationChoice
from gonio.fitting.solve import Solution, refine, start

if TYPE_CHECKING:
    from gonio.store import Scan

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
WeightMethod = Literal["auto", "r_sd", "none"]

FEWEST_READINGS = 8
"""Readings a wavelength must have: four parameters and as many degrees of freedom for the noise."""

_ROUNDS = 2  # of weights from residuals; more change neither the parameters nor the coverage


def fit(
    scan: Scan,
    *,
    aperture: ApertureName = "exact",
    polarization: PolarizationChoice = "joint",
    weights: WeightMethod = "auto",
    intervals: IntervalMethod = "wald",
) -> FitResult:
    """Fit the published four-parameter lobe to a scan, each wavelength for itself.

    Parameters
    ----------
    scan
        A measured scan, `gonio.load`.  Missing, saturated and refused readings are left out.
    aperture
        ``"exact"`` integrates the scan's aperture; ``"eq22"``, ``"point"`` and ``"published"`` are the
        paper's approximations, see `gonio.aperture.Aperture.variant`.
    polarization
        ``"joint"`` fits S and P with common parameters, ``"s"`` or ``"p"`` one of them alone.
    weights
        ``"auto"``: from a variance function of the residuals (`gonio.fitting.noise`), begun with `scan.r_sd`
        where it is given; ``"r_sd"``: 1/r_sd^2 as it is; ``"none"``: all alike.  The covariance is scaled by
        chi2 per degree of freedom in each case.
    intervals
        ``"wald"``: 95 % by Student's t, alpha on its logarithm, common-mode uncertainties included,
        open-ended where the data give no bound.  ``"nlparci"``: exactly MATLAB's nlparci, which knows none of
        this, on unweighted residuals.

    Raises
    ------
    FitError
        No reading of that polarization, no wavelength with enough readings, or an unknown option.
    """
    return fit_readings(
        scan.theta_i_deg,
        scan.theta_o_deg,
        scan.polarization,
        np.where(scan.usable, scan.r, np.nan),
        instrument=scan.aperture,
        wavelength_nm=scan.wavelength_nm,
        detector_index=scan.detector_index,
        r_sd=scan.r_sd,
        gain_u=scan.gain_u,
        offset_u=scan.offset_u,
        aperture=aperture,
        polarization=polarization,
        weights=weights,
        intervals=intervals,
        sample_name=scan.sample_name,
    )


def fit_readings(
    theta_i_deg: ArrayLike,
    theta_o_deg: ArrayLike,
    polarization_of: ArrayLike,
    r: ArrayLike,
    *,
    instrument: Aperture,
    wavelength_nm: ArrayLike | None = None,
    detector_index: ArrayLike | None = None,
    r_sd: ArrayLike | None = None,
    gain_u: ArrayLike | None = None,
    offset_u: ArrayLike | None = None,
    aperture: ApertureName = "exact",
    polarization: PolarizationChoice = "joint",
    weights: WeightMethod = "auto",
    intervals: IntervalMethod = "wald",
    sample_name: str = "",
) -> FitResult:
    """Fit plain arrays: (n,) angles in degrees, (n,) ``"s"``/``"p"``, (n, m) readings, NaN for none.

    `r_sd`, `gain_u`, `offset_u` broadcast to (n, m) and default to unknown; see `fit` and `gonio.store.Scan`.
    """
    if aperture not in APERTURE_NAMES:
        raise FitError(f"aperture = {aperture!r} is not known; use one of {', '.join(APERTURE_NAMES)}")
    if polarization not in ("joint", "s", "p"):
        raise FitError(f"polarization = {polarization!r} is not known; use 'joint', 's' or 'p'")
    if weights not in ("auto", "r_sd", "none"):
        raise FitError(f"weights = {weights!r} is not known; use 'auto', 'r_sd' or 'none'")
    if intervals not in ("wald", "nlparci"):
        raise FitError(f"intervals = {intervals!r} is not known; use 'wald' or 'nlparci'")
    readings = np.atleast_2d(np.asarray(r, np.float64))
    n, m = readings.shape
    which = np.asarray(polarization_of, np.str_)
    theta_i, theta_o = np.asarray(theta_i_deg, np.float64), np.asarray(theta_o_deg, np.float64)
    if not theta_i.shape == theta_o.shape == which.shape == (n,):
        raise FitError(
            f"the readings have {n} positions, but there are {theta_i.size} theta_i, {theta_o.size} "
            f"theta_o and {which.size} polarizations; give one of each per position"
        )
    chosen = np.isin(which, ["s", "p"]) if polarization == "joint" else which == polarization
    if not np.any(chosen):
        have = ", ".join(sorted(set(which.tolist()))) or "none"
        raise FitError(f"polarization '{polarization}' was not measured; the scan has: {have}")
    used = _Used.of(readings[chosen], _sized(r_sd, n, m)[chosen], weights, intervals)
    problem = Problem.of(instrument.variant(aperture), theta_i[chosen], theta_o[chosen], which[chosen] == "s")
    detector = np.zeros(m, np.uint8) if detector_index is None else np.asarray(detector_index, np.uint8)
    wavelength = np.full(m, np.nan) if wavelength_nm is None else np.asarray(wavelength_nm, np.float64)
    if wavelength.shape != (m,) or detector.shape != (m,):
        raise FitError(
            f"the readings have {m} wavelengths, but wavelength_nm or detector_index do not; give {m} each"
        )
    single = single_group(problem, used.use)
    common = None
    if intervals == "wald":
        gain, offset = (np.nan_to_num(_sized(u, n, m)[chosen][:, used.columns]) for u in (gain_u, offset_u))
        common = CommonMode(gain, offset) if np.any(gain) or np.any(offset) else None
    solution, w = _solve(problem, used, single, detector, common)
    return assemble(
        problem,
        solution,
        y=used.y,
        w=w,
        single=single,
        columns=used.columns,
        count=used.count,
        common=common,
        wavelength_nm=wavelength,
        detector_index=detector,
        theta_o_deg=theta_o[chosen],
        position=np.flatnonzero(chosen),
        aperture=aperture,
        polarization=polarization,
        intervals=intervals,
        weights=used.weights,
        instrument=instrument,
        sample_name=sample_name,
    )


def _sized(values: ArrayLike | None, n: int, m: int) -> FloatArray:
    return np.array(np.broadcast_to(np.nan if values is None else np.asarray(values, np.float64), (n, m)))


@dataclass(frozen=True, slots=True)
class _Used:
    """The wavelengths that can be fitted: indices into all m, and their readings, weights and masks."""

    columns: NDArray[np.intp]  # (k,)
    count: NDArray[np.int64]  # (m,) usable readings of every wavelength
    y: FloatArray  # (n, k), zero where unused
    use: BoolArray  # (n, k)
    first_weight: FloatArray  # (n, k)
    weights: WeightMethod

    @classmethod
    def of(
        cls, readings: FloatArray, r_sd: FloatArray, weights: WeightMethod, intervals: IntervalMethod
    ) -> _Used:
        if intervals == "nlparci" and weights != "none":
            weights = "none"  # nlparci's covariance is mse (J'J)^-1
        use = np.isfinite(readings)
        known = np.isfinite(r_sd) & (r_sd > 0.0)
        if weights == "r_sd":
            use &= known
        count = np.sum(use, axis=0)
        columns = np.flatnonzero(count >= FEWEST_READINGS)
        if not columns.size:
            what = "readings with a standard deviation r_sd" if weights == "r_sd" else "usable readings"
            raise FitError(
                f"no wavelength has {FEWEST_READINGS} {what} (the best has {int(count.max(initial=0))}), the "
                "fewest that determine four parameters and their noise; measure more positions"
            )
        use = use[:, columns]
        whole = np.all(
            known[:, columns] | ~use, axis=0
        )  # r_sd for some readings only would misweigh the others
        weigh = (weights != "none") & whole
        variance = np.where(weigh & use, r_sd[:, columns], 1.0) ** 2
        return cls(columns, count, np.where(use, readings[:, columns], 0.0), use, use / variance, weights)


def _solve(
    problem: Problem,
    used: _Used,
    single: BoolArray,
    detector: NDArray[np.uint8],
    common: CommonMode | None,
) -> tuple[Solution, FloatArray]:
    """Return the optimum and the final weights, (n, k)."""
    w = used.first_weight
    begin = start(problem, used.y, w)
    solution = _refine(problem, used, w, begin, single)
    if used.weights != "auto":
        return solution, w
    for _ in range(_ROUNDS):
        model = problem.model(solution.basic)
        lever = np.nan_to_num(leverage(problem, solution.basic, w), nan=0.0)
        residual = np.where(used.use, used.y - model, 0.0)
        if common is not None:
            residual, _ = without_common(problem, solution.basic, w, residual, common)
        squared = np.where(used.use, residual**2, 0.0) / np.maximum(1.0 - lever, 0.05)
        # residuals of the size of the last digit are rounding, and all weigh alike
        exact = np.sqrt(np.max(squared, axis=0)) < 1e-11 * np.max(np.abs(used.y), axis=0)
        if np.all(exact):
            break
        variance = variance_function(squared, model, used.use, detector[used.columns])
        w = np.where(used.use, np.where(exact, 1.0, 1.0 / np.where(variance > 0.0, variance, 1.0)), 0.0)
        solution = _refine(problem, used, w, solution.basic[:, 2:], single)
    return solution, w


def _refine(problem: Problem, used: _Used, w: FloatArray, begin: FloatArray, single: BoolArray) -> Solution:
    """Refine, with n2 held at 1.5 where a single incidence and polarization cannot tell it."""
    if not np.any(single):
        return refine(problem, used.y, w, begin)
    begin = np.where(single[:, None] & np.array([False, True]), 1.5, begin)
    basic, chi2, converged = np.empty((len(begin), 4)), np.empty(len(begin)), np.empty(len(begin), bool)
    for part, free in ((single, (True, False)), (~single, (True, True))):
        rows = np.flatnonzero(part)
        if rows.size:
            s = refine(problem, used.y[:, rows], w[:, rows], begin[rows], free=free)
            basic[rows], chi2[rows], converged[rows] = s.basic, s.chi2, s.converged
    return Solution(basic, chi2, converged)


def single_group(problem: Problem, use: BoolArray) -> BoolArray:
    """Return where all used readings share one incidence (to half a degree) and polarization, (k,)."""
    theta = np.where(use, problem.theta_i_deg[:, None], np.nan)
    one_incidence = np.nanmax(theta, axis=0) - np.nanmin(theta, axis=0) < 0.5
    s = np.sum(use & problem.is_s[:, None], axis=0)
    return np.asarray(one_incidence & ((s == 0) | (s == np.sum(use, axis=0))))

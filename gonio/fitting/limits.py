"""What do the data not determine?  Open-ended intervals, missing lobes, and a sentence for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from gonio.fitting.problem import Problem
from gonio.fitting.solve import HIGH, LOW, Solution, refine

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_NO_LOBE_P = 1e-4  # chance that noise alone looks like a lobe, before the search over its shape
_NEAR = 4.0  # standard errors within which a bound is examined by profile
_BISECTIONS = 18


def lobe_is_seen(
    y: FloatArray, w: FloatArray, diffuse: FloatArray, chi2: FloatArray, dof: FloatArray
) -> BoolArray:
    """Return where the lobe improves on a purely diffuse fit by more than noise can, (m,).

    An F test of three parameters at 1e-4.  Without a lobe, alpha and n2 are undefined and the test's
    distribution is not exactly F, since the shape is searched for: hence the low level.
    """
    d = diffuse[:, None]
    rho = np.sum(w * d * y, axis=0) / np.sum(w * d * d, axis=0)
    diffuse_chi2 = np.sum(w * (y - d * rho) ** 2, axis=0)
    needed = 3.0 * special.fdtri(3.0, dof, 1.0 - _NO_LOBE_P) * chi2 / dof
    # rounding: a noiseless Lambertian surface leaves chi2 of the order of the last digit
    rounding = 1e-26 * np.sum(w * y * y, axis=0)
    return np.asarray(diffuse_chi2 - chi2 > needed + rounding)


@dataclass(frozen=True, slots=True)
class Limits:
    """Profile limits of one parameter where its Wald interval would mislead; NaN where Wald stands."""

    lower: FloatArray  # (m,)
    upper: FloatArray


def profile_limits(
    problem: Problem,
    y: FloatArray,
    w: FloatArray,
    solution: Solution,
    *,
    column: int,
    se: FloatArray,
    variance_scale: FloatArray,
    quantile: FloatArray,
) -> Limits:
    """Return profile-likelihood limits of log_alpha (column 0) or n2 (column 1) where a bound is near.

    A wavelength is examined if the bound of the search range lies within four standard errors, or there is no
    standard error.  If the data accept the bound itself, ``chi2(bound) - chi2 <= t^2 s^2``, that side is open
    (±inf), and the other end is found by bisection of the profile.
    """
    at = solution.basic[:, 2 + column]
    near = ~(at - _NEAR * se > LOW[column]) | ~(at + _NEAR * se < HIGH[column])
    lower, upper = np.full(at.shape, np.nan), np.full(at.shape, np.nan)
    rows = np.flatnonzero(near)
    if not rows.size:
        return Limits(lower, upper)
    y, w, optimum = y[:, rows], w[:, rows], solution.basic[rows, 2:]
    allowed = solution.chi2[rows] + quantile[rows] ** 2 * variance_scale[rows]
    free = (column == 1, column == 0)

    def accepted(value: FloatArray, pick: NDArray[np.intp]) -> BoolArray:
        begin = optimum[pick].copy()
        begin[:, column] = value
        return refine(problem, y[:, pick], w[:, pick], begin, free=free).chi2 <= allowed[pick]

    everything = np.arange(rows.size)
    open_low = accepted(np.full(rows.size, LOW[column]), everything)
    open_high = accepted(np.full(rows.size, HIGH[column]), everything)
    examined = open_low | open_high
    for is_open, bound, ends, away in ((open_low, LOW, lower, -np.inf), (open_high, HIGH, upper, np.inf)):
        ends[rows[is_open]] = away
        pick = np.flatnonzero(examined & ~is_open)
        inside, outside = optimum[pick, column].copy(), np.full(pick.size, bound[column])
        for _ in range(_BISECTIONS if pick.size else 0):
            middle = 0.5 * (inside + outside)
            good = accepted(middle, pick)
            inside, outside = np.where(good, middle, inside), np.where(good, outside, middle)
        ends[rows[pick]] = inside
    return Limits(lower, upper)

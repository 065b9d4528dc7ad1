"""What do the data not determine?  Open-ended intervals, and lobes that are not there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from gonio.fitting.columns import BoolArray, FitModel, FloatArray
from gonio.fitting.solve import Solution, refine

_NO_LOBE_P = 1e-4  # chance that noise alone looks like a lobe, before the search over its shape
_NEAR = 4.0  # standard errors within which a bound is examined by profile
_BISECTIONS = 18


def is_lobe(name: str) -> bool:
    """Whether a basic parameter is the strength of a lobe, and not of the diffuse part."""
    return name.startswith(("k_n", "rho_s"))


def diffuse_only(model: FitModel, y: FloatArray, w: FloatArray, basic: FloatArray) -> FloatArray:
    """Return the best fit without a lobe, (m, p): lobe coefficients zero, shape parameters as given."""
    count = len(model.linear)
    columns = model.columns(basic[:, count:]).value
    kept = [k for k, name in enumerate(model.linear) if not is_lobe(name)]
    phi = [np.broadcast_to(columns[k], y.shape) for k in kept]
    normal = np.stack([[np.sum(w * a * b, axis=0) for b in phi] for a in phi]).transpose(2, 0, 1)
    right = np.stack([np.sum(w * a * y, axis=0) for a in phi], axis=1)
    found = basic.copy()
    found[:, :count] = 0.0
    found[:, kept] = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    return found


def lobe_is_seen(
    y: FloatArray,
    w: FloatArray,
    diffuse_chi2: FloatArray,
    chi2: FloatArray,
    variance: FloatArray,
    dof: FloatArray,
    count: int,
) -> BoolArray:
    """Return where the lobe improves on a purely diffuse fit by more than noise can, (m,).

    An F test of the lobe's `count` parameters at 1e-4, against the `variance` (m,) of weighted residuals.
    Without a lobe, alpha and n2 are undefined and the distribution is not exactly F, since the shape is
    searched for: hence the low level.
    """
    needed = count * special.fdtri(float(count), dof, 1.0 - _NO_LOBE_P) * variance
    # rounding: a noiseless Lambertian surface leaves chi2 of the order of the last digit
    rounding = 1e-26 * np.sum(w * y * y, axis=0)
    return np.asarray(diffuse_chi2 - chi2 > needed + rounding)


@dataclass(frozen=True, slots=True)
class Limits:
    """Profile limits of one parameter where its Wald interval would mislead; NaN where Wald stands."""

    lower: FloatArray  # (m,)
    upper: FloatArray


def profile_limits(
    model: FitModel,
    y: FloatArray,
    w: FloatArray,
    solution: Solution,
    *,
    shape: int,
    free: BoolArray,
    se: FloatArray,
    variance_scale: FloatArray,
    quantile: FloatArray,
) -> Limits:
    """Return profile-likelihood limits of a shape parameter, by its number, where a bound is near.

    A wavelength is examined if the bound of the search range lies within four standard errors, or there is no
    standard error.  If the data accept the bound itself, ``chi2(bound) - chi2 <= t^2 s^2``, that side is open
    (±inf), and the other end is found by bisection of the profile.  `free` (m, k) are the shape parameters
    that the fit was free to choose.
    """
    low, high = model.low[shape], model.high[shape]
    at = solution.basic[:, len(model.linear) + shape]
    near = (~(at - _NEAR * se > low) | ~(at + _NEAR * se < high)) & free[:, shape]
    lower, upper = np.full(at.shape, np.nan), np.full(at.shape, np.nan)
    rows = np.flatnonzero(near)
    if not rows.size:
        return Limits(lower, upper)
    y, w, optimum = y[:, rows], w[:, rows], solution.basic[rows, len(model.linear) :]
    allowed = solution.chi2[rows] + quantile[rows] ** 2 * variance_scale[rows]
    others = free[rows].copy()
    others[:, shape] = False

    def accepted(value: FloatArray, pick: NDArray[np.intp]) -> BoolArray:
        begin = optimum[pick].copy()
        begin[:, shape] = value
        return refine(model, y[:, pick], w[:, pick], begin, free=others[pick]).chi2 <= allowed[pick]

    everything = np.arange(rows.size)
    open_low = accepted(np.full(rows.size, low), everything)
    open_high = accepted(np.full(rows.size, high), everything)
    examined = open_low | open_high
    for is_open, bound, ends, away in ((open_low, low, lower, -np.inf), (open_high, high, upper, np.inf)):
        ends[rows[is_open]] = away
        pick = np.flatnonzero(examined & ~is_open)
        inside, outside = optimum[pick, shape].copy(), np.full(pick.size, bound)
        for _ in range(_BISECTIONS if pick.size else 0):
            middle = 0.5 * (inside + outside)
            good = accepted(middle, pick)
            inside, outside = np.where(good, middle, inside), np.where(good, outside, middle)
        ends[rows[pick]] = inside
    return Limits(lower, upper)

"""Where has an interval no end?  Profile limits of the shape parameters, and what they mean for the known
ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.columns import BoolArray, FitModel, FloatArray
from gonio.fitting.limits import is_lobe, profile_limits
from gonio.fitting.solve import Solution


@dataclass(frozen=True, slots=True)
class Ends:
    """Profile limits of the shape parameters, (k, shape); NaN where Wald's interval stands."""

    lower: FloatArray
    upper: FloatArray

    @classmethod
    def none(cls, count: int, shape: int) -> Ends:
        """Return Wald's everywhere."""
        return cls(np.full((count, shape), np.nan), np.full((count, shape), np.nan))

    @classmethod
    def of(
        cls,
        model: FitModel,
        y: FloatArray,
        w: FloatArray,
        solution: Solution,
        free: BoolArray,
        scale: FloatArray,
        quantile: FloatArray,
        unit: FloatArray,
    ) -> Ends:
        """Return the limits of every shape parameter where a bound of its range is near.

        `unit` is the inverse normal matrix, (k, p, p), to be scaled by `scale`, (k,).
        """
        ends = cls.none(*free.shape)
        linear = len(model.linear)
        for shape in range(free.shape[1]):
            rows = np.flatnonzero(free[:, shape])
            if not rows.size:
                continue
            part = Solution(solution.basic[rows], solution.chi2[rows], solution.converged[rows])
            limits = profile_limits(
                model, y[:, rows], w[:, rows], part,
                shape=shape,
                free=free[rows],
                se=np.sqrt(scale[rows] * unit[rows, linear + shape, linear + shape]),
                variance_scale=scale[rows],
                quantile=quantile[rows],
            )  # fmt: skip
            ends.lower[rows, shape], ends.upper[rows, shape] = limits.lower, limits.upper
        return ends


def open_ends(
    kind: type[FitModel],
    basic: FloatArray,
    basic_covariance: FloatArray,
    ends: Ends,
    quantile: FloatArray,
    value: FloatArray,
    se: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    covariance: FloatArray,
) -> None:
    """Put intervals on the logarithm and open-ended ones in place of the plain ones, in the last five arrays.

    What has no bound on one side has no standard error.  A strength rho_s = k_n / R(0) follows n2, the other
    way round: n2 without a lower bound leaves it without an upper one.
    """
    linear = len(kind.linear)
    for shape, name in enumerate(kind.shape):
        low, high = ends.lower[:, shape], ends.upper[:, shape]
        at = linear + shape
        rows = np.flatnonzero(~np.isnan(low))
        if name.startswith("log_"):
            column = kind.parameters.index(name.removeprefix("log_"))
            with np.errstate(invalid="ignore", over="ignore"):  # no bound that can be written
                factor = np.exp(quantile * np.sqrt(basic_covariance[:, at, at]))
            lower[:, column], upper[:, column] = value[:, column] / factor, value[:, column] * factor
            lower[rows, column], upper[rows, column] = np.exp(low[rows]), np.exp(high[rows])
            _forget(rows, column, se, covariance)
        elif name == "n2":
            column = kind.parameters.index(name)
            lower[rows, column] = np.where(np.isneginf(low[rows]), 1.0, low[rows])
            upper[rows, column] = high[rows]
            _forget(rows, column, se, covariance)
            for strength in (x for x in kind.parameters if is_lobe(x)):
                k_n = kind.linear.index(strength.replace("rho_s", "k_n"))
                own = kind.parameters.index(strength)
                lower[rows, own], upper[rows, own] = _strength(
                    basic[rows, k_n], low[rows], high[rows], float(kind.low[shape])
                )
                _forget(rows, own, se, covariance)


def _forget(rows: NDArray[np.intp], column: int, se: FloatArray, covariance: FloatArray) -> None:
    se[rows, column] = np.nan
    covariance[rows, column, :] = covariance[rows, :, column] = np.nan


def _strength(
    k_n: FloatArray, low: FloatArray, high: FloatArray, least: float
) -> tuple[FloatArray, FloatArray]:
    """Return the ends of ``k_n / R(0)`` for n2 between `low` and `high`, which may be infinite."""
    at_high, at_low = (
        k_n / ((n - 1.0) / (n + 1.0)) ** 2 for n in (np.minimum(high, 1e12), np.maximum(low, least))
    )
    endless = np.isneginf(low)
    lower = np.where(k_n > 0.0, at_high, np.where(endless, -np.inf, at_low))
    upper = np.where(k_n > 0.0, np.where(endless, np.inf, at_low), at_high)
    return lower, upper

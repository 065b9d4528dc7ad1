"""Which readings take part, and with what weight?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gonio.errors import FitError
from gonio.fitting.columns import BoolArray, FitModel, FloatArray, readings
from gonio.fitting.covariance import CommonMode, leverage, without_common
from gonio.fitting.noise import variance_function
from gonio.fitting.robust import Loss, robust_scale, weight_factor
from gonio.fitting.solve import Solution, refine

WeightMethod = Literal["auto", "r_sd", "none"]

_ROUNDS = 2  # of weights from residuals; more change neither the parameters nor the coverage
_ROBUST_ROUNDS = 50
_SETTLED = 1e-9  # change of the shape parameters between two rounds of robust weights
_TINY = 1e-11  # residuals of this part of the readings are rounding


@dataclass(frozen=True, slots=True)
class Used:
    """The wavelengths that can be fitted: indices into all m, and their readings, weights and masks."""

    columns: NDArray[np.intp]  # (k,)
    count: NDArray[np.int64]  # (m,) usable readings of every wavelength
    y: FloatArray  # (n, k), zero where unused
    use: BoolArray  # (n, k)
    first_weight: FloatArray  # (n, k)
    weights: WeightMethod

    @classmethod
    def of(cls, r: FloatArray, r_sd: FloatArray, weights: WeightMethod, parameters: int) -> Used:
        """Select the wavelengths with at least twice as many readings as parameters.

        Raises
        ------
        FitError
            There is none.
        """
        fewest = 2 * parameters
        use = np.isfinite(r)
        known = np.isfinite(r_sd) & (r_sd > 0.0)
        if weights == "r_sd":
            use &= known
        count = np.sum(use, axis=0)
        columns = np.flatnonzero(count >= fewest)
        if not columns.size:
            what = "readings with a standard deviation r_sd" if weights == "r_sd" else "usable readings"
            raise FitError(
                f"no wavelength has {fewest} {what} (the best has {int(count.max(initial=0))}), the fewest "
                f"that determine {parameters} parameters and their noise; measure more positions"
            )
        use = use[:, columns]
        # r_sd for some readings only would misweigh the others
        whole = np.all(known[:, columns] | ~use, axis=0)
        weigh = (weights != "none") & whole
        variance = np.where(weigh & use, r_sd[:, columns], 1.0) ** 2
        return cls(columns, count, np.where(use, r[:, columns], 0.0), use, use / variance, weights)

    def start_weight(self, loss: Loss) -> FloatArray:
        """Return the weights of the first search, (n, k).

        With a robust loss no reading counts for more than a typical one does, however large it is: from an
        optimum that one wild reading has made, weights by residuals do not find the way back.
        """
        if loss == "squares":
            return self.first_weight
        size = np.sqrt(self.first_weight) * np.abs(self.y)
        typical = np.nanmedian(np.where(self.use, size, np.nan), axis=0)
        return self.first_weight / (1.0 + size / np.where(typical > 0.0, typical, np.inf)) ** 2


@dataclass(frozen=True, slots=True)
class Weighed:
    """The optimum, the weights ``1/variance`` (n, k), and the robust factor on them, 0...1 (n, k)."""

    solution: Solution
    w: FloatArray
    factor: FloatArray


def solve_weighed(
    model: FitModel,
    used: Used,
    begin: FloatArray,
    free: BoolArray,
    detector: NDArray[np.integer],
    common: CommonMode | None,
    loss: Loss,
) -> Weighed:
    """Return the optimum with final weights; `begin` and `free` are of the shape parameters, (k, shape)."""
    w, factor = used.first_weight, np.ones_like(used.y)
    solution = refine(model, used.y, used.start_weight(loss), begin, free=free)
    count = len(model.linear)
    if loss != "squares":  # whose weights are not known yet: Huber's loss forgets no reading altogether
        for _ in range(_ROUNDS):
            factor = _robust_factor(model, used, w, solution, "huber")
            solution = refine(model, used.y, w * factor, solution.basic[:, count:], free=free)
    for _ in range(_ROUNDS if used.weights == "auto" else 0):
        expected = readings(model, solution.basic)
        lever = np.nan_to_num(leverage(model, solution.basic, w), nan=0.0)
        residual = np.where(used.use, used.y - expected, 0.0)
        if common is not None:
            residual, _ = without_common(model, solution.basic, w, residual, common)
        squared = np.where(used.use, residual**2, 0.0) / np.maximum(1.0 - lever, 0.05)
        # residuals of the size of the last digit are rounding, and all weigh alike
        exact = np.sqrt(np.max(squared, axis=0)) < _TINY * np.max(np.abs(used.y), axis=0)
        if np.all(exact):
            break
        variance = variance_function(squared, expected, used.use, detector, outliers=loss != "squares")
        w = np.where(used.use, np.where(exact, 1.0, 1.0 / np.where(variance > 0.0, variance, 1.0)), 0.0)
        if loss != "squares":
            factor = _robust_factor(model, used, w, solution, loss)
        solution = refine(model, used.y, w * factor, solution.basic[:, count:], free=free)
    for _ in range(_ROBUST_ROUNDS if loss != "squares" else 0):
        before = solution.basic[:, count:]
        factor = _robust_factor(model, used, w, solution, loss)
        solution = refine(model, used.y, w * factor, before, free=free)
        if np.all(np.abs(solution.basic[:, count:] - before) < _SETTLED):
            break
    return Weighed(solution, w, factor)


def _robust_factor(model: FitModel, used: Used, w: FloatArray, solution: Solution, loss: Loss) -> FloatArray:
    u = np.sqrt(w) * (used.y - readings(model, solution.basic))
    scale = robust_scale(u, used.use, solution.basic.shape[1])
    floor = _TINY * np.max(np.sqrt(w) * np.abs(used.y), axis=0)
    return weight_factor(u / np.maximum(scale, np.maximum(floor, np.finfo(float).tiny)), loss)

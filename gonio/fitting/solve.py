"""Where is the least-squares optimum?  A start from a grid, then steps down, all wavelengths at once.

The linear coefficients are eliminated (`gonio.fitting.separable`), the nonlinear parameters descend within
their bounds (`gonio.fitting.newton`).  A model is anything with `linear`, `low`, `high` and `columns`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.newton import minimise
from gonio.fitting.separable import IndexArray, Projected, Rows, Separable, project, settle

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_BLOCK = 100_000  # readings worked on together: scratch arrays stay in the cache
_GRID_BLOCK = 1_000_000  # numbers of a grid's sums held at once
_ALIKE = 1e-10  # squared part of a column beside the others below which a start does not count it
_ITERATIONS = 200
_BOLD = 10.0
_BOLDNESS = np.array([1.0, 10.0, 0.1, 100.0])
_SAME = 1e-8  # of chi2


@dataclass(frozen=True, slots=True)
class Solution:
    """Optimum of each of m wavelengths; NaN where a reading, a weight or the start is none."""

    basic: FloatArray  # (m, L + k), the linear coefficients first
    chi2: FloatArray  # (m,) weighted sum of squared residuals
    converged: BoolArray  # (m,)


def refine(
    model: Separable,
    y: FloatArray,
    w: FloatArray,
    begin: FloatArray,
    *,
    free: bool | Sequence[bool] | BoolArray = True,
    iterations: int = _ITERATIONS,
    bold: float | FloatArray = _BOLD,
) -> Solution:
    """Return the local optimum that each wavelength descends to from `begin`.

    Parameters
    ----------
    y, w
        Readings and weights, (n, m); a reading of weight 0 is not used and may be NaN.
    begin
        Nonlinear parameters to start from, (m, k).
    free
        False holds a nonlinear parameter at its given value, for profiles and for data that cannot determine
        it; (k,) for all wavelengths alike or (m, k).
    iterations
        Steps at most; a wavelength that needs more is not `converged`.
    bold
        First trust region in lengths of x, for parameters without bounds; one for all or (m,).
    """
    m, k = begin.shape
    may = np.broadcast_to(np.asarray(free, np.bool_), (m, k))
    reach = np.broadcast_to(np.asarray(bold, np.float64), (m,))
    basic, chi2 = np.empty((m, len(model.linear) + k)), np.empty(m)
    converged = np.empty(m, np.bool_)
    for part in blocks(*y.shape):
        with np.errstate(all="ignore"):  # a trial step may leave the range of the model; it is taken back
            basic[part], chi2[part], converged[part] = _refine_block(
                model, y[:, part], w[:, part], begin[part], may[part], iterations, reach[part]
            )
    return Solution(basic, chi2, converged)


def refine_boldly(model: Separable, y: FloatArray, w: FloatArray, begin: FloatArray) -> Solution:
    """Return the best of the optima that more and less cautious descents reach, for starts that are far away.

    A first step that is too long leaves the basin (over a pole, into an exponential that has died out), one
    that is too short follows every bend of a valley; no one length suits all problems, so each is tried.
    Where none arrives they are given more time.
    """
    found = _best_of(model, y, w, begin, 500)
    rows = np.flatnonzero(~found.converged & np.isfinite(found.chi2))
    if rows.size:
        again = _best_of(model, y[:, rows], w[:, rows], begin[rows], 5000)
        found.basic[rows], found.chi2[rows] = again.basic, again.chi2
        found.converged[rows] = again.converged
    return found


def _best_of(model: Separable, y: FloatArray, w: FloatArray, begin: FloatArray, iterations: int) -> Solution:
    m, tries = len(begin), _BOLDNESS.size
    many = refine(
        model,
        np.tile(y, tries),
        np.tile(w, tries),
        np.tile(begin, (tries, 1)),
        iterations=iterations,
        bold=np.repeat(_BOLDNESS, m),
    )
    chi2, converged = many.chi2.reshape(tries, m), many.converged.reshape(tries, m)
    rank = np.where(np.isnan(chi2), np.inf, chi2)
    least = np.min(np.where(converged, rank, np.inf), axis=0)
    good = np.where(np.isfinite(least), converged & (rank <= least * (1.0 + _SAME)), rank <= rank.min(axis=0))
    pick = np.argmax(good, axis=0) * m + np.arange(m)  # of equal optima the first, the nearest as a rule
    return Solution(many.basic[pick], many.chi2[pick], many.converged[pick])


def blocks(n: int, m: int) -> list[slice]:
    """Return the wavelengths in parts that are worked on together."""
    width = max(1, _BLOCK // max(n, 1))
    return [slice(at, at + width) for at in range(0, m, width)]


def _refine_block(
    model: Separable,
    y: FloatArray,
    w: FloatArray,
    begin: FloatArray,
    free: BoolArray,
    iterations: int,
    bold: FloatArray,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    rows = Rows.of(y, w)
    known = rows.known & np.all(np.isfinite(begin), axis=1)
    all_rows = np.arange(len(begin))
    x = np.where(known[:, None], begin, np.nan)

    def evaluate(at: FloatArray, pick: IndexArray) -> Projected:
        part = rows if pick.size == all_rows.size else rows.of_problems(pick)
        return project(model, part, at)

    def last(at: FloatArray, pick: IndexArray) -> tuple[FloatArray, FloatArray]:
        return settle(model, rows.of_problems(pick), at)

    x, state, converged = minimise(
        evaluate, last, x, model.low, model.high, free, iterations=iterations, bold=bold
    )
    basic = np.concatenate([state.coefficients * rows.size[:, None], x], axis=1)
    chi2 = state.chi2 * (rows.size * rows.heaviest) ** 2
    lost = ~np.isfinite(state.chi2)
    basic[lost], chi2[lost] = np.nan, np.nan
    return basic, chi2, converged & np.any(rows.root > 0.0, axis=0)


def grid_start(model: Separable, y: FloatArray, w: FloatArray, grid: FloatArray) -> FloatArray:
    """Return the point with each wavelength's least chi2, (m, k), of a grid of nonlinear parameters, (G, k).

    The columns are made once for all wavelengths; the sums over positions are matrix products, so the cost is
    that of (L + 1)(L + 2)/2 of them, (G, n) @ (n, m).  Where L columns are one another's combination to a
    hundred-thousandth, the last are left out there: enough to choose a start by.
    """
    best = np.empty((y.shape[1], grid.shape[1]))
    columns = [column.T for column in model.columns(grid).value]  # (G, n) or (1, n)
    width = max(1, _GRID_BLOCK // max(4 * len(y), len(columns) ** 2 * len(grid), 1))
    for at in range(0, len(best), width):
        part = slice(at, at + width)
        gain = _explained(columns, len(model.linear), Rows.of(y[:, part], w[:, part]), len(grid))
        best[part] = grid[np.argmax(np.where(np.isfinite(gain), gain, -np.inf), axis=0)]
    return best


def _explained(columns: list[FloatArray], count: int, rows: Rows, points: int) -> FloatArray:
    """Return the part of chi2 that the best coefficients take off at every point of a grid, (G, m)."""
    w = rows.root**2
    wy = rows.root * rows.target
    shape = (points, wy.shape[1])
    gain = np.zeros(shape)
    pull = [np.broadcast_to(c @ wy, shape) for c in columns[:count]]
    if len(columns) > count:  # of the readings without the column that has no coefficient
        fixed = columns[count]
        gain = gain + (2.0 * fixed @ wy - (fixed**2 @ w) / rows.size) / rows.size
        pull = [p - (c * fixed) @ w / rows.size for p, c in zip(pull, columns, strict=False)]
    gram = {
        (i, j): np.broadcast_to((columns[i] * columns[j]) @ w, shape)
        for i in range(count)
        for j in range(i + 1)
    }
    whole = [gram[i, i] for i in range(count)]
    for j in range(count):
        pivot = gram[j, j]
        inverse = np.where(pivot > _ALIKE * whole[j], 1.0, 0.0) / np.where(pivot > 0.0, pivot, 1.0)
        gain = gain + pull[j] ** 2 * inverse
        for i in range(j + 1, count):
            share = gram[i, j] * inverse
            pull[i] = pull[i] - share * pull[j]
            for h in range(j + 1, i + 1):
                gram[i, h] = gram[i, h] - share * gram[h, j]
    return gain

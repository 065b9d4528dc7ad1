"""How does one step down from any start?  Trust regions for m small problems at once, ending at bounds.

Two models of chi2 compete at each problem, as in NL2SOL (Dennis, Gay & Welsch, ACM TOMS 7 (1981) 348): that
of Gauss and Newton, which is good far from the optimum, and the exact one, which converges quadratically also
where residuals are large.  The one that foretold the last step better makes the next.  A step is at most as
long as the trust region in units of `Projected.scale` (Moré, LNM 630 (1978) 105), and at most a tenth of a
bounded range.  The undamped step comes from the orthogonal factor; a shorter one from the eigenvectors of the
model's Hessian.  A variable that pushes against its bound rests there.

A problem has converged when the step that is left would lower the root of chi2 by less than 1e-10 of itself
(relative offset of Bates & Watts, Technometrics 23 (1981) 179), or by no more than rounding lets one see, and
no direction curves downwards.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.separable import Projected
from gonio.fitting.trust import Step, step_within

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]
Evaluate = Callable[[FloatArray, IndexArray], Projected]
"""State of some problems, by their numbers, at x."""
Settle = Callable[[FloatArray, IndexArray], tuple[FloatArray, FloatArray]]
"""Linear coefficients and half of chi2 alone."""

_EPS = float(np.finfo(float).eps)
_OFFSET = 1e-10  # of the root of chi2, what a converged problem may still win
_LANDING = 1e-5  # the same, from where a whole Newton step wins all that can be seen
_BLUNT = 1e-6  # the same where rounding stops the descent
_SLIGHT = 1e-12  # of chi2: a change this small cannot be told from rounding
_SHARE = 0.1  # of a bounded range in one step
_IDLE = 1e3  # in rounding of the readings: a variable that moves them by less in such a step rests
_STALLS = 3
_PATIENCE = 100  # steps in which a problem must come closer


def minimise(
    evaluate: Evaluate,
    settle: Settle,
    x: FloatArray,
    low: FloatArray,
    high: FloatArray,
    free: BoolArray,
    *,
    iterations: int,
    bold: FloatArray,
) -> tuple[FloatArray, Projected, BoolArray]:
    """Return x (m, k) at the local minimum each problem descends to, its state, and whether it got there.

    `free` (m, k) are the variables that may move; `low` and `high` (k,) bound them; `bold` (m,) is the first
    trust region, in lengths of x, where there are no bounds.
    """
    x = np.clip(x, low, high)
    state = evaluate(x, np.arange(len(x)))
    if not x.shape[1]:  # everything is linear
        return x, state, np.isfinite(state.chi2)
    descent = _Descent(evaluate, settle, x, state, low, high, free, bold)
    for count in range(iterations):
        todo = np.flatnonzero(~descent.done)
        if not todo.size:
            break
        descent.advance(todo)
        if count % _PATIENCE == _PATIENCE - 1:
            descent.give_up()
    return x, state, descent.converged


class _Descent:
    """The m problems on their way; x and state are changed in place."""

    def __init__(
        self,
        evaluate: Evaluate,
        settle: Settle,
        x: FloatArray,
        state: Projected,
        low: FloatArray,
        high: FloatArray,
        free: BoolArray,
        bold: FloatArray,
    ) -> None:
        m = len(x)
        self.evaluate, self.settle, self.x, self.state = evaluate, settle, x, state
        self.low, self.high, self.free = low, high, free
        width = np.where(np.isfinite(high - low), high - low, np.inf)
        self.longest = _SHARE * width
        self.scale = state.scale.copy()  # largest so far: a variable that fades must not run away
        reach = np.where(np.isfinite(width), self.longest, bold[:, None] * np.abs(x))
        self.radius = np.sqrt(np.sum((self.scale * reach) ** 2, axis=1))
        self.radius = np.where(self.radius > 0.0, self.radius, bold)
        self.newton = np.zeros(m, np.bool_)
        self.stalls = np.zeros(m, np.intp)
        self.lowest = np.full(m, np.inf)
        self.left = np.full(m, np.inf)  # what there is to win
        self.marked = state.chi2.copy(), self.left.copy()
        self.done = ~np.isfinite(state.chi2)
        self.converged = np.zeros(m, np.bool_)

    def advance(self, todo: IndexArray) -> None:
        """Take one step, or find that there is none to take."""
        here, x = self.state.of(todo), self.x[todo]
        self.scale[todo] = np.maximum(self.scale[todo], here.scale)
        scale = self.scale[todo]
        pushed = (x <= self.low) & (here.gradient > 0.0) | (x >= self.high) & (here.gradient < 0.0)
        # what rounding alone moves over its whole range has a direction of rounding, too
        idle = np.isfinite(self.longest) & (here.scale * self.longest < _IDLE * np.sqrt(here.floor)[:, None])
        held = ~self.free[todo] | pushed | (scale == 0.0) | idle
        step = step_within(here, scale, held, self.radius[todo], self.newton[todo])
        cut = np.max(np.abs(step.s) / self.longest, axis=1, initial=1.0)
        trial = np.clip(x + step.s / cut[:, None], self.low, self.high)
        noise = np.maximum(_SLIGHT * here.chi2, np.maximum(here.floor, np.sqrt(here.chi2 * here.floor)))
        still = np.all(np.abs(trial - x) <= 2.0 * _EPS * np.abs(x), axis=1)
        ended = self._ended(todo, here, step, still, noise, faded=np.any(~held & (here.scale == 0.0), axis=1))
        whole = step.exact & step.whole & (cut == 1.0) & np.all(trial == x + step.s, axis=1)
        landing = np.flatnonzero(~ended & whole & (step.decrement <= _LANDING**2 * here.chi2))
        ended[landing] = self._land(todo[landing], trial[landing], here.chi2[landing] + 10.0 * noise[landing])
        go = np.flatnonzero(~ended)
        if go.size:
            self._try(todo[go], here.of(go), trial[go], step.exact[go], noise[go])

    def give_up(self) -> None:
        """End problems that crawl where the readings hardly depend on x, far from any optimum."""
        chi2, left = self.marked
        crawl = (self.state.chi2 > (1.0 - 1e-4) * chi2) & (self.left > 0.1 * left)
        self.done |= crawl & (self.left > 1e-3 * self.state.chi2)
        self.marked = self.state.chi2.copy(), self.left.copy()

    def _ended(
        self,
        todo: IndexArray,
        here: Projected,
        step: Step,
        still: BoolArray,
        noise: FloatArray,
        faded: BoolArray,
    ) -> BoolArray:
        """Return which problems have nothing left to win that can be seen, and note which have converged."""
        left = self.left[todo] = step.decrement
        sound = ~step.downward & ~faded  # a model that no longer depends on x has run away
        there = sound & (left <= np.maximum(_OFFSET**2 * here.chi2, here.floor))
        blunt = sound & (left <= np.maximum(np.maximum(_BLUNT**2 * here.chi2, 100.0 * here.floor), noise))
        # rounding ends the descent where steps no longer shrink
        flat = left <= noise
        stuck = flat & (left >= 0.999 * self.lowest[todo])
        self.stalls[todo] += stuck
        self.lowest[todo] = np.where(flat, np.minimum(self.lowest[todo], left), self.lowest[todo])
        ended = there | still | (self.stalls[todo] >= _STALLS)
        self.converged[todo[ended]] = (there | blunt)[ended]
        self.done[todo[ended]] = True
        return np.asarray(ended)

    def _land(self, rows: IndexArray, trial: FloatArray, most: FloatArray) -> BoolArray:
        """Take the last step without derivatives; its error is of second order.  Return who has landed."""
        if not rows.size:
            return np.zeros(0, np.bool_)
        coefficients, chi2 = self.settle(trial, rows)
        good = chi2 <= most
        pick = rows[good]
        self.x[pick], self.state.coefficients[pick], self.state.chi2[pick] = (
            trial[good],
            coefficients[good],
            chi2[good],
        )
        self.converged[pick] = self.done[pick] = True
        return good

    def _try(
        self, rows: IndexArray, here: Projected, trial: FloatArray, exact: BoolArray, noise: FloatArray
    ) -> None:
        """Evaluate a trial, keep it if it is better, and learn from what was foretold."""
        s = trial - self.x[rows]
        length = np.sqrt(np.sum((self.scale[rows] * s) ** 2, axis=1))
        new = self.evaluate(trial, rows)
        won = 0.5 * (here.chi2 - new.chi2)
        by_gauss, by_hessian = _foretold(here, s)
        told = np.where(exact, by_hessian, by_gauss)
        ratio = np.where(np.isfinite(won) & (told > 0.0), won / np.where(told > 0.0, told, 1.0), -1.0)
        unseen = (np.abs(told) <= noise) & (np.abs(won) <= 10.0 * noise)
        better = np.flatnonzero((ratio > 1e-4) | unseen)
        self.x[rows[better]] = trial[better]
        self.state.put(rows[better], new, better)
        radius = self.radius[rows]
        radius = np.where(unseen | (ratio >= 0.25), radius, 0.25 * np.minimum(radius, length))
        self.radius[rows] = np.where(~unseen & (ratio > 0.75), np.maximum(radius, 2.0 * length), radius)
        if self.state.exact:
            closer = np.abs(won - by_hessian) <= np.abs(won - by_gauss)
            self.newton[rows] = np.where(np.isfinite(won) & ~unseen, closer, self.newton[rows])


def _foretold(here: Projected, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what half of chi2 should fall by, (m,), to Gauss and Newton and to the Hessian."""
    slope = np.sum(here.gradient * s, axis=1)
    change = np.einsum("mqa,ma->mq", here.factor, s)
    by_gauss = -slope - 0.5 * np.sum(change**2, axis=1)
    by_hessian = -slope - 0.5 * np.einsum("ma,mab,mb->m", s, here.hessian, s)
    return by_gauss, by_hessian

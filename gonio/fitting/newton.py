"""How does one step down from any start?  Trust regions for m small problems at once, steps ending at bounds.

Two models of chi2 compete at each problem, as in NL2SOL (Dennis, Gay & Welsch, ACM TOMS 7 (1981) 348): that of
Gauss and Newton, which is good far from the optimum, and the exact one, which converges quadratically also where
residuals are large.  The one that foretold the last step better makes the next.  A step is at most as long as
the trust region in units of `Projected.scale` (More, LNM 630 (1978) 105), and at most a tenth of a bounded range.
The undamped step comes from the orthogonal factor; a shorter one from the eigenvectors of the model's Hessian.
A variable that pushes against its bound rests there.

A problem has converged when the step that is left would lower the root of chi2 by less than 1e-9 of itself
(relative offset of Bates & Watts, Technometrics 23 (1981) 179), or by no more than rounding lets one see, and
no direction curves downwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.separable import Projected

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]
Evaluate = Callable[[FloatArray, IndexArray], Projected]
"""State of some problems, by their numbers, at x."""

_EPS = float(np.finfo(float).eps)
_OFFSET = 1e-9  # of the root of chi2, what a converged problem may still win
_BLUNT = 1e-6  # the same where rounding stops the descent
_SLIGHT = 1e-12  # of chi2: a change this small cannot be told from rounding
_RIDGE = 1e-13  # keeps a singular factor solvable; its square is far below the rounding of a Hessian
_SHARP = 1e-7  # a factor with a smaller pivot makes nonsense of second derivatives
_SHARE = 0.1  # of a bounded range in one step
_FACTOR = 100.0  # first trust region, in lengths of x, without bounds
_STALLS = 3


def minimise(
    evaluate: Evaluate, x: FloatArray, low: FloatArray, high: FloatArray, free: BoolArray, iterations: int
) -> tuple[FloatArray, Projected, BoolArray]:
    """Return x (m, k) at the local minimum each problem descends to, its state, and whether it got there.

    `free` (m, k) are the variables that may move; `low` and `high` (k,) bound them.
    """
    x = np.clip(x, low, high)
    m = len(x)
    state = evaluate(x, np.arange(m))
    share = np.where(np.isfinite(high - low), _SHARE * np.where(np.isfinite(high - low), high - low, 0.0), np.inf)
    scale = np.zeros_like(x)
    radius = np.full(m, np.nan)
    newton = np.full(m, state.exact)
    stalls, lowest = np.zeros(m, int), np.full(m, np.inf)
    done, converged = ~np.isfinite(state.chi2), np.zeros(m, bool)
    for _ in range(iterations):
        todo = np.flatnonzero(~done)
        if not todo.size:
            break
        here, at = state.of(todo), x[todo]
        scale[todo] = np.maximum(scale[todo], here.scale)
        first = np.isnan(radius[todo])
        radius[todo[first]] = _first_radius(at[first], scale[todo[first]], share)
        g = here.gradient
        held = ~free[todo] | (scale[todo] == 0.0)
        held |= ((at <= low) & (g > 0.0)) | ((at >= high) & (g < 0.0))
        step = _step(here, scale[todo], held, radius[todo], newton[todo])
        slight = np.maximum(_SLIGHT * here.chi2, here.floor)
        there = ~step.downward & (step.decrement <= np.maximum(_OFFSET**2 * here.chi2, here.floor))
        shrink = np.min(np.where(step.s != 0.0, share, np.inf) / np.where(step.s != 0.0, np.abs(step.s), 1.0), axis=1)
        trial = np.clip(at + step.s * np.minimum(1.0, shrink)[:, None], low, high)
        s = trial - at
        length = np.sqrt(np.sum((scale[todo] * s) ** 2, axis=1))
        still = np.all(np.abs(s) <= 2.0 * _EPS * np.abs(at), axis=1)
        blunt = ~step.downward & (step.decrement <= np.maximum(_BLUNT**2 * here.chi2, 100.0 * here.floor))
        # rounding ends the descent where steps no longer shrink
        flat = step.decrement <= slight
        stuck = flat & (step.decrement > 0.25 * lowest[todo])
        stalls[todo] = np.where(stuck, stalls[todo] + 1, 0)
        lowest[todo] = np.where(flat, np.minimum(lowest[todo], step.decrement), lowest[todo])
        ended = there | still | (stalls[todo] >= _STALLS)
        converged[todo[ended]] = (there | blunt)[ended]
        done[todo[ended]] = True
        go = np.flatnonzero(~ended)
        if not go.size:
            continue
        rows = todo[go]
        new = evaluate(trial[go], rows)
        won = 0.5 * (here.chi2[go] - new.chi2)
        gauss, exact = _foretold(here.of(go), s[go])
        told = np.where(step.exact[go], exact, gauss)
        ratio = np.where(np.isfinite(won) & (told > 0.0), won / np.where(told > 0.0, told, 1.0), -1.0)
        invisible = (np.abs(told) <= slight[go]) & (np.abs(won) <= 10.0 * slight[go])
        better = (ratio > 1e-4) | invisible
        x[rows[better]] = trial[go[better]]
        state.put(rows[better], new, np.flatnonzero(better))
        grown = np.maximum(radius[rows], 2.0 * length[go])
        shrunk = 0.25 * np.minimum(radius[rows], length[go])
        radius[rows] = np.where(
            invisible, radius[rows], np.where(ratio < 0.25, shrunk, np.where(ratio > 0.75, grown, radius[rows]))
        )
        if state.exact:
            closer = np.abs(won - exact) <= np.abs(won - gauss)
            newton[rows] = np.where(np.isfinite(won) & ~invisible, closer, newton[rows])
    return x, state, converged


def _first_radius(x: FloatArray, scale: FloatArray, share: FloatArray) -> FloatArray:
    width = np.where(np.isfinite(share), share, _FACTOR * np.abs(x))
    length = np.sqrt(np.sum((scale * width) ** 2, axis=1))
    return np.where(length > 0.0, length, _FACTOR)


def _foretold(here: Projected, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what half of chi2 should fall by, (m,), to Gauss and Newton and to the Hessian."""
    slope = np.sum(here.gradient * s, axis=1)
    change = np.einsum("mqa,ma->mq", here.factor, s)
    gauss = -slope - 0.5 * np.sum(change**2, axis=1)
    exact = -slope - 0.5 * np.einsum("ma,mab,mb->m", s, here.hessian, s)
    return gauss, exact


@dataclass(frozen=True, slots=True)
class _Step:
    s: FloatArray  # (m, k)
    exact: BoolArray  # (m,) by the Hessian
    decrement: FloatArray  # (m,) what the undamped step takes off chi2
    downward: BoolArray  # (m,) some direction curves downwards


def _step(here: Projected, scale: FloatArray, held: BoolArray, radius: FloatArray, newton: BoolArray) -> _Step:
    """Return the step within the trust region, zero in held variables."""
    m, k = held.shape
    unit = np.where(held, 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0))
    factor = here.factor * unit[:, None, :]
    ridge = np.where(held, 1.0, _RIDGE)[:, :, None] * np.eye(k)
    right = np.concatenate([here.right, np.zeros((m, k))], axis=1)[:, :, None]
    whole = np.concatenate([np.concatenate([factor, ridge], axis=1), right], axis=2)
    r = np.linalg.qr(whole, mode="r")
    pivot, b = r[:, :k, :k], r[:, :k, k]
    inverse = np.linalg.inv(pivot)
    s = np.einsum("mab,mb->ma", inverse, b)
    decrement = np.sum(b**2, axis=1)
    matrix = np.swapaxes(factor, 1, 2) @ factor
    use, downward = np.zeros(m, bool), np.zeros(m, bool)
    long = np.sum(s**2, axis=1) > radius**2
    if here.exact:
        # in the basis of the factor, where the Hessian of Gauss and Newton is 1, digits survive
        sharp = np.min(np.abs(np.diagonal(pivot, axis1=1, axis2=2)), axis=1) > _SHARP
        basis = np.where(sharp[:, None, None], inverse, 0.0)
        hessian = here.hessian * unit[:, :, None] * unit[:, None, :]
        e, axes = np.linalg.eigh(np.eye(k) + np.swapaxes(basis, 1, 2) @ (hessian - matrix) @ basis)
        convex, downward = e[:, 0] > 1e-3, e[:, 0] < -1e-3
        # where Gauss and Newton see an optimum that is a saddle, only the Hessian knows the way
        use = sharp & (newton | (downward & (decrement <= _SLIGHT * here.chi2)))
        z = np.einsum("mab,ma->mb", axes, b)
        divided = np.where(convex[:, None], z / np.where(convex[:, None], e, 1.0), z)
        s = np.where(use[:, None], np.einsum("mab,mbc,mc->ma", inverse, axes, divided), s)
        decrement = np.where(sharp, np.sum(z * divided, axis=1), decrement)
        matrix = np.where(use[:, None, None], hessian, matrix)
        long = (use & ~convex) | (np.sum(s**2, axis=1) > radius**2)
    rows = np.flatnonzero(long)
    if rows.size:
        matrix = matrix[rows] + ridge[rows]
        s[rows] = _within(matrix, (here.gradient * unit)[rows], radius[rows])
    return _Step(s * unit, use, decrement, downward)


def _within(matrix: FloatArray, gradient: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the s, (m, k), that minimises ``g's + s'Hs/2`` within a radius.

    ``s = -(H + l)^-1 g`` with l >= 0 from Newton steps of ``1/|s|``, which rise to it from below (More &
    Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983) 553); where g has no part along the direction that curves
    downwards, the step is completed along it.
    """
    e, axes = np.linalg.eigh(matrix)
    g = np.einsum("mab,ma->mb", axes, gradient)
    size = np.max(np.abs(e), axis=1)
    least = np.maximum(0.0, -e[:, 0]) + 1e-14 * size + np.finfo(float).tiny
    shift = np.maximum(least, np.max(np.abs(g) / radius[:, None] - e, axis=1))
    for _ in range(12):
        part = g / (e + shift[:, None])
        norm = np.sqrt(np.sum(part**2, axis=1))
        slope = np.sum(part**2 / (e + shift[:, None]), axis=1)
        change = np.where(slope > 0.0, norm**2 * (norm / radius - 1.0) / np.where(slope > 0.0, slope, 1.0), 0.0)
        if np.all(np.abs(change) <= 1e-3 * shift):
            break
        shift = np.maximum(least, shift + change)
    part = -g / (e + shift[:, None])
    missing = np.sqrt(np.maximum(0.0, radius**2 - np.sum(part**2, axis=1)))
    part[:, 0] += np.where(e[:, 0] < -1e-10 * size, np.where(part[:, 0] < 0.0, -missing, missing), 0.0)
    return np.einsum("mab,mb->ma", axes, part)

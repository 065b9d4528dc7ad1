"""Which step lowers a model of chi2 most, within a trust region?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.separable import Projected

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_RIDGE = 1e-13  # keeps a singular factor solvable; its square is far below the rounding of a Hessian
_SHARP = 1e-7  # a factor with a smaller pivot makes nonsense of second derivatives
_NEAR = 0.25  # of chi2: who hopes to lower it by more is too far off for second derivatives
_SEEN = 1e-12  # of chi2
_BENT = (
    1e-3  # curvature, with that of Gauss and Newton as 1, below which a direction does not count as convex
)


@dataclass(frozen=True, slots=True)
class Step:
    """A step of each of m problems.

    Attributes
    ----------
    s
        (m, k), zero in held variables.
    exact
        (m,), it minimises the model with the exact Hessian, not that of Gauss and Newton.
    whole
        (m,), the trust region does not shorten it.
    decrement
        (m,), what the step without a trust region would take off chi2.
    downward
        (m,), chi2 curves downwards along some direction.
    """

    s: FloatArray
    exact: BoolArray
    whole: BoolArray
    decrement: FloatArray
    downward: BoolArray


def step_within(
    here: Projected, scale: FloatArray, held: BoolArray, radius: FloatArray, newton: BoolArray
) -> Step:
    """Return the best step no longer than `radius`, (m,), in units of `scale`, (m, k).

    `newton` (m,) asks for the exact Hessian, which is used where it can be trusted.
    """
    m, k = held.shape
    unit = np.where(held, 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0))
    factor = here.factor * unit[:, None, :]
    ridge = np.where(held, 1.0, _RIDGE)[:, :, None] * np.eye(k)
    right = np.concatenate([here.right, np.zeros((m, k))], axis=1)[:, :, None]
    whole = np.concatenate([np.concatenate([factor, ridge], axis=1), right], axis=2)
    r = np.asarray(np.linalg.qr(whole, mode="r"))
    pivot, b = r[:, :k, :k], r[:, :k, k]
    inverse = np.linalg.inv(pivot)
    s = np.einsum("mab,mb->ma", inverse, b)
    decrement = np.sum(b**2, axis=1)
    matrix = np.swapaxes(factor, 1, 2) @ factor
    use, downward = np.zeros(m, np.bool_), np.zeros(m, np.bool_)
    long = np.sum(s**2, axis=1) > radius**2
    if here.exact:
        # in the basis of the factor, where the Hessian of Gauss and Newton is 1, digits survive
        sharp = np.min(np.abs(np.diagonal(pivot, axis1=1, axis2=2)), axis=1) > _SHARP
        basis = np.where(sharp[:, None, None], inverse, 0.0)
        hessian = here.hessian * unit[:, :, None] * unit[:, None, :]
        e, axes = np.linalg.eigh(np.eye(k) + np.swapaxes(basis, 1, 2) @ (hessian - matrix) @ basis)
        convex, downward = e[:, 0] > _BENT, e[:, 0] < -_BENT
        blunt = np.flatnonzero(~sharp)
        if blunt.size:  # the readings do not tell some direction in first order; the second may
            downward[blunt] = np.linalg.eigvalsh(hessian[blunt])[:, 0] < -_BENT
        # where Gauss and Newton see an optimum that is a saddle, only the Hessian knows the way
        near = decrement <= _NEAR * here.chi2
        use = (sharp & newton & near) | (downward & (decrement <= _SEEN * here.chi2))
        z = np.einsum("mab,ma->mb", axes, b)
        divided = np.where(convex[:, None], z / np.where(convex[:, None], e, 1.0), z)
        s = np.where(use[:, None], np.einsum("mab,mbc,mc->ma", inverse, axes, divided), s)
        decrement = np.where(sharp, np.sum(z * divided, axis=1), decrement)
        matrix = np.where(use[:, None, None], hessian, matrix)
        long = (use & ~(convex & sharp)) | (np.sum(s**2, axis=1) > radius**2)
    rows = np.flatnonzero(long)
    if rows.size:
        s[rows] = _within(matrix[rows] + ridge[rows], (here.gradient * unit)[rows], radius[rows])
    return Step(s * unit, use, ~long, decrement, downward)


def _within(matrix: FloatArray, gradient: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the s, (m, k), that minimises ``g's + s'Hs/2`` within a radius.

    ``s = -(H + l)^-1 g`` with l >= 0 from Newton steps of ``1/|s|``, which rise to it from below (Moré &
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
        slope = np.where(slope > 0.0, slope, np.inf)
        change = norm**2 * (norm / radius - 1.0) / slope
        if np.all(np.abs(change) <= 1e-3 * shift):
            break
        shift = np.maximum(least, shift + change)
    part = -g / (e + shift[:, None])
    missing = np.sqrt(np.maximum(0.0, radius**2 - np.sum(part**2, axis=1)))
    part[:, 0] += np.where(e[:, 0] < -1e-10 * size, np.where(part[:, 0] < 0.0, -missing, missing), 0.0)
    return np.asarray(np.einsum("mab,mb->ma", axes, part))

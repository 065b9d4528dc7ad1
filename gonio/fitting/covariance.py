"""How uncertain are the parameters: the random part from the residuals, and the part all positions share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem import Problem

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_BLOCK = 256
_FLAT = 1e-9  # a parameter that moves no reading by more than this part of the largest does not count


@dataclass(frozen=True, slots=True)
class CommonMode:
    """Standard uncertainties that positions share, (n, m) each.

    An error g of the 100 % baseline of one polarization scales its readings, ``g r``; an error o of the dark,
    which is read once for both, shifts all readings.  They are no scatter: more positions do not average them
    out, and residuals do not show them.
    """

    gain_u: FloatArray  # relative
    offset_u: FloatArray  # in r


def without_common(
    problem: Problem, basic: FloatArray, w: FloatArray, residual: FloatArray, common: CommonMode
) -> tuple[FloatArray, FloatArray]:
    """Return residuals (n, m) without what the common modes explain, and the degrees of freedom taken.

    What a baseline error does to S alone the four parameters cannot take up; it stays in the residuals and
    would pass for noise.  The amplitudes of the modes are estimated from the residuals with their standard
    uncertainty as prior,

        d = (V' W V / s^2 + 1)^-1 V' W e / s^2,

    V the modes after projection off the parameters, s^2 the variance scale of the residuals, found by
    iteration.
    """
    clean, taken = residual.copy(), np.zeros(len(basic))
    for at in range(0, len(basic), _BLOCK):
        part = slice(at, at + _BLOCK)
        root = np.sqrt(w[:, part].T)
        j = problem.jacobian(basic[part]) * root[:, :, None]
        size = np.sqrt(np.sum(j**2, axis=1))
        j = j / np.where(size > 0.0, size, 1.0)[:, None, :]
        v = np.stack(_modes(problem, basic[part], common, part), axis=-1) * root.T[:, :, None]
        v = np.swapaxes(v, 0, 1)  # (m, n, modes), as j
        normal = np.swapaxes(j, 1, 2) @ j + np.where(size > 0.0, 0.0, 1.0)[:, :, None] * np.eye(4)
        v = v - j @ (np.nan_to_num(_inverse(normal)) @ (np.swapaxes(j, 1, 2) @ v))
        e = residual[:, part].T * root
        gram, pull = np.swapaxes(v, 1, 2) @ v, np.einsum("mnv,mn->mv", v, e)
        count = np.sum(root > 0.0, axis=1) - 4.0
        total = np.sum(e**2, axis=1)
        scale, modes = total / count, np.zeros_like(pull)
        used = np.zeros(len(total))
        for _ in range(6):
            prior = np.maximum(scale, np.finfo(float).tiny)[:, None, None] * np.eye(v.shape[2])
            ridge = np.linalg.solve(gram + prior, np.concatenate([gram, pull[:, :, None]], axis=2))
            modes, used = ridge[:, :, -1], np.trace(ridge[:, :, :-1], axis1=1, axis2=2)
            scale = np.sum((e - np.einsum("mnv,mv->mn", v, modes)) ** 2, axis=1) / (count - used)
        explained = np.einsum("mnv,mv->mn", v, modes) / np.where(root > 0.0, root, np.inf)
        clean[:, part] -= explained.T
        taken[part] = used
    return clean, taken


def _modes(problem: Problem, basic: FloatArray, common: CommonMode, part: slice) -> list[FloatArray]:
    """Return the shift of every reading by one standard uncertainty of each common mode, (n, m) each."""
    scaled = common.gain_u[:, part] * problem.model(basic)
    gains = [np.where(x[:, None], scaled, 0.0) for x in (problem.is_s, ~problem.is_s) if np.any(x)]
    return [*gains, common.offset_u[:, part]]


def random_and_common(
    problem: Problem, basic: FloatArray, w: FloatArray, held: BoolArray, common: CommonMode | None
) -> tuple[FloatArray, FloatArray]:
    """Return inverse normal matrix and common-mode covariance of the basic parameters, (m, 4, 4) each.

    The first is ``(J' W J)^-1``, to be scaled by chi2 per degree of freedom.  The second is the sum over
    common modes of ``s s'`` with ``s = (J' W J)^-1 J' W v``, the shift of the optimum by one standard
    uncertainty of that mode, ``v = gain_u r`` or ``offset_u`` over the positions of one
    polarization.  Parameters that are `held` (m, 4), or that no reading depends on, have NaN.
    """
    inverse, shared = np.empty((len(basic), 4, 4)), np.zeros((len(basic), 4, 4))
    for at in range(0, len(basic), _BLOCK):
        part = slice(at, at + _BLOCK)
        j = problem.jacobian(basic[part])
        size = np.sqrt(np.einsum("mna,mna,nm->ma", j, j, w[:, part]))
        free = ~held[part] & (size > _FLAT * size[:, :1])
        unit = np.where(free, size, 1.0)
        j = np.where(free, 1.0, 0.0)[:, None, :] * j / unit[:, None, :]
        wj = j * w[:, part].T[:, :, None]
        normal = np.swapaxes(wj, 1, 2) @ j + np.where(free, 0.0, 1.0)[:, :, None] * np.eye(4)
        inverse[part] = _inverse(normal)
        if common is not None:
            for v in _modes(problem, basic[part], common, part):
                pull = np.einsum("mna,nm->ma", wj, v)
                shift = np.einsum("mab,mb->ma", inverse[part], pull)
                shared[part] += shift[:, :, None] * shift[:, None, :]
        known = np.where(free, 1.0, np.nan) / unit
        outer = known[:, :, None] * known[:, None, :]
        inverse[part] *= outer
        shared[part] *= outer
    return inverse, shared


def leverage(problem: Problem, basic: FloatArray, w: FloatArray) -> FloatArray:
    """Return the diagonal of the hat matrix, (n, m): how much a reading pulls the fit to itself, 0...1."""
    h = np.empty_like(w)
    for at in range(0, len(basic), _BLOCK):
        part = slice(at, at + _BLOCK)
        j = problem.jacobian(basic[part]) * np.sqrt(w[:, part].T)[:, :, None]
        size = np.sqrt(np.sum(j**2, axis=1))
        j = j / np.where(size > 0.0, size, 1.0)[:, None, :]
        normal = np.swapaxes(j, 1, 2) @ j + np.where(size > 0.0, 0.0, 1.0)[:, :, None] * np.eye(4)
        h[:, part] = np.sum((j @ _inverse(normal)) * j, axis=2).T
    return np.clip(h, 0.0, 1.0)


def _inverse(normal: FloatArray) -> FloatArray:
    """Return inverses of correlation-scaled normal matrices; NaN where singular to working precision."""
    good = np.linalg.cond(normal) < 1e14
    safe = np.where(good[:, None, None], normal, np.eye(4))
    return np.where(good[:, None, None], np.linalg.inv(safe), np.nan)

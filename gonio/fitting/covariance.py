"""How uncertain are the parameters: the random part from the residuals, and the part all positions share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.columns import BoolArray, FitModel, FloatArray, jacobian, readings

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
    is_s: BoolArray  # (n,)


def without_common(
    model: FitModel, basic: FloatArray, w: FloatArray, residual: FloatArray, common: CommonMode
) -> tuple[FloatArray, FloatArray]:
    """Return residuals (n, m) without what the common modes explain, and the degrees of freedom taken.

    What a baseline error does to S alone the parameters cannot take up; it stays in the residuals and would
    pass for noise.  The amplitudes of the modes are estimated from the residuals with their standard
    uncertainty as prior,

        d = (V' W V / s^2 + 1)^-1 V' W e / s^2,

    V the modes after projection off the parameters, s^2 the variance scale of the residuals, found by
    iteration.
    """
    clean, taken = residual.copy(), np.zeros(len(basic))
    for at in range(0, len(basic), _BLOCK):
        part = slice(at, at + _BLOCK)
        root = np.sqrt(w[:, part].T)
        j = jacobian(model, basic[part]) * root[:, :, None]
        size = np.sqrt(np.sum(j**2, axis=1))
        j = j / np.where(size > 0.0, size, 1.0)[:, None, :]
        v = np.stack(_modes(model, basic[part], common, part), axis=-1) * root.T[:, :, None]
        v = np.swapaxes(v, 0, 1)  # (m, n, modes), as j
        v = v - j @ (np.nan_to_num(inverse(_normal(j, size > 0.0))) @ (np.swapaxes(j, 1, 2) @ v))
        e = residual[:, part].T * root
        gram, pull = np.swapaxes(v, 1, 2) @ v, np.einsum("mnv,mn->mv", v, e)
        count = np.sum(root > 0.0, axis=1) - float(basic.shape[1])
        total = np.sum(e**2, axis=1)
        scale, modes = total / count, np.zeros_like(pull)
        used = np.zeros(len(total))
        for _ in range(6):
            # without noise nothing is left of s^2; rounding of V' W V still is
            least = np.finfo(float).eps * np.trace(gram, axis1=1, axis2=2) + np.finfo(float).tiny
            prior = np.maximum(scale, least)[:, None, None] * np.eye(v.shape[2])
            ridge = np.linalg.solve(gram + prior, np.concatenate([gram, pull[:, :, None]], axis=2))
            modes, used = ridge[:, :, -1], np.trace(ridge[:, :, :-1], axis1=1, axis2=2)
            scale = np.sum((e - np.einsum("mnv,mv->mn", v, modes)) ** 2, axis=1) / (count - used)
        explained = np.einsum("mnv,mv->mn", v, modes) / np.where(root > 0.0, root, np.inf)
        clean[:, part] -= explained.T
        taken[part] = used
    return clean, taken


def _modes(model: FitModel, basic: FloatArray, common: CommonMode, part: slice) -> list[FloatArray]:
    """Return the shift of every reading by one standard uncertainty of each common mode, (n, m) each."""
    scaled = common.gain_u[:, part] * readings(model, basic)
    gains = [np.where(x[:, None], scaled, 0.0) for x in (common.is_s, ~common.is_s) if np.any(x)]
    return [*gains, common.offset_u[:, part]]


def random_and_common(
    model: FitModel, basic: FloatArray, w: FloatArray, held: BoolArray, common: CommonMode | None
) -> tuple[FloatArray, FloatArray]:
    """Return inverse normal matrix and common-mode covariance of the basic parameters, (m, p, p) each.

    The first is ``(J' W J)^-1``, to be scaled by chi2 per degree of freedom.  The second is the sum over
    common modes of ``s s'`` with ``s = (J' W J)^-1 J' W v``, the shift of the optimum by one standard
    uncertainty of that mode, ``v = gain_u r`` or ``offset_u`` over the positions of one
    polarization.  Parameters that are `held` (m, p), or that no reading depends on, have NaN.
    """
    p = basic.shape[1]
    inverted, shared = np.empty((len(basic), p, p)), np.zeros((len(basic), p, p))
    for at in range(0, len(basic), _BLOCK):
        part = slice(at, at + _BLOCK)
        j, free, unit = _scaled(model, basic[part], w[:, part], held[part])
        wj = j * w[:, part].T[:, :, None]
        inverted[part] = inverse(np.swapaxes(wj, 1, 2) @ j + _ones(~free))
        if common is not None:
            for v in _modes(model, basic[part], common, part):
                pull = np.einsum("mna,nm->ma", wj, v)
                shift = np.einsum("mab,mb->ma", inverted[part], pull)
                shared[part] += shift[:, :, None] * shift[:, None, :]
        known = np.where(free, 1.0, np.nan) / unit
        outer = known[:, :, None] * known[:, None, :]
        inverted[part] *= outer
        shared[part] *= outer
    return inverted, shared


def shifts(
    model: FitModel, basic: FloatArray, w: FloatArray, held: BoolArray, change: NDArray[np.float64]
) -> FloatArray:
    """Return how far the optimum moves when readings change, (g, m, p).

    Parameters
    ----------
    change
        (g, n, m): g changes of the readings.  To first order the optimum moves by
        ``(J' W J)^-1 J' W change``; parameters that are `held` (m, p) stay where they are.
    """
    moved = np.zeros((len(change), *basic.shape))
    for at in range(0, len(basic), _BLOCK):
        part = slice(at, at + _BLOCK)
        j, free, unit = _scaled(model, basic[part], w[:, part], held[part])
        wj = j * w[:, part].T[:, :, None]
        inverted = np.nan_to_num(inverse(np.swapaxes(wj, 1, 2) @ j + _ones(~free)))
        pull = np.einsum("mna,gnm->gma", wj, change[:, :, part], optimize=True)
        moved[:, part] = np.einsum("mab,gmb->gma", inverted, pull) * np.where(free, 1.0, 0.0) / unit
    return moved


def leverage(model: FitModel, basic: FloatArray, w: FloatArray) -> FloatArray:
    """Return the diagonal of the hat matrix, (n, m): how much a reading pulls the fit to itself, 0...1."""
    h = np.empty_like(w)
    for at in range(0, len(basic), _BLOCK):
        part = slice(at, at + _BLOCK)
        j = jacobian(model, basic[part]) * np.sqrt(w[:, part].T)[:, :, None]
        size = np.sqrt(np.sum(j**2, axis=1))
        j = j / np.where(size > 0.0, size, 1.0)[:, None, :]
        h[:, part] = np.sum((j @ inverse(_normal(j, size > 0.0))) * j, axis=2).T
    return np.clip(h, 0.0, 1.0)


def _scaled(
    model: FitModel, basic: FloatArray, w: FloatArray, held: BoolArray
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Return the Jacobian with columns of length one, which are free, and the lengths."""
    j = jacobian(model, basic)
    size = np.sqrt(np.einsum("mna,mna,nm->ma", j, j, w))
    count = len(model.linear)
    # a linear column has no unit of its own; a shape moves readings by what its columns' coefficients are
    largest = np.max(size[:, :count], axis=1, keepdims=True)
    moved = np.max(size[:, :count] * np.abs(basic[:, :count]), axis=1, keepdims=True)
    least = np.concatenate([np.repeat(largest, count, 1), np.repeat(moved, size.shape[1] - count, 1)], axis=1)
    free = ~held & (size > _FLAT * least)
    unit = np.where(free, size, 1.0)
    return np.where(free, 1.0, 0.0)[:, None, :] * j / unit[:, None, :], free, unit


def _normal(j: FloatArray, there: BoolArray) -> FloatArray:
    return np.asarray(np.swapaxes(j, 1, 2) @ j + _ones(~there))


def _ones(rows: BoolArray) -> FloatArray:
    """Return (m, p, p) with ones on the diagonal of the parameters in `rows`, (m, p)."""
    return np.where(rows, 1.0, 0.0)[:, :, None] * np.eye(rows.shape[1])


def inverse(normal: FloatArray) -> FloatArray:
    """Return inverses of correlation-scaled normal matrices; NaN where singular to working precision."""
    size = normal.shape[1]
    good = np.linalg.cond(normal) < 1e14
    safe = np.where(good[:, None, None], normal, np.eye(size))
    return np.where(good[:, None, None], np.linalg.inv(safe), np.nan)

"""How noisy is each reading?  A variance function, estimated from the residuals of a first fit.

A goniospectrophotometer's noise has a floor (detector), a part that grows with the signal (shot noise) and a
part proportional to it (flicker of the lamp):

    var(r) = c0 + c1 r + c2 r^2,   all c >= 0,

evaluated at the fitted r, for weights taken from noisy readings would bias the fit.  The coefficients are
found for each wavelength from the squared residuals of its neighbours too, never across a change of the
detector.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

NEIGHBOURS = 7
"""Wavelengths on each side whose residuals are pooled."""

_WILD = 1e3  # times the typical square: a fit that has failed tells nothing about its neighbours
_FAR = 6.0  # residuals beyond so many standard deviations are no noise and do not widen the variance function
_LEVELS = 12  # of the signal, between which medians of squared residuals are compared
_MEDIAN = 0.45493642311957283  # of the square of a standard normal number
_MOST = 1e4  # times the median square, more than a lobe's peak has beside its diffuse light
_FLOOR = 1e-6  # of the mean variance; keeps weights finite where the fitted function touches zero


def variance_function(
    squared_residual: FloatArray,
    model: FloatArray,
    use: NDArray[np.bool_],
    detector_index: NDArray[np.integer],
    *,
    outliers: bool = False,
) -> FloatArray:
    """Return the variance of every reading.

    Parameters
    ----------
    squared_residual
        (n, m), each divided by one minus its leverage, so that its expectation is the variance.
    model
        (n, m) fitted readings.
    use
        (n, m) readings that took part.
    detector_index
        (m,); residuals are pooled among neighbours with the same index.
    outliers
        Whether a good part of the readings may be no measurements: it then begins with medians.

    Returns
    -------
    ndarray
        (n, m), positive; zero everywhere if all residuals are zero.
    """
    there = use & (squared_residual > 0.0)
    if not np.any(there):
        return np.zeros_like(model)
    most = _MOST * np.median(squared_residual[there])  # or one wild reading would set the floor of all
    floor = _FLOOR * float(np.sum(np.minimum(squared_residual, most) * use)) / int(np.sum(use))
    level = np.maximum(np.abs(model), 1e-300)
    typical = np.sum(level * use) / max(int(np.sum(use)), 1)
    columns = np.stack([np.ones_like(level), level / typical, (level / typical) ** 2])  # (3, n, m)
    total, count = np.sum(squared_residual * use, axis=0), np.sum(use, axis=0).astype(np.float64)
    wild = _wild(total / np.maximum(count, 1.0), detector_index)
    pooled_mean = _pooled(total, detector_index, wild) / np.maximum(_pooled(count, detector_index, wild), 1.0)
    variance = np.broadcast_to(pooled_mean, level.shape)
    if outliers:
        variance = _from_medians(squared_residual, level, use)
    variance = np.maximum(variance, floor)
    for _ in range(3):
        near = use & (squared_residual < _FAR**2 * variance)
        weight = near / variance**2  # a squared residual varies as the square of the variance
        normal = np.einsum("anm,bnm,nm->mab", columns, columns, weight, optimize=True)
        right = np.einsum("anm,nm->ma", columns, weight * squared_residual, optimize=True)
        c = _non_negative(_pooled(normal, detector_index, wild), _pooled(right, detector_index, wild))
        variance = np.maximum(np.einsum("ma,anm->nm", c, columns), floor)
    return np.asarray(variance)


def _from_medians(squared: FloatArray, level: FloatArray, use: NDArray[np.bool_]) -> FloatArray:
    """Return a variance for every reading from the median of squares among those of like level."""
    edges = np.quantile(level[use], np.linspace(0.0, 1.0, _LEVELS + 1)[1:-1])
    step = np.searchsorted(edges, level)
    variance = np.zeros_like(level)
    for number in range(_LEVELS):
        here = step == number
        if np.any(here & use):
            variance[here] = np.median(squared[here & use]) / _MEDIAN
    return variance


def _wild(mean_square: FloatArray, detector_index: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return the wavelengths, (m,), with residuals far above the median of their neighbours'."""
    run = _runs(detector_index)
    near = [mean_square]
    for away in range(1, min(NEIGHBOURS, len(run) - 1) + 1):
        gap = np.full(away, np.inf)
        same = run[away:] == run[:-away]
        near.append(np.concatenate([gap, np.where(same, mean_square[:-away], np.inf)]))
        near.append(np.concatenate([np.where(same, mean_square[away:], np.inf), gap]))
    ordered = np.sort(np.stack(near), axis=0)
    middle = (np.sum(np.isfinite(ordered), axis=0) - 1) // 2
    return np.asarray(mean_square > _WILD * ordered[middle, np.arange(len(run))])


def _runs(detector_index: NDArray[np.integer]) -> NDArray[np.intp]:
    """Return a number, (m,), that is the same for wavelengths in a row with one detector."""
    return np.cumsum(np.concatenate([[0], np.diff(detector_index.astype(np.int64)) != 0]))


def _pooled(values: FloatArray, detector_index: NDArray[np.integer], wild: NDArray[np.bool_]) -> FloatArray:
    """Return the sums (m, ...) over each wavelength's neighbours in order, as far as its detector reaches.

    Those that are `wild` (m,) stand alone.
    """
    run = np.where(wild, -1 - np.arange(len(wild)), _runs(detector_index))
    result = values.copy()
    for away in range(1, min(NEIGHBOURS, len(values) - 1) + 1):
        same = (run[away:] == run[:-away]).reshape(-1, *[1] * (values.ndim - 1))
        result[away:] += np.where(same, values[:-away], 0.0)
        result[:-away] += np.where(same, values[away:], 0.0)
    return result


def _non_negative(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Return argmin of ``c' A c / 2 - b' c`` over c >= 0, m times, by trying every active set."""
    m, p = right.shape
    best, value = np.zeros((m, p)), np.zeros(m)
    for size in range(1, p + 1):
        for chosen in itertools.combinations(range(p), size):
            pick = list(chosen)
            a = normal[:, pick][:, :, pick]
            trace = np.trace(a, axis1=1, axis2=2)
            a = a + 1e-12 * np.where(trace > 0.0, trace, 1.0)[:, None, None] * np.eye(size)
            c = np.linalg.solve(a, right[:, pick][:, :, None])[:, :, 0]
            gain = 0.5 * np.sum(c * right[:, pick], axis=1)
            better = np.all(c >= 0.0, axis=1) & (gain > value)
            best[better] = 0.0  # what a smaller set had found
            best[np.flatnonzero(better)[:, None], pick] = c[better]
            value[better] = gain[better]
    return best

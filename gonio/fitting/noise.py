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

_FAR = 6.0  # residuals beyond so many standard deviations are no noise and do not widen the variance function
_LEVELS = 12  # of the signal, between which medians of squared residuals are compared
_MEDIAN = 0.45493642311957283  # of the square of a standard normal number
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
    mean = np.sum(squared_residual * use) / max(int(np.sum(use)), 1)
    if mean == 0.0:
        return np.zeros_like(model)
    level = np.maximum(np.abs(model), 1e-300)
    typical = np.sum(level * use) / max(int(np.sum(use)), 1)
    columns = np.stack([np.ones_like(level), level / typical, (level / typical) ** 2])  # (3, n, m)
    total, count = np.sum(squared_residual * use, axis=0), np.sum(use, axis=0).astype(np.float64)
    pooled_mean = _pooled(total, detector_index) / np.maximum(_pooled(count, detector_index), 1.0)
    variance = np.broadcast_to(pooled_mean, level.shape)
    if outliers:
        variance = _from_medians(squared_residual, level, use)
    variance = np.maximum(variance, _FLOOR * mean)
    for _ in range(3):
        near = use & (squared_residual < _FAR**2 * variance)
        weight = near / variance**2  # a squared residual varies as the square of the variance
        normal = np.einsum("anm,bnm,nm->mab", columns, columns, weight, optimize=True)
        right = np.einsum("anm,nm->ma", columns, weight * squared_residual, optimize=True)
        c = _non_negative(_pooled(normal, detector_index), _pooled(right, detector_index))
        variance = np.maximum(np.einsum("ma,anm->nm", c, columns), _FLOOR * mean)
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


def _pooled(values: FloatArray, detector_index: NDArray[np.integer]) -> FloatArray:
    """Return the sums (m, ...) over each wavelength's neighbours in order, as far as its detector reaches."""
    run = np.cumsum(np.concatenate([[0], np.diff(detector_index.astype(np.int64)) != 0]))
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

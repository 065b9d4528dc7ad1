"""How much does a reading far from the fit count?  Robust losses, by iterated weights.

Residuals u in units of their standard deviation have weight ``psi(u)/u``: Huber (1964), ``psi = u`` up to
1.345 and constant beyond, and Tukey's biweight (1974), ``psi = u (1 - (u/4.685)^2)^2``, zero beyond 4.685.
Both keep 95 % efficiency for normal noise.  The standard deviation is 1.4826 times the median of |u|.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Loss = Literal["squares", "huber", "tukey"]

_HUBER, _TUKEY = 1.345, 4.685
_MAD = 1.4826022185056018  # 1 / (75 % quantile of the normal distribution)


def robust_scale(u: FloatArray, use: BoolArray, parameters: int) -> FloatArray:
    """Return the standard deviation of the bulk of residuals u (n, m), by columns, (m,).

    The median is of the used residuals but the smallest `parameters`, which the fit has made small.
    """
    size = np.sort(np.where(use, np.abs(u), np.inf), axis=0)
    count = np.sum(use, axis=0)
    rank = parameters + (count - parameters - 1) / 2.0
    low, high = np.floor(rank).astype(int), np.ceil(rank).astype(int)
    columns = np.arange(u.shape[1])
    return np.asarray(_MAD * 0.5 * (size[low, columns] + size[high, columns]))


def weight_factor(u: FloatArray, loss: Loss) -> FloatArray:
    """Return ``psi(u)/u``, 0...1, of residuals in standard deviations."""
    if loss == "huber":
        return np.asarray(_HUBER / np.maximum(np.abs(u), _HUBER))
    if loss == "tukey":
        return np.asarray(np.where(np.abs(u) < _TUKEY, (1.0 - (u / _TUKEY) ** 2) ** 2, 0.0))
    return np.ones_like(u)


def variance_factor(u: FloatArray, use: BoolArray, loss: Loss, parameters: int) -> FloatArray:
    """Return the factor on ``(J'WJ)^-1`` in units of the scale squared, (m,): Huber's (1973) formula.

    ``n/(n - p) mean(psi^2) / mean(psi')^2 (1 + p var(psi') / (n mean(psi')^2))^2``.
    """
    count = np.sum(use, axis=0).astype(np.float64)
    psi = np.where(use, u * weight_factor(u, loss), 0.0)
    if loss == "huber":
        slope = np.where(np.abs(u) < _HUBER, 1.0, 0.0)
    elif loss == "tukey":
        x = (u / _TUKEY) ** 2
        slope = np.where(x < 1.0, (1.0 - x) * (1.0 - 5.0 * x), 0.0)
    else:
        slope = np.ones_like(u)
    slope = np.where(use, slope, 0.0)
    mean = np.sum(slope, axis=0) / count
    spread = np.sum(np.where(use, (slope - mean) ** 2, 0.0), axis=0) / count
    correction = 1.0 + parameters * spread / (count * mean**2)
    return np.asarray(np.sum(psi**2, axis=0) / (count - parameters) / mean**2 * correction**2)

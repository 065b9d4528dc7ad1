"""Several equal first-order low-passes in a row: how mean and noise of each pass through them, exactly.

Stage k obeys ``tau dy_k/dt = y_(k-1) - y_k``; ``y_0`` is the input.  In ``u = dt / tau`` the stages forget as

    y_k(u) = sum_(j<=k) exp(-u) u^(k-j) / (k-j)!  y_j(0)

and white noise at the input leaves them with the covariances ``(sigma_1^2 / tau) Q_ij(u)``,

    Q_ij = integral_0^u  s^(i+j-2) exp(-2 s) / ((i-1)! (j-1)!) ds
         = C(i+j-2, i-1) 2^-(i+j-1) P(i+j-1, 2u)

where P is the regularised lower incomplete gamma function.  For one stage this is the Ornstein-Uhlenbeck
process.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc

Array = NDArray[np.float64]


def response(stages: Array, duration_s: float, tau_s: float, inputs: Array) -> Array:
    """Return the stages of several chains after their inputs went straight from one value to another.

    Parameters
    ----------
    stages
        (n_chain, n_stage) float64, V: before.
    duration_s, tau_s
        How long it took, and the time constant of each stage.
    inputs
        (n_chain, 2) float64, V: at the beginning and at the end.
    """
    left = decay(stages.shape[1], _rounded(duration_s / tau_s)).T
    start, end = inputs[:, :1], inputs[:, 1:]
    change = end - start
    if not change.any():
        return np.asarray(end + (stages - end) @ left)
    # a ramp that has run for ever leaves stage k behind by k time constants
    settled = start - change * (tau_s / duration_s) * np.arange(1, stages.shape[1] + 1)
    return np.asarray(settled + change + (stages - settled) @ left)


def _rounded(u: float) -> float:
    """Round to 12 digits, so that equal steps of time, different by their last bit, share a matrix."""
    return float(f"{u:.12g}")


@lru_cache(maxsize=64)
def decay(order: int, u: float) -> Array:
    """Return what is left of the stages after `u` time constants without input, (order, order) float64."""
    left = np.zeros((order, order))
    for k in range(order):
        for j in range(k + 1):
            left[k, j] = math.exp(-u) * u ** (k - j) / math.factorial(k - j)
    return left


def kick(order: int, u: float) -> Array:
    """Return the matrix that makes the fresh noise of `u` time constants from standard normal numbers.

    (order, order) float64, lower triangular, in units of ``sigma_1 / sqrt(tau)``.
    """
    return _kick(order, _rounded(u))


@lru_cache(maxsize=64)
def _kick(order: int, u: float) -> Array:
    index = np.arange(1, order + 1)
    total = index[:, None] + index[None, :]
    ways = np.array([[math.comb(i + j - 2, i - 1) for j in index] for i in index])
    covariance = ways * 0.5 ** (total - 1) * gammainc(total - 1, 2.0 * u)
    sd = np.sqrt(np.diag(covariance))
    if not np.all(sd > 0):
        return np.zeros((order, order))  # no time has passed
    # scaled to a correlation first: stage k gathers noise as u^(k-1/2), which spans many decades
    return np.asarray(sd[:, None] * np.linalg.cholesky(covariance / np.outer(sd, sd)))

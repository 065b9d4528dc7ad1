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


def response(stages: Array, duration_s: float, tau_s: float, start_v: float, end_v: float) -> Array:
    """Return the stages after an input that went straight from `start_v` to `end_v`.

    Parameters
    ----------
    stages
        (n_stage,) float64, V: before.
    duration_s, tau_s
        How long it took, and the time constant of each stage.
    """
    slope = (end_v - start_v) / duration_s if duration_s > 0 else 0.0
    # a ramp that has run for ever leaves stage k behind by k time constants
    behind = slope * tau_s * np.arange(1, len(stages) + 1)
    settled = start_v - behind
    return np.asarray(
        settled + slope * duration_s + decay(len(stages), duration_s / tau_s) @ (stages - settled)
    )


@lru_cache(maxsize=64)
def decay(order: int, u: float) -> Array:
    """Return what is left of the stages after `u` time constants without input, (order, order) float64."""
    left = np.zeros((order, order))
    for k in range(order):
        for j in range(k + 1):
            left[k, j] = math.exp(-u) * u ** (k - j) / math.factorial(k - j)
    return left


@lru_cache(maxsize=64)
def kick(order: int, u: float) -> Array:
    """Return the matrix that makes the fresh noise of `u` time constants from standard normal numbers.

    (order, order) float64, lower triangular, in units of ``sigma_1 / sqrt(tau)``.
    """
    index = np.arange(1, order + 1)
    total = index[:, None] + index[None, :]
    ways = np.array([[math.comb(i + j - 2, i - 1) for j in index] for i in index])
    covariance = ways * 0.5 ** (total - 1) * gammainc(total - 1, 2.0 * u)
    sd = np.sqrt(np.diag(covariance))
    if not np.all(sd > 0):
        return np.zeros((order, order))  # no time has passed
    # scaled to a correlation first: stage k gathers noise as u^(k-1/2), which spans many decades
    return np.asarray(sd[:, None] * np.linalg.cholesky(covariance / np.outer(sd, sd)))

"""By how much do two runs differ at most?  Bounds from pairs of replicas that share their random numbers.

Two scenes run with one seed use the same points in every replica, so what they have in common cancels in the
difference, replica by replica.  Let d be the mean difference of a receiver's patches over R replicas, S the
covariance of d's error, and |.| the root mean square over the patches (weighted with their area).  Two bounds
of the true difference x, of which the lower one is taken:

    |x| <= |d| + t sqrt(tr S),
    |x| <= t s + sqrt(t^2 s^2 + max(|d|^2 - (tr S - 2 sqrt(a tr S^2)), 0)),      s^2 = sqrt(tr S^2).

The first holds for any correlation.  The second is better where the errors of many patches are independent:
|d|^2 then holds their noise, which is known and can be taken off.  It solves ``|d|^2 = |x|^2 + 2 <x, e> +
|e|^2`` for |x| with a lower limit for each of the last two terms: s^2 is no less than the largest eigenvalue
of S, and the quadratic form's by Laurent and Massart (2000), Annals of Statistics 28, lemma 1.
t is Student's quantile at 1 - 1e-4 for R - 1 degrees of freedom and a = -ln(1e-4).  tr S and tr S^2 are
estimated without bias for normal errors; tr S^2 is then taken half as large again.

The bound of a receiver's mean follows: a mean is at most the root mean square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MISS = 1e-4
"""Probability that one limit of a bound fails."""

_MARGIN = 1.5  # of tr S^2, whose estimate from 16 replicas scatters by some ten per cent


@dataclass(frozen=True, slots=True)
class Difference:
    """Of two runs, for each receiver: W/m2, (receivers,)."""

    mean: FloatArray
    standard_error: FloatArray  # of `mean`
    rms: FloatArray  # over the patches, noise included
    noise: FloatArray  # t sqrt(tr S) + what photons may have missed
    bound: FloatArray  # of the root mean square over the patches, and so of the mean

    @property
    def least(self) -> FloatArray:
        """Lower bound of the root mean square over the patches."""
        return np.maximum(self.rms - self.noise, 0.0)


def difference(d: FloatArray, cells: list[tuple[slice, FloatArray]], unseen: FloatArray) -> Difference:
    """Return the bounds of a difference.

    Parameters
    ----------
    d
        (cells, replicas) W/m2.
    cells
        Of each receiver the slice of its cells, and their parts of its area (adding up to 1).
    unseen
        (receivers,) W/m2, what light that found no way into either run may add.
    """
    rows = []
    for (here, weight), missed in zip(cells, unseen, strict=True):
        mean = weight @ d[here]
        rms, noise, bound = rms_bound(d[here], weight)
        rows.append((mean.mean(), standard_errors(mean), rms, noise + missed, bound + missed))
    return Difference(*(np.array(column, np.float64) for column in zip(*rows, strict=True)))


def rms_bound(d: FloatArray, weight: FloatArray) -> tuple[float, float, float]:
    """Return ``(|d|, t sqrt(tr S), upper bound of |x|)`` of one receiver; `d` (cells, replicas)."""
    count = d.shape[1]
    value = d.mean(axis=1)
    square = float(weight @ value**2)
    scatter = (d - value[:, None]) * np.sqrt(weight)[:, None]
    gram = scatter.T @ scatter / (count - 1)
    trace, trace2 = float(np.trace(gram)) ** 2, float(np.sum(gram**2))  # (tr C)^2 and tr C^2 of the sample
    m = count - 1
    unbiased = (trace2 - trace / m) / (1.0 + 1.0 / m - 2.0 / m**2)
    squares = min(_MARGIN * max(unbiased, trace / max(len(d), 1)), trace)
    total, root = math.sqrt(trace) / count, math.sqrt(squares) / count  # tr S, sqrt(tr S^2)
    t = quantile(count)
    noise = t * math.sqrt(total)
    any_correlation = math.sqrt(square) + noise
    known = max(total - 2.0 * math.sqrt(-math.log(MISS)) * root, 0.0)
    independent = t * math.sqrt(root) + math.sqrt(t**2 * root + max(square - known, 0.0))
    return math.sqrt(square), noise, min(any_correlation, independent)


def standard_errors(replicas: FloatArray) -> FloatArray:
    """Return the standard error of the mean over the last axis."""
    return np.asarray(replicas.std(axis=-1, ddof=1) / math.sqrt(replicas.shape[-1]))


@cache
def quantile(replicas: int) -> float:
    """Return Student's one-sided quantile at 1 - 1e-4 with one degree of freedom less than replicas."""
    from scipy import special

    return float(special.stdtrit(replicas - 1, 1.0 - MISS))

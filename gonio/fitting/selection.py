"""Which of several models do the readings prefer, and does the preferred one describe them?

AICc ranks models that were fitted to the same readings with the same weights; the runs test asks of each
alone whether its residuals keep their sign along a sweep, as those of a lobe of the wrong shape do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

FloatArray = NDArray[np.float64]

_SAME_INCIDENCE_DEG = 0.5


def aicc(chi2: ArrayLike, count: ArrayLike, parameters: ArrayLike) -> FloatArray:
    """Return AICc of weighted least squares with the scale of the variance fitted too.

    ``n ln(chi2 / n) + 2 K + 2 K (K + 1)/(n - K - 1)``, K the parameters and the scale (Hurvich and Tsai,
    Biometrika 76 (1989) 297).  The weights' own part is left out, so that only fits with the same weights can
    be compared.

    Parameters
    ----------
    chi2
        Weighted sum of squared residuals, broadcast against the others.
    count
        n, the readings that were used.
    parameters
        Fitted parameters, without the scale.

    Returns
    -------
    ndarray
        NaN where ``n <= K + 1`` or chi2 is not positive.
    """
    chi2, n, k = np.broadcast_arrays(
        *(np.asarray(x, np.float64) for x in (chi2, count, np.asarray(parameters, np.float64) + 1.0))
    )
    good = (n > k + 1.0) & (chi2 > 0.0)
    n, k = np.where(good, n, 10.0), np.where(good, k, 1.0)
    value = n * np.log(np.where(good, chi2, 1.0) / n) + 2.0 * k + 2.0 * k * (k + 1.0) / (n - k - 1.0)
    return np.asarray(np.where(good, value, np.nan))


def akaike(result: FitResult) -> FloatArray:
    """Return `aicc` of every wavelength of a fit, (m,)."""
    n = np.sum(np.isfinite(result.residual), axis=0)
    return aicc(result.chi2, n, n - result.dof)


def akaike_weights(values: FloatArray) -> FloatArray:
    """Return the weights of evidence of models from their AICc, (models, ...): ``exp(-difference/2)``, sum 1.

    A model with NaN has no weight; where all are NaN so are the weights.
    """
    values = np.asarray(values, np.float64)
    known = np.isfinite(values)
    least = np.min(np.where(known, values, np.inf), axis=0)
    relative = np.where(known, np.exp(-0.5 * (values - np.where(np.isfinite(least), least, 0.0))), 0.0)
    total = np.sum(relative, axis=0)
    return np.asarray(np.where(total > 0.0, relative / np.where(total > 0.0, total, 1.0), np.nan))


def runs_excess(
    residual: FloatArray, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return the number of runs of one sign beyond the expected one, and its variance by chance, (m,) each.

    Wald and Wolfowitz (Ann. Math. Statist. 11 (1940) 147), along theta_o within each incidence and
    polarization; the counts of these sweeps are added.  With a residuals above and b below zero in random
    order, runs have the mean ``1 + 2ab/(a + b)`` and the variance ``2ab(2ab - a - b)/((a + b)^2 (a + b -
    1))``.

    Parameters
    ----------
    residual
        (n, m), weighted or not; NaN or 0 where a reading was not used.
    theta_i_deg, theta_o_deg, is_s
        (n,) positions; incidences within half a degree are one.
    """
    excess, variance = np.zeros(residual.shape[1]), np.zeros(residual.shape[1])
    order = np.argsort(theta_i_deg, kind="stable")
    steps = np.concatenate([[0], np.cumsum(np.diff(theta_i_deg[order]) > _SAME_INCIDENCE_DEG)])
    sweep = np.empty(len(order), int)
    sweep[order] = steps
    for number in range(int(steps[-1]) + 1):
        for chosen in (is_s, ~is_s):
            rows = np.flatnonzero((sweep == number) & chosen)
            if not rows.size:
                continue
            sign = np.sign(np.nan_to_num(residual[rows[np.argsort(theta_o_deg[rows], kind="stable")]]))
            above, below = np.sum(sign > 0.0, axis=0), np.sum(sign < 0.0, axis=0)
            # a reading that was not used takes the sign before it, and begins no run
            last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(rows.size)[:, None], -1), axis=0)
            held = np.where(last >= 0, np.take_along_axis(sign, np.maximum(last, 0), axis=0), 0.0)
            runs = 1.0 + np.sum((held[1:] != held[:-1]) & (held[:-1] != 0.0), axis=0)
            count, product = (above + below).astype(np.float64), 2.0 * above * below
            both = product > 0.0
            count = np.where(both, count, 2.0)
            excess += np.where(both, runs - 1.0 - product / count, 0.0)
            variance += np.where(both, product * (product - count) / (count**2 * (count - 1.0)), 0.0)
    return excess, variance


def _probability(excess: ArrayLike, variance: ArrayLike) -> FloatArray:
    excess, variance = np.asarray(excess, np.float64), np.asarray(variance, np.float64)
    known = variance > 0.0
    z = (excess + 0.5) / np.sqrt(np.where(known, variance, 1.0))  # a count of k reaches to k + 1/2
    return np.asarray(np.where(known, special.ndtr(z), np.nan))


def runs_probability(
    residual: FloatArray, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: NDArray[np.bool_]
) -> FloatArray:
    """Return the probability of as few runs of one sign by chance, (m,); arguments as `runs_excess`.

    A model of the wrong shape leaves residuals that keep their sign from position to position, and a small
    probability.  So does whatever else positions share, without any fault of the model: a baseline error
    shifts a whole polarization, a drift a part of a sweep.  NaN where no sweep has both signs.
    """
    return _probability(*runs_excess(residual, theta_i_deg, theta_o_deg, is_s))


def combined_runs_probability(
    residual: FloatArray, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: NDArray[np.bool_]
) -> float:
    """Return `runs_probability` of all wavelengths together: their counts of runs added.

    Wavelengths are taken as independent.  A shape that is slightly wrong shows here long before it does at
    any one wavelength.
    """
    excess, variance = runs_excess(residual, theta_i_deg, theta_o_deg, is_s)
    return float(_probability(np.sum(excess), np.sum(variance)))

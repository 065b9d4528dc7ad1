"""What is pooled over neighbouring wavelengths: always within one detector.

Few repeats give few degrees of freedom; neighbouring wavelengths of the same detector have nearly the same
noise, those on the other side of the detector change have not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.devices import FloatArray

POOLED_DOF = 30
"""Degrees of freedom that a pooled variance should have: its own relative standard error is then 26 %."""


def moving_sum(values: FloatArray, detector_index: NDArray[np.uint8], half_width: int) -> FloatArray:
    """Return the sum over the window of 2 half_width + 1 wavelengths around each, within its detector.

    Parameters
    ----------
    values : (..., m) float64, finite
    detector_index : (m,)
    half_width : neighbours on each side; the window is cut at the ends and at a detector change
    """
    total: FloatArray = np.empty_like(values)
    edges = np.flatnonzero(np.diff(detector_index.astype(np.int16)) != 0) + 1
    for low, high in zip([0, *edges], [*edges, len(detector_index)], strict=True):
        part = values[..., low:high]
        running = np.concatenate([np.zeros((*part.shape[:-1], 1)), np.cumsum(part, axis=-1)], axis=-1)
        at = np.arange(high - low)
        first, last = np.maximum(at - half_width, 0), np.minimum(at + half_width + 1, high - low)
        total[..., low:high] = running[..., last] - running[..., first]
    return total


def pooled_variance(
    variance: FloatArray, dof: FloatArray, detector_index: NDArray[np.uint8], min_dof: int = POOLED_DOF
) -> FloatArray:
    """Return the variance pooled over neighbouring wavelengths until it has `min_dof` degrees of freedom.

    Parameters
    ----------
    variance : (..., m) float64; NaN is left out
    dof : (..., m) float64, degrees of freedom of each
    detector_index : (m,)

    Returns
    -------
    (..., m) float64, weighted by degrees of freedom; NaN where the window holds none
    """
    weight = np.where(np.isfinite(variance), dof, 0.0)
    typical = float(np.median(weight[weight > 0])) if np.any(weight > 0) else 0.0
    if typical == 0.0:
        return np.full_like(variance, np.nan)
    half_width = max(0, int(np.ceil((min_dof / typical - 1.0) / 2.0)))
    weighted = moving_sum(
        np.where(weight > 0, weight * np.nan_to_num(variance), 0.0), detector_index, half_width
    )
    total = moving_sum(weight, detector_index, half_width)
    with np.errstate(invalid="ignore", divide="ignore"):
        # the running sums leave a rounding error of the size of the largest variance in them
        return np.where(total > 0.5, np.maximum(weighted, 0.0) / total, np.nan)

"""Where dark and baseline were between two references, and how far they may have been from there.

The value is the straight line between the references on either side.  Its variance, at the fraction w of the
way between neighbours whose values differ by delta, is the sum of three:

    (1 - w)^2 v_k + w^2 v_k+1           the scatter of the two references themselves
    delta^2 (1/12 + (w - 1/2)^2)        the value changed from the one to the other at no known time
    the larger of  q dt w (1 - w)       it walks at random, at the rate q seen from reference to reference,
              and  e^2                  and what leaving out each inner reference in turn shows besides

The second is the mean square about the line of a value that is anywhere between the two references with
equal probability.  A change that goes one way only, at whatever time and however suddenly, is therefore never
off by more than twice its root (equality for a step after a third of the way).  The third needs no such
assumption, but sees only what several references see; with two references, second and third add up to
delta^2 / 3, the rectangle of half-width delta.  Reasons and coverage: docs/decisions/drift.md.

delta is freed of the references' own scatter.  It is pooled over the wavelengths of the detector and over
those nearby, and the larger counts: one lamp, but its blue may age faster.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.devices import FloatArray
from gonio.store.pooling import moving_sum

_NEARBY = 7  # wavelengths on each side over which a change is pooled: its scatter falls to a quarter


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """References of one kind and polarization in order of time; arrays (k, m) without gaps.

    Attributes
    ----------
    variance : (k, m), of the value, that is of the mean of the repeats
    step_variance : (k - 1, m), delta^2
    walk_rate : (m,), q, per second
    misfit_variance : (m,), e^2
    """

    time_s: FloatArray
    value_v: FloatArray
    variance: FloatArray
    step_variance: FloatArray
    walk_rate: FloatArray
    misfit_variance: FloatArray

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return value and variance at `time_s` (n, m), held beyond both ends, where the walk goes on."""
        k = len(self.time_s)
        if k == 1:
            return (
                np.broadcast_to(self.value_v, time_s.shape).copy(),
                np.broadcast_to(self.variance, time_s.shape).copy(),
            )
        passed = self._passed(time_s)
        low, high = np.clip(passed - 1, 0, k - 2), np.clip(passed, 1, k - 1)
        start_s, end_s = _take(self.time_s, low), _take(self.time_s, high)
        with np.errstate(invalid="ignore", divide="ignore"):
            w = np.where(end_s > start_s, np.clip((time_s - start_s) / (end_s - start_s), 0.0, 1.0), 0.0)
        value = (1.0 - w) * _take(self.value_v, low) + w * _take(self.value_v, high)
        variance = (1.0 - w) ** 2 * _take(self.variance, low) + w**2 * _take(self.variance, high)
        variance += _take(self.step_variance, low) * (1.0 / 12.0 + (w - 0.5) ** 2)
        beyond_s = np.maximum(np.maximum(start_s - time_s, time_s - end_s), 0.0)
        walked = self.walk_rate * ((end_s - start_s) * w * (1.0 - w) + beyond_s)
        return value, variance + np.maximum(walked, self.misfit_variance)

    def _passed(self, time_s: FloatArray) -> NDArray[np.intp]:
        """Return how many references are not later than each time, comparing only those that may be."""
        known = time_s[np.isfinite(time_s)]
        if known.size == 0:
            return np.zeros(time_s.shape, dtype=np.intp)
        first = int(np.searchsorted(np.maximum.accumulate(self.time_s.max(axis=1)), known.min(), "right"))
        last = int(np.searchsorted(self.time_s.min(axis=1), known.max(), "right"))
        passed = np.full(time_s.shape, first, dtype=np.intp)
        for reference in self.time_s[first:last]:
            passed += time_s >= reference
        return passed


def joined(
    time_s: FloatArray,
    value_v: FloatArray,
    variance: FloatArray,
    detector_index: NDArray[np.uint8],
    *,
    relative: bool,
) -> Series:
    """Return the series of references, each (k, m) in order of time, NaN where a reference has no value.

    Parameters
    ----------
    relative
        Changes are pooled over wavelengths relative to the value (a lamp) instead of in volts (an amplifier).
    """
    value_v, time_s, variance = fill_gaps(value_v, time_s, variance)
    k, m = value_v.shape
    scale = np.abs(value_v) if relative else np.ones((k, m))
    noise = np.nan_to_num(variance)
    span_s = np.diff(time_s, axis=0)
    between = 0.5 * (scale[1:] + scale[:-1])
    step = (
        _pooled(np.diff(value_v, axis=0) ** 2 - noise[1:] - noise[:-1], between, detector_index) * between**2
    )
    rate, misfit = np.zeros(m), np.zeros(m)
    moved = span_s > 0  # a gap that was filled has its neighbour's time
    if np.any(moved):
        with np.errstate(invalid="ignore", divide="ignore"):
            each = np.where(moved, step / span_s, np.nan)
        rate = _mean(each)
    if k > 2:
        misfit = _left_out(time_s, value_v, noise, scale, detector_index)
    return Series(time_s, value_v, variance, step, rate, misfit)


def _left_out(
    time_s: FloatArray,
    value_v: FloatArray,
    noise: FloatArray,
    scale: FloatArray,
    detector_index: NDArray[np.uint8],
) -> FloatArray:
    """Return the mean square by which inner references are off the line between their neighbours, (m,)."""
    span_s = time_s[2:] - time_s[:-2]
    with np.errstate(invalid="ignore", divide="ignore"):
        w = np.where(span_s > 0, (time_s[1:-1] - time_s[:-2]) / span_s, np.nan)
    off = value_v[1:-1] - (1.0 - w) * value_v[:-2] - w * value_v[2:]
    excess = off**2 - noise[1:-1] - (1.0 - w) ** 2 * noise[:-2] - w**2 * noise[2:]
    inner = len(off)
    # few references give a mean square that is often too small by chance: at one, three times it
    doubt = (inner + 2.0) / inner
    pooled = _mean(_pooled(excess, scale[1:-1], detector_index))
    return np.asarray(doubt * pooled * np.mean(scale, axis=0) ** 2)


def _pooled(excess: FloatArray, scale: FloatArray, detector_index: NDArray[np.uint8]) -> FloatArray:
    """Return the relative excess (k, m), pooled over the detector or nearby, whichever is larger."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = excess / scale**2
    known = np.isfinite(ratio)
    ratio = np.where(known, ratio, 0.0)
    pooled = np.zeros_like(ratio)
    for half_width in (_NEARBY, len(detector_index)):
        count = moving_sum(known.astype(np.float64), detector_index, half_width)
        mean = moving_sum(ratio, detector_index, half_width) / np.maximum(count, 1.0)
        pooled = np.maximum(pooled, mean)
    return pooled


def _mean(values: FloatArray) -> FloatArray:
    """Return the mean over the first axis of what is known; 0 where nothing is."""
    known = np.isfinite(values)
    return np.asarray(np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))


def _take(values: FloatArray, index: NDArray[np.intp]) -> FloatArray:
    return np.take_along_axis(values, index, axis=0)


def fill_gaps(
    value: FloatArray, time_s: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Replace each bad reading of a series (k, m) by the one before, or by the first good one after."""
    value, time_s, variance = value.copy(), time_s.copy(), variance.copy()
    k = len(value)
    for order in (range(1, k), range(k - 2, -1, -1)):
        for here in order:
            there = here - 1 if order.step > 0 else here + 1
            gap = ~np.isfinite(value[here]) & np.isfinite(value[there])
            if np.any(gap):
                for array in (value, time_s, variance):
                    array[here, gap] = array[there, gap]
    return value, time_s, variance

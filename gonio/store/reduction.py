"""From volts to r: dark and baseline interpolated in time, and what their scatter says of the uncertainty.

    r = (V - D) / (B - D)

V is the reading, D and B are the dark and the 100 % baseline of the same wavelength and polarization at
the time of the reading.  Between two references they are taken to change linearly; before the first and
after the last the nearest holds.  Three parts of the uncertainty are kept apart, since a fit must treat
them differently:

random, `r_sd`
    u(V) / (B - D), independent from reading to reading.  The variance of one reading goes from that of
    the dark to that of the full beam in proportion to the signal, as photon noise does, var(V) = var_D +
    (var_B - var_D)+ (V - D)/(B - D); noise of the source, which goes with the square of the signal, is
    overestimated by this, never underestimated.  A reading that was itself repeated brings its own
    scatter.
gain, `gain_u`
    u(B) / (B - D), relative, common to the positions of one polarization.
offset, `offset_u`
    u(D) / (B - D), common to all positions, since the dark is one for both polarizations.

u(B) and u(D) hold the scatter of the reference readings and the doubt in the interpolation: the change
between two references is taken as one realisation of a random walk, whose bridge has the variance delta^2
w (1 - w) at the fraction w of the way (pooled over the wavelengths of a detector, after the scatter is
taken off).

Few repeats give few degrees of freedom, so variances are pooled over neighbouring wavelengths of the same
detector, never across the detector change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.devices import FloatArray, Quality
from gonio.store.records import ReferenceKind, ReferenceRecord

POOLED_DOF = 30
"""Degrees of freedom that a pooled variance should have: its own relative standard error is then 26 %."""

_BAD = np.uint16(Quality.OVER_RANGE | Quality.REFUSED | Quality.NOT_MEASURED)


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """Corrected readings, each (n, m); see the module for what they are.  NaN where there is no value."""

    r: FloatArray
    r_sd: FloatArray
    dark_v: FloatArray
    baseline_v: FloatArray
    gain_u: FloatArray
    offset_u: FloatArray


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


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """References of one kind and polarization in order of time; arrays (k, m), gaps filled by the nearest."""

    time_s: FloatArray
    value_v: FloatArray
    variance: FloatArray  # of the value, that is of the mean of the repeats
    walk_variance: FloatArray  # (k - 1, m): squared change between neighbours, pooled over the detector

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return value and variance interpolated linearly to `time_s` (n, m), held beyond both ends."""
        k = len(self.time_s)
        if k == 1:
            nearest = (
                np.broadcast_to(self.value_v, time_s.shape),
                np.broadcast_to(self.variance, time_s.shape),
            )
            return nearest[0].copy(), nearest[1].copy()
        passed = np.zeros(time_s.shape, dtype=np.intp)
        for reference in self.time_s:
            passed += time_s >= reference
        low, high = np.clip(passed - 1, 0, k - 1), np.clip(passed, 0, k - 1)

        def take(values: FloatArray, index: NDArray[np.intp]) -> FloatArray:
            return np.take_along_axis(values, index, axis=0)

        start_s, span_s = take(self.time_s, low), take(self.time_s, high) - take(self.time_s, low)
        with np.errstate(invalid="ignore", divide="ignore"):
            w = np.where(span_s > 0, (time_s - start_s) / span_s, 0.0)
        value = (1.0 - w) * take(self.value_v, low) + w * take(self.value_v, high)
        variance = (1.0 - w) ** 2 * take(self.variance, low) + w**2 * take(self.variance, high)
        if k > 1:
            variance = variance + w * (1.0 - w) * take(self.walk_variance, np.minimum(low, k - 2))
        return value, variance


class Reduction:
    """Turns readings into r with the references that there are so far.

    Parameters
    ----------
    references
        All references of the scan, in any order.
    detector_index : (m,) uint8
    """

    def __init__(self, references: Sequence[ReferenceRecord], detector_index: NDArray[np.uint8]) -> None:
        self._detector_index = detector_index
        by_kind: dict[ReferenceKind, list[ReferenceRecord]] = {"dark": [], "baseline": []}
        for reference in sorted(references, key=lambda reference: float(np.nanmean(reference.time_s))):
            by_kind[reference.kind].append(reference)
        self._dark_var = self._single_reading_variance(by_kind["dark"], relative=False)
        self._baseline_relative_var = self._single_reading_variance(by_kind["baseline"], relative=True)
        self._dark = self._series(by_kind["dark"], self._dark_var, relative=False)
        self._baseline = {
            polarization: self._series(
                [r for r in by_kind["baseline"] if r.polarization == polarization],
                self._baseline_relative_var,
                relative=True,
            )
            for polarization in ("s", "p")
        }

    def _single_reading_variance(self, references: list[ReferenceRecord], *, relative: bool) -> FloatArray:
        """Return the variance of one reading, (m,): V^2 for the dark, relative for the baseline."""
        m = len(self._detector_index)
        if not references:
            return np.full(m, np.nan)
        value = np.stack([_good(reference) for reference in references])
        sd = np.stack([reference.signal_sd_v for reference in references])
        dof = _averages(references, m) - 1.0
        with np.errstate(invalid="ignore", divide="ignore"):
            variance = np.where(np.isfinite(value), (sd / value if relative else sd) ** 2, np.nan)
        weight = np.where(np.isfinite(variance), dof, 0.0)
        total = weight.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(total > 0, (weight * np.nan_to_num(variance)).sum(axis=0) / total, np.nan)
        return pooled_variance(mean, total, self._detector_index)

    def _series(
        self, references: list[ReferenceRecord], single_var: FloatArray, *, relative: bool
    ) -> Series | None:
        if not references:
            return None
        value = np.stack([_good(reference) for reference in references])
        time_s = np.stack([reference.time_s for reference in references])
        averages = _averages(references, value.shape[1])
        variance = single_var * (value**2 if relative else 1.0) / averages
        value, time_s, variance = _fill_gaps(value, time_s, variance)
        walk = np.zeros((max(len(references) - 1, 0), value.shape[1]))
        for k in range(len(references) - 1):
            scale = 0.5 * np.abs(value[k] + value[k + 1]) if relative else np.ones(value.shape[1])
            with np.errstate(invalid="ignore", divide="ignore"):
                excess = (np.diff(value[k : k + 2], axis=0)[0] / scale) ** 2
                excess -= np.nan_to_num(variance[k] + variance[k + 1]) / scale**2
            for detector in np.unique(self._detector_index):
                own = self._detector_index == detector
                seen = excess[own & np.isfinite(excess)]
                pooled = max(float(seen.mean()), 0.0) if len(seen) else 0.0
                walk[k, own] = pooled * scale[own] ** 2
        return Series(time_s, value, variance, walk)

    def apply(
        self,
        raw_v: FloatArray,
        raw_sd_v: FloatArray,
        averages: NDArray[np.integer],
        time_s: FloatArray,
        polarization: Sequence[str],
    ) -> Reduced:
        """Return the corrected values of n positions.

        Parameters
        ----------
        raw_v, raw_sd_v, time_s : (n, m) float64
            Mean and single-reading standard deviation in volts, and seconds since the scan began.
        averages : (n,) or (n, m) int
        polarization : n of ``"s"`` or ``"p"``
        """
        shape = raw_v.shape
        averages = np.broadcast_to(averages if averages.ndim == 2 else averages[:, None], shape)
        dark, dark_var = self._dark.at(time_s) if self._dark else _unknown(shape)
        baseline, baseline_var = _unknown(shape)
        chosen = np.asarray(polarization)
        for name, series in self._baseline.items():
            rows = chosen == name
            if series is not None and np.any(rows):
                baseline[rows], baseline_var[rows] = series.at(time_s[rows])
        full = baseline - dark
        full = np.where(
            full > 0, full, np.nan
        )  # a baseline that is no brighter than the dark measures nothing
        with np.errstate(invalid="ignore"):
            r = (raw_v - dark) / full
            beam_var = np.maximum(self._baseline_relative_var * baseline**2 - self._dark_var, 0.0)
            predicted = self._dark_var + beam_var * np.maximum(r, 0.0)
            single_var = self._own_scatter(raw_sd_v, averages, predicted)
            r_sd = np.sqrt(single_var / averages) / full
            return Reduced(
                r=r,
                r_sd=np.where(np.isfinite(r), r_sd, np.nan),
                dark_v=dark,
                baseline_v=baseline,
                gain_u=np.sqrt(baseline_var) / full,
                offset_u=np.sqrt(dark_var) / full,
            )

    def _own_scatter(
        self, raw_sd_v: FloatArray, averages: NDArray[np.integer], predicted: FloatArray
    ) -> FloatArray:
        """Return the variance of one reading: measured where readings were repeated, else predicted.

        The measured one is pooled as its ratio to the prediction, because the signal varies over the window.
        """
        if not np.any(averages > 1):
            return predicted
        scale = np.where(np.isfinite(predicted) & (predicted > 0), predicted, 1.0)
        dof = np.maximum(averages.astype(np.float64) - 1.0, 0.0)
        ratio = pooled_variance(raw_sd_v**2 / scale, dof, self._detector_index)
        return np.where(np.isfinite(ratio), ratio * scale, predicted)


def _good(reference: ReferenceRecord) -> FloatArray:
    """Return the signal with NaN where a flag says that it is none."""
    return np.where(reference.quality & _BAD == 0, reference.signal_v, np.nan)


def _averages(references: Sequence[ReferenceRecord], m: int) -> FloatArray:
    """Return the number of readings behind each value, (k, m)."""
    return np.stack([np.broadcast_to(np.asarray(r.averages, dtype=np.float64), (m,)) for r in references])


def _unknown(shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    return np.full(shape, np.nan), np.full(shape, np.nan)


def _fill_gaps(
    value: FloatArray, time_s: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Replace each bad reading of a series (k, m) by the one before, or by the first good one after."""
    value, time_s, variance = value.copy(), time_s.copy(), variance.copy()
    k = len(value)
    for order in (range(1, k), range(k - 2, -1, -1)):
        for here in order:
            there = here - 1 if order.step > 0 else here + 1
            gap = ~np.isfinite(value[here]) & np.isfinite(value[there])
            for array in (value, time_s, variance):
                array[here, gap] = array[there, gap]
    return value, time_s, variance

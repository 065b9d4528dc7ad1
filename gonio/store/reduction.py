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

u(B) and u(D) hold the scatter of the reference readings and the doubt in the interpolation, see
`gonio.store.drift`.

Few repeats give few degrees of freedom, so variances are pooled over neighbouring wavelengths of the same
detector, never across the detector change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.devices import FloatArray, Quality
from gonio.store.drift import Series, joined
from gonio.store.pooling import pooled_variance
from gonio.store.records import ReferenceKind, ReferenceRecord

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


class Reduction:
    """Turns readings into r with the references that there are so far.

    Parameters
    ----------
    references
        All references of the scan, in any order.
    detector_index : (m,) uint8

    Attributes
    ----------
    dark, baseline
        The references as `Series` in order of time; `baseline` by polarization.  None where there are none.
    """

    def __init__(self, references: Sequence[ReferenceRecord], detector_index: NDArray[np.uint8]) -> None:
        self._detector_index = detector_index
        by_kind: dict[ReferenceKind, list[ReferenceRecord]] = {"dark": [], "baseline": []}
        for reference in in_order(references):
            by_kind[reference.kind].append(reference)
        self._dark_var = self._single_reading_variance(by_kind["dark"], relative=False)
        self._baseline_relative_var = self._single_reading_variance(by_kind["baseline"], relative=True)
        self.dark = self._series(by_kind["dark"], self._dark_var, relative=False)
        self.baseline = {
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
        return joined(time_s, value, variance, self._detector_index, relative=relative)

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
        dark, dark_var = self.dark.at(time_s) if self.dark else _unknown(shape)
        baseline, baseline_var = _unknown(shape)
        chosen = np.asarray(polarization)
        for name, series in self.baseline.items():
            rows = chosen == name
            if series is not None and np.any(rows):
                baseline[rows], baseline_var[rows] = series.at(time_s[rows])
        full = baseline - dark
        full = np.where(
            full > 0, full, np.nan
        )  # a baseline that is no brighter than the dark measures nothing
        with np.errstate(invalid="ignore", divide="ignore"):  # no averages where nothing was measured
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


def in_order(references: Sequence[ReferenceRecord]) -> list[ReferenceRecord]:
    """Return references in order of time."""
    return sorted(references, key=lambda reference: float(np.nanmean(reference.time_s)))


def _good(reference: ReferenceRecord) -> FloatArray:
    """Return the signal with NaN where a flag says that it is none."""
    return np.where(reference.quality & _BAD == 0, reference.signal_v, np.nan)


def _averages(references: Sequence[ReferenceRecord], m: int) -> FloatArray:
    """Return the number of readings behind each value, (k, m)."""
    return np.stack([np.broadcast_to(np.asarray(r.averages, dtype=np.float64), (m,)) for r in references])


def _unknown(shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    return np.full(shape, np.nan), np.full(shape, np.nan)

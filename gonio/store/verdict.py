"""Did lamp or amplifier change between references by more than the references' noise explains?

Asked at the end of a scan, when all references are known, and answered as events of the file.  What changed
is in `gain_uncertainty` and `offset_uncertainty` already; the event says where, so that somebody looks at the
lamp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.devices import FloatArray
from gonio.store.drift import Series
from gonio.store.records import Level, ReferenceRecord
from gonio.store.reduction import Reduction, in_order

_SIGNIFICANT = 5.0  # standard errors: among a thousand scans none says so by chance
WARN_BEAM = 0.005
"""Relative change of the direct beam, beyond that of a warm lamp in a day, that is a warning."""
WARN_DARK = 0.0005
"""Change of the dark, in parts of the full beam: 5 % of what a white panel sends into the aperture."""


@dataclass(frozen=True, slots=True)
class Change:
    """A change between two neighbouring references of one kind, as one detector saw it.

    `relative` is the change over the full beam, `noise` its standard error.
    """

    kind: str
    polarization: str
    detector: int
    before: ReferenceRecord
    after: ReferenceRecord
    relative: float
    noise: float

    @property
    def level(self) -> Level:
        """Warning if it is large, info if noise does not explain it."""
        limit = WARN_BEAM if self.kind == "baseline" else WARN_DARK
        return "warning" if abs(self.relative) >= limit else "info"

    def message(self, detector_name: str, between: tuple[int, int] | None) -> str:
        """Return what is told; `between` are the first and last position between the two references."""
        what = "dark signal" if self.kind == "dark" else f"direct beam ({self.polarization})"
        unit = " of the full beam" if self.kind == "dark" else ""
        told = (
            f"the {what} of detector {detector_name} changed by {100 * self.relative:+.3g} %{unit} between "
            f"the references '{self.before.when}' and '{self.after.when}'; their noise explains "
            f"{100 * self.noise:.1g} %"
        )
        if self.level == "info":
            return told
        where = f"; positions {between[0]} to {between[1]} lie between" if between else ""
        cause = "lamp and beam path" if self.kind == "baseline" else "amplifier, shutter and stray light"
        return (
            f"{told}{where}, and their stated uncertainty holds the change: look at {cause}, measure them "
            "again if they matter, and plan references in between ([references] every_minutes)"
        )


def beamless(
    reduction: Reduction, references: Sequence[ReferenceRecord], detector_index: NDArray[np.uint8]
) -> list[tuple[ReferenceRecord, int]]:
    """Return the references of the direct beam, and the detector, in which no beam is seen.

    That is where, at the median wavelength, the beam is less than five of its standard uncertainties above
    the dark.
    """
    found: list[tuple[ReferenceRecord, int]] = []
    for polarization, series in reduction.baseline.items():
        if series is None or reduction.dark is None:
            continue
        rows = [r for r in in_order(references) if (r.kind, r.polarization) == ("baseline", polarization)]
        dark_v, dark_variance = reduction.dark.at(series.time_s)
        above_v = series.value_v - dark_v
        noise_v = np.sqrt(np.nan_to_num(series.variance) + np.nan_to_num(dark_variance))
        for detector in np.unique(detector_index).tolist():
            own = detector_index == detector
            missing = np.median(above_v[:, own] - _SIGNIFICANT * noise_v[:, own], axis=1) <= 0.0
            found += [(rows[k], detector) for k in np.flatnonzero(missing).tolist()]
    return found


def no_beam_message(missing: Sequence[tuple[ReferenceRecord, int]], detector_names: Sequence[str]) -> str:
    """Return what is told of the references that `beamless` found."""
    when = list(dict.fromkeys(reference.when for reference, _ in missing))
    shown = ", ".join(when[:4]) + (f" and {len(when) - 4} more" if len(when) > 4 else "")
    beams = "/".join(dict.fromkeys(reference.polarization for reference, _ in missing))
    detectors = "/".join(detector_names[i] for i in sorted({detector for _, detector in missing}))
    return (
        f"no direct beam ({beams}) is seen by {detectors} in the references: {shown}; the lamp was out, or "
        "something stood in the beam: r of the positions about them means nothing, measure them again"
    )


def changes(
    reduction: Reduction, references: Sequence[ReferenceRecord], detector_index: NDArray[np.uint8]
) -> list[Change]:
    """Return, for each kind and polarization, the largest change that noise does not explain.

    `reduction` was made of the same references.
    """
    beams = [series.value_v for series in reduction.baseline.values() if series is not None]
    if not beams:
        return []
    full = np.max(np.nan_to_num(np.concatenate(beams)), axis=0)
    found: list[Change] = []
    for kind, polarization, series in (
        ("dark", "any", reduction.dark),
        *(("baseline", p, series) for p, series in reduction.baseline.items()),
    ):
        if series is None:
            continue
        rows = [r for r in in_order(references) if (r.kind, r.polarization) == (kind, polarization)]
        each: list[Change] = []
        for detector in np.unique(detector_index).tolist():
            own = detector_index == detector
            each += [
                Change(
                    kind, polarization, detector, rows[k], rows[k + 1], *_change(series, k, kind, own, full)
                )
                for k in range(len(rows) - 1)
            ]
        each = [change for change in each if abs(change.relative) > _SIGNIFICANT * change.noise]
        if each:
            found.append(max(each, key=lambda change: abs(change.relative)))
    return found


def _change(
    series: Series, k: int, kind: str, own: NDArray[np.bool_], full: FloatArray
) -> tuple[float, float]:
    """Return the mean change over a detector's wavelengths in parts of the full beam, and its noise."""
    value, variance = series.value_v[k : k + 2], series.variance[k : k + 2]
    scale = full if kind == "dark" else np.max(np.abs(value), axis=0)
    known = own & np.all(np.isfinite(value), axis=0) & (scale > 0)
    if not np.any(known):
        return 0.0, np.inf
    change = np.diff(value, axis=0)[0, known] / scale[known]
    noise = variance.sum(axis=0)[known] / scale[known] ** 2
    if not np.all(np.isfinite(noise)):  # no repeats: what scatters from wavelength to wavelength is noise
        noise = np.full(change.shape, np.var(change) if len(change) > 1 else np.inf)
    return float(np.mean(change)), float(np.sqrt(np.mean(noise) / len(change)))

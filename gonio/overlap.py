"""Wavelengths that were measured with two detectors: which column is meant when only one may be.

Columns are grouped by detector, ascending within each (`gonio.plan.channels`).  About a detector change both
detectors may have measured the same wavelengths.  Each column keeps its own r and its own fit; a curve never
joins two detectors.  Where there must be one value per wavelength (a material, a mean over a band) it is that
of the detector on whose side of the change the wavelength lies.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def changes_nm(wavelength_nm: FloatArray, detector_index: NDArray[np.integer]) -> tuple[float, ...]:
    """Return where the detector changes, nm.

    Halfway between the last wavelength of one detector and the first of the next, which is the middle of the
    overlap where there is one.
    """
    last = np.flatnonzero(np.diff(detector_index.astype(np.int16)) != 0)
    return tuple(float(w) for w in 0.5 * (wavelength_nm[last] + wavelength_nm[last + 1]))


def home(wavelength_nm: FloatArray, detector_index: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return a mask (m,) that keeps each wavelength once, on its own side of the detector change."""
    changes = changes_nm(wavelength_nm, detector_index)
    run = np.concatenate([[0], np.cumsum(np.diff(detector_index.astype(np.int16)) != 0)])
    keep: NDArray[np.bool_] = np.ones(len(wavelength_nm), dtype=np.bool_)
    for number, change_nm in enumerate(changes):
        low, high = run == number, run == number + 1
        twice = np.intersect1d(wavelength_nm[low], wavelength_nm[high])
        shared = np.isin(wavelength_nm, twice)
        keep &= ~(low & shared & (wavelength_nm >= change_nm))
        keep &= ~(high & shared & (wavelength_nm < change_nm))
    return keep


def pairs(wavelength_nm: FloatArray, detector_index: NDArray[np.integer]) -> list[tuple[int, int]]:
    """Return the columns of the same wavelength and neighbouring detectors, (lower, higher detector)."""
    found: list[tuple[int, int]] = []
    for first, w in enumerate(wavelength_nm.tolist()):
        later = np.flatnonzero(wavelength_nm[first + 1 :] == w) + first + 1
        found.extend(
            (first, int(second)) for second in later if detector_index[second] != detector_index[first]
        )
    return found


def block_starts(x: FloatArray) -> NDArray[np.intp]:
    """Return where a new detector's columns begin in overlapping wavelengths: where `x` falls.

    Empty unless a value is there twice: wavelengths in any other order are not grouped by detector.
    """
    falls = np.flatnonzero(np.diff(x) < 0) + 1
    return falls if len(falls) and len(np.unique(x)) < len(x) else falls[:0]

"""Wavelengths that two detectors measured, in figures and tables."""

from __future__ import annotations

import numpy as np

from gonio.report import style
from gonio.report.bands import bands

X = np.array([820.0, 840.0, 860.0, 880.0, 840.0, 860.0, 880.0, 900.0])


def test_a_curve_stops_at_the_end_of_one_detector_and_starts_again_at_the_next():
    y = np.array([1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0])
    x, (broken,) = style.broken(X, y, at=(860.0,))
    assert x.tolist() == [820, 840, 860, 880, 860, 840, 860, 880, 900]
    assert np.flatnonzero(np.isnan(broken)).tolist() == [4]
    assert broken[:4].tolist() == [1, 1, 1, 1]
    assert broken[5:].tolist() == [2, 2, 2, 2]


def test_a_wavelength_at_the_change_belongs_to_the_band_above_it():
    """With overlap the change lies at a wavelength that was measured; its home is the detector above."""
    at = np.array([820.0, 840.0, 860.0, 880.0])
    assert [band.tolist() for band in bands(at, (860.0,))] == [[0, 1], [2, 3]]

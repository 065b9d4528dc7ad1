"""What a pass of monochromator and lock-in takes, by hand: instrument seconds and exchanges."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.rig import default_rig_text, parse_rig

RIG = parse_rig(default_rig_text())
SPECTROMETER = RIG.spectrometer
SETTLE_S, JUMP_S, SPACING_S = 0.5, 1.2, 0.3  # of 0.1 s time constants at 6 dB/octave
CHANGES = 0.7  # per pass over the sample, in the built-in rig file


def pass_time(wavelengths, detectors, averages=1, **how):
    return SPECTROMETER.pass_time(np.array(wavelengths), np.array(detectors, dtype=np.uint8), averages, **how)


def drive_s(distance_nm):
    return 0.02 + distance_nm / 175.0


def test_a_pass_within_one_band():
    found = pass_time([550.0, 560.0], [0, 0], after=(560.0, 0), beam="direct")
    assert found.instrument_s == pytest.approx(JUMP_S + SETTLE_S + 2 * drive_s(10.0))
    # each wavelength one drive and one look, then what was set is asked for once more
    assert found.exchanges == {"monochromator": 2 + 4, "lockin": 2 + 1}


def test_the_detector_asked_for_decides_and_not_the_wavelength():
    """Overlap: 880 nm with the first detector, then 840 nm with the second."""
    found = pass_time([880.0, 840.0], [0, 1], after=(880.0, 0), beam="direct")
    assert found.instrument_s == pytest.approx(2 * JUMP_S + drive_s(40.0) + 1.0)
    same = pass_time([880.0, 840.0], [0, 0], after=(880.0, 0), beam="direct")
    assert same.instrument_s == pytest.approx(JUMP_S + SETTLE_S + drive_s(40.0))


def test_averages_of_each_wavelength():
    one = pass_time([550.0, 560.0], [0, 0], after=(560.0, 0), beam="direct")
    more = pass_time([550.0, 560.0], [0, 0], np.array([3, 5]), after=(560.0, 0), beam="direct")
    assert more.instrument_s - one.instrument_s == pytest.approx((2 + 4) * SPACING_S)
    assert more.exchanges["lockin"] - one.exchanges["lockin"] == 6


def test_the_first_pass_searches_a_range_for_each_detector_and_the_sample_changes_it():
    known = pass_time([850.0, 860.0], [0, 1], after=(850.0, 0), beam="dark")
    first = pass_time([850.0, 860.0], [0, 1], after=(850.0, 0), beam="dark", first=True)
    assert first.instrument_s - known.instrument_s == pytest.approx(2 * JUMP_S)
    sample = pass_time([850.0, 860.0], [0, 1], after=(850.0, 0))
    assert sample.instrument_s - known.instrument_s == pytest.approx(CHANGES * JUMP_S)


def test_where_nobody_knows_the_monochromator_it_stands_at_the_first_wavelength():
    assert pass_time([550.0], [0], beam="direct").instrument_s == pytest.approx(JUMP_S)
    assert pass_time([], []).instrument_s == 0.0


def test_grating_and_filter_cost_their_change_once_each_way():
    found = pass_time([690.0, 700.0], [0, 0], after=(690.0, 0), beam="direct")
    assert found.instrument_s == pytest.approx(2 * JUMP_S + drive_s(10.0) + 5.0 + 0.8)
    assert found.exchanges["monochromator"] == 2 + 2 * 2 + 4

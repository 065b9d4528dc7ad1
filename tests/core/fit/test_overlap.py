"""Wavelengths that two detectors measured: each column for itself, once where one value is asked for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated_readings import FloatArray, Positions, instrument_noise

from gonio.aperture import Aperture
from gonio.fitting import FitResult, fit_readings
from gonio.fitting.ratios import detector_ratios
from gonio.material import Material
from gonio.overlap import block_starts, changes_nm, home, pairs

WAVELENGTH_NM = np.array([820.0, 840.0, 860.0, 880.0, 840.0, 860.0, 880.0, 900.0])
DETECTOR = np.array([0, 0, 0, 0, 1, 1, 1, 1], dtype=np.uint8)


def test_the_change_is_the_middle_of_the_overlap_and_home_keeps_each_wavelength_once() -> None:
    assert changes_nm(WAVELENGTH_NM, DETECTOR) == (860.0,)
    keep = home(WAVELENGTH_NM, DETECTOR)
    assert WAVELENGTH_NM[keep].tolist() == [820, 840, 860, 880, 900]
    assert DETECTOR[keep].tolist() == [0, 0, 1, 1, 1]
    assert pairs(WAVELENGTH_NM, DETECTOR) == [(1, 4), (2, 5), (3, 6)]
    assert block_starts(WAVELENGTH_NM).tolist() == [4]


def test_without_overlap_everything_is_home() -> None:
    wavelength_nm, detector = np.array([840.0, 850.0, 860.0]), np.array([0, 0, 1], dtype=np.uint8)
    assert home(wavelength_nm, detector).all()
    assert changes_nm(wavelength_nm, detector) == (855.0,)
    assert not pairs(wavelength_nm, detector)
    assert not len(block_starts(wavelength_nm))
    assert not len(block_starts(np.array([3.0, 1.0, 2.0])))  # out of order, but no two detectors


@given(
    steps=st.lists(st.integers(1, 40), min_size=3, max_size=40),
    cut=st.integers(1, 39),
    overlap=st.integers(0, 60),
)
def test_home_keeps_every_wavelength_exactly_once_and_ascending(
    steps: list[int], cut: int, overlap: int
) -> None:
    asked = np.cumsum(steps).astype(np.float64) + 300.0
    change = asked[min(cut, len(asked) - 1)]
    low, high = asked[asked <= change + overlap], asked[asked >= change - overlap]
    if overlap == 0:
        low = asked[asked < change]
    wavelength_nm = np.concatenate([low, high])
    detector = np.repeat(np.array([0, 1], dtype=np.uint8), [len(low), len(high)])
    np.testing.assert_array_equal(wavelength_nm[home(wavelength_nm, detector)], asked)


@pytest.fixture(scope="module")
def mismatched(
    positions: Positions, exact_readings: Callable[..., FloatArray], aperture: Aperture
) -> FitResult:
    """A fit of readings whose first detector reads 10 % low, as the paper's does below 860 nm."""
    rng = np.random.default_rng(860)
    r = np.repeat(exact_readings(0.7, 1.0, 90.0, 1.5)[:, None], len(DETECTOR), axis=1)
    r *= np.where(DETECTOR == 0, 0.9, 1.0)
    sd = instrument_noise(r)
    return fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization,
        r + sd * rng.standard_normal(r.shape), instrument=aperture, r_sd=sd,
        wavelength_nm=WAVELENGTH_NM, detector_index=DETECTOR,
    )  # fmt: skip


def test_the_ratio_of_the_detectors_is_found_with_its_uncertainty(mismatched: FitResult) -> None:
    (ratio,) = detector_ratios(mismatched)
    assert ratio.wavelength_nm.tolist() == [840, 860, 880]
    assert ratio.mean_se < 0.005
    assert abs(ratio.mean - 1.0 / 0.9) < 4.0 * ratio.mean_se
    assert np.all(np.abs(ratio.ratio - 1.0 / 0.9) < 4.5 * ratio.se)


def test_the_table_prints_the_ratio_with_the_detectors_names(mismatched: FitResult) -> None:
    text = mismatched.table(detector_names=("pmt", "ingaas"))
    assert "ingaas over pmt (840-880 nm, 3 wavelengths): k_g ratio 1.11" in text
    assert "detector 1 over detector 0" in mismatched.table()


def test_the_table_counts_a_wavelength_with_its_own_detector(mismatched: FitResult) -> None:
    """Mixed, the band above the change would lie between the detectors."""
    line = next(
        line for line in mismatched.table([(860.0, 900.0)]).splitlines() if line.startswith("860-900")
    )
    rho_d = float(line.split()[1])
    assert abs(rho_d - 0.7) < 0.01


def test_a_part_of_a_fit_is_the_fit_of_that_part(mismatched: FitResult) -> None:
    part = mismatched.only(DETECTOR == 1)
    assert part.wavelength_nm.tolist() == [840, 860, 880, 900]
    np.testing.assert_array_equal(part.value, mismatched.value[4:])
    assert part.residual.shape == (len(mismatched.theta_i_deg), 4)
    assert len(part.notes) == 4


def test_a_material_has_one_value_per_wavelength(mismatched: FitResult) -> None:
    material = Material.from_fit(mismatched)
    assert material.wavelength_nm.tolist() == [820, 840, 860, 880, 900]
    np.testing.assert_allclose(material.rho_d, [0.63, 0.63, 0.7, 0.7, 0.7], atol=0.01)

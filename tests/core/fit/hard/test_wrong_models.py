"""Readings that no lobe of this model gives: the residuals tell, where the estimates alone would not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from simulated_readings import FloatArray, Positions, instrument_noise, plane_quadrature

from gonio.aperture import Aperture
from gonio.fitting import FitResult, fit_readings

Readings = Callable[..., FloatArray]
TRUTH = (0.72, 1.0, 90.0, 1.5)
SYSTEMATIC = "the residuals keep their sign along the sweeps"


def noisy(r: FloatArray, m: int = 12, seed: int = 0, level: float = 1.0) -> FloatArray:
    noise = np.random.default_rng(seed).standard_normal((r.size, m))
    return r[:, None] + level * instrument_noise(r)[:, None] * noise


def run(at: Positions, y: FloatArray, instrument: Aperture, /, **options: object) -> FitResult:
    return fit_readings(at.theta_i_deg, at.theta_o_deg, at.polarization, y, instrument=instrument, **options)  # type: ignore[arg-type]


def moved(at: Positions, incidence_deg: float, detector_deg: float) -> Positions:
    return Positions(at.theta_i_deg + incidence_deg, at.theta_o_deg + detector_deg, at.polarization)


def test_the_right_model_is_not_suspected(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    fit = run(positions, noisy(exact_readings(*TRUTH), m=300), aperture)
    assert not any(SYSTEMATIC in note or "saturated" in note for note in fit.notes)
    assert not any("keep their sign" in remark for remark in fit.remarks)


def test_two_lobes(positions: Positions, exact_readings: Readings, aperture: Aperture) -> None:
    r = exact_readings(*TRUTH) + plane_quadrature(positions, 0.0, 0.5, 2000.0, 1.5, aperture, panels=8)
    assert all(SYSTEMATIC in note for note in run(positions, noisy(r), aperture).notes)


@pytest.mark.parametrize(("incidence", "detector"), [(0.5, -0.5), (2.0, 0.0)])
def test_an_angle_that_is_off(
    positions: Positions, aperture: Aperture, incidence: float, detector: float
) -> None:
    """0.5 deg of theta_i with the arm where it should be; a lobe tilted by 2 deg."""
    r = plane_quadrature(moved(positions, incidence, detector), *TRUTH, aperture, panels=4)
    assert all(SYSTEMATIC in note for note in run(positions, noisy(r), aperture).notes)


def test_an_angle_that_is_off_by_less_than_one_wavelength_shows(
    positions: Positions, aperture: Aperture
) -> None:
    r = plane_quadrature(moved(positions, 0.1, 0.0), *TRUTH, aperture, panels=4)
    fit = run(positions, noisy(r, m=60), aperture)
    assert sum(SYSTEMATIC in note for note in fit.notes) < 6
    assert any("over all wavelengths the residuals keep their sign" in remark for remark in fit.remarks)
    assert any("keep their sign" in line for line in fit.table().splitlines())


@pytest.mark.parametrize("slope", [0.0, 1e-4])
def test_readings_that_are_no_scattering(positions: Positions, aperture: Aperture, slope: float) -> None:
    r = 0.01 + slope * (positions.theta_o_deg + 30.0)
    fit = run(positions, noisy(r), aperture)
    assert all(SYSTEMATIC in note for note in fit.notes)


def test_constant_without_noise(positions: Positions, aperture: Aperture) -> None:
    fit = run(positions, np.full((292, 2), 0.01), aperture)
    assert all("292 readings share the largest value 0.01" in note for note in fit.notes)


def test_nothing_but_zeros(positions: Positions, aperture: Aperture) -> None:
    fit = run(positions, np.zeros((292, 2)), aperture)
    np.testing.assert_array_equal(fit.value[:, :2], 0.0)
    assert np.all(np.isnan(fit.value[:, 2:]))
    assert all("share the largest value 0: saturated, or no measurement" in note for note in fit.notes)


def test_noise_about_zero(positions: Positions, aperture: Aperture) -> None:
    y = 2e-5 * np.random.default_rng(1).standard_normal((292, 40))
    fit = run(positions, y, aperture)
    assert all("no lobe is seen" in note for note in fit.notes)
    assert np.sum((fit.lower[:, 0] > 0.0) | (fit.upper[:, 0] < 0.0)) <= 8


def test_dark_sample_with_negative_readings(positions: Positions, aperture: Aperture) -> None:
    truth = (1e-3, 0.01, 90.0, 1.5)
    y = noisy(plane_quadrature(positions, *truth, aperture, panels=4), m=40)
    assert np.mean(y < 0.0) > 0.05
    fit = run(positions, y, aperture)
    assert np.all(np.sum((fit.lower > truth) | (fit.upper < truth), axis=0) <= 8)


@pytest.mark.parametrize("alpha", [90.0, 2000.0])
def test_saturated_plateau(
    positions: Positions, exact_readings: Readings, aperture: Aperture, alpha: float
) -> None:
    truth = (0.72, 1.0, alpha, 1.5)
    y = noisy(exact_readings(*truth))
    level = 0.55 * np.max(exact_readings(*truth))
    clipped = np.minimum(y, level)
    fit = run(positions, clipped, aperture)
    assert all("readings share the largest value" in note for note in fit.notes)
    # Tukey's loss, or the flag that belongs there, finds the truth
    flagged = run(positions, np.where(y >= level, np.nan, y), aperture)
    assert np.all(np.sum((flagged.lower > truth) | (flagged.upper < truth), axis=0) <= 4)


def test_percent_instead_of_one(positions: Positions, exact_readings: Readings, aperture: Aperture) -> None:
    fit = run(positions, noisy(exact_readings(*TRUTH)) * 100.0, aperture)
    assert all("rho_d = 7" in note and "above 1, unphysical" in note for note in fit.notes)


@pytest.mark.parametrize("loss", ["huber", "tukey"])
@pytest.mark.parametrize("size", [1.0, 1e6])
def test_robust_losses_forget_one_reading_of_any_size(
    positions: Positions, exact_readings: Readings, aperture: Aperture, loss: str, size: float
) -> None:
    y = noisy(exact_readings(*TRUTH), m=8)
    clean = run(positions, y, aperture, loss=loss)
    y[50, 3] = size
    fit = run(positions, y, aperture, loss=loss)
    assert np.all(np.abs(fit.value - clean.value) < 0.5 * clean.se)
    np.testing.assert_allclose(fit.se, clean.se, rtol=0.2)
    assert "position 50" in fit.notes[3]


def test_one_wild_reading_spoils_its_own_wavelength_only(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    y = noisy(exact_readings(*TRUTH), m=15)
    clean = run(positions, y, aperture)
    y[50, 7] = 1e6
    fit = run(positions, y, aperture)
    others = np.arange(15) != 7
    assert np.all(np.abs(fit.value - clean.value)[others] < 0.5 * clean.se[others])
    np.testing.assert_allclose(fit.se[others], clean.se[others], rtol=0.2)
    assert "outlier(s) beyond 6 sd, at position 50" in fit.notes[7]

"""Means over a band: what wavelengths share does not average out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from simulated_readings import FloatArray, Positions, instrument_noise

from gonio.aperture import Aperture
from gonio.fitting import FitResult, fit_readings
from gonio.fitting.means import columns_of
from gonio.fitting.widen import with_modes

Readings = Callable[..., FloatArray]
M = 16
NM = np.linspace(400.0, 700.0, M)
EVERY = np.ones(M, bool)


def fitted(at: Positions, y: FloatArray, aperture: Aperture, **options: object) -> FitResult:
    return fit_readings(
        at.theta_i_deg, at.theta_o_deg, at.polarization, y, instrument=aperture, wavelength_nm=NM, **options
    )  # type: ignore[arg-type]


@pytest.fixture
def readings(positions: Positions, exact_readings: Readings) -> FloatArray:
    return np.repeat(exact_readings(0.72, 1.0, 90.0, 1.5)[:, None], M, axis=1)


def test_the_claimed_error_of_a_mean_is_its_scatter_with_a_shared_index(
    positions: Positions, readings: FloatArray, aperture: Aperture
) -> None:
    """rho_s hangs on n2, which all share: its mean over 16 wavelengths scatters nearly as one of them."""
    rng = np.random.default_rng(4)
    found, claimed = [], []
    for _ in range(60):
        y = readings + instrument_noise(readings) * rng.standard_normal(readings.shape)
        columns = columns_of(fitted(positions, y, aperture, n2="constant"), 8.0)
        means = [columns[name].mean(EVERY) for name in ("rho_s", "n2", "k_s")]
        found.append([mean for mean, _ in means])
        claimed.append([half for _, half in means])
    ratio = 1.97 * np.std(found, axis=0) / np.median(claimed, axis=0)
    assert np.all((ratio > 0.75) & (ratio < 1.3))
    assert np.all(np.abs(np.mean(found, axis=0) - [1.0, 1.5, 0.04]) < np.median(claimed, axis=0))


def test_a_common_error_of_known_size_stays_whole(
    positions: Positions, readings: FloatArray, aperture: Aperture
) -> None:
    """1 % of every reading, as half a percent of distance makes, is 1 % of the mean of any band."""
    y = readings + instrument_noise(readings) * np.random.default_rng(5).standard_normal(readings.shape)
    plain = fitted(positions, y, aperture)
    modes = np.zeros((1, M, 4))
    modes[0, :, :2] = 0.01 * plain.basic[:, :2]
    wide = with_modes(plain, modes, ("scale",))
    for name, value in (("rho_d", 0.72), ("rho_s", 1.0), ("k_d", 0.72), ("k_s", 0.04), ("k_g", 0.76)):
        before, after = (columns_of(fit, 8.0)[name].mean(EVERY) for fit in (plain, wide))
        assert after[0] == before[0]
        assert after[1] == pytest.approx(np.hypot(before[1], 1.97 * 0.01 * value), rel=0.01)
        assert columns_of(wide, 8.0)[name].mean(np.array([3]))[1] == pytest.approx(
            np.hypot(columns_of(plain, 8.0)[name].half[3], 1.97 * 0.01 * value), rel=0.02
        )
    assert "± holds noise, dark and baseline of the scan, and what wavelengths share: scale" in wide.table()
    assert "not the rig's [uncertainty]" in " ".join(plain.table().split())


def test_without_anything_shared_a_mean_is_that_of_independent_wavelengths(
    positions: Positions, readings: FloatArray, aperture: Aperture
) -> None:
    y = readings + instrument_noise(readings) * np.random.default_rng(6).standard_normal(readings.shape)
    y[:, 2] = np.nan
    fit = fitted(positions, y, aperture)
    mean, half = columns_of(fit, 8.0)["n2"].mean(EVERY)
    known = np.isfinite(fit.value[:, 3])
    assert int(np.sum(known)) == M - 1
    assert mean == pytest.approx(float(np.mean(fit.value[known, 3])), rel=1e-12)
    expected = float(np.sqrt(np.sum((fit.quantile * fit.se[:, 3])[known] ** 2))) / (M - 1)
    assert half == pytest.approx(expected, rel=1e-12)
    nothing = columns_of(fit, 8.0)["n2"].mean(np.array([2]))
    assert np.all(np.isnan(nothing))

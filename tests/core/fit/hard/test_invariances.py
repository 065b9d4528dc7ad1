"""What must not matter does not: order, unit, neighbours, where a wavelength stands in the batch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_readings import FloatArray, Positions, instrument_noise, paper_positions, plane_quadrature

from gonio.aperture import Aperture
from gonio.fitting import FitResult, fit_readings

Readings = Callable[..., FloatArray]
TRUTH = (0.72, 1.0, 90.0, 1.5)
APERTURE = Aperture(26.0, 18.0, 95.2353)
AT = paper_positions(6.0)
N = AT.theta_i_deg.size


@pytest.fixture(scope="module")
def y() -> FloatArray:
    r = plane_quadrature(AT, *TRUTH, APERTURE, panels=4)
    return r[:, None] + instrument_noise(r)[:, None] * np.random.default_rng(0).standard_normal((N, 6))


def run(at: Positions, y: FloatArray, /, **options: object) -> FitResult:
    return fit_readings(at.theta_i_deg, at.theta_o_deg, at.polarization, y, instrument=APERTURE, **options)  # type: ignore[arg-type]


@settings(max_examples=10, deadline=None, derandomize=True)
@given(exponent=st.floats(-25.0, 13.0))
def test_readings_scale_rho_d_and_rho_s_alone(y: FloatArray, exponent: float) -> None:
    c = 10.0**exponent
    one, scaled = run(AT, y), run(AT, c * y)
    unit = np.array([c, c, 1.0, 1.0])
    for name in ("value", "se", "lower", "upper"):
        np.testing.assert_allclose(getattr(scaled, name) / unit, getattr(one, name), rtol=1e-9)
    np.testing.assert_allclose(scaled.chi2, one.chi2, rtol=1e-9)
    np.testing.assert_allclose(scaled.condition, one.condition, rtol=1e-9)


@settings(max_examples=8, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), weights=st.sampled_from(["none", "auto"]))
def test_order_of_positions_does_not_matter(y: FloatArray, seed: int, weights: str) -> None:
    order = np.random.default_rng(seed).permutation(N)
    one, other = run(AT, y, weights=weights), run(AT[order], y[order], weights=weights)
    np.testing.assert_allclose(other.value, one.value, rtol=1e-9)
    np.testing.assert_allclose(other.se, one.se, rtol=1e-7)
    np.testing.assert_allclose(other.residual, one.residual[order], atol=1e-12)


@pytest.mark.parametrize("loss", ["squares", "tukey"])
def test_order_of_wavelengths_does_not_matter_without_neighbours(y: FloatArray, loss: str) -> None:
    order = np.array([3, 1, 5, 0, 4, 2])
    nm = np.array([400.0, 410.0, 420.0, 430.0, 440.0, 450.0])
    one = run(AT, y, weights="none", loss=loss, wavelength_nm=nm)
    other = run(AT, y[:, order], weights="none", loss=loss, wavelength_nm=nm[order])
    np.testing.assert_allclose(other.value, one.value[order], rtol=1e-9)
    np.testing.assert_allclose(other.se, one.se[order], rtol=1e-7)
    assert other.wavelength_nm.tolist() == nm[order].tolist()


def test_another_wavelength_changes_nothing_without_weights_and_little_with_them(y: FloatArray) -> None:
    for weights, most in (("none", 1e-7), ("auto", 0.5)):
        few, more = run(AT, y[:, :5], weights=weights), run(AT, y, weights=weights)
        assert np.all(np.abs(more.value[:5] - few.value) < most * few.se)
    np.testing.assert_allclose(more.se[:5], few.se, rtol=0.2)


def test_polarizations_swap_with_what_is_fitted(y: FloatArray) -> None:
    """S alone is S alone, whatever the other rows hold."""
    s = AT.polarization == "s"
    noise = np.where(s[:, None], y, 7.0)
    np.testing.assert_array_equal(run(AT, noise, polarization="s").value, run(AT[s], y[s]).value)
    reordered = np.concatenate([np.flatnonzero(~s), np.flatnonzero(s)])
    swapped = run(AT[reordered], y[reordered], polarization="shared_n2")
    np.testing.assert_allclose(swapped.value, run(AT, y, polarization="shared_n2").value, rtol=1e-8)


def test_ten_thousand_wavelengths_with_holes_of_their_own(y: FloatArray) -> None:
    """Missing readings differ from wavelength to wavelength; each is fitted as if it stood alone."""
    rng = np.random.default_rng(2)
    m = 10_000
    r = plane_quadrature(AT, *TRUTH, APERTURE, panels=4)
    many = r[:, None] + instrument_noise(r)[:, None] * rng.standard_normal((N, m))
    many[rng.uniform(size=many.shape) < 0.3] = np.nan
    many[:, 17] = np.nan
    many[5:, 18] = np.nan
    fit = run(AT, many, weights="none")
    assert fit.notes[17] == "only 0 usable readings, too few to fit"
    assert fit.notes[18].startswith("only ")
    for k in rng.choice(m, 12, replace=False):
        alone = run(AT, many[:, [k]], weights="none")
        np.testing.assert_allclose(fit.value[k], alone.value[0], rtol=1e-9)
        np.testing.assert_allclose(fit.se[k], alone.se[0], rtol=1e-7)
        assert fit.dof[k] == alone.dof[0]
    fitted = np.isfinite(fit.value[:, 0])
    assert np.sum(fitted) == m - 2
    z = (np.mean(fit.value[fitted], axis=0) - TRUTH) / np.std(fit.value[fitted], axis=0)
    assert np.all(np.abs(z) < 0.1)  # bias of the estimator, in standard deviations of one wavelength

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.brdf import (
    Lambert,
    PublishedLobe,
    ScatteringModel,
    brdf_from_dsf,
    check_model,
    dsf_from_brdf,
    integrated_albedo,
    lobe_above_horizon,
    lobe_dsf,
    reflectance_factor_from_brdf,
)
from gonio.fresnel import reflectance


@pytest.mark.parametrize("theta_i_deg", [0.0, 20.0, 55.0, 80.0])
@pytest.mark.parametrize("alpha", [0.0, 2.5, 40.0, 900.0])
def test_true_albedo_is_the_integral_of_the_dsf_above_the_horizon(theta_i_deg: float, alpha: float) -> None:
    model = PublishedLobe(0.5, 0.8, alpha, 1.6)
    # where the horizon cuts cos_+ at 90 deg from a tilted mirror direction, the brute-force rule sees a step
    tolerance = 2e-3 if alpha < 1.0 else 1e-5
    for polarization in ("s", "p"):
        expected = integrated_albedo(model, theta_i_deg, polarization)
        value = float(model.directional_albedo(theta_i_deg, polarization))
        assert value == pytest.approx(expected, rel=tolerance)


def test_published_albedo_counts_the_lobe_below_the_horizon() -> None:
    model = PublishedLobe(0.72, 1.0, 10.0, 1.5)
    for theta, kept in ((55.0, 0.980), (75.0, 0.803), (85.0, 0.611)):
        r = float(reflectance(1.5, theta, "s"))
        assert float(model.published_albedo(theta, "s")) == pytest.approx(0.72 + r, rel=1e-14)
        assert float(model.specular_albedo(theta, "s")) == pytest.approx(r * kept, abs=r * 1e-3)
    np.testing.assert_allclose(lobe_above_horizon(100.0, [55.0, 75.0, 85.0]), [1.0, 0.996, 0.81], atol=1e-3)
    assert float(lobe_above_horizon(7.0, 90.0)) == 0.5
    assert float(lobe_above_horizon(7.0, 0.0)) == 1.0


def test_conversions_have_their_cosine() -> None:
    white = Lambert(1.0)
    theta = np.array([0.0, 30.0, 80.0])
    brdf = white.brdf(20.0, theta, "s")
    np.testing.assert_allclose(brdf, 1.0 / np.pi, rtol=1e-14)
    np.testing.assert_allclose(reflectance_factor_from_brdf(brdf), 1.0, rtol=1e-14)
    np.testing.assert_allclose(dsf_from_brdf(brdf, theta), white.dsf(20.0, theta, "s"), rtol=1e-14)
    assert np.isnan(brdf_from_dsf(0.1, 90.0))
    lobe = PublishedLobe(0.0, 1.0, 3.0, 1.5)
    assert float(lobe.brdf(60.0, 85.0, "s")) == pytest.approx(
        float(lobe.dsf(60.0, 85.0, "s")) / np.cos(np.deg2rad(85.0)), rel=1e-14
    )


def test_dsf_is_equation_17() -> None:
    model = PublishedLobe(0.72, 1.0, 90.0, 1.5)
    o, i = np.deg2rad(37.0), np.deg2rad(30.0)
    r_p = float(reflectance(1.5, 30.0, "p"))
    expected = 0.72 / np.pi * np.cos(o) + r_p * 91.0 / (2.0 * np.pi) * np.cos(o - i) ** 90.0
    assert float(model.dsf(30.0, 37.0, "p")) == pytest.approx(expected, rel=1e-13)
    assert float(model.dsf(30.0, -95.0, "p")) == 0.0


@given(alpha=st.floats(0.0, 1e8))
def test_narrow_lobes_keep_their_digits(alpha: float) -> None:
    """At one lobe width from the axis cos^alpha is about exp(-1/2); a rounded cosine loses it."""
    versine = 0.5 / (alpha + 1.0)
    expected = (alpha + 1.0) / (2.0 * np.pi) * np.exp(alpha * np.log1p(-versine))
    assert float(lobe_dsf(alpha, versine)) == pytest.approx(expected, rel=1e-14)


def test_check_finds_where_the_published_lobe_creates_energy() -> None:
    model = PublishedLobe(0.72, 1.0, 1e6, 1.5)
    check = check_model(model)
    # 0.72 + R(unpolarized) passes 1 above 76 deg
    assert check.energy_from_deg == pytest.approx(76.3, abs=0.11)
    assert check.albedo == pytest.approx(0.72 + float(reflectance(1.5, 89.9, "unpolarized")), abs=0.03)
    assert float(model.directional_albedo(90.0, "s")) == pytest.approx(
        1.22, rel=1e-12
    )  # half the lobe is above
    assert check_model(PublishedLobe(0.72, 1.0, 30.0, 1.5)).reciprocity > 0.1
    assert "creates energy from 76" in str(check)


def test_lambert_is_reciprocal_and_conserves_energy() -> None:
    check = check_model(Lambert(0.8))
    assert check.reciprocity < 1e-12
    assert check.albedo == 0.8
    assert np.isnan(check.energy_from_deg)
    assert isinstance(Lambert(0.8), ScatteringModel)
    assert isinstance(PublishedLobe(0.5, 0.5, 10.0, 1.5), ScatteringModel)


def test_parameters_broadcast_over_wavelengths() -> None:
    model = PublishedLobe(
        np.array([0.3, 0.7]), np.array([1.0, 0.5]), np.array([20.0, 200.0]), np.array([1.4, 1.6])
    )
    both = model.dsf(20.0, 25.0, "s")
    for k in range(2):
        one = PublishedLobe(*(np.asarray(getattr(model, name))[k] for name in model.parameter_names))
        assert both[k] == one.dsf(20.0, 25.0, "s")

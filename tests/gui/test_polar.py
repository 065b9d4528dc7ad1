"""The polar plot against closed forms, and its scale."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio_gui.polar import Curve, PolarPlot, outer_radius
from gonio_gui.theme import DARK


@pytest.fixture
def plot(qtbot: Any) -> PolarPlot:
    made = PolarPlot("S")
    qtbot.addWidget(made)
    made.set_theme(DARK)
    made.prepare([20.0, 45.0])
    return made


def test_a_lambertian_sample_draws_a_circle(plot: PolarPlot) -> None:
    # r = c cos(theta_o) is, in polar coordinates, the circle of diameter c that touches the surface
    theta_o = np.linspace(-80.0, 85.0, 34)
    c = 0.02
    plot.draw([Curve(0, 20.0, theta_o, c * np.cos(np.radians(theta_o)))])
    x, y = plot._curves[0].getData()
    half = 100.0 * c / 2.0 / plot.radius_percent
    np.testing.assert_allclose(np.hypot(x, y - half), half, rtol=1e-12)


def test_angles_and_values_are_where_they_belong(plot: PolarPlot) -> None:
    theta_o, r = np.array([-30.0, 0.0, 60.0]), np.array([0.01, 0.02, 0.034])
    plot.draw([Curve(1, 45.0, theta_o, r)])
    shown_theta_o, shown_percent = plot.points(1)
    np.testing.assert_allclose(shown_theta_o, theta_o, atol=1e-10)
    np.testing.assert_allclose(shown_percent, 100.0 * r, rtol=1e-12)
    assert plot.radius_percent == 4.0
    x, y = plot._beams[1].getData()
    np.testing.assert_allclose(np.degrees(np.arctan2(x, y)), -45.0)  # light comes from the left


def test_scale_follows_the_data_up_and_down(plot: PolarPlot) -> None:
    for peak, radius in ((0.011, 1.2), (0.5, 60.0), (0.0002, 0.02)):
        plot.draw([Curve(0, 20.0, np.array([0.0]), np.array([peak]))])
        assert plot.radius_percent == pytest.approx(radius)
        assert [item.toPlainText() for item in plot._scale][-1] == f"{radius:.4g}"


def test_missing_values_and_nothing_at_all_do_no_harm(plot: PolarPlot) -> None:
    plot.draw([Curve(0, 20.0, np.array([0.0, 1.0]), np.array([np.nan, np.nan]))])
    plot.draw([Curve(0, 20.0, np.array([]), np.array([]))])
    assert plot.points(0)[0].size == 0


@given(st.floats(1e-9, 1e9))
def test_outer_circle_holds_the_peak_and_wastes_less_than_half(peak: float) -> None:
    radius = outer_radius(peak)
    assert peak <= radius * (1 + 1e-9)
    assert radius <= peak * 1.5 * (1 + 1e-9)


@pytest.mark.parametrize("peak", [0.0, -1.0, float("nan")])
def test_without_a_positive_peak_the_scale_is_one(peak: float) -> None:
    assert outer_radius(peak) == 1.0

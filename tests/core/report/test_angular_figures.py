from __future__ import annotations

import numpy as np
import pytest

from gonio.report import choose, style
from gonio.report.curves import draw_curves
from gonio.report.model import model_of
from gonio.report.polar import draw_polar


def lines(axes, gid):
    return [line for line in axes.get_lines() if line.get_gid() == gid]


def fit_figure(content, column):
    return draw_curves(content, model_of(content.scan, content.main_fit()), column).figure


def column_of(scan, wavelength_nm):
    return int(np.argmin(np.abs(scan.wavelength_nm - wavelength_nm)))


def test_polar_has_s_and_p_side_by_side_with_one_curve_per_incidence(content):
    drawing = draw_polar(content, column_of(content.scan, 550.0))
    assert drawing.name == "polar_550nm"
    s, p = drawing.figure.axes
    assert s.get_title().startswith("S polarization")
    assert p.get_title().startswith("P polarization")
    for axes in (s, p):
        assert len(lines(axes, "curve")) == 4
        assert [line.get_label() for line in lines(axes, "curve")] == ["20°", "30°", "45°", "55°"]
        assert axes.get_aspect() == 1.0
        assert axes.get_xlabel() == "observation angle θₒ / °, radius r / %"


def test_polar_puts_the_normal_up_and_the_specular_side_right(content):
    scan = content.scan
    column = column_of(scan, 550.0)
    curve = lines(draw_polar(content, column).figure.axes[0], "curve")[3]
    x, y = curve.get_data()
    peak = int(np.argmax(np.hypot(x, y)))
    assert np.degrees(np.arctan2(x[peak], y[peak])) == pytest.approx(55.0, abs=3.0)
    rows = choose.sweep(scan, 55.0, "s")
    assert np.hypot(x, y) == pytest.approx(100.0 * scan.r[rows, column])
    assert np.degrees(np.arctan2(x, y)) == pytest.approx(scan.theta_o_deg[rows])


def test_blind_zones_lie_around_the_incident_beams_outside_the_circle(content):
    drawing = draw_polar(content, column_of(content.scan, 550.0))
    axes = drawing.figure.axes[0]
    data = max(np.nanmax(np.hypot(*line.get_data())) for line in lines(axes, "curve"))
    for theta_i, arc in zip((20.0, 30.0, 45.0, 55.0), lines(axes, "blind-zone"), strict=True):
        angle = np.degrees(np.arctan2(*arc.get_data()))
        assert (angle.min(), angle.max()) == pytest.approx((-theta_i - 15.0, -theta_i + 15.0))
        assert np.hypot(*arc.get_data()).min() > data
    assert "±15°" in drawing.caption


def test_without_a_blind_zone_in_the_rig_file_none_is_drawn(make_content, make_scan):
    drawing = draw_polar(make_content(make_scan(rig_text="not TOML [")), 0)
    assert not lines(drawing.figure.axes[0], "blind-zone")
    assert "states no blind zone" in drawing.caption


def test_no_line_crosses_the_incident_beam(make_scan):
    scan = make_scan(sweeps=((20.0, 105.0),))
    # the same sweep, begun on the far side of the beam
    mes = scan.theta_mes_deg.copy()
    mes[:5] = [-27.0, -24.0, -21.0, -18.0, -15.0]
    scan = make_scan(sweeps=((20.0, 105.0),), theta_mes_deg=mes, theta_o_deg=mes - scan.theta_i_deg)
    theta_o, r, u = choose.curve(scan, choose.sweep(scan, 20.0, "s"), 30)
    gap = np.flatnonzero(np.isnan(r))
    assert gap.size == 1
    assert theta_o[gap[0]] == -20.0
    assert np.all(np.diff(theta_o) > 0)
    assert np.isnan(u[gap[0]])


def test_missing_and_saturated_readings_are_gaps(make_scan, make_content):
    scan = make_scan()
    column = column_of(scan, 550.0)
    rows = choose.sweep(scan, 30.0, "s")
    scan.r[rows[4], column] = np.nan
    scan.quality[rows[7], column] = 1  # over range
    drawing = draw_polar(make_content(scan), column)
    x, _ = lines(drawing.figure.axes[0], "curve")[1].get_data()
    assert np.flatnonzero(np.isnan(x)).tolist() == [4, 7]
    assert "2 readings" in drawing.caption


def test_wavelengths_shown_are_one_in_the_visible_and_one_in_the_infrared(make_scan):
    def shown(*wavelength_nm):
        scan = make_scan(wavelength_nm=wavelength_nm)
        return [float(scan.wavelength_nm[i]) for i in choose.shown_wavelengths(scan)]

    assert shown(300.0, 540.0, 900.0, 1190.0, 1500.0) == [540.0, 1190.0]
    assert shown(400.0, 500.0, 700.0) == [500.0]
    assert shown(1300.0) == [1300.0]
    assert shown(1000.0, 1300.0) == [1000.0, 1300.0]


def test_a_wavelength_without_any_reading_is_not_shown(make_scan):
    scan = make_scan(wavelength_nm=[540.0, 550.0, 1200.0])
    scan.r[:, 1] = np.nan
    assert [float(scan.wavelength_nm[i]) for i in choose.shown_wavelengths(scan)] == [540.0, 1200.0]
    scan.r[:] = np.nan
    assert choose.shown_wavelengths(scan) == []


def test_fit_over_data_has_points_curves_and_residuals_with_units(content):
    scan, fit = content.scan, content.main_fit()
    column = column_of(scan, 1200.0)
    figure = fit_figure(content, column)
    s_upper, p_upper, s_lower, _ = figure.axes
    assert s_upper.get_ylabel() == "r / % of incident power"
    assert s_lower.get_xlabel() == "observation angle θₒ / °"
    assert s_lower.get_ylabel() == "data − fit / %"
    for axes in (s_upper, p_upper):
        assert len(lines(axes, "fit")) == 4
        assert len(axes.containers) == 4
    rows = choose.sweep(scan, 45.0, "s")
    x, y = s_upper.containers[2].lines[0].get_data()
    assert x == pytest.approx(scan.theta_o_deg[rows])
    assert y == pytest.approx(100 * scan.r[rows, column])
    expected = fit.predict(45.0, scan.theta_o_deg[rows], "s")[:, column]
    assert s_lower.containers[2].lines[0].get_ydata() == pytest.approx(
        100 * (scan.r[rows, column] - expected)
    )


def test_error_bars_are_two_standard_uncertainties(content):
    scan = content.scan
    column = column_of(scan, 550.0)
    axes = fit_figure(content, column).axes[0]
    rows = choose.sweep(scan, 20.0, "s")
    segments = axes.containers[0].lines[2][0].get_segments()
    half = [(s[1, 1] - s[0, 1]) / 2 for s in segments]
    assert half == pytest.approx(100 * 2 * scan.r_sd[rows, column])


def test_a_fit_of_s_alone_draws_no_curve_over_p(make_content):
    figure = fit_figure(make_content(fits=("s",)), 25)
    assert [len(lines(axes, "fit")) for axes in figure.axes[:2]] == [4, 0]


def test_readings_without_known_noise_are_drawn_without_bars(make_scan, make_content):
    scan = make_scan()
    scan.r_sd[:] = np.nan
    axes = fit_figure(make_content(scan), 25).axes[0]
    assert axes.containers[0].lines[0].get_ydata() == pytest.approx(
        100 * scan.r[choose.sweep(scan, 20.0, "s"), 25]
    )
    assert style.png_bytes(axes.figure)

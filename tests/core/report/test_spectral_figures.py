from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gonio.report import agreement, bands, choose, spectra
from gonio.report.diagnostics import draw_references, draw_residuals, normalised_residual
from gonio.report.model import model_of


def spectra_in(axes):
    return [line for line in axes.get_lines() if line.get_gid() == "spectrum"]


def by_label(axes, start):
    found = [line for line in spectra_in(axes) if line.get_label().startswith(start)]
    assert len(found) == 1, [line.get_label() for line in spectra_in(axes)]
    return found[0]


def joins(line, change_nm):
    """Say whether the line has two neighbouring finite points on either side of the change."""
    x, y = line.get_data()
    finite = np.isfinite(y)
    return bool(np.any(finite[:-1] & finite[1:] & (x[:-1] < change_nm) & (x[1:] > change_nm)))


def test_coefficients_stand_against_sphere_and_truth_with_units(content):
    fit = content.main_fit()
    figure = spectra.draw_coefficients(content, fit).figure
    upper, middle, lower = figure.axes
    assert upper.get_ylabel() == "reflectance at 8° / %"
    assert middle.get_ylabel().endswith("at 8° / %")
    assert lower.get_ylabel() == "difference / %"
    assert lower.get_xlabel() == "wavelength / nm"
    assert len(spectra_in(upper)) == 5  # k_g, k_d, the truth of both, the sphere
    assert len(spectra_in(middle)) == 2
    k_g = by_label(upper, "$k_\\mathrm{g}$ =")
    x, y = k_g.get_data()
    keep = np.isin(x, fit.wavelength_nm)
    assert y[keep] == pytest.approx(100 * fit.hemispherical(8.0).k_g.value)
    sphere = by_label(upper, "integrating sphere").get_data()[1]
    assert sphere[np.isfinite(sphere)] == pytest.approx(100 * content.sphere.columns["k_g"])


def test_bands_reach_from_the_lower_to_the_upper_limit(content):
    fit = content.main_fit()
    axes = spectra.draw_coefficients(content, fit).figure.axes[1]
    k_s = fit.hemispherical(8.0).k_s
    vertices = np.concatenate([p.vertices for p in axes.collections[0].get_paths()])
    for i in (0, 60, 120):
        here = vertices[np.isclose(vertices[:, 0], fit.wavelength_nm[i])][:, 1]
        assert here.min() == pytest.approx(100 * k_s.lower[i])
        assert here.max() == pytest.approx(100 * k_s.upper[i])


@pytest.mark.parametrize("draw", [spectra.draw_coefficients, spectra.draw_parameters, spectra.draw_index])
def test_no_measured_curve_is_joined_across_the_detector_change(content, draw):
    assert content.scan.detector_change_nm == (855.0,)
    for axes in draw(content, content.main_fit()).figure.axes:
        for line in spectra_in(axes):
            measured = line.get_label() not in (spectra.TRUTH, "_truth")
            assert joins(line, 855.0) is not measured, line.get_label()
        marks = [line for line in axes.get_lines() if np.all(np.equal(line.get_xdata(), 855.0))]
        assert marks


def test_the_change_is_where_the_data_say_not_at_860_nm(make_scan, make_content):
    w = np.arange(700.0, 900.0, 10.0)
    detector = (w > 820.0).astype(np.uint8)
    content = make_content(make_scan(wavelength_nm=w, detector_index=detector))
    drawing = spectra.draw_coefficients(content, content.main_fit())
    line = by_label(drawing.figure.axes[0], "$k_\\mathrm{d}$")
    assert not joins(line, 825.0)
    assert joins(line, 855.0)
    assert "820–830 nm" in drawing.caption


def test_a_wavelength_without_result_is_a_gap(content):
    fit = dataclasses.replace(content.main_fit())
    fit.value = fit.value.copy()
    fit.value[20] = np.nan
    figure = spectra.draw_index(content, fit).figure
    x, y = by_label(figure.axes[0], "S and P jointly").get_data()
    assert np.isnan(y[x == fit.wavelength_nm[20]]).all()


def test_index_shows_the_joint_fit_each_polarization_and_the_truth(content):
    axes = spectra.draw_index(content, content.main_fit()).figure.axes[0]
    assert [line.get_label() for line in spectra_in(axes)] == [
        "S and P jointly, 95 % band",
        "S alone",
        "P alone",
        spectra.TRUTH,
    ]
    assert axes.get_ylabel() == "refractive index n₂ / 1"


def test_index_says_how_to_add_the_fits_that_are_missing(make_content):
    content = make_content(fits=("joint",))
    drawing = spectra.draw_index(content, content.main_fit())
    assert len(spectra_in(drawing.figure.axes[0])) == 2
    assert "Fits of S and P alone are not stored" in drawing.caption


def test_parameters_have_three_panels_with_the_fitted_values(content):
    fit = content.main_fit()
    axes = spectra.draw_parameters(content, fit).figure.axes
    assert len(axes) == 3
    for column, panel in enumerate(axes):
        x, y = by_label(panel, "fit with 95 % band").get_data()
        assert y[np.isin(x, fit.wavelength_nm)] == pytest.approx(fit.value[:, column])


def test_both_polarizations_alone_share_their_scales(content):
    fits = [content.fits["exact_s"], content.fits["exact_p"]]
    figure = spectra.draw_coefficients_alone(content, fits).figure
    s_upper, p_upper, s_lower, p_lower = figure.axes
    assert s_upper.get_ylim() == p_upper.get_ylim()
    assert s_lower.get_ylim() == p_lower.get_ylim()
    assert not any(joins(line, 855.0) for line in spectra_in(p_upper) if "fit" in line.get_label())


# -- agreement with the sphere


def test_e_n_is_the_deviation_over_the_expanded_uncertainties(content):
    fit = content.main_fit()
    found = agreement.compare(content, fit)
    k_g = fit.hemispherical(8.0).k_g
    sphere, u = content.sphere.columns["k_g"], content.sphere.columns["k_g_u"]
    for i in (0, 40, 100):
        expanded_fit = 1.97 * k_g.se[i]
        expected = (k_g.value[i] - sphere[i]) / np.sqrt(expanded_fit**2 + (2 * u[i]) ** 2)
        assert found.e_n[i] == pytest.approx(expected, rel=1e-9)


def test_a_gain_error_of_one_detector_shows_in_its_own_row(content):
    pmt, ingaas = agreement.compare(content, content.main_fit()).parts()
    assert (pmt.detector, pmt.low_nm, pmt.high_nm) == ("pmt", 300.0, 850.0)
    assert (ingaas.detector, ingaas.low_nm, ingaas.high_nm) == ("ingaas", 860.0, 1500.0)
    assert pmt.relative == pytest.approx(-0.032, abs=0.003)  # -3 %, and the sphere reads 0.2 % high
    assert ingaas.relative == pytest.approx(-0.002, abs=0.002)
    assert pmt.within < 0.2 * pmt.count
    assert ingaas.within >= 0.95 * ingaas.count
    assert pmt.worst_e_n < -1.0


def test_a_sphere_on_another_grid_is_interpolated_and_not_extended(make_content):
    content = make_content()
    sphere = dataclasses.replace(
        content.sphere,
        wavelength_nm=np.array([600.0, 700.0, 850.0]),
        columns={"k_g": np.array([0.7, 0.8, 0.8]), "k_g_u": np.full(3, 0.01)},
    )
    found = agreement.compare(dataclasses.replace(content, sphere=sphere), content.main_fit())
    k_g = content.main_fit().hemispherical(8.0).k_g.value
    i = int(np.argmin(np.abs(found.wavelength_nm - 650.0)))
    assert found.difference[i] == pytest.approx(k_g[i] - 0.75)
    assert np.isnan(found.difference[found.wavelength_nm < 600.0]).all()
    assert np.isnan(found.difference[found.wavelength_nm > 850.0]).all()
    assert found.u_sphere[i] == pytest.approx(0.02)


def test_a_sphere_without_uncertainty_is_shown_but_not_judged(content):
    sphere = dataclasses.replace(content.sphere, columns={"k_g": np.full(121, 0.76)})
    content = dataclasses.replace(content, sphere=sphere)
    found = agreement.compare(content, content.main_fit())
    assert np.isfinite(found.difference).all()
    assert np.isnan(found.e_n).all()
    assert [part.judged for part in found.parts()] == [0, 0]
    assert "no uncertainty stated" in spectra.draw_coefficients(content, content.main_fit()).caption


def test_a_sphere_without_the_specular_beam_is_compared_with_the_diffuse_coefficient(content):
    sphere = dataclasses.replace(
        content.sphere,
        columns={"k_d": np.full(121, 0.7), "k_d_u": np.full(121, 0.01)},
        facts={"geometry": "8:de"},
    )
    found = agreement.compare(dataclasses.replace(content, sphere=sphere), content.main_fit())
    k_d = content.main_fit().hemispherical(8.0).k_d.value
    np.testing.assert_allclose(found.difference, k_d - 0.7, rtol=1e-12)


# -- bands


def test_no_band_spans_a_detector_change_and_every_wavelength_is_in_one():
    w = np.arange(250.0, 1701.0, 10.0)
    found = bands.bands(w, (825.0,))
    assert sorted(np.concatenate(found).tolist()) == list(range(w.size))
    assert not any((w[b] < 825.0).any() and (w[b] > 825.0).any() for b in found)


def test_bands_are_those_of_the_table_that_gonio_fit_prints():
    w = np.arange(300.0, 1501.0, 10.0)
    ends = [(w[b][0], w[b][-1]) for b in bands.bands(w, (855.0,))]
    assert ends == [
        (300.0, 390.0),
        (400.0, 540.0),
        (550.0, 690.0),
        (700.0, 850.0),
        (860.0, 1090.0),
        (1100.0, 1290.0),
        (1300.0, 1500.0),
    ]


def test_band_values_are_means_with_the_interval_of_the_mean_beside_the_truth(content):
    (table,) = bands.band_table(content, content.main_fit())
    fit = content.main_fit()
    inside = (fit.wavelength_nm >= 1300.0) & (fit.wavelength_nm <= 1500.0)
    row = next(r for r in table.rows if r[0] == "1300–1500")
    assert len(table.head) == len(row)
    cell = row[table.head.index("k<sub>d</sub> = ρ<sub>d</sub> / %")]
    shown, true = cell.split("<br><small>true ")
    value, half = (float(x) for x in shown.split(" ± "))
    assert value == pytest.approx(100 * fit.value[inside, 0].mean(), abs=0.006)
    assert half == pytest.approx(100 * 1.97 * 0.002 / np.sqrt(inside.sum()), rel=0.05)
    expected = 100 * content.truth.columns["rho_d"][inside].mean()
    assert float(true.removesuffix("</small>")) == pytest.approx(expected, rel=1e-3)


# -- diagnostics


def test_residual_map_shows_every_reading_and_blanks_what_is_missing(make_scan, make_content):
    scan = make_scan()
    scan.r[3, 10] = np.nan
    content = make_content(scan)
    model = model_of(scan, content.main_fit())
    figure = draw_residuals(content, model).figure
    cells = figure.axes[0].collections[0].get_array()
    _, z = normalised_residual(content, model, "s", choose.incidences(scan))
    blank = 56  # the column between 850 and 860 nm
    values, missing = np.ma.getdata(cells), np.ma.getmaskarray(cells)
    assert missing[:, blank].all()
    known = np.isfinite(z)
    assert np.delete(values, blank, axis=1)[known] == pytest.approx(z[known])
    assert int(np.delete(missing, blank, axis=1).sum()) == 1
    assert figure.axes[-1].get_ylabel() == "(data − fit) / standard deviation / 1"


def test_residuals_are_in_standard_deviations_scaled_by_chi_squared(content):
    scan, fit = content.scan, content.main_fit()
    rows, z = normalised_residual(content, model_of(scan, fit), "s", choose.incidences(scan))
    i = int(np.flatnonzero(rows == 140)[0])
    expected = fit.predict(scan.theta_i_deg[140], scan.theta_o_deg[140], "s")[0]
    assert z[i] == pytest.approx((scan.r[140] - expected) / 2e-4)


def test_positions_measured_after_the_fit_take_their_own_uncertainty(make_scan, make_content, make_fit):
    scan = make_scan()
    fit = make_fit(scan)
    fit.theta_i_deg, fit.theta_o_deg = fit.theta_i_deg[:-1], fit.theta_o_deg[:-1]
    fit.polarization_of, fit.sigma = fit.polarization_of[:-1], fit.sigma[:-1]
    model = model_of(scan, fit)
    assert model.sigma[-1] == pytest.approx(scan.r_sd[-1])
    assert model.sigma[-2] == pytest.approx(2e-4)


def test_drift_of_the_references_is_relative_to_the_first(content, make_references):
    references = make_references(content.scan, drift=0.004)
    upper, lower = draw_references(content, references).figure.axes
    drawn = spectra_in(upper)
    assert [line.get_label() for line in drawn] == ["S, 10 h 02 min", "P, 10 h 17 min"]
    for line in drawn:
        y = line.get_ydata()
        assert y[np.isfinite(y)] == pytest.approx(0.4)
        assert not joins(line, 855.0)
    dark = spectra_in(lower)[0].get_ydata()
    assert dark[~np.isnan(dark)] == pytest.approx(1e6 * 2e-4 / references.signal_v[1])
    assert upper.get_ylabel() == "baseline / first − 1 / %"

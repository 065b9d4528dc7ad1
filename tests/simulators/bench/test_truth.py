"""The table of the truth, and the simulated integrating sphere's error."""

from __future__ import annotations

import csv
import math

import numpy as np
import pytest

from gonio_simulators.bench.truth import (
    lobe_above_horizon,
    sphere_spectrum,
    truth_table,
    write_sphere,
    write_truth,
)


@pytest.mark.parametrize(
    ("alpha", "theta_i_deg", "kept"),
    [(10.0, 55.0, 0.980), (10.0, 75.0, 0.803), (10.0, 85.0, 0.61), (100.0, 75.0, 0.996), (100.0, 85.0, 0.81)],
)
def test_light_of_the_lobe_above_the_horizon(alpha: float, theta_i_deg: float, kept: float) -> None:
    digits = len(str(kept)) - 2
    assert lobe_above_horizon(theta_i_deg, alpha) == pytest.approx(kept, abs=0.51 * 10**-digits)


def test_table_is_interpolated_and_holds_its_ends(make_config) -> None:
    config = make_config()
    table = truth_table(config, np.array([250.0, 300.0, 325.0, 400.0, 2000.0]))
    assert table["rho_d"].tolist() == pytest.approx([0.10, 0.10, 0.20, 0.62, 0.64])
    assert table["alpha"].tolist() == pytest.approx([70.0, 70.0, 70.0 + 40.0 * 25 / 1200, 73.3333333, 110.0])
    grid = truth_table(config)["wavelength_nm"]
    assert (grid[0], grid[-1], grid[1] - grid[0]) == (200.0, 1600.0, 10.0)


def test_coefficients_near_normal_incidence(make_config) -> None:
    table = truth_table(make_config({"simulation.truth.n2": 1.5}), np.array([500.0, 900.0]))
    # 8 deg: Snell and Fresnel in their textbook form
    incidence = math.radians(8.0)
    refraction = math.asin(math.sin(incidence) / 1.5)
    r_s = (math.sin(incidence - refraction) / math.sin(incidence + refraction)) ** 2
    r_p = (math.tan(incidence - refraction) / math.tan(incidence + refraction)) ** 2
    assert table["k_s"].tolist() == pytest.approx([0.5 * (r_s + r_p)] * 2, rel=1e-12)
    np.testing.assert_allclose(table["k_g"], table["k_d"] + table["k_s"], rtol=1e-15)
    np.testing.assert_array_equal(table["k_d"], table["rho_d"])


def test_sphere_errors_have_the_stated_size_and_shape(make_config) -> None:
    grid = np.arange(300.0, 1501.0, 100.0)
    truth = truth_table(make_config(), grid)["k_g"]
    errors = np.array(
        [sphere_spectrum(make_config({"simulation.seed": seed}), grid) / truth - 1.0 for seed in range(150)]
    )
    sigma = 0.01 / 2.0
    assert np.std(errors) == pytest.approx(sigma, rel=0.1)
    assert np.std(errors.mean(axis=1)) == pytest.approx(sigma * math.sqrt(0.5 + 0.5 / len(grid)), rel=0.15)
    assert abs(np.mean(errors)) < 4.0 * sigma / math.sqrt(150.0 / 2.0)


def test_sphere_is_the_same_on_any_grid(make_config) -> None:
    config = make_config()
    coarse = sphere_spectrum(config, np.array([500.0, 700.0]))
    fine = sphere_spectrum(config, np.arange(400.0, 801.0, 50.0))
    np.testing.assert_array_equal(coarse, fine[[2, 6]])


def test_an_exact_sphere_reads_the_truth_at_its_own_angle(make_config) -> None:
    config = make_config({"simulation.sphere": {"theta_i_deg": 8.0, "uncertainty": 0.0}})
    np.testing.assert_array_equal(sphere_spectrum(config), truth_table(config)["k_g"])
    steep = make_config({"simulation.sphere": {"theta_i_deg": 60.0, "uncertainty": 0.0}})
    assert np.all(sphere_spectrum(steep) > sphere_spectrum(config))


def test_files(make_config, tmp_path) -> None:
    config = make_config()
    write_truth(tmp_path / "truth.csv", config)
    write_sphere(tmp_path / "sphere.csv", config, np.array([400.0, 500.0]))
    with (tmp_path / "truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["wavelength_nm", "rho_d", "rho_s", "alpha", "n2", "k_d", "k_s", "k_g"]
    assert len(rows) == 141
    assert float(rows[20]["rho_d"]) == pytest.approx(0.62)
    lines = (tmp_path / "sphere.csv").read_text().splitlines()
    assert lines[0] == "wavelength_nm,k_g,k_g_u"
    assert [float(line.split(",")[0]) for line in lines[1:]] == [400.0, 500.0]
    value, standard = (float(v) for v in lines[1].split(",")[1:])
    assert standard == pytest.approx(0.005 * value)

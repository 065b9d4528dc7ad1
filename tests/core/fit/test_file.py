"""A fit stored beside its data, its table, and the material made of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np
import pytest
from simulated_readings import FloatArray, Positions, instrument_noise

from gonio.aperture import Aperture
from gonio.errors import GonioError, StoreError
from gonio.fitting import FitResult, fit_readings, load_fit
from gonio.material import Material

TRUTH = (0.72, 1.0, 90.0, 1.5)


@pytest.fixture(scope="module")
def fit(positions: Positions, exact_readings: Callable[..., FloatArray], aperture: Aperture) -> FitResult:
    rng = np.random.default_rng(1)
    m = 13
    r = exact_readings(*TRUTH)
    y = r[:, None] + instrument_noise(r)[:, None] * rng.standard_normal((r.size, m))
    y[:, 4] = np.nan
    return fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization, y,
        instrument=aperture, wavelength_nm=np.linspace(300.0, 1500.0, m), gain_u=0.002, sample_name="panel",
        detector_index=[0] * 6 + [1] * 7,
    )  # fmt: skip


@pytest.fixture
def scan_file(tmp_path: Path) -> Path:
    path = tmp_path / "scan.h5"
    with h5py.File(path, "w") as file:
        file.create_group("entry").attrs["NX_class"] = "NXentry"
    return path


def test_round_trip(fit: FitResult, scan_file: Path) -> None:
    assert fit.save(scan_file) == "exact_joint"
    again = load_fit(scan_file)
    for field in fields(FitResult):
        ours, theirs = getattr(fit, field.name), getattr(again, field.name)
        if isinstance(ours, np.ndarray):
            np.testing.assert_array_equal(theirs, ours)
            assert theirs.dtype.kind == ours.dtype.kind
        else:
            assert theirs == ours, field.name
    with h5py.File(scan_file) as file:
        group = file["entry/fit_exact_joint"]
        assert group.attrs["NX_class"] == "NXprocess"
        assert group["wavelength_nm"].attrs["units"] == "nm"
        assert all("quantity" in d.attrs for d in group.values() if getattr(d, "ndim", 0) == 2)


def test_a_fit_replaces_the_one_of_its_name_and_no_other(fit: FitResult, scan_file: Path) -> None:
    fit.save(scan_file, "mine")
    fit.save(scan_file, "mine")
    fit.save(scan_file)
    with h5py.File(scan_file) as file:
        assert sorted(file["entry"]) == ["fit_exact_joint", "fit_mine"]
    assert load_fit(scan_file, "fit_mine").sample_name == "panel"


def test_refusals(fit: FitResult, scan_file: Path, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="holds no fit; run: gonio fit"):
        load_fit(scan_file)
    fit.save(scan_file)
    with pytest.raises(StoreError, match="holds no fit 'point_s'; it holds: exact_joint"):
        load_fit(scan_file, "point_s")
    with pytest.raises(StoreError, match="letters, digits and _ only"):
        fit.save(scan_file, "a/b")
    with pytest.raises(StoreError, match="there is no such file"):
        load_fit(tmp_path / "none.h5")
    text = tmp_path / "text.h5"
    text.write_text("not HDF5")
    with pytest.raises(StoreError, match="is not an HDF5 file"):
        fit.save(text)
    with h5py.File(scan_file, "r+") as file:
        del file["entry/fit_exact_joint/covariance"]
    with pytest.raises(StoreError, match="damaged or of another version"):
        load_fit(scan_file)


def test_table_shows_truth_and_sphere_beside_the_fit(fit: FitResult) -> None:
    at = fit.wavelength_nm
    truth = {"wavelength_nm": at, "rho_d": np.full(at.size, 0.72), "n2": np.full(at.size, 1.5)}
    sphere = {"wavelength_nm": at, "k_g": np.full(at.size, 0.79), "k_g_u": np.full(at.size, 0.004)}
    text = fit.table(truth=truth, sphere=sphere)
    rows = text.splitlines()
    assert rows[0].split() == ["nm", "rho_d", "rho_s", "alpha", "n2"]
    assert ["nm", "k_d", "k_s", "k_g", "k_g", "sphere", "E_n"] in [row.split() for row in rows]
    parameters, coefficients = (row for row in rows if row.startswith("300-400"))
    assert parameters.split()[1] == coefficients.split()[1] == f"{fit.value[0, 0]:.4f}"
    # (0.76 - 0.79) / (2 * 0.004) with the fit's own small interval
    assert -3.9 < float(coefficients.split()[-1]) < -3.4
    assert max(map(len, rows[:20])) < 100
    assert sum("true" in row and "0.7200" in row and "1.500" in row for row in rows) == 7
    assert "700 nm: only 0 usable readings" in text
    assert len(fit.table([(300.0, 900.0)]).splitlines()) < len(rows)


def test_material_of_a_fit(fit: FitResult, scan_file: Path) -> None:
    fit.save(scan_file)
    material = Material.from_file(scan_file)
    assert material.name == "panel"
    assert material.wavelength_nm.size == 12  # the wavelength without a result is left out
    assert material.theta_i_deg == pytest.approx((20.0, 30.0, 45.0, 55.0))
    band = material.band(300.0, 1500.0)
    values = [float(x[0]) for x in (band.rho_d, band.rho_s, band.alpha, band.n2)]
    assert values == pytest.approx(TRUTH, rel=0.01)
    assert float(band.k_s(8.0)[0]) == pytest.approx(0.04, rel=0.005)


def test_material_without_a_lobe_is_lambertian(
    positions: Positions, exact_readings: Callable[..., FloatArray], aperture: Aperture
) -> None:
    r = exact_readings(0.6, 0.0, 50.0, 1.5)[:, None]
    at = (positions.theta_i_deg, positions.theta_o_deg, positions.polarization)
    material = Material.from_fit(fit_readings(*at, r, instrument=aperture, wavelength_nm=[500.0]))
    assert float(material.k_g(70.0)[0]) == pytest.approx(0.6, rel=1e-9)
    s = positions.polarization == "s"
    one = s & (positions.theta_i_deg == 45.0)
    product = exact_readings(*TRUTH)[one][:, None]
    single = fit_readings(*(x[one] for x in at), product, instrument=aperture, wavelength_nm=[500.0])
    with pytest.raises(GonioError, match="rho_s and n2 are undetermined"):
        Material.from_fit(single)


def test_band_average_of_a_stored_fit_is_that_of_the_fit(fit: FitResult, scan_file: Path) -> None:
    fit.save(scan_file)
    flat = load_fit(scan_file).band_average(400.0, 600.0, weight="flat")
    use = (fit.wavelength_nm >= 400.0) & (fit.wavelength_nm <= 600.0)
    at, k = fit.wavelength_nm[use], fit.hemispherical(8.0).k_d.value[use]
    assert float(flat.k_d.value) == pytest.approx(np.trapezoid(k, at) / 200.0, rel=1e-12)
    assert flat.k_d.u < float(np.max(fit.se[use, 0]))

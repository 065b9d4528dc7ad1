"""The sphere beside the scan: round trip through the file, files of before, and damaged ones."""

from __future__ import annotations

import hashlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from perkinelmer_files import asc

from gonio.errors import StoreError
from gonio.sphere import (
    Geometry,
    attach_sphere,
    parse_uncertainty,
    read_sphere,
    read_sphere_file,
    sphere_of,
    sphere_of_columns,
)
from gonio.store import attach_csv_spectrum, read_spectrum

POINTS = [(900.0, 78.5), (890.0, 78.0), (880.0, 77.25)]


@pytest.fixture
def scan_file(tmp_path: Path) -> Path:
    path = tmp_path / "scan.h5"
    with h5py.File(path, "w") as file:
        file.create_group("entry/data")
    return path


def test_round_trip_with_all_that_is_known(tmp_path: Path, scan_file: Path) -> None:
    source = tmp_path / "hpl.asc"
    source.write_text(asc(POINTS, {43: "820.8", 48: "45"}), encoding="utf-8")
    given = sphere_of(
        read_sphere_file(source), parse_uncertainty("1 % relative, k=2"), Geometry(8.0, "included")
    )
    attach_sphere(scan_file, given)
    found = read_sphere(scan_file)
    np.testing.assert_array_equal(found.wavelength_nm, given.wavelength_nm)
    np.testing.assert_array_equal(found.value, given.value)
    np.testing.assert_allclose(found.standard, 0.005 * given.value, rtol=1e-14)
    assert found.uncertainty == "1 % relative, k = 2"
    assert found.geometry == Geometry(8.0, "included", stated=True)
    assert found.detector_change_nm == (820.8,)
    assert found.facts == {k: v for k, v in given.facts.items() if k != "geometry"}
    assert found.facts["source_sha256"] == hashlib.sha256(source.read_bytes()).hexdigest()
    assert found.facts["header_instrument"] == "Lambda 950"
    assert found.name == "hpl.asc"
    with h5py.File(scan_file) as file:
        group = file["entry/sphere"]
        assert group.attrs["NX_class"] == "NXdata"
        assert group.attrs["signal"] == "k_g"
        assert group.attrs["specular"] == "included"
        assert group.attrs["geometry"] == "8:di"
        assert group.attrs["theta_i_deg"] == 8.0
        assert group.attrs["uncertainty"] == "1 % relative, k = 2"
        assert group["k_g_u"].attrs["units"] == "1"
        assert group["wavelength"].attrs["units"] == "nm"
    # what reads spectra knows it as well
    np.testing.assert_array_equal(read_spectrum(scan_file, "sphere")["k_g"], given.value)


def test_without_the_specular_beam_it_is_stored_as_the_diffuse_coefficient(
    tmp_path: Path, scan_file: Path
) -> None:
    source = tmp_path / "sce.csv"
    source.write_text("nm,%R,U\n300,30,0.4\n310,40,0.4\n", encoding="utf-8")
    given = sphere_of(
        read_sphere_file(source, column="%R"), parse_uncertainty("column U, k=2"), Geometry(10.0, "excluded")
    )
    attach_sphere(scan_file, given)
    found = read_sphere(scan_file)
    assert found.geometry == Geometry(10.0, "excluded")
    assert set(read_spectrum(scan_file, "sphere")) == {"wavelength_nm", "k_d", "k_d_u"}
    np.testing.assert_allclose(found.standard, 0.002, rtol=1e-14)
    assert found.uncertainty == "column U of the file, k = 2"


def test_a_second_takes_the_place_of_the_first(tmp_path: Path, scan_file: Path) -> None:
    test_round_trip_with_all_that_is_known(tmp_path, scan_file)
    test_without_the_specular_beam_it_is_stored_as_the_diffuse_coefficient(tmp_path, scan_file)
    with h5py.File(scan_file) as file:
        assert list(file["entry"]) == ["data", "sphere"]
        assert "header_instrument" not in file["entry/sphere"].attrs


def test_files_of_before_are_read(tmp_path: Path, scan_file: Path) -> None:
    source = tmp_path / "old.csv"
    source.write_text("wavelength_nm,k_g,k_g_u\n300,0.30,0.004\n310,0.40,0.004\n", encoding="utf-8")
    attach_csv_spectrum(scan_file, "sphere", source)
    found = read_sphere(scan_file)
    assert found.geometry == Geometry(8.0, "included", stated=False)
    assert found.uncertainty == "as its file says (column k_g_u, k = 1)"
    np.testing.assert_array_equal(found.standard, 0.004)
    source.write_text("wavelength_nm,k_g\n300,0.30\n310,\n320,0.40\n", encoding="utf-8")
    attach_csv_spectrum(scan_file, "sphere", source)
    found = read_sphere(scan_file)
    np.testing.assert_array_equal(found.wavelength_nm, [300.0, 320.0])  # an empty cell of before
    assert np.all(np.isnan(found.standard))
    assert found.uncertainty == "no uncertainty stated"


def test_damaged_groups_are_named(tmp_path: Path, scan_file: Path) -> None:
    with pytest.raises(StoreError, match="holds no /entry/sphere; bring one in"):
        read_sphere(scan_file)
    source = tmp_path / "hpl.csv"
    source.write_text("nm,%R\n300,30\n310,40\n", encoding="utf-8")
    given = sphere_of(read_sphere_file(source), parse_uncertainty("0.01 absolute, k=1"), Geometry())
    for attribute, value, message in (
        ("geometry", "sideways", "'sideways' is no geometry"),
        ("geometry", "8:de", "holds wavelength_nm, k_g, k_g_u, and not k_d"),
        ("detector_change_nm", "soon", "detector_change_nm = 'soon' is no list"),
        ("detector_change_nm", "inf", "detector_change_nm = 'inf' is no list"),
    ):
        attach_sphere(scan_file, given)
        with h5py.File(scan_file, "r+") as file:
            file["entry/sphere"].attrs[attribute] = value
        with pytest.raises(StoreError, match=message):
            read_sphere(scan_file)
    attach_sphere(scan_file, given)
    with h5py.File(scan_file, "r+") as file:
        file["entry/sphere/k_g_u"][0] = -0.1
    with pytest.raises(StoreError, match="negative uncertainties"):
        read_sphere(scan_file)
    with pytest.raises(StoreError, match="has a wavelength twice"):
        sphere_of_columns({"wavelength_nm": np.array([500.0, 500.0]), "k_g": np.array([0.1, 0.2])})


def test_a_refused_scan_file_is_as_before(tmp_path: Path) -> None:
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["x"] = 1
    before = other.read_bytes()
    source = tmp_path / "hpl.csv"
    source.write_text("nm,%R\n300,30\n310,40\n", encoding="utf-8")
    given = sphere_of(read_sphere_file(source), parse_uncertainty("0.01 absolute, k=1"), Geometry())
    with pytest.raises(StoreError, match="is not a gonio scan"):
        attach_sphere(other, given)
    assert other.read_bytes() == before

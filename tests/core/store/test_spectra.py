"""Spectra from CSV: round trip, and every mistake with its line."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest

import gonio
from gonio.acquire import Runner
from gonio.errors import StoreError
from gonio.plan import parse_plan
from gonio.store import attach_csv_spectrum, read_spectrum

CSV = """# integrating sphere, 8 deg
wavelength_nm,k_s,k_g,theta_i_deg
300,0.04,0.5,8
310.5,,0.6,8
320,0.041,0.7,8
"""


@pytest.fixture(scope="module")
def path(memory: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scan") / "scan.h5"
    return Runner(memory.rig(), parse_plan(memory.PLAN_TOML), path).run()


def attach(path: Path, tmp_path: Path, text: str, group: str = "sphere") -> None:
    csv = tmp_path / "spectrum.csv"
    csv.write_text(text, encoding="utf-8")
    attach_csv_spectrum(path, group, csv)


def test_columns_come_back_by_their_names(path: Path, tmp_path: Path) -> None:
    attach(path, tmp_path, CSV)
    columns = read_spectrum(path, "sphere")
    assert list(columns) == ["wavelength_nm", "k_s", "k_g", "theta_i_deg"]
    np.testing.assert_array_equal(columns["wavelength_nm"], [300.0, 310.5, 320.0])
    np.testing.assert_array_equal(columns["k_s"], [0.04, np.nan, 0.041])
    with h5py.File(path, "r") as file:
        group = file["entry/sphere"]
        assert group.attrs["NX_class"] == "NXdata"
        assert group.attrs["signal"] == "k_s"
        assert group.attrs["auxiliary_signals"].tolist() == ["k_g", "theta_i"]
        assert group["wavelength"].attrs["units"] == "nm"
        assert group["k_s"].attrs["units"] == "1"  # k_s is a coefficient, not a time
        assert group["theta_i"].attrs["units"] == "deg"
        assert group.attrs["description"] == "integrating sphere, 8 deg"
    gonio.load(path)


def test_a_second_spectrum_takes_the_place_of_the_first(path: Path, tmp_path: Path) -> None:
    attach(path, tmp_path, CSV, "simulated_truth")
    attach(path, tmp_path, "wavelength_nm,rho_d\n500,0.7\n", "simulated_truth")
    assert list(read_spectrum(path, "simulated_truth")) == ["wavelength_nm", "rho_d"]


MISTAKES = {
    "empty": ("", "holds no header line"),
    "header only": ("wavelength_nm,k_g\n", "holds no header line"),
    "no unit": (
        "wavelength,k_g\n1,2\n",
        "line 1: the first column is 'wavelength'; it must be wavelength_nm",
    ),
    "one column": ("wavelength_nm\n300\n", "no column beside the wavelength"),
    "bad name": ("wavelength_nm,k g\n1,2\n", "'k g' is no column name"),
    "path as a name": ("wavelength_nm,../k\n1,2\n", "is no column name"),
    "same name": ("wavelength_nm,k,k\n1,2,3\n", "a column name is there twice"),
    "not a number": ("wavelength_nm,k\n300,0.5\n310,high\n", "line 3: k = 'high' is not a number"),
    "too few": ("wavelength_nm,k\n300\n", "line 2: 1 values under 2 names"),
    "descending": ("wavelength_nm,k\n310,1\n\n300,1\n", "line 4: wavelength_nm = 300 does not ascend"),
    "nan wavelength": ("wavelength_nm,k\nnan,1\n", "line 2: wavelength_nm = nan is not a wavelength"),
}


@pytest.mark.parametrize(("text", "message"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_names_its_line_and_leaves_the_file_alone(
    path: Path, tmp_path: Path, text: str, message: str
) -> None:
    before = path.read_bytes()
    with pytest.raises(StoreError) as caught:
        attach(path, tmp_path, text)
    assert message in str(caught.value)
    assert "spectrum.csv" in str(caught.value)
    assert path.read_bytes() == before


def test_a_spectrum_goes_only_where_spectra_go(path: Path, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="'data' is no place for a spectrum"):
        attach(path, tmp_path, CSV, "data")
    with pytest.raises(StoreError, match="'data' is no place"):
        read_spectrum(path, "data")


def test_a_missing_spectrum_says_how_to_bring_one(memory: ModuleType, tmp_path: Path) -> None:
    path = Runner(memory.rig(), parse_plan(memory.PLAN_TOML), tmp_path / "scan.h5").run()
    with pytest.raises(StoreError, match="holds no /entry/sphere; bring one in"):
        read_spectrum(path, "sphere")
    with pytest.raises(StoreError, match="there is no such file"):
        attach_csv_spectrum(path, "sphere", tmp_path / "no.csv")

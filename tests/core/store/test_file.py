"""The finished file as a stranger sees it: with h5py alone, following NeXus."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest

from gonio.acquire import Runner
from gonio.plan import Plan, parse_plan
from gonio.store.describe import nexus_group


@pytest.fixture
def finished(memory: ModuleType, plan: Plan, tmp_path: Path) -> Path:
    world = memory.World(gain_drift_s=1e-4, dark_drift_v_s=1e-6, noise_dark_v=1e-6, noise_full=1e-4)
    return Runner(memory.rig(world), plan, tmp_path / "scan.h5").run()


def datasets(group: h5py.Group) -> Iterator[h5py.Dataset]:
    for item in group.values():
        if isinstance(item, h5py.Group):
            yield from datasets(item)
        else:
            yield item


def test_the_default_plot_is_found_as_a_nexus_viewer_finds_it(finished: Path) -> None:
    with h5py.File(finished, "r") as file:
        entry = file[file.attrs["default"]]
        assert entry.attrs["NX_class"] == "NXentry"
        data = entry[entry.attrs["default"]]
        assert data.attrs["NX_class"] == "NXdata"
        signal = data[data.attrs["signal"]]
        axes = [data[name] for name in data.attrs["axes"]]
        assert signal.shape == tuple(axis.shape[0] for axis in axes)
        assert data[f"{data.attrs['signal']}_errors"].shape == signal.shape
        for name in ("theta_i", "theta_o", "polarization", "wavelength", "time"):
            dimension = int(data.attrs[f"{name}_indices"])
            assert data[name].shape == (signal.shape[dimension],)
        assert np.all(np.diff(axes[1][...]) > 0)


def test_every_sweep_is_a_plot_of_its_rows_of_the_data(finished: Path, plan: Plan) -> None:
    with h5py.File(finished, "r") as file:
        entry = file["entry"]
        names = sorted(name for name in entry if name.startswith("sweep_"))
        assert names == ["sweep_20_p", "sweep_20_s", "sweep_45_p", "sweep_45_s"]
        for name in names:
            group = entry[name]
            assert group.attrs["NX_class"] == "NXdata"
            assert group.attrs["axes"].tolist() == ["theta_o", "wavelength"]
            theta_i, polarization = float(name.split("_")[1]), name[-1]
            rows = [
                p.index
                for p in plan.positions()
                if (p.theta_i_deg, p.polarization) == (theta_i, polarization)
            ]
            np.testing.assert_array_equal(group[group.attrs["signal"]][...], entry["data/r"][rows])
            np.testing.assert_array_equal(group["theta_o"][...], entry["data/theta_o"][rows])
            np.testing.assert_array_equal(group["wavelength"][...], entry["data/wavelength"][...])
            assert np.all(np.diff(group["theta_o"][...]) > 0)


def test_a_sweep_listed_out_of_order_is_plotted_in_order(memory: ModuleType, tmp_path: Path) -> None:
    plan = parse_plan(memory.PLAN_TOML.replace("[15.0, 30.0, 40.0]", "[40.0, 15.0, 16.0, 30.0]"))
    path = Runner(memory.rig(), plan, tmp_path / "scan.h5").run()
    with h5py.File(path, "r") as file:
        group = file["entry/sweep_20_s"]
        np.testing.assert_allclose(group["theta_o"][...], np.array([15.0, 16.0, 30.0, 40.0]) - 20.005)
        np.testing.assert_array_equal(group["r"][...], file["entry/data/r"][[0, 1, 2, 3]][[1, 2, 3, 0]])


def test_a_plan_that_scatters_its_rows_has_copies_of_them(
    memory: ModuleType, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gonio.store.sweeps._MOST_PIECES", 1)
    path = Runner(memory.rig(), plan, tmp_path / "scan.h5").run()
    with h5py.File(path, "r") as file:
        entry = file["entry"]
        for name in (name for name in entry if name.startswith("sweep_")):
            group = entry[name]
            assert not group["r"].is_virtual
            rows = group["position"][...]
            for column in ("r", "r_errors", "theta_o"):
                np.testing.assert_array_equal(group[column][...], entry["data"][column][...][rows])
            assert np.all(np.diff(group["theta_o"][...]) > 0)


def test_every_number_in_data_declares_its_quantity_and_unit(finished: Path) -> None:
    with h5py.File(finished, "r") as file:
        for part in ("data", "references", "sweep_20_s", "instrument", "events"):
            for dataset in datasets(file["entry"][part]):
                if h5py.check_string_dtype(dataset.dtype) is None:
                    assert dataset.attrs["quantity"], dataset.name
                    assert dataset.attrs["units"], dataset.name
                elif dataset.shape != ():
                    assert dataset.attrs["quantity"], dataset.name
        assert file["entry/data/r"].attrs["units"] == "1"
        assert file["entry/data/raw_signal"].attrs["quantity"] == "raw signal"
        assert file["entry/data/baseline"].attrs["units"] == "V"


def test_each_detector_shows_its_own_raw_signal(finished: Path) -> None:
    with h5py.File(finished, "r") as file:
        entry = file["entry"]
        raw, wavelength_nm = entry["data/raw_signal"][...], entry["data/wavelength"][...]
        for number, name in enumerate(entry["data/detector_names"].asstr()[...]):
            own = entry["data/detector_index"][...] == number
            group = entry[f"instrument/detector_{name}/raw_data"]
            assert group.attrs["NX_class"] == "NXdata"
            np.testing.assert_array_equal(group[group.attrs["signal"]][...], raw[:, own])
            np.testing.assert_array_equal(group["wavelength"][...], wavelength_nm[own])
            assert group["position"] == entry["data/position"]


def test_the_instrument_speaks_of_angles_as_optical_spectroscopy_does(finished: Path) -> None:
    with h5py.File(finished, "r") as file:
        instrument = file["entry/instrument"]
        assert file["entry/experiment_type"].asstr()[()] == "reflection spectroscopy"
        assert instrument["angle_reference_frame"].asstr()[()] == "sample-normal centered"
        assert instrument["angle_of_incidence"] == file["entry/data/theta_i"]  # the same dataset
        assert instrument["angle_of_detection"] == file["entry/data/theta_o"]
        assert instrument["angle_of_in_plane_sample_rotation"][()] == 0.0
        assert instrument["beam_incident"] == instrument["beam"]
        assert instrument["detector_pmt/detector_channel_type"].asstr()[()] == "single-channel"
        assert instrument["detector_pmt/solid_angle"].attrs["units"] == "sr"
        assert instrument["detector_pmt/distance"].attrs["units"] == "mm"


def nexus_errors(group: h5py.Group) -> list[str]:
    """Return what breaks the rules by which a viewer finds and labels a plot, for each NXdata below."""
    told: list[str] = []
    for name, item in group.items():
        if not isinstance(item, h5py.Group):
            continue
        told += nexus_errors(item)
        if item.attrs.get("NX_class") != "NXdata":
            continue
        signal = item.get(str(item.attrs.get("signal")))
        axes = [str(axis) for axis in np.atleast_1d(item.attrs["axes"])]
        if not isinstance(signal, h5py.Dataset) or len(axes) != signal.ndim:
            told.append(f"{name}: signal and axes")
            continue
        for dimension, axis in enumerate(axes):
            if item[axis].shape != (signal.shape[dimension],):
                told.append(f"{name}: axis {axis}")
        for key, value in item.attrs.items():
            if key.endswith("_indices"):
                along = item[key.removesuffix("_indices")]
                wanted = tuple(signal.shape[int(i)] for i in np.atleast_1d(value))
                told += [] if along.shape == wanted else [f"{name}: {key}"]
        for key in item:
            if key.endswith("_errors") and item[key].shape != item[key.removesuffix("_errors")].shape:
                told.append(f"{name}: {key}")
    return told


def test_every_plot_keeps_the_rules_of_nexus(finished: Path) -> None:
    with h5py.File(finished, "r") as file:
        assert nexus_errors(file) == []


def test_every_group_has_a_nexus_class(finished: Path) -> None:
    with h5py.File(finished, "r") as file:

        def look(name: str, item: object) -> None:
            if isinstance(item, h5py.Group):
                assert str(item.attrs["NX_class"]).startswith("NX"), name

        file.visititems(look)


def test_r_follows_from_the_raw_columns_beside_it(finished: Path, plan: Plan) -> None:
    with h5py.File(finished, "r") as file:
        data = file["entry/data"]
        raw, dark, baseline = (data[name][...] for name in ("raw_signal", "dark", "baseline"))
        np.testing.assert_allclose(data["r"][...], (raw - dark) / (baseline - dark), rtol=1e-12)
        # and the interpolated columns from the references
        references = file["entry/references"]
        kind = references["kind"].asstr()[...]
        chosen = references["polarization"].asstr()[...] == "p"
        signal, time_s = references["signal"][...], references["time"][...]
        row = next(p.index for p in plan.positions() if p.polarization == "p")
        for j in range(5):
            for name, rows in (("dark", kind == "dark"), ("baseline", (kind == "baseline") & chosen)):
                at = data["reading_time"][row, j]
                expected = np.interp(at, time_s[rows, j], signal[rows, j])
                assert data[name][row, j] == pytest.approx(expected, rel=1e-12)


def test_the_file_says_where_it_comes_from(finished: Path, plan: Plan) -> None:
    with h5py.File(finished, "r") as file:
        entry = file["entry"]

        def text(name: str) -> str:
            return str(entry[name].asstr()[()])

        assert parse_plan(text("plan")) == plan
        assert text("rig").startswith("# the rig file, kept as it is")
        assert text("program").startswith("gonio ")
        assert text("start_time") <= text("end_time")
        assert text("sample/name") == "coded sample"
        assert text("instrument/lockin_identity/model") == "lock-in in memory"
        assert text("instrument/detector_ingaas/detector_type") == "InGaAs"
        aperture = entry["instrument/aperture"]
        w, h, distance = (aperture[k][()] for k in ("width", "height", "distance"))
        assert aperture["solid_angle"][()] == pytest.approx(0.05090, abs=5e-6)  # PHYSICS.md
        assert (w, h, distance) == (26.0, 18.0, 95.2353)
        assert entry.attrs["scan_status"] == "finished"


def test_reference_readings_are_kept_with_their_repeats(finished: Path) -> None:
    with h5py.File(finished, "r") as file:
        group = file["entry/references"]
        assert group["kind"].asstr()[...].tolist() == ["dark", "baseline", "baseline"] * 2
        assert group["when"].asstr()[...].tolist() == ["start"] * 3 + ["end"] * 3
        assert group["polarization"].asstr()[...].tolist() == ["any", "s", "p"] * 2
        assert group["averages"][...].tolist() == [4] * 6
        assert np.all(group["signal_sd"][...] > 0)
        np.testing.assert_allclose(group["theta_mes"][...], 180.0 - 0.003)


def test_a_fit_stored_beside_the_data_disturbs_nothing(finished: Path) -> None:
    import gonio

    before = gonio.load(finished)
    with h5py.File(finished, "r+") as file:
        nexus_group(file["entry"], "fit_exact_joint", "NXprocess").create_dataset("value", data=[1.0])
    np.testing.assert_array_equal(gonio.load(finished).r, before.r)

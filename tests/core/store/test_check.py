"""`gonio check`: a good file passes; whatever is broken in it is found, with its place and what to do."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest

from gonio.acquire import FaultPolicy, Runner, Snapshot
from gonio.acquire.journal import journal_path
from gonio.devices import Quality
from gonio.errors import DeviceError, ScanStopped
from gonio.plan import Plan, parse_plan
from gonio.store.check import check_file


@pytest.fixture(scope="module")
def original(memory: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scan") / "scan.h5"
    world = memory.World(noise_dark_v=1e-6, noise_full=1e-4, gain_drift_s=1e-4)
    return Runner(memory.rig(world), parse_plan(memory.PLAN_TOML), path).run()


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(original, tmp_path / "scan.h5"))


def gonio(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gonio.cli", *map(str, arguments)], capture_output=True, text=True, check=False
    )


def test_a_finished_file_is_in_order(original: Path) -> None:
    verdict = check_file(original)
    assert verdict.findings == []
    assert verdict.kind == "scan, 10 positions x 5 wavelengths, finished"


def test_an_unfinished_file_is_in_order_and_says_how_to_go_on(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    runner = Runner(memory.rig(), plan, path, on_snapshot=lambda s: runner.stop() if s.done == 3 else None)
    with pytest.raises(ScanStopped):
        runner.run()
    verdict = check_file(path)
    assert verdict.findings == []
    assert verdict.kind.endswith("unfinished; continue it with gonio scan --resume")
    journal_path(path).unlink()
    assert check_file(path).kind.endswith("unfinished, without its journal")


def test_a_skipped_position_is_in_order(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world = memory.World()

    def fail_once(snapshot: Snapshot) -> None:
        if snapshot.done == 2 and not world.fail and not failed:
            failed.append(True)
            world.fail["measure"] = DeviceError("lock-in", "does not answer", "look at it")

    failed: list[bool] = []
    policy = FaultPolicy(retries=0, then="skip")
    path = Runner(memory.rig(world), plan, tmp_path / "scan.h5", policy=policy, on_snapshot=fail_once).run()
    with h5py.File(path, "r") as file:
        assert np.sum(np.isnan(file["entry/data/theta_i"][...])) == 1
    assert check_file(path).findings == []


def test_two_detectors_on_one_wavelength_are_in_order(memory: ModuleType, tmp_path: Path) -> None:
    plan = parse_plan("overlap_nm = 10.0\n" + memory.PLAN_TOML)
    path = Runner(memory.rig(), plan, tmp_path / "scan.h5").run()
    with h5py.File(path, "r") as file:
        assert np.any(np.diff(file["entry/data/wavelength"][...]) < 0)
    assert check_file(path).findings == []


def set_row(name: str, row: Any, value: Any) -> Callable[[h5py.File], None]:
    return lambda file: file[name].__setitem__(row, value)


def attribute(name: str, key: str, value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if value is None:
            del file[name].attrs[key]
        else:
            file[name].attrs[key] = value

    return change


def instead(name: str, **options: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        attributes = dict(file[name].attrs)
        del file[name]
        file.create_dataset(name, **options).attrs.update(attributes)

    return change


BROKEN: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "no default": (attribute("/", "default", None), "/: has no attribute default; set it to 'entry'"),
    "no class": (attribute("entry/sample", "NX_class", None), "/entry/sample: has no attribute NX_class"),
    "other class": (
        attribute("entry", "NX_class", "NXroot"),
        "attribute NX_class is 'NXroot'; set it to 'NXentry'",
    ),
    "number for a class": (attribute("entry", "NX_class", 7), "/entry: has no attribute NX_class"),
    "no unit": (
        attribute("entry/data/raw_signal", "units", None),
        "/entry/data/raw_signal: has no attribute units; set it to 'V'",
    ),
    "other unit": (
        attribute("entry/data/theta_o", "units", "rad"),
        "attribute units is 'rad'; set it to 'deg'",
    ),
    "no quantity": (attribute("entry/data/r", "quantity", None), "/entry/data/r: has no attribute quantity"),
    "no unit of a reference": (
        attribute("entry/references/signal", "units", None),
        "/entry/references/signal: has no attribute units",
    ),
    "no index": (
        attribute("entry/data", "theta_o_indices", None),
        "theta_o_indices is missing or wrong; set it to 0",
    ),
    "axes": (
        attribute("entry/data", "axes", ["wavelength", "position"]),
        "attribute axes is ['wavelength', 'position']",
    ),
    "signal": (attribute("entry/data", "signal", "raw_signal"), "attribute signal is 'raw_signal'"),
    "status": (attribute("entry", "scan_status", "nearly"), "attribute scan_status is 'nearly'"),
    "no sample": (lambda f: f.__delitem__("entry/sample"), "/entry/sample: is missing"),
    "no detector": (
        lambda f: f.__delitem__("entry/instrument/detector_pmt"),
        "/entry/instrument/detector_pmt: is missing",
    ),
    "no start": (lambda f: f.__delitem__("entry/start_time"), "/entry/start_time: is missing"),
    "no end": (lambda f: f.__delitem__("entry/end_time"), "/entry/end_time: is missing"),
    "strange end": (set_row("entry/end_time", (), "yesterday"), "'yesterday' is no time"),
    "no column": (
        lambda f: f.__delitem__("entry/data/wavelength_readback"),
        "/entry/data/wavelength_readback: is missing",
    ),
    "shape": (
        instead("entry/data/raw_signal_sd", data=np.ones((10, 4))),
        "has shape (10, 4), expected (10, 5)",
    ),
    "type": (
        instead("entry/data/theta_mes_set", data=np.arange(10)),
        "/entry/data/theta_mes_set: holds int64, expected f8",
    ),
    "solid angle": (
        set_row("entry/instrument/aperture/solid_angle", (), 0.06),
        "is 0.06 sr, of these sizes 0.0509",
    ),
    "theta_o": (
        set_row("entry/data/theta_o", 3, 12.0),
        "/entry/data/theta_o: is not theta_mes - theta_i at position 3",
    ),
    "NaN angle": (
        set_row("entry/data/theta_i", 2, np.nan),
        "/entry/data/theta_i: has no angle at position 2",
    ),
    "far": (
        set_row("entry/data/theta_mes_set", 4, 0.0),
        "is more than 1 deg from theta_mes_set at position 4",
    ),
    "number": (
        set_row("entry/data/position", 1, -1),
        "/entry/data/position: is not the number of its row at position 1",
    ),
    "circular": (set_row("entry/data/polarization", 0, b"c"), "is neither s nor p at position 0"),
    "time": (set_row("entry/data/time", 5, 0.0), "/entry/data/time: does not ascend at position 5"),
    "bits": (set_row("entry/data/quality", (1, 2), 1 << 12), "has unknown bits at position 1, column 2"),
    "not measured": (
        set_row("entry/data/quality", (1, 2), int(Quality.NOT_MEASURED)),
        "says not measured, but it is",
    ),
    "r": (
        set_row("entry/data/r", (6, 1), 0.5),
        "/entry/data/r: is not (raw_signal - dark) / (baseline - dark) at position 6, column 1",
    ),
    "raw": (
        set_row("entry/data/raw_signal", (6, 1), np.nan),
        "/entry/data/raw_signal: has no value, and quality does not say why",
    ),
    "negative": (set_row("entry/data/r_errors", (0, 0), -1e-3), "/entry/data/r_errors: is negative"),
    "averages": (set_row("entry/data/averages", (0, 0), 0), "/entry/data/averages: is zero"),
    "reference": (
        set_row("entry/references/signal", (1, 2), 0.5),
        "/entry/data/baseline: does not follow from /entry/references",
    ),
    "kind": (set_row("entry/references/kind", 0, "grey"), "holds grey any"),
    "reference time": (set_row("entry/references/time", 4, 0.0), "/entry/references/time: does not ascend"),
    "level": (set_row("entry/events/level", 0, "panic"), "/entry/events/level: holds panic"),
    "plan": (set_row("entry/plan", (), "title = 3"), "/entry/plan: cannot be read"),
    "index": (set_row("entry/data/detector_index", 0, 9), "reaches 9, 2 are named"),
    "descending": (set_row("entry/data/wavelength", 1, 800.0), "does not ascend within each detector"),
    "sweep": (attribute("entry/sweep_20_s", "axes", "theta_o"), "/entry/sweep_20_s: attribute axes is []"),
}


@pytest.mark.parametrize(("change", "told"), BROKEN.values(), ids=BROKEN.keys())
def test_what_is_broken_is_found(path: Path, change: Callable[[h5py.File], None], told: str) -> None:
    with h5py.File(path, "r+") as file:
        change(file)
    lines = [str(finding) for finding in check_file(path).findings]
    assert any(told in line for line in lines), lines
    assert all(line.startswith("/") and "; " in line for line in lines)


def test_a_finished_file_with_a_journal_is_found(path: Path) -> None:
    journal_path(path).touch()
    assert "lies beside it; run gonio scan --resume" in str(check_file(path).findings[0])


def test_a_file_of_another_program_and_no_file_are_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["results"] = [1.0]
    verdict = check_file(tmp_path / "other.h5")
    assert verdict.kind == "HDF5 file of another program"
    assert "/entry is missing" in str(verdict.findings[0])
    assert "there is no such file" in str(check_file(tmp_path / "none.h5").findings[0])
    assert "is a folder" in str(check_file(tmp_path).findings[0])


def test_the_command_prints_one_line_for_each_finding_and_exits_1(path: Path, original: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["entry/data/r"].attrs["units"]
        file["entry/data/theta_o"][3] = 12.0
        file.create_group("entry/fit_point_s")
    bad = gonio("check", original, path)
    assert bad.returncode == 1
    assert bad.stderr == ""
    lines = bad.stdout.splitlines()
    assert lines[0].endswith("finished; nothing is wrong with it")
    assert lines[1] == f"{path}: scan, finished"
    assert f"{path}:/entry/data/r: has no attribute units; set it to '1'" in lines
    assert lines[-1].startswith(f"{path}:/entry/fit_point_s: is damaged or of another version")
    assert gonio("check", original).returncode == 0
    assert gonio("check").returncode == 2


def test_a_facade_result_is_known(tmp_path: Path) -> None:
    path = tmp_path / "facade.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update({"default": "entry"})
        entry = file.create_group("entry")
        entry["experiment_type"] = "gonio facade simulation"
        entry.create_group("process").attrs["NX_class"] = "NXprocess"
        group = entry.create_group("receiver_south")
        group.attrs["NX_class"] = "NXdata"
        for name in ("irradiance", "irradiance_errors"):
            group.create_dataset(name, data=np.ones((2, 3))).attrs["units"] = "W/m2"
    assert check_file(path).kind == "facade result"
    assert check_file(path).findings == []
    with h5py.File(path, "r+") as file:
        file["entry/receiver_south/irradiance"][0, 0] = np.nan
    assert "no irradiance" in str(check_file(path).findings[0])

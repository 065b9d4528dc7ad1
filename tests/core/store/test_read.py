"""Loading: what comes back, and what bad files are answered."""

from __future__ import annotations

import shutil
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest

import gonio
from gonio.acquire import Runner, Snapshot
from gonio.devices import Quality
from gonio.errors import ScanStopped, StoreError
from gonio.plan import Plan, parse_plan


@pytest.fixture(scope="module")
def original(memory: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scan") / "scan.h5"
    world = memory.World(noise_dark_v=1e-6, noise_full=1e-4)
    return Runner(memory.rig(world), parse_plan(memory.PLAN_TOML), path).run()


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(original, tmp_path / "scan.h5"))


def test_an_xarray_has_named_dimensions_and_units(original: Path) -> None:
    scan = gonio.load(original)
    dataset = scan.to_xarray()
    assert dict(dataset.sizes) == {"position": 10, "wavelength": 5}
    assert dataset.r.dims == ("position", "wavelength")
    assert dataset.theta_o.attrs["units"] == "deg"
    assert dataset.wavelength.attrs["units"] == "nm"
    assert dataset.raw_signal.attrs["units"] == "V"
    chosen = dataset.where((dataset.polarization == "p") & (dataset.theta_i > 40), drop=True)
    np.testing.assert_array_equal(chosen.r, scan.r[(scan.polarization == "p") & (scan.theta_i_deg > 40)])
    assert dataset.detector.values.tolist() == ["pmt"] * 2 + ["ingaas"] * 3


def test_a_saturated_reading_is_stored_and_not_usable(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    rig = memory.rig()
    rig.spectrometer.over_range.add(("sample", 860.0))
    scan = gonio.load(Runner(rig, plan, tmp_path / "scan.h5").run())
    assert np.all(scan.quality[:, 2] == Quality.OVER_RANGE)
    assert np.all(np.isfinite(scan.r))
    assert not scan.usable[:, 2].any()
    assert scan.usable[:, [0, 1, 3, 4]].all()


def test_an_unfinished_scan_loads_with_what_it_has(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == 4:
            runner.stop()

    runner = Runner(memory.rig(), plan, path, on_snapshot=on_snapshot)
    with pytest.raises(ScanStopped):
        runner.run()
    scan = gonio.load(path)
    assert not scan.finished
    assert scan.n_planned == 10
    assert scan.position.tolist() == [0, 1, 2, 3]
    assert scan.r.shape == (4, 5)
    assert np.all(scan.usable)


def test_a_file_without_a_position_says_so(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    runner = Runner(
        memory.rig(),
        plan,
        path,
        on_snapshot=lambda s: runner.stop() if s.readings_done >= 5 else None,
    )
    with pytest.raises(ScanStopped):
        runner.run()
    with pytest.raises(StoreError, match="no position has been measured yet"):
        gonio.load(path)


def test_missing_empty_and_foreign_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="there is no such file"):
        gonio.load(tmp_path / "no.h5")
    (tmp_path / "empty.h5").touch()
    with pytest.raises(StoreError, match="is empty"):
        gonio.load(tmp_path / "empty.h5")
    (tmp_path / "text.h5").write_text("theta, r\n1, 2\n" * 1000)
    with pytest.raises(StoreError, match="is not an HDF5 file"):
        gonio.load(tmp_path / "text.h5")
    with pytest.raises(StoreError, match="is a folder and not an HDF5 file"):
        gonio.load(tmp_path)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["results"] = [1.0, 2.0]
    with pytest.raises(StoreError, match=r"other\.h5: is not a gonio scan: /entry is missing"):
        gonio.load(tmp_path / "other.h5")


@pytest.mark.parametrize("part", [0.999, 0.9, 0.5, 0.1, 0.01])
def test_a_truncated_file_is_an_error_and_names_the_way_on(path: Path, part: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    with pytest.raises(StoreError, match=r"cut short|not an HDF5 file"):
        gonio.load(path)


def replace(name: str, make: Callable[[h5py.Group, str], Any]) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        parent, _, last = name.rpartition("/")
        del file[name]
        make(file[parent], last)

    return change


HUGE = 10**15

HOSTILE: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "no data": (lambda f: f.__delitem__("entry/data"), "/entry/data/detector_names is missing"),
    "no r": (lambda f: f.__delitem__("entry/data/r"), "/entry/data/r is missing"),
    "group for r": (replace("entry/data/r", lambda g, n: g.create_group(n)), "is not a dataset"),
    "soft link": (
        replace("entry/data/r", lambda g, n: g.__setitem__(n, h5py.SoftLink("/entry/data/dark"))),
        "is a link out of its place",
    ),
    "external link": (
        replace("entry/data/r", lambda g, n: g.__setitem__(n, h5py.ExternalLink("x.h5", "/r"))),
        r"/entry/data/r is a link to another file \(x\.h5\)",
    ),
    "external storage": (
        replace(
            "entry/data/r",
            lambda g, n: g.create_dataset(n, (10, 5), "f8", external=[("other.raw", 0, h5py.h5f.UNLIMITED)]),
        ),
        "is kept in another place",
    ),
    "one dimension": (
        replace("entry/data/r", lambda g, n: g.create_dataset(n, data=np.ones(10))),
        "has 1 dimensions, expected 2",
    ),
    "huge rows": (
        replace("entry/data/r", lambda g, n: g.create_dataset(n, (HUGE, 5), "f8", chunks=(1, 5))),
        "values, more than are stored",
    ),
    "huge everything": (
        lambda f: (
            [
                replace(
                    f"entry/data/{name}",
                    lambda g, n: g.create_dataset(n, (HUGE, 5) if n == "r" else (HUGE,), "f8", chunks=True),
                )(f)
                for name in ("r", "theta_i")
            ]
            and None
        ),
        "values, more than are stored",
    ),
    "huge wavelengths": (
        replace("entry/data/wavelength", lambda g, n: g.create_dataset(n, (HUGE,), "f8", chunks=True)),
        "values, more than are stored",
    ),
    "compressed bomb": (
        replace(
            "entry/data/wavelength",
            lambda g, n: g.create_dataset(n, (HUGE,), "f8", chunks=(10**6,), compression="gzip"),
        ),
        "values, more than are stored",
    ),
    "integers": (
        replace("entry/data/r", lambda g, n: g.create_dataset(n, data=np.ones((10, 5), int))),
        "holds int64, expected a type of kind 'f'",
    ),
    "texts": (
        replace("entry/data/theta_i", lambda g, n: g.create_dataset(n, data=["a"] * 10)),
        "/entry/data/theta_i holds object",
    ),
    "missing column": (
        replace("entry/data/r_errors", lambda g, n: g.create_dataset(n, data=np.ones((10, 4)))),
        r"has shape \(10, 4\), expected \(10, 5\)",
    ),
    "unnamed detector": (
        replace("entry/data/detector_index", lambda g, n: g.create_dataset(n, data=np.full(5, 9, "u1"))),
        "detector_index reaches 9, but 2 detectors are named",
    ),
    "negative wavelength": (
        lambda f: f["entry/data/wavelength"].write_direct(-np.ones(5)),
        "wavelength holds values that are not positive",
    ),
    "circular": (lambda f: f["entry/data/polarization"].__setitem__(0, b"c"), "something else than s and p"),
    "flat aperture": (
        lambda f: f["entry/instrument/aperture/width"].__setitem__((), -1.0),
        "aperture",
    ),
    "numbers for a title": (
        replace("entry/title", lambda g, n: g.create_dataset(n, data=[1, 2])),
        "/entry/title is not a text",
    ),
}


@pytest.mark.parametrize(("change", "message"), HOSTILE.values(), ids=HOSTILE.keys())
def test_a_file_that_contradicts_itself_is_refused_without_taking_memory(
    path: Path, change: Callable[[h5py.File], None], message: str
) -> None:
    with h5py.File(path, "r+") as file:
        change(file)
    tracemalloc.start()
    with pytest.raises(StoreError, match=message) as caught:
        gonio.load(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert str(caught.value).startswith(str(path))
    assert peak < 50_000_000


def test_a_repacked_compressed_copy_loads(path: Path, tmp_path: Path) -> None:
    scan = gonio.load(path)
    with h5py.File(path, "r+") as file:
        r = file["entry/data/r"][...]
        del file["entry/data/r"]
        file["entry/data"].create_dataset("r", data=r, compression="gzip", chunks=True)
    np.testing.assert_array_equal(gonio.load(path).r, scan.r)


@pytest.mark.parametrize("seed", range(40))
def test_random_damage_is_a_store_error_or_harmless(path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = bytearray(path.read_bytes())
    for at in rng.integers(0, len(data), 200):
        data[at] = rng.integers(0, 256)
    path.write_bytes(data)
    with suppress(StoreError):  # anything else is a defect
        scan = gonio.load(path)
        assert scan.r.shape == (len(scan.position), len(scan.wavelength_nm))

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from gonio.errors import ConfigError, StoreError
from gonio.facade import (
    CONTRIBUTIONS,
    BandIrradiance,
    EnergyBalance,
    Estimate,
    ExchangeBalance,
    Irradiance,
    Omission,
    Optics,
    Receiver,
    Scene,
    load_irradiance,
    simulate,
)
from gonio.store.check import check_file


@pytest.fixture
def result(canyon: Callable[..., Scene]) -> Irradiance:
    scene = canyon(
        wall=Optics(0.6, 1.0, 80.0, 1.5), dni=800.0, dhi=100.0, rows=3, columns=2, title="Canyon",
        text="# scene",
        notes=("a note",),
    )  # fmt: skip
    return simulate(scene, rel_tol=0.03, seed=11)


def test_file_gives_back_what_was_saved(result: Irradiance, tmp_path: Path) -> None:
    path = tmp_path / "facade.h5"
    path.write_bytes(b"an older file")
    result.save(path)
    again = load_irradiance(path)
    assert list(tmp_path.iterdir()) == [path]
    for key in ("energy", "title", "scene_text", "seed", "rel_tol", "relative_error", "converged", "rays",
                "duration_s", "notes"):  # fmt: skip
        assert getattr(again, key) == getattr(result, key), key
    assert [r.name for r in again.receivers] == ["left", "right", "ground"]
    for a, b in zip(again.receivers, result.receivers, strict=True):
        assert (a.origin_m, a.u_m, a.v_m) == (b.origin_m, b.u_m, b.v_m)
        assert np.array_equal(a.value, b.value)
        assert np.array_equal(a.standard_error, b.standard_error)
        assert a.mean.value == b.mean.value
        for name in CONTRIBUTIONS:
            assert np.array_equal(a.contributions[name].value, b.contributions[name].value)
            assert a.mean_contributions[name].standard_error == b.mean_contributions[name].standard_error
    assert again.table() == result.table()


def test_file_is_nexus_with_units(result: Irradiance, tmp_path: Path) -> None:
    result.save(tmp_path / "facade.h5")
    with h5py.File(tmp_path / "facade.h5") as file:
        data = file[file.attrs["default"]]
        data = data[data.attrs["default"]]
        assert data.attrs["NX_class"] == "NXdata"
        assert data[data.attrs["signal"]].shape == (3, 2)
        assert [data[axis].shape for axis in data.attrs["axes"]] == [(3,), (2,)]

        seen: set[str] = set()

        def declares(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset) and item.dtype.kind == "f":
                assert item.attrs["quantity"], name
                seen.add(item.attrs["units"])
                if name.startswith("entry/receiver_left/") and "row" not in name and "column" not in name:
                    assert item.attrs["units"] == "W/m2"
                    assert "irradiance" in item.attrs["quantity"]

        file.visititems(declares)
        assert seen <= {"W/m2", "W", "m", "s", "1", "%", "any"}
        assert file["entry/process/scene"].asstr()[()] == "# scene"


def mesh_receiver(name: str = "roof") -> Receiver:
    """Two triangles of 1 and 3 m2."""
    vertices = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]])
    faces = np.array([[0, 1, 2], [0, 1, 3]])
    values = np.array([100.0, 200.0])

    def part(share: float) -> Estimate:
        return Estimate(share * values, share * np.array([1.0, 3.0]))

    def mean(share: float) -> Estimate:
        return Estimate(np.asarray(share * 175.0), np.asarray(share))

    return Receiver.on_mesh(
        name, vertices, faces, total=part(1.0), mean=mean(1.0), discretisation_w_m2=0.35,
        contributions={c: part(0.25) for c in CONTRIBUTIONS},
        mean_contributions={c: mean(0.25) for c in CONTRIBUTIONS},
    )  # fmt: skip


def whole(*receivers: Receiver, **changed: Any) -> Irradiance:
    """Return a result with something in every field."""
    means = {r.name: Estimate(np.asarray(50.0), np.asarray(0.5)) for r in receivers}
    fields: dict[str, Any] = {
        "receivers": receivers,
        "energy": EnergyBalance(10.0, 0.0, 4.0, 0.1, 3.0, 0.0, 3.0),
        "title": "Made up",
        "scene_text": "# scene",
        "seed": 2**62,
        "rel_tol": 0.01,
        "relative_error": 0.008,
        "converged": True,
        "rays": 10**12,
        "duration_s": 1.5,
        "notes": (),
        "omissions": (Omission("the lobe of the glass", 0.7, 0.4, "roof"), Omission("bands", 0.35, 0.2)),
        "method": "rows",
        "levels": {"glass": "diffuse", "panel/2": "lobe"},
        "bands": (BandIrradiance(380, 500, 10, 2, means), BandIrradiance(500, 740, 20, 3, means)),
        "exchange": ExchangeBalance(100.0, 60.0, 39.0, 0.8, 1e-15),
        "state": {
            "sums": np.arange(6.0).reshape(2, 3),
            "digest": np.arange(32, dtype=np.uint8),
            "index": np.array([], np.int64),
            "coarse": np.ones(3, np.float32),
            "flags": np.array([True, False]),
            "done": np.array(7),
        },
        "interrupted": True,
        "floor_w_m2": 0.9,
        "versions": {"gonio": "1", "numba": "2"},
        "options": {"full": "True"},
        "date": "2026-11-24T21:00:00+00:00",
    }
    return Irradiance(**{**fields, **changed})


def test_everything_a_result_can_hold_comes_back(tmp_path: Path) -> None:
    result = whole(mesh_receiver())
    result.save(tmp_path / "facade.h5")
    again = load_irradiance(tmp_path / "facade.h5")
    for f in dataclasses.fields(Irradiance):
        if f.name not in ("receivers", "state", "bands"):
            assert getattr(again, f.name) == getattr(result, f.name), f.name
    assert again.table() == result.table()
    assert again.bands[1].means["roof"].standard_error == 0.5
    roof, kept = result["roof"], again["roof"]
    assert kept.is_mesh
    assert kept.vertices_m == pytest.approx(roof.vertices_m)
    assert np.array_equal(kept.faces, roof.faces)
    assert kept.area_m2 == pytest.approx([1.0, 3.0])
    assert kept.discretisation_w_m2 == 0.35
    assert again.state is not None
    assert result.state is not None
    assert set(again.state) == set(result.state)
    for key, array in result.state.items():
        assert again.state[key].dtype == array.dtype
        assert np.array_equal(again.state[key], array)
        assert again.state[key].shape == array.shape
    with h5py.File(tmp_path / "facade.h5") as file:
        roof_group = file["entry/receiver_roof"]
        assert roof_group.attrs["signal"] == "irradiance"
        assert roof_group[roof_group.attrs["axes"][0]].shape == roof_group["irradiance"].shape


def test_names_that_hdf5_would_read_as_paths(tmp_path: Path) -> None:
    names = ["north/wall", "north wall", "north_wall", "..", "Süd \N{GREEK SMALL LETTER ALPHA}"]
    result = whole(*(mesh_receiver(name) for name in names))
    result.save(tmp_path / "facade.h5")
    assert [r.name for r in load_irradiance(tmp_path / "facade.h5").receivers] == names


def test_results_of_older_versions_still_load(canyon: Callable[..., Scene], tmp_path: Path) -> None:
    path = tmp_path / "facade.h5"
    glossy = canyon(wall=Optics(0.5, 1.0, 50.0, 1.5), dni=800.0, rows=2)
    result = simulate(glossy, rel_tol=0.1, seed=11, estimator="paths", full=True)
    result.save(path)
    with h5py.File(path, "r+") as file:
        process = file["entry/process"]
        for name in ("method", "interrupted", "state", "versions", "options", "levels", "date", "floor_w_m2"):
            del process[name]
        del process["energy/handed_w"]
        for name in ("left", "right", "ground"):
            del file[f"entry/receiver_{name}/discretisation"]
    again = load_irradiance(path)
    assert (again.method, again.state, again.omissions, again.date) == ("paths", None, (), "")
    assert np.array_equal(again["left"].value, result["left"].value)
    assert check_file(path).findings == []


def test_errors_of_a_receiver_add_up_to_the_total() -> None:
    result = whole(mesh_receiver())
    error = result.error_of("roof")
    # standard errors 1 and 3 W/m2 on 1 and 3 m2; bounds 0.7 + 0.35 + 0.35 W/m2; mean 175 W/m2
    assert error.statistical == pytest.approx(np.sqrt((1.0 + 3.0 * 9.0) / 4.0) / 175.0)
    assert error.omitted == pytest.approx(1.4 / 175.0)
    assert error.total == pytest.approx(np.hypot(error.statistical, error.omitted))
    assert result.worst == ("roof", error)
    assert dataclasses.replace(result, floor_w_m2=350.0).error_of("roof").omitted == pytest.approx(0.004)
    text = result.table()
    for words in (
        "the lobe of the glass",
        "finite size of the patches",
        "(+) 0.8 % left out",
        "380-500",
        "handed to the diffuse exchange",
        "sent out diffusely",
        "glass diffuse",
        "INTERRUPTED",
    ):
        assert words in text, words


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("entry/receiver_roof/faces", np.array([[0, 1, 2], [0, 1, 9]]), "vertices that are not there"),
        ("entry/receiver_roof/sky", np.ones(3), "has shape"),
        ("entry/process/seed", "many", "entry/process/seed is"),
        ("entry/process/levels/level", np.array([1.0, 2.0]), "is not a list of names"),
        ("entry/process/energy/emitted_w", np.ones(2), "is not a number"),
    ],
)
def test_strange_contents_are_refused(tmp_path: Path, place: str, value: Any, message: str) -> None:
    path = tmp_path / "facade.h5"
    whole(mesh_receiver()).save(path)
    with h5py.File(path, "r+") as file:
        del file[place]
        file[place] = value
    with pytest.raises(StoreError, match=message):
        load_irradiance(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("receiver_left/direct", lambda x: x + 1.0), "not the sum of its contributions"),
        (("receiver_left/sky_errors", lambda x: -x - 1.0), "no irradiance"),
        (("process/energy/escaped_w", lambda x: 2.0 * x), "does not balance"),
    ],
)
def test_the_check_finds_what_does_not_add_up(
    result: Irradiance, tmp_path: Path, change: Any, message: str
) -> None:
    path = tmp_path / "facade.h5"
    result.save(path)
    assert check_file(path).findings == []
    with h5py.File(path, "r+") as file:
        dataset = file[f"entry/{change[0]}"]
        dataset[...] = change[1](dataset[()])
    assert [message in str(f) for f in check_file(path).findings] == [True]


def test_the_check_tells_an_interrupted_result(tmp_path: Path) -> None:
    path = tmp_path / "facade.h5"
    whole(mesh_receiver()).save(path)
    verdict = check_file(path)
    assert verdict.kind == f"facade result, interrupted; go on with gonio facade --resume {path}"
    assert verdict.findings == []
    with h5py.File(path, "r+") as file:
        del file["entry/process/state"]
    assert "points to go on with are missing" in str(check_file(path).findings[0])


def test_a_write_that_fails_leaves_the_older_file(result: Irradiance, tmp_path: Path) -> None:
    path = tmp_path / "facade.h5"
    result.save(path)
    before = path.read_bytes()
    broken = dataclasses.replace(result, state={"sums": np.array([None], object)})
    with pytest.raises((TypeError, StoreError)):
        broken.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_contributions_add_up_and_means_are_means(result: Irradiance) -> None:
    for r in result.receivers:
        assert sum(r.contributions[c].value for c in CONTRIBUTIONS) == pytest.approx(r.value, rel=1e-13)
        assert float(r.mean.value) == pytest.approx(r.value.mean(), rel=1e-13)
        assert 0.0 < float(r.mean.standard_error) < r.standard_error.max()
        assert r.row_centres_m == pytest.approx([1 / 6, 1 / 2, 5 / 6])
    assert [r.contributions["specular"].value.mean() > 0.5 for r in result.receivers] == [True] * 3


def test_table_shows_every_receiver_and_the_error(result: Irradiance) -> None:
    text = result.table()
    for word in ("left", "right", "ground", "specular", "±", "W/m2", "seed 11", "balance", "a note"):
        assert word in text
    with pytest.raises(KeyError, match="there are left, right, ground"):
        result["roof"]


def test_unreadable_and_unwritable_files(result: Irradiance, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="there is no such file"):
        load_irradiance(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("no HDF5")
    with pytest.raises(StoreError, match="is not an HDF5 file"):
        load_irradiance(tmp_path / "text.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.create_group("entry")
    with pytest.raises(StoreError, match="holds no facade irradiance"):
        load_irradiance(tmp_path / "other.h5")
    with pytest.raises(StoreError, match="cannot be written"):
        result.save(tmp_path / "no folder" / "facade.h5")


def test_progress_ends_at_one(canyon: Callable[..., Scene]) -> None:
    seen: list[tuple[float, str]] = []
    simulate(canyon(dhi=1.0, rows=2), rel_tol=0.01, progress=lambda done, text: seen.append((done, text)))
    assert seen[-1][0] == 1.0
    assert all(0.0 <= done <= 1.0 and text for done, text in seen)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rel_tol": 0.0}, "rel_tol = 0 is outside"),
        ({"rel_tol": 2.0}, "rel_tol = 2 is outside"),
        ({"seed": -1}, "seed = -1"),
        ({"threads": 0}, "threads = 0"),
    ],
)
def test_options_out_of_range_are_refused(
    canyon: Callable[..., Scene], options: dict[str, int], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        simulate(canyon(dhi=1.0), **options)  # type: ignore[arg-type]

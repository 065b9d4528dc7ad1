from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from gonio.errors import ConfigError, SceneError, StoreError
from gonio.facade import CONTRIBUTIONS, Irradiance, Optics, Scene, load_irradiance, simulate


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
        assert seen <= {"W/m2", "W", "m", "s", "1", "any"}
        assert file["entry/process/scene"].asstr()[()] == "# scene"


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


def test_backward_paths_do_not_renormalize(canyon: Callable[..., Scene]) -> None:
    with pytest.raises(SceneError, match="cannot renormalize"):
        simulate(canyon(dhi=1.0, horizon="renormalize"), estimator="backward")

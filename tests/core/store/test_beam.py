"""The beam of the rig file, in the scan's file and back."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import ModuleType

import h5py
import pytest

import gonio
from gonio.acquire import Runner
from gonio.aperture import IncidentBeam
from gonio.errors import ConfigError, StoreError
from gonio.plan import Plan
from gonio.rig import BeamConfig, default_rig_text, parse_rig


def test_the_beam_of_the_rig_is_stored_with_its_units_and_read_back(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    Runner(memory.rig(beam=BeamConfig(width_mm=2.0, height_mm=1.5, divergence_deg=0.3)), plan, path).run()
    assert gonio.load(path).beam == IncidentBeam(2.0, 1.5, 0.3)
    with h5py.File(path) as file:
        beam = file["entry/instrument/beam"]
        assert {k: beam[k].attrs["units"] for k in ("width", "height", "divergence")} == {
            "width": "mm",
            "height": "mm",
            "divergence": "deg",
        }


def test_a_rig_without_a_beam_makes_a_scan_without_one(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    Runner(memory.rig(), plan, path).run()
    assert gonio.load(path).beam is None


@pytest.mark.parametrize(("name", "value"), [("width", -1.0), ("divergence", 60.0), ("height", None)])
def test_a_beam_that_cannot_be_is_refused(
    memory: ModuleType, plan: Plan, tmp_path: Path, name: str, value: float | None
) -> None:
    path, other = tmp_path / "scan.h5", tmp_path / "other.h5"
    Runner(memory.rig(beam=BeamConfig(width_mm=2.0, height_mm=1.5)), plan, path).run()
    shutil.copy(path, other)
    with h5py.File(other, "r+") as file:
        del file[f"entry/instrument/beam/{name}"]
        if value is not None:
            file[f"entry/instrument/beam/{name}"] = value
    with pytest.raises(StoreError, match=f"beam.*{name}"):
        gonio.load(other)


def test_a_rig_with_an_impossible_beam_moves_nothing(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    rig = memory.rig(beam=BeamConfig(width_mm=2.0, height_mm=1.5, divergence_deg=40.0))
    with pytest.raises(ConfigError, match="divergence_deg = 40"):
        Runner(rig, plan, tmp_path / "scan.h5").run()
    assert not (tmp_path / "scan.h5").exists()


def test_the_built_in_rig_says_what_its_bench_has() -> None:
    config = parse_rig(default_rig_text())
    assert config.beam is not None
    assert config.simulation is not None
    for name in ("width_mm", "height_mm", "divergence_deg"):
        assert getattr(config.beam, name) == config.simulation["beam"][name]

"""Sources that come from a plan: all of it, until enough is known, or by the name of an installed one."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest
from source_walker import PLAN, Walker, asked_for

import gonio
from gonio.acquire import Runner
from gonio.errors import RefusedError
from gonio.plan import Plan, parse_plan
from gonio.plan.source import Measured, PlanSource, UntilSource


@pytest.mark.parametrize("references", ["every_positions = 3", "every_minutes = 0.5", ""])
def test_the_source_that_does_not_look_is_the_plan(
    memory: ModuleType, tmp_path: Path, references: str
) -> None:
    plan = parse_plan(memory.PLAN_TOML + f"[references]\n{references}\n")
    Runner(memory.rig(), plan, tmp_path / "plan.h5").run()
    Runner(memory.rig(), plan, tmp_path / "source.h5", source=PlanSource.of(plan)).run()
    with h5py.File(tmp_path / "plan.h5") as one, h5py.File(tmp_path / "source.h5") as other:
        for group in ("data", "references"):
            assert list(one["entry"][group]) == list(other["entry"][group])
            for name in one["entry"][group]:
                np.testing.assert_array_equal(one["entry"][group][name], other["entry"][group][name])
        assert set(other["entry"]) - set(one["entry"]) == {"source"}
        assert set(one["entry"]) <= set(other["entry"])


def test_a_plan_is_measured_until_enough_is_known(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    def steep(measured: Sequence[Measured]) -> bool:
        return bool(measured[-1].r[0] > 0.037)

    path = tmp_path / "scan.h5"
    Runner(memory.rig(), plan, path, source=UntilSource.of(plan, steep)).run()
    scan = gonio.load(path)
    n = len(scan.position)
    assert 0 < n < plan.n_positions
    assert asked_for(scan) == [(p.theta_i_deg, p.theta_mes_deg, p.polarization) for p in plan.positions()[:n]]
    assert scan.r[-1, 0] > 0.037 >= scan.r[:-1, 0].max()
    with h5py.File(path) as file:
        text = file["entry/source/text"].asstr()[()]
    assert text.startswith("10 positions in the order of the plan, until test_a_plan_is_measured")


def test_a_plan_names_an_installed_source(
    memory: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Point:
        name = "walk"

        def load(self) -> Callable[..., Walker]:
            return lambda plan, rig: Walker(count=len(plan.wavelength_nm) + 1)

    plan = parse_plan(PLAN.to_toml().replace('"python"', '"walk"'))
    assert plan.positions() == ()
    with pytest.raises(RefusedError, match="source of positions 'walk', which is not installed; installed"):
        Runner(memory.rig(), plan, tmp_path / "scan.h5").run()
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [Point()])
    Runner(memory.rig(), plan, tmp_path / "scan.h5").run()
    assert gonio.load(tmp_path / "scan.h5").n_planned == 3

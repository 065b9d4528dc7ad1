"""Plans with overlap, averages per range, references in between and passes to and fro, run on the bench in
memory.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest

import gonio
from gonio.acquire import Runner, resume_scan
from gonio.errors import ScanStopped
from gonio.plan import parse_plan, timetable
from gonio.plan.timetable import PlannedReference

_PATH = Path(__file__).parents[1] / "acquire/memory_rig.py"

PLAN = """
overlap_nm = 10.0
[[wavelengths]]
start_nm = 830.0
stop_nm = 880.0
step_nm = 10.0
averages = 2
[[wavelengths]]
values_nm = [900.0]
integration_s = 4.0
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = [15.0, 30.0, 40.0]
[[positions]]
theta_i_deg = [45.0, 45.0]
theta_mes_deg = [30.0, 90.0]
polarization = ["p", "s"]
[references]
every_positions = 3
[order]
alternate_wavelengths = true
[repeats]
count = 2
"""


@pytest.fixture(scope="module")
def memory() -> ModuleType:
    spec = importlib.util.spec_from_file_location("gonio_plan_memory_rig", _PATH)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


def check_values(memory: ModuleType, path: Path) -> None:
    plan = parse_plan(PLAN)
    scan = gonio.load(path)
    assert scan.finished
    assert scan.wavelength_nm.tolist() == [830, 840, 850, 860, 870, 850, 860, 870, 880, 900]
    assert scan.detector_index.tolist() == [0] * 5 + [1] * 5
    assert scan.detector_change_nm == (860.0,)
    positions = plan.positions()
    assert len(scan.position) == len(positions) == 16
    expected = memory.true_r(
        np.array([p.theta_i_deg for p in positions]) + 0.002,
        np.array([p.theta_mes_deg for p in positions]) - 0.003,
        [p.polarization for p in positions],
        scan.wavelength_nm,
    )
    # a pass that ran backwards and was not turned round again would be found here
    np.testing.assert_allclose(scan.r, expected, rtol=1e-9)


def test_every_column_holds_the_reading_of_its_wavelength(memory: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    world = memory.World(dark_drift_v_s=1e-6, gain_drift_s=1e-5)
    rig = memory.rig(world)
    Runner(rig, parse_plan(PLAN), path).run()
    check_values(memory, path)
    with h5py.File(path) as file:
        averages = file["entry/data/averages"][...]
        times = file["entry/data/reading_time"][...]
        when = file["entry/references/when"].asstr()[...].tolist()
    assert averages.tolist() == [[2] * 9 + [4]] * 16
    descending = [step.descending for step in timetable(parse_plan(PLAN), rig.config).steps
                  if not isinstance(step.task, PlannedReference)]  # fmt: skip
    assert [row[0] > row[-1] for row in times.tolist()] == descending
    assert when == ["start"] * 3 + [w for k in (3, 6, 9, 12, 15) for w in [f"before {k}"] * 3] + ["end"] * 3


def test_a_resumed_scan_measures_no_reference_and_no_position_twice(
    memory: ModuleType, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    plan = parse_plan(PLAN)
    rig = memory.rig(memory.World())
    runner: Runner
    done: list[object] = []

    def stop_behind_the_second_period(record: object) -> None:
        done.append(record)
        if len(done) == 14:
            runner.stop()

    runner = Runner(rig, plan, path, on_record=stop_behind_the_second_period)
    with pytest.raises(ScanStopped):
        runner.run()
    resume_scan(path, memory.rig(memory.World())).run()
    check_values(memory, path)
    with h5py.File(path) as file:
        keys = list(zip(*(file[f"entry/references/{name}"].asstr()[...].tolist()
                          for name in ("kind", "when", "polarization")), strict=True))  # fmt: skip
    steps = [step.task for step in timetable(plan, rig.config).steps]
    planned = [(t.kind, t.when, t.polarization) for t in steps if isinstance(t, PlannedReference)]
    assert sorted(keys) == sorted(planned)

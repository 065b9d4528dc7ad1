"""A lamp that drifts between references: the stated uncertainty covers it, and the file says so aloud."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gonio
from gonio.acquire import Runner
from gonio.plan import Plan
from gonio.store.drift import Series, joined
from gonio.store.records import EventRecord

DETECTOR = np.zeros(4, dtype=np.uint8)


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    path = Path(__file__).parents[3] / "benchmarks" / "store_drift.py"
    spec = importlib.util.spec_from_file_location("gonio_bench_store_drift", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def series(times: list[float], values: list[float], variance: float = 0.0) -> Series:
    time_s = np.repeat(np.array(times)[:, None], 4, axis=1)
    value_v = np.repeat(np.array(values)[:, None], 4, axis=1)
    return joined(time_s, value_v, np.full(value_v.shape, variance), DETECTOR, relative=True)


def sd_at(found: Series, *times: float) -> list[float]:
    return np.sqrt(found.at(np.repeat(np.array(times)[:, None], 4, axis=1))[1][:, 0]).tolist()


def test_between_two_references_the_uncertainty_is_the_rectangle_of_their_difference() -> None:
    found = series([0.0, 1000.0], [1.0, 1.02])
    np.testing.assert_allclose(sd_at(found, 0.0, 10.0, 500.0, 990.0, 1000.0), 0.02 / np.sqrt(3.0), rtol=1e-12)


def test_beyond_the_last_reference_the_uncertainty_grows() -> None:
    found = series([0.0, 1000.0], [1.0, 1.02])
    inside, near, far = sd_at(found, 1000.0, 1100.0, 3000.0)
    assert inside < near < far
    # a walk of 0.02 in 1000 s goes on for 2000 s; the last reference may itself have been just after a step
    assert far == pytest.approx(0.02 * np.sqrt(1.0 / 3.0 + 2.0), rel=1e-12)


def test_references_that_agree_leave_their_own_scatter() -> None:
    found = series([0.0, 1000.0], [1.0, 1.0], variance=1e-6)
    assert sd_at(found, 0.0, 500.0) == pytest.approx([1e-3, 1e-3 / np.sqrt(2.0)])


def test_a_linear_drift_seen_by_many_references_is_narrow() -> None:
    times = np.linspace(0.0, 1000.0, 11)
    found = series(times.tolist(), (1.0 + 2e-5 * times).tolist())
    assert max(sd_at(found, 50.0, 100.0, 555.0)) == pytest.approx(0.002 / np.sqrt(3.0), rel=0.05)


def test_two_references_that_agree_by_chance_do_not_hide_what_the_others_saw() -> None:
    found = series([0.0, 100.0, 200.0, 300.0, 400.0], [1.0, 1.02, 1.02, 0.99, 1.01])
    assert sd_at(found, 150.0)[0] > 0.01


@given(
    change=st.floats(-0.05, 0.05),
    at=st.floats(0.0, 1.0),
    length=st.floats(0.0, 1.0),
    when=st.floats(0.0, 1.0),
)
def test_a_change_that_goes_one_way_is_never_off_by_more_than_twice_the_uncertainty(
    change: float, at: float, length: float, when: float
) -> None:
    def value(x: float) -> float:
        moved = float(x > at) if length == 0.0 else min(max((x - at) / length, 0.0), 1.0)
        return 1.0 + change * moved

    ends = [value(0.0), value(1.0)]
    found = series([0.0, 1000.0], ends)
    error = abs((1.0 - when) * ends[0] + when * ends[1] - value(when))
    assert error <= 2.0 * sd_at(found, 1000.0 * when)[0] + 1e-12


@pytest.mark.parametrize(
    ("lamp", "references", "wanted"),
    [
        ("line", 2, 0.999),
        ("curve", 2, 0.999),
        ("ramp", 3, 0.999),
        ("step", 2, 0.999),
        ("step", 5, 0.999),
        ("random walk", 5, 0.95),
        ("O-U, 1 x", 9, 0.95),
        ("O-U, 0.1 x", 17, 0.94),
    ],
)
def test_twice_the_stated_uncertainty_covers_the_lamp(
    bench: ModuleType, lamp: str, references: int, wanted: float
) -> None:
    within, _, stated = bench.coverage(bench.LAMPS[lamp], references, scans=40, seed=11)
    assert within >= wanted
    assert stated < 0.02  # and not because anything would be covered


def test_more_references_narrow_what_is_stated(bench: ModuleType) -> None:
    stated = [bench.coverage(bench.curve, k, scans=20, seed=3)[2] for k in (2, 5, 17)]
    assert stated[0] > 2.0 * stated[1] > 4.0 * stated[2]


# -- told in the file


def events(path: Path) -> list[tuple[str, str]]:
    with h5py.File(path, "r") as file:
        group = file["entry/events"]
        return list(zip(group["level"].asstr()[...], group["message"].asstr()[...], strict=True))


def test_a_lamp_that_went_out_is_a_warning_with_the_positions_and_what_to_do(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    world = memory.World(noise_dark_v=1e-6, noise_full=1e-4)
    told: list[EventRecord] = []
    shine = world.full

    def goes_out(wavelength_nm: float, t_s: float) -> float:
        return float(shine(wavelength_nm, t_s)) * (1.0 if len(world.log) < 30 else 0.02)

    world.full = goes_out
    path = Runner(
        memory.rig(world),
        plan,
        tmp_path / "scan.h5",
        on_record=lambda record: told.append(record) if isinstance(record, EventRecord) else None,
    ).run()
    warnings = [message for level, message in events(path) if level == "warning"]
    assert len(warnings) == 2  # s and p
    assert warnings[0].startswith("the direct beam (s) of detector ingaas changed by -98")
    assert "between the references 'start' and 'end'" in warnings[0]
    assert "positions 0 to 9 lie between" in warnings[0]
    assert "[references] every_minutes" in warnings[0]
    assert [event.message for event in told if event.level == "warning"] == warnings
    scan = gonio.load(path)
    assert np.nanmin(scan.gain_u) > 0.5


def test_a_reference_that_sees_no_beam_is_named(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world = memory.World(noise_dark_v=1e-6, noise_full=1e-4)
    world.full = lambda _wavelength_nm, _t_s: 0.0
    path = Runner(memory.rig(world), plan, tmp_path / "scan.h5").run()
    warnings = [message for level, message in events(path) if level == "warning"]
    assert len(warnings) == 1
    assert warnings[0].startswith("no direct beam (s/p) is seen by pmt/ingaas in the references: start, end;")


def test_a_drift_that_noise_does_not_explain_is_told_and_a_steady_lamp_is_not(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    steady = memory.World(noise_dark_v=1e-6, noise_full=1e-4)
    path = Runner(memory.rig(steady), plan, tmp_path / "steady.h5").run()
    assert events(path) == []
    drifting = memory.World(noise_dark_v=1e-6, noise_full=1e-4, gain_drift_s=3e-5)
    path = Runner(memory.rig(drifting), plan, tmp_path / "drifting.h5").run()
    assert {level for level, _ in events(path)} == {"info"}
    assert "changed by +0.2" in events(path)[0][1]


def test_a_dark_that_moved_is_told_in_parts_of_the_full_beam(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    world = memory.World(noise_dark_v=1e-7, noise_full=1e-4, dark_drift_v_s=2e-5)
    path = Runner(memory.rig(world), plan, tmp_path / "scan.h5").run()
    warnings = [message for level, message in events(path) if level == "warning"]
    assert any(
        message.startswith("the dark signal of detector ingaas changed by +0.2") for message in warnings
    )
    assert all("% of the full beam" in message for message in warnings if "dark signal" in message)

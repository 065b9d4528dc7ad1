"""What a scan makes of a device that fails: again, pause, skip or the end, and never a wrong angle."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest

import gonio
from gonio.acquire import FaultPolicy, Runner, Snapshot, State, resume_scan
from gonio.devices import Quality
from gonio.errors import ConfigError, DeviceError, MotionError, RefusedError, ScanStopped
from gonio.plan import Plan

AT_ONCE = FaultPolicy(retries=2, first_wait_s=0.0)
STALL = MotionError("theta_i", "stalled (FS)", "free the axis")


def events(path: Path) -> list[str]:
    with h5py.File(path) as file:
        return list(file["entry/events/message"].asstr()[...].tolist())


def failing_at(world: Any, position: int, action: str, error: Exception, times: int = 1) -> Any:
    """Have an action fail, so many times, when a position is about to be measured."""
    left = [times]

    def on_snapshot(snapshot: Snapshot) -> None:
        if (
            snapshot.done >= position
            and snapshot.state is State.RUNNING
            and left[0]
            and action not in world.fail
        ):
            world.fail[action] = error
            left[0] -= 1

    return on_snapshot


def check_angles(memory: ModuleType, plan: Plan, path: Path) -> gonio.Scan:
    """Every position once, and every measured value that of its own angles."""
    scan = gonio.load(path)
    assert scan.position.tolist() == list(range(plan.n_positions))
    seen = scan.usable.all(axis=1)
    truth = memory.true_r(scan.theta_i_deg, scan.theta_mes_deg, scan.polarization, scan.wavelength_nm)
    np.testing.assert_allclose(scan.r[seen], truth[seen], rtol=1e-9)
    wanted = np.array([(p.theta_i_deg, p.theta_mes_deg) for p in plan.positions()])
    np.testing.assert_allclose(scan.theta_i_deg[seen], wanted[seen, 0], atol=0.01)
    np.testing.assert_allclose(scan.theta_mes_deg[seen], wanted[seen, 1], atol=0.01)
    return scan


@pytest.mark.parametrize("action", ["start", "measure", "select"])
def test_a_failed_position_is_measured_anew_after_recovery(
    memory: ModuleType, plan: Plan, tmp_path: Path, action: str
) -> None:
    world, path = memory.World(), tmp_path / "scan.h5"
    Runner(
        memory.rig(world), plan, path, on_snapshot=failing_at(world, 3, action, STALL), policy=AT_ONCE
    ).run()
    scan = check_angles(memory, plan, path)
    assert scan.usable.all()
    retried = np.flatnonzero((scan.quality & Quality.RETRIED).any(axis=1))
    assert len(retried) == 1
    assert world.log.count("recover") == 1
    told = events(path)
    assert "theta_i: stalled (FS); free the axis" in told[0]
    assert told[1] == "recovered: stage: homed"
    assert told[2].endswith("measured after a failed attempt")


def test_the_motors_rest_and_the_shutter_is_closed_before_a_recovery(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    world = memory.World()
    failing = failing_at(world, 1, "measure", DeviceError("lockin", "is silent", "check its cable"))
    Runner(memory.rig(world), plan, tmp_path / "scan.h5", on_snapshot=failing, policy=AT_ONCE).run()
    before = world.log[: world.log.index("recover")]
    assert before[-4:] == ["stage.stop", "polarizer.stop", "spectrometer.stop", "shutter"]


def test_a_recovery_that_fails_counts_as_an_attempt(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world, path = memory.World(), tmp_path / "scan.h5"
    world.fail["recover"] = DeviceError("stage", "does not answer yet", "wait")
    failing = failing_at(world, 2, "measure", STALL)
    Runner(memory.rig(world), plan, path, on_snapshot=failing, policy=AT_ONCE).run()
    assert check_angles(memory, plan, path).usable.all()
    assert world.log.count("recover") == 2


def test_when_no_attempt_is_left_the_scan_ends_and_can_go_on(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    world, path = memory.World(), tmp_path / "scan.h5"
    failing = failing_at(world, 2, "start", STALL, times=100)
    with pytest.raises(MotionError, match=r"stalled.*gonio scan --resume"):
        Runner(memory.rig(world), plan, path, on_snapshot=failing, policy=AT_ONCE).run()
    assert world.log.count("recover") == 2
    resume_scan(path, memory.rig(memory.World())).run()
    assert check_angles(memory, plan, path).usable.all()


def paused_by_fault(
    then: Callable[[Runner], None],
) -> tuple[list[Snapshot], Callable[[Snapshot], None], list[Runner]]:
    seen: list[Snapshot] = []
    runner: list[Runner] = []

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.state is State.PAUSED and (not seen or seen[-1].state is not State.PAUSED):
            threading.Timer(0.05, then, [runner[0]]).start()
        seen.append(snapshot)

    return seen, on_snapshot, runner


def test_a_fault_pauses_until_somebody_has_mended_it(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world, path = memory.World(), tmp_path / "scan.h5"
    seen, watch, runners = paused_by_fault(lambda runner: runner.resume())
    failing = failing_at(world, 2, "measure", STALL)

    def on_snapshot(snapshot: Snapshot) -> None:
        failing(snapshot)
        watch(snapshot)

    runner = Runner(
        memory.rig(world), plan, path, on_snapshot=on_snapshot, policy=FaultPolicy(retries=0, then="pause")
    )
    runners.append(runner)
    runner.run()
    paused = next(s for s in seen if s.state is State.PAUSED)
    assert "theta_i: stalled (FS); free the axis" in paused.message  # device, fault and remedy
    assert not world.shutter_open
    assert check_angles(memory, plan, path).usable.all()
    assert "resumed by the operator" in events(path)


def test_a_paused_scan_can_be_stopped(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world, path = memory.World(), tmp_path / "scan.h5"
    _, watch, runners = paused_by_fault(lambda runner: runner.stop())
    failing = failing_at(world, 2, "measure", STALL)

    def on_snapshot(snapshot: Snapshot) -> None:
        failing(snapshot)
        watch(snapshot)

    runner = Runner(
        memory.rig(world), plan, path, on_snapshot=on_snapshot, policy=FaultPolicy(retries=0, then="pause")
    )
    runners.append(runner)
    with pytest.raises(ScanStopped):
        runner.run()
    assert runner.state is State.IDLE
    runner.run()
    assert check_angles(memory, plan, path).usable.all()


def test_a_position_may_be_skipped_and_is_flagged(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world, path = memory.World(), tmp_path / "scan.h5"
    failing = failing_at(world, 2, "measure", STALL)
    policy = FaultPolicy(retries=0, then="skip")
    Runner(memory.rig(world), plan, path, on_snapshot=failing, policy=policy).run()
    with h5py.File(path) as file:
        data = file["entry/data"]
        assert (data["quality"][2] == Quality.SKIPPED).all()
        assert np.isnan(data["r"][2]).all()
        assert np.isnan(data["theta_i"][2])
        assert np.isfinite(np.delete(data["r"][...], 2, axis=0)).all()
    scan = gonio.load(path)  # measured positions only
    assert scan.finished
    assert scan.position.tolist() == [i for i in range(plan.n_positions) if i != 2]
    assert scan.usable.all()
    assert any(text.endswith("skipped after a failed attempt") for text in events(path))


def test_not_every_position_is_skipped_when_a_device_is_dead(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    world, path = memory.World(), tmp_path / "scan.h5"
    silent = DeviceError("lockin", "is silent", "check its cable")

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done >= 1:
            world.fail.setdefault("measure", silent)

    with pytest.raises(DeviceError, match="is silent"):
        Runner(
            memory.rig(world), plan, path, on_snapshot=on_snapshot, policy=FaultPolicy(retries=0, then="skip")
        ).run()
    with h5py.File(path) as file:
        skipped = (file["entry/data/quality"][...] & Quality.SKIPPED).all(axis=1)
    assert np.flatnonzero(skipped).tolist() == [1, 2, 3]


def test_a_reference_is_never_skipped(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world = memory.World()
    world.fail["measure"] = STALL
    with pytest.raises(MotionError):
        Runner(
            memory.rig(world), plan, tmp_path / "scan.h5", policy=FaultPolicy(retries=0, then="skip")
        ).run()


def test_a_knob_turned_during_the_pass_is_found_out_at_its_end(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    """The read-back before the pass was right; the readings are not those of these angles."""
    world, path = memory.World(), tmp_path / "scan.h5"
    rig = memory.rig(world)
    turned = []

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.position == 2 and snapshot.theta_mes_deg is not None and not turned:
            turned.append(snapshot)
            rig.stage.theta_mes.where_deg += 1.0

    class Watched(memory.MemorySpectrometer):  # type: ignore[misc, name-defined]
        def measure_spectrum(self, *args: Any, **kwargs: Any) -> Any:
            runner._published_s = 0.0
            return super().measure_spectrum(*args, **kwargs)

    rig.spectrometer = Watched(world, rig.stage)
    runner = Runner(rig, plan, path, on_snapshot=on_snapshot, policy=AT_ONCE)
    runner.run()
    assert turned
    assert check_angles(memory, plan, path).usable.all()
    assert "theta_mes: is at" in events(path)[0]


def test_pause_at_once_measures_the_position_anew(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world, path = memory.World(), tmp_path / "scan.h5"
    rig = memory.rig(world)
    seen, watch, runners = paused_by_fault(lambda runner: runner.resume())

    class Hasty(memory.MemorySpectrometer):  # type: ignore[misc, name-defined]
        def measure_spectrum(self, *args: Any, on_reading: Callable[[int], None], **kwargs: Any) -> Any:
            def reading(i: int) -> None:
                if (
                    i == 2
                    and runner.snapshot().position == 3
                    and not any(s.state is State.PAUSED for s in seen)
                ):
                    runner.stop_motion()
                on_reading(i)

            return super().measure_spectrum(*args, on_reading=reading, **kwargs)

    rig.spectrometer = Hasty(world, rig.stage)
    runner = Runner(rig, plan, path, on_snapshot=watch)
    runners.append(runner)
    runner.run()
    paused = [s for s in seen if s.state is State.PAUSED]
    assert paused[0].done == 3  # in the middle of the fourth
    assert events(path) == [
        "paused at once by the operator: motors at rest, shutter closed",
        "resumed by the operator",
    ]
    scan = check_angles(memory, plan, path)
    assert scan.usable.all()
    assert not scan.quality.any()


def test_the_next_motion_begins_before_the_record_is_safe(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    world = memory.World()
    order: list[str] = []

    def on_record(record: Any) -> None:
        order.append(f"recorded after {sum(entry.startswith('start theta_mes') for entry in world.log)}")

    Runner(memory.rig(world), plan, tmp_path / "scan.h5", on_record=on_record).run()
    assert order[0] == "recorded after 2"  # the dark reading's own motion, and the next
    assert order[-1] == f"recorded after {len(order)}"


def test_a_path_that_is_refused_is_no_matter_of_trying_again(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    world = memory.World()
    refusal = RefusedError("theta_mes: the way sweeps through the blind zone")
    failing = failing_at(world, 2, "start", refusal)
    with pytest.raises(RefusedError, match=r"blind zone.*--resume"):
        Runner(memory.rig(world), plan, tmp_path / "scan.h5", on_snapshot=failing, policy=AT_ONCE).run()
    assert "recover" not in world.log


@pytest.mark.parametrize("wrong", [{"retries": -1}, {"then": "hope"}])
def test_a_policy_that_is_none(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="give"):
        FaultPolicy(**wrong)


def test_waits_grow_and_are_bounded() -> None:
    policy = FaultPolicy(first_wait_s=0.5)
    assert [policy.wait_s(k) for k in (1, 2, 3, 20)] == [0.5, 1.0, 2.0, 60.0]


def test_a_driver_that_hangs_is_stopped_and_told(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    """A call that returns only when everything is stopped, and the next that works."""
    world, path = memory.World(), tmp_path / "scan.h5"
    rig = memory.rig(world)
    hung: list[bool] = []

    class Hanging(memory.MemorySpectrometer):  # type: ignore[misc, name-defined]
        def measure_spectrum(self, *args: Any, **kwargs: Any) -> Any:
            if runner.snapshot().position == 3 and not hung:
                self.stop_event.clear()
                hung.append(self.stop_event.wait(20))
            return super().measure_spectrum(*args, **kwargs)

        def stop(self) -> None:
            super().stop()

    rig.spectrometer = Hanging(world, rig.stage)
    runner = Runner(rig, plan, path, policy=FaultPolicy(retries=2, first_wait_s=0.0, silence_s=0.3))
    runner.run()
    assert hung == [True]
    assert check_angles(memory, plan, path).usable.all()
    assert any("the rig: gave no sign of life for" in text for text in events(path))


def test_a_pause_is_no_silence(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world, path = memory.World(), tmp_path / "scan.h5"

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == 2 and snapshot.state is State.RUNNING and not paused:
            paused.append(True)
            runner.pause()
            threading.Timer(0.6, runner.resume).start()

    paused: list[bool] = []
    policy = FaultPolicy(silence_s=0.2)
    runner = Runner(memory.rig(world), plan, path, on_snapshot=on_snapshot, policy=policy)
    runner.run()
    assert paused
    assert not any("sign of life" in text for text in events(path))

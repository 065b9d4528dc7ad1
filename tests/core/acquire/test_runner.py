"""The runner on the bench in memory: its states, its order, its ends, and what it leaves on the disk."""

from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest

import gonio
from gonio.acquire import FaultPolicy, Runner, Snapshot, State, resume_scan, stored_rig
from gonio.acquire.journal import Journal, journal_path
from gonio.devices import Quality
from gonio.errors import DeviceError, GonioError, MotionError, RefusedError, ScanStopped, StoreError
from gonio.plan import Plan, estimate, parse_plan
from gonio.rig import ApertureConfig
from gonio.store import Scan
from gonio.store.records import PositionRecord, ReferenceRecord


def states(snapshots: list[Snapshot]) -> list[State]:
    found = [snapshot.state for snapshot in snapshots]
    return [found[0], *(b for a, b in pairwise(found) if a is not b)]


def check_complete(memory: ModuleType, plan: Plan, path: Path) -> Scan:
    """Every position of the plan once, in order, under its own angles, with the value these angles have."""
    scan = gonio.load(path)
    assert scan.finished
    assert not journal_path(path).exists()
    positions = plan.positions()
    assert scan.position.tolist() == list(range(len(positions)))
    np.testing.assert_allclose(scan.theta_i_deg, [p.theta_i_deg + 0.002 for p in positions], atol=1e-12)
    np.testing.assert_allclose(scan.theta_mes_deg, [p.theta_mes_deg - 0.003 for p in positions], atol=1e-12)
    assert scan.polarization.tolist() == [p.polarization for p in positions]
    truth = memory.true_r(scan.theta_i_deg, scan.theta_mes_deg, scan.polarization, scan.wavelength_nm)
    np.testing.assert_allclose(scan.r, truth, rtol=1e-9)
    assert np.all(scan.usable)
    with h5py.File(path, "r") as file:
        times = file["entry/data/reading_time"][...]
        assert np.all(np.diff(times.ravel()) > 0)
        kinds = file["entry/references/kind"].asstr()[...].tolist()
        assert sorted(kinds) == ["baseline"] * 4 + ["dark"] * 2
    return scan


def test_a_scan_goes_through_its_states_and_stores_the_truth(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    snapshots: list[Snapshot] = []
    world = memory.World(gain_drift_s=1e-4, dark_drift_v_s=1e-6)
    path = tmp_path / "scan.h5"
    runner = Runner(memory.rig(world), plan, path, on_snapshot=snapshots.append)
    assert runner.state is State.IDLE
    assert runner.run() == path
    assert states(snapshots) == [State.PREPARING, State.RUNNING, State.DONE]
    assert [s.done for s in snapshots if s.position is None][-1] == 10
    last = snapshots[-1]
    assert (last.done, last.total) == (10, 10)
    assert last.readings_done == last.readings_total == 16 * 5
    assert last.left_s == 0.0
    scan = check_complete(memory, plan, path)
    assert scan.title == "Test scan"
    assert scan.sample_name == "coded sample"
    assert scan.detector_names == ("pmt", "ingaas")
    assert scan.detector_change_nm == (855.0,)
    with pytest.raises(RuntimeError, match="done"):
        runner.run()


def test_the_devices_are_used_in_the_right_order(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world = memory.World()
    Runner(memory.rig(world), plan, tmp_path / "scan.h5").run()
    log = [entry for entry in world.log if not entry.startswith("start")]
    assert log[0] == "identify"
    assert log[1:6] == ["measure dark None", "select s", "measure direct s", "select p", "measure direct p"]
    assert log[6:11] == ["select s", *["measure sample s"] * 3, "select p"]
    assert log[-6:-1] == [
        "measure dark p",
        "select s",
        "measure direct s",
        "select p",
        "measure direct p",
    ]
    assert log[-1] == "shutter"
    assert not world.shutter_open
    first_moves = [entry for entry in world.log if entry.startswith("start")][:2]
    assert first_moves == ["start theta_i 90", "start theta_mes 180"]


def test_time_left_is_nearly_the_estimate_at_first_and_falls_to_zero(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    snapshots: list[Snapshot] = []
    rig = memory.rig()
    Runner(rig, plan, tmp_path / "scan.h5", on_snapshot=snapshots.append).run()
    running = [s for s in snapshots if s.state is State.RUNNING]
    assert running[0].left_s == pytest.approx(estimate(plan, rig.config), rel=1e-9)
    assert running[-1].left_s == 0.0
    elapsed = [s.elapsed_s for s in running]
    assert elapsed == sorted(elapsed)
    # this bench is faster than its model; halfway, pace must have been noticed
    total_s = running[-1].elapsed_s
    halfway = min(running, key=lambda s: abs(s.elapsed_s - 0.75 * total_s))
    assert halfway.left_s < 2.0 * (total_s - halfway.elapsed_s) + 0.2 * estimate(plan, rig.config)


def test_whoever_watches_is_told_each_record_once_and_on_resume_those_before(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    interrupted(memory, plan, path)
    told: list[Any] = []
    resume_scan(path, memory.rig(), on_record=told.append).run()
    positions = [record.index for record in told if isinstance(record, PositionRecord)]
    assert positions == list(range(10))
    assert sum(isinstance(record, ReferenceRecord) for record in told) == 6


# -- nothing is made before everything is checked
# -----------------------------------------------------------------


def test_a_refused_plan_makes_no_file_and_moves_nothing(memory: ModuleType, tmp_path: Path) -> None:
    plan = parse_plan(memory.PLAN_TOML.replace("15.0, 30.0", "5.0, 30.0"))
    world = memory.World()
    runner = Runner(memory.rig(world), plan, tmp_path / "scan.h5")
    with pytest.raises(RefusedError, match="theta_mes = 5 deg is inside the blind zone"):
        runner.run()
    assert runner.state is State.FAILED
    assert list(tmp_path.iterdir()) == []
    assert not any(entry.startswith(("start", "measure")) for entry in world.log)


def test_a_silent_device_makes_no_file(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    world = memory.World(fail={"identify": DeviceError("stage", "does not answer", "switch it on")})
    runner = Runner(memory.rig(world), plan, tmp_path / "scan.h5")
    with pytest.raises(DeviceError) as caught:
        runner.run()
    assert str(caught.value) == "stage: does not answer; switch it on"
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_never_overwritten(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    path.write_bytes(b"precious")
    with pytest.raises(StoreError, match=r"scan\.h5 exists already"):
        Runner(memory.rig(), plan, path).run()
    assert path.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_named(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"the folder .*nowhere does not exist"):
        Runner(memory.rig(), plan, tmp_path / "nowhere" / "scan.h5").run()


def test_a_disk_without_room_is_refused(
    memory: ModuleType, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Usage:
        free = 1000

    monkeypatch.setattr("shutil.disk_usage", lambda _path: Usage)
    with pytest.raises(StoreError, match=r"the disk has 0\.0 MB left"):
        Runner(memory.rig(), plan, tmp_path / "scan.h5").run()
    assert list(tmp_path.iterdir()) == []


# -- pause, stop, errors
# ------------------------------------------------------------------------------------------


def test_pause_takes_effect_after_the_position_and_closes_the_shutter(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    world = memory.World()
    seen: list[Snapshot] = []
    shutter_in_pause: list[bool] = []

    def on_snapshot(snapshot: Snapshot) -> None:
        seen.append(snapshot)
        if snapshot.state is State.RUNNING and snapshot.position == 3 and not shutter_in_pause:
            runner.pause()
        if snapshot.state is State.PAUSED:
            shutter_in_pause.append(world.shutter_open)
            threading.Timer(0.05, runner.resume).start()

    class Slow(memory.MemorySpectrometer):  # type: ignore[misc, name-defined]
        def measure_spectrum(self, *args: Any, on_reading: Callable[[int], None], **kwargs: Any) -> Any:
            runner._published_s = 0.0  # every reading is published, however fast this bench is
            return super().measure_spectrum(*args, on_reading=on_reading, **kwargs)

    rig = memory.rig(world)
    rig.spectrometer = Slow(world, rig.stage)
    runner = Runner(rig, plan, tmp_path / "scan.h5", on_snapshot=on_snapshot)
    runner.run()
    assert states(seen) == [State.PREPARING, State.RUNNING, State.PAUSED, State.RUNNING, State.DONE]
    assert shutter_in_pause == [False]
    paused = next(s for s in seen if s.state is State.PAUSED)
    assert paused.done == 4  # the position during which it was asked for is whole
    check_complete(memory, plan, tmp_path / "scan.h5")
    with h5py.File(tmp_path / "scan.h5") as file:
        messages = file["entry/events/message"].asstr()[...].tolist()
    assert messages == ["paused by the operator: motors at rest, shutter closed", "resumed by the operator"]


@pytest.mark.parametrize("at_reading", [0, 7, 33, 52, 79])
def test_stop_from_another_thread_within_a_reading_and_run_again(
    memory: ModuleType, plan: Plan, tmp_path: Path, at_reading: int
) -> None:
    world = memory.World(gain_drift_s=1e-5)
    rig = memory.rig(world)
    counted = 0

    class Counting(memory.MemorySpectrometer):  # type: ignore[misc, name-defined]
        def measure_spectrum(self, *args: Any, on_reading: Callable[[int], None], **kwargs: Any) -> Any:
            def count(index: int) -> None:
                nonlocal counted
                if counted == at_reading:
                    thread = threading.Thread(target=runner.stop)
                    thread.start()
                    thread.join()
                counted += 1
                on_reading(index)

            return super().measure_spectrum(*args, on_reading=count, **kwargs)

    rig.spectrometer = Counting(world, rig.stage)
    path = tmp_path / "scan.h5"
    seen: list[Snapshot] = []
    runner = Runner(rig, plan, path, on_snapshot=seen.append)
    with pytest.raises(ScanStopped, match=r"gonio scan --resume .*scan\.h5"):
        runner.run()
    assert counted == at_reading + 1
    assert runner.state is State.IDLE
    assert seen[-1].state is State.IDLE
    assert not world.shutter_open
    assert {"stage.stop", "polarizer.stop", "spectrometer.stop"} <= set(world.log)
    with h5py.File(path, "r") as file:  # plain h5py opens it
        assert file["entry"].attrs["scan_status"] == "unfinished"
        measured = np.isfinite(file["entry/data/theta_i"][...])
        assert np.all(file["entry/data/quality"][...][~measured] == Quality.NOT_MEASURED)
        assert measured.sum() == max(0, min(10, at_reading // 5 - 3))
    runner.run()
    check_complete(memory, plan, path)


def test_stop_is_harmless_in_every_state(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    runner = Runner(memory.rig(), plan, tmp_path / "scan.h5")
    runner.stop()
    runner.stop()
    after = [runner.state]
    runner.run()
    runner.stop()
    assert [*after, runner.state] == [State.IDLE, State.DONE]


def test_stop_ends_a_pause(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.state is State.RUNNING:
            runner.pause()
        if snapshot.state is State.PAUSED:
            threading.Timer(0.05, runner.stop).start()

    runner = Runner(memory.rig(), plan, tmp_path / "scan.h5", on_snapshot=on_snapshot)
    with pytest.raises(ScanStopped):
        runner.run()
    assert runner.state is State.IDLE


@pytest.mark.parametrize("action", ["start", "measure", "select"])
def test_a_device_error_keeps_what_was_measured_and_names_the_way_on(
    memory: ModuleType, plan: Plan, tmp_path: Path, action: str
) -> None:
    world = memory.World()
    path = tmp_path / "scan.h5"
    seen: list[Snapshot] = []

    def on_snapshot(snapshot: Snapshot) -> None:
        seen.append(snapshot)
        if snapshot.done == 3 and State.RUNNING is snapshot.state:
            world.fail.setdefault(action, MotionError("theta_i", "stalled (FS)", "free the axis"))

    runner = Runner(memory.rig(world), plan, path, on_snapshot=on_snapshot, policy=FaultPolicy(retries=0))
    with pytest.raises(MotionError) as caught:
        runner.run()
    assert caught.value.device == "theta_i"
    assert str(caught.value).startswith("theta_i: stalled (FS); free the axis")
    assert f"gonio scan --resume {path}" in str(caught.value)
    assert states(seen)[-1] is State.FAILED
    assert "stalled" in seen[-1].message
    assert not world.shutter_open
    # the motion to the fourth had begun before the third was on the disk
    assert gonio.load(path).position.tolist() == [0, 1, 2, 3][: 4 if action == "start" else 3]
    assert not gonio.load(path).finished

    resume_scan(path, memory.rig(memory.World())).run()
    check_complete(memory, plan, path)
    with h5py.File(path) as file:
        messages = file["entry/events/message"].asstr()[...].tolist()
    assert "theta_i: stalled" in messages[0]
    assert messages[1].startswith("MotionError: theta_i: stalled")
    assert messages[2].startswith("resumed ")


def test_a_dead_line_during_the_shut_down_does_not_hide_the_first_error(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    world = memory.World()
    world.fail = {
        "measure": DeviceError("lockin", "is silent", "check the cable"),
        "shutter": DeviceError("monochromator", "is silent too", "check it"),
    }
    with pytest.raises(DeviceError, match="lockin: is silent"):
        Runner(memory.rig(world), plan, tmp_path / "scan.h5", policy=FaultPolicy(retries=0)).run()
    assert "stage.stop" in world.log


def test_ctrl_c_ends_as_a_stop_and_stays_a_keyboard_interrupt(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    world = memory.World()
    world.fail = {"select": KeyboardInterrupt()}
    runner = Runner(memory.rig(world), plan, tmp_path / "scan.h5")
    with pytest.raises(KeyboardInterrupt):
        runner.run()
    assert runner.state is State.IDLE
    assert journal_path(tmp_path / "scan.h5").exists()
    runner.run()
    check_complete(memory, plan, tmp_path / "scan.h5")


def test_a_full_disk_ends_the_scan_and_it_resumes_when_there_is_room(
    memory: ModuleType, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "scan.h5"
    written = 0
    write = Journal.write

    def full(self: Journal, record: Any) -> None:
        nonlocal written
        written += 1
        if written == 7:
            self._write(b"half a rec")
            raise StoreError("No space left on device")
        write(self, record)

    monkeypatch.setattr(Journal, "write", full)
    with pytest.raises(StoreError, match="No space left"):
        Runner(memory.rig(), plan, path).run()
    monkeypatch.undo()
    resume_scan(path, memory.rig()).run()
    check_complete(memory, plan, path)


def test_a_driver_that_returns_too_few_readings_is_found_out(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    class Short(memory.MemorySpectrometer):  # type: ignore[misc, name-defined]
        def measure_spectrum(self, wavelength_nm: Any, detector_index: Any, **kwargs: Any) -> Any:
            return super().measure_spectrum(wavelength_nm[:-1], detector_index[:-1], **kwargs)

    rig = memory.rig()
    rig.spectrometer = Short(rig.spectrometer.world, rig.stage)
    with pytest.raises(DeviceError, match=r"shape \(4,\) for 5 wavelengths"):
        Runner(rig, plan, tmp_path / "scan.h5").run()


# -- resume
# -------------------------------------------------------------------------------------------------------


def interrupted(memory: ModuleType, plan: Plan, path: Path, done: int = 4, **world: Any) -> None:
    """Leave a scan that was stopped after `done` positions."""

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == done:
            runner.stop()

    runner = Runner(memory.rig(memory.World(**world)), plan, path, on_snapshot=on_snapshot)
    with pytest.raises(ScanStopped):
        runner.run()


def test_the_time_axis_goes_on_after_the_last_record(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    interrupted(memory, plan, path)
    before_s = gonio.load(path).time_s.max()
    resume_scan(path, memory.rig()).run()
    scan = check_complete(memory, plan, path)
    assert scan.time_s[4] > before_s
    assert np.all(np.diff(scan.time_s) > 0)


def test_on_real_hardware_the_time_away_counts(
    memory: ModuleType, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "scan.h5"
    interrupted(memory, plan, path)
    before_s = gonio.load(path).time_s.max()
    now = __import__("time").time()
    monkeypatch.setattr("time.time", lambda: now + 3600.0)
    real = memory.rig(memory.World(clock=memory.ManualClock(speed=1.0)))
    resume_scan(path, real).run()
    assert gonio.load(path).time_s[4] - before_s > 3590.0


def test_a_scan_is_not_resumed_on_another_rig(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    interrupted(memory, plan, path)
    other = memory.rig(aperture=ApertureConfig(width_mm=20.0, height_mm=18.0, distance_mm=95.2353))
    before = path.read_bytes()
    with pytest.raises(StoreError, match=r"width_mm was 26\.0 and is 20\.0"):
        resume_scan(path, other).run()
    assert path.read_bytes() == before
    resume_scan(path, memory.rig()).run()


def test_there_is_nothing_to_resume_without_a_journal(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="neither a scan nor its journal"):
        resume_scan(tmp_path / "no.h5", memory.rig())
    Runner(memory.rig(), plan, tmp_path / "scan.h5").run()
    with pytest.raises(StoreError, match="the scan is complete"):
        resume_scan(tmp_path / "scan.h5", memory.rig())


def test_a_new_scan_does_not_run_over_an_interrupted_one(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    interrupted(memory, plan, path)
    path.unlink()
    with pytest.raises(StoreError, match="unfinished scan is there; continue it"):
        Runner(memory.rig(), plan, path).run()
    resume_scan(path, memory.rig()).run()  # the journal alone is enough
    check_complete(memory, plan, path)


def test_the_rig_of_the_beginning_is_found_in_the_journal(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    rig = memory.rig(text='driver = "nothing"\n')
    runner = Runner(rig, plan, path, on_snapshot=lambda s: runner.stop() if s.done == 1 else None)
    with pytest.raises(ScanStopped):
        runner.run()
    with pytest.raises(GonioError, match=r"the rig in scan\.h5\.journal"):
        stored_rig(path)  # that text is no rig, and the message says where it came from


def test_spectra_survive_a_resume_and_fits_of_a_part_do_not(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path, csv = tmp_path / "scan.h5", tmp_path / "sphere.csv"
    csv.write_text("wavelength_nm,k_g\n800,0.7\n900,0.8\n")
    interrupted(memory, plan, path)
    gonio.store.attach_csv_spectrum(path, "sphere", csv)
    with h5py.File(path, "r+") as file:
        file.create_group("entry/fit_exact_joint").attrs["NX_class"] = "NXprocess"
    resume_scan(path, memory.rig()).run()
    np.testing.assert_array_equal(gonio.store.read_spectrum(path, "sphere")["k_g"], [0.7, 0.8])
    with h5py.File(path) as file:
        assert "fit_exact_joint" not in file["entry"]
        messages = file["entry/events/message"].asstr()[...].tolist()
    assert any("fit_exact_joint saw only a part" in message for message in messages)


def test_a_second_runner_on_a_running_scan_is_refused(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    refusals: list[str] = []

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == 2 and not refusals:
            for second in (Runner(memory.rig(), plan, path), resume_scan(path, memory.rig())):
                with pytest.raises(StoreError) as caught:
                    second.run()
                refusals.append(str(caught.value))

    Runner(memory.rig(), plan, path, on_snapshot=on_snapshot).run()
    assert "unfinished scan is there" in refusals[0]
    assert "another process is measuring into this file" in refusals[1]
    check_complete(memory, plan, path)

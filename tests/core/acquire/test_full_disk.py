"""A disk that takes no more bytes pauses the scan, or ends it, with everything intact."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections import namedtuple
from pathlib import Path
from types import ModuleType

import h5py
import pytest

import gonio
from gonio.acquire import FaultPolicy, Runner, Snapshot, State, resume_scan
from gonio.acquire import room as room_module
from gonio.errors import StoreError
from gonio.plan import Plan

Usage = namedtuple("Usage", "total used free")


def check_whole(memory: ModuleType, plan: Plan, path: Path) -> None:
    scan = gonio.load(path)
    assert scan.finished
    assert scan.position.tolist() == list(range(plan.n_positions))
    truth = memory.true_r(scan.theta_i_deg, scan.theta_mes_deg, scan.polarization, scan.wavelength_nm)
    assert scan.r == pytest.approx(truth, rel=1e-9)


class Disk:
    """What the operating system says of the free room."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.free = 10**12
        monkeypatch.setattr(room_module.shutil, "disk_usage", lambda path: Usage(10**12, 0, self.free))


def test_a_disk_that_fills_up_pauses_until_there_is_room(
    memory: ModuleType, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, path = Disk(monkeypatch), tmp_path / "scan.h5"
    seen: list[Snapshot] = []

    def mend() -> None:
        disk.free = 10**12
        runner.resume()

    def on_snapshot(snapshot: Snapshot) -> None:
        if (
            snapshot.state is State.RUNNING
            and snapshot.done == 2
            and not any(s.state is State.PAUSED for s in seen)
        ):
            disk.free = 100_000
        if snapshot.state is State.PAUSED:
            threading.Timer(0.05, mend).start()
        seen.append(snapshot)

    policy = FaultPolicy(then="pause")
    runner = Runner(memory.rig(), plan, path, on_snapshot=on_snapshot, policy=policy)
    runner.run()
    paused = next(s for s in seen if s.state is State.PAUSED)
    assert paused.done == 2
    assert "the disk has 0.1 MB left and" in paused.message
    assert "free some space" in paused.message
    check_whole(memory, plan, path)
    with h5py.File(path) as file:
        messages = file["entry/events/message"].asstr()[...].tolist()
    assert sum("the disk has 0.1 MB left" in text for text in messages) == 1  # told once there was room


def test_without_anybody_to_make_room_the_scan_ends_and_can_be_resumed(
    memory: ModuleType, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, path = Disk(monkeypatch), tmp_path / "scan.h5"

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == 4:
            disk.free = 100_000

    with pytest.raises(StoreError, match=r"the disk has 0.1 MB left.*--resume"):
        Runner(memory.rig(), plan, path, on_snapshot=on_snapshot).run()
    disk.free = 10**12
    assert len(gonio.load(path).position) == 4
    resume_scan(path, memory.rig()).run()
    check_whole(memory, plan, path)


_LIMITED = """
import importlib.util, pathlib, resource, signal, sys
spec = importlib.util.spec_from_file_location("memory_rig", sys.argv[1])
memory = importlib.util.module_from_spec(spec)
sys.modules["memory_rig"] = memory
spec.loader.exec_module(memory)
from gonio.acquire import Runner
from gonio.acquire.journal import frames
from gonio.errors import StoreError
from gonio.plan import parse_plan
path = pathlib.Path(sys.argv[2])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # the error code instead of the signal
left = [int(sys.argv[3])]
def on_record(record):
    left[0] -= 1
    if left[0] == 0:
        journal = max(end for end, _ in frames(path.with_name(path.name + ".journal").read_bytes()))
        size = {"journal": journal + 100, "h5": path.stat().st_size + 100}[sys.argv[4]]
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
try:
    Runner(memory.rig(), parse_plan(memory.PLAN_TOML), path, on_record=on_record).run()
except StoreError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no limit on the size of a file")
@pytest.mark.parametrize(("after", "which"), [(2, "journal"), (5, "h5")])
def test_writes_that_really_fail_lose_nothing(
    memory: ModuleType, plan: Plan, tmp_path: Path, after: int, which: str
) -> None:
    """Writes beyond a limit fail with EFBIG: in a process of its own, whose HDF5 is not trusted any more."""
    path = tmp_path / "scan.h5"
    ended = subprocess.run(
        [sys.executable, "-c", _LIMITED, memory.__file__, str(path), str(after), which],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    if not path.with_name("scan.h5.journal").exists():
        assert which == "h5"  # the file never grew again
        check_whole(memory, plan, path)
        return
    assert "--resume" in ended.stdout
    done: list[object] = []
    resume_scan(path, memory.rig(), on_record=done.append).run()
    check_whole(memory, plan, path)

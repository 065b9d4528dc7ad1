"""A process that scans is killed with SIGKILL again and again: no position lost, doubled or misplaced.

The harness is that of `benchmarks/kill.py`, which kills a thousand times.
"""

from __future__ import annotations

import random
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest

from gonio.acquire import Runner, Snapshot, State, resume_scan
from gonio.acquire.journal import MAGIC, encode, frames, journal_path
from gonio.cli import main
from gonio.errors import ScanStopped, StoreError
from gonio.plan import Plan, parse_plan

KILLS = 28
BENCHMARKS = Path(__file__).parents[3] / "benchmarks"

posix = pytest.mark.skipif(sys.platform != "linux", reason="timers that send SIGKILL are Linux's")


@pytest.fixture(scope="module")
def kill() -> Iterator[ModuleType]:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import kill

        yield kill
    finally:
        sys.path.remove(str(BENCHMARKS))


@posix
def test_killed_at_random_instants_and_resumed_until_complete(kill: ModuleType, tmp_path: Path) -> None:
    tally = kill.killed_in_memory(tmp_path, KILLS, random.Random(20221122))
    assert tally.complaints == []
    assert tally.bad == 0
    assert tally.kills == KILLS
    assert tally.positions == tally.scans * 40
    assert tally.rows > 40, "hardly a row was looked at"
    assert len(tally.phases) > 4, "the kills fell into few phases"
    left = {path.name for path in tmp_path.iterdir()}
    assert left <= {"plan.toml", "lives.log", "scan.h5.rebuilt"}


@posix
def test_the_harness_finds_what_is_lost_doubled_wrong_and_torn(
    kill: ModuleType, memory: ModuleType, tmp_path: Path
) -> None:
    """Each kind of damage, done by hand to a scan that was stopped, is seen."""
    from killing.remains import Examiner, Tally

    plan, path = parse_plan(memory.PLAN_TOML), tmp_path / "scan.h5"

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == 4:
            runner.stop()

    runner = Runner(memory.rig(), plan, path, on_snapshot=on_snapshot)
    with pytest.raises(ScanStopped):
        runner.run()
    truth, offset_deg = kill.memory_truth()

    def look(known: set[int]) -> Tally:
        examiner = Examiner(plan, truth, Tally(), offset_deg, 1e-9, 1e-9, 0.0)
        examiner.killed(path, known)
        return examiner.tally

    assert look({0, 1, 2, 3}).bad == 0
    assert look({0, 1, 2, 3, 4}).lost == 1
    with h5py.File(path, "r+") as file:
        file["entry/data/theta_i"][2] += 0.001
    assert look(set()).wrong == 1
    with h5py.File(path, "r+") as file:
        file["entry/data/theta_i"][2] -= 0.001
        file["entry/data/r"][1, 3] *= 1.0 + 1e-6
    assert look(set()).wrong == 1
    with h5py.File(path, "r+") as file:
        file["entry/data/theta_i"][7] = 20.0  # a row that no record stands for
    assert look(set()).wrong > 1
    path.write_bytes(path.read_bytes()[:1000])
    assert look(set()).unopened == 1


def test_a_torn_heap_of_texts_does_not_hang_the_resuming(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    """HDF5 walks for ever through a heap with zeros in it: a page that a power cut has lost."""
    path = tmp_path / "scan.h5"

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == 4:
            runner.stop()

    runner = Runner(memory.rig(), plan, path, on_snapshot=on_snapshot)
    with pytest.raises(ScanStopped):
        runner.run()
    whole = path.read_bytes()
    first = whole.index(b"GCOL\x01\0\0\0")
    size = int.from_bytes(whole[first + 8 : first + 16], "little")
    torn = bytearray(whole)
    torn[first + 512 : first + size] = bytes(size - 512)
    path.write_bytes(torn)
    resume_scan(path, memory.rig()).run()
    with h5py.File(path) as file:
        assert file["entry"].attrs["scan_status"] == "finished"
        np.testing.assert_array_equal(file["entry/data/position"], np.arange(10))


def test_a_second_process_is_refused(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    path, plan_file = tmp_path / "scan.h5", tmp_path / "plan.toml"
    plan_file.write_text(memory.PLAN_TOML)
    paused = threading.Event()

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == 3 and snapshot.state is State.RUNNING and not paused.is_set():
            runner.pause()
        if snapshot.state is State.PAUSED:
            paused.set()

    runner = Runner(memory.rig(), plan, path, on_snapshot=on_snapshot)
    thread = threading.Thread(target=runner.run, daemon=True)
    thread.start()
    try:
        assert paused.wait(30)
        resume = (
            "import sys; from gonio.acquire.journal import Journal, journal_path; from pathlib import Path\n"
        )
        resume += "from gonio.errors import StoreError\n"
        resume += "try: Journal.reopen(journal_path(Path(sys.argv[1])))\nexcept StoreError as e: print(e)"
        said = subprocess.run(
            [sys.executable, "-c", resume, str(path)], capture_output=True, text=True, timeout=60, check=True
        ).stdout
        assert "another process is measuring into this file; wait until it has ended, or stop it" in said
        with pytest.raises(
            StoreError, match="an unfinished scan is there; continue it with gonio scan --resume"
        ):
            Runner(memory.rig(), plan, path).run()
        assert main(["scan", str(plan_file), "-o", str(path)]) == 1
    finally:
        runner.resume()
        thread.join(30)
    with h5py.File(path) as file:
        assert file["entry"].attrs["scan_status"] == "finished"
        np.testing.assert_array_equal(file["entry/data/position"], np.arange(10))


def test_a_scan_that_died_at_its_birth_is_simply_begun_again(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    for length in (0, 7, len(MAGIC), len(MAGIC) + 30):
        journal_path(path).write_bytes((MAGIC + encode(a_record()))[:length])
        Runner(memory.rig(), plan, path).run()
        assert not journal_path(path).exists()
        path.unlink()
    journal_path(path).write_bytes(MAGIC + encode(a_record()))
    assert next(frames(journal_path(path).read_bytes()))
    with pytest.raises(StoreError, match="an unfinished scan is there"):
        Runner(memory.rig(), plan, path).run()


def a_record() -> object:
    from gonio.store.records import EventRecord

    return EventRecord(0.0, 0.0, "info", "runner", "x" * 100)

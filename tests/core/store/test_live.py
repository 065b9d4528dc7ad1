"""A scan is read by another process while it runs: the positions so far, whole, or a reason to try again."""

from __future__ import annotations

import importlib
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest

import gonio
from gonio.acquire import Runner, Snapshot, resume_scan
from gonio.acquire.journal import journal_path
from gonio.errors import ScanStopped, StoreError
from gonio.plan import Plan, parse_plan

READ_UNTIL_FINISHED = """
import sys, time
import numpy as np
import gonio
from gonio.errors import StoreError
path, loads, early, last = sys.argv[1], [], [], None
end = time.monotonic() + 60.0
while time.monotonic() < end:
    try:
        scan = gonio.load(path)
    except StoreError as error:
        early.append(str(error))
        print("-", flush=True)
        continue
    loads.append(scan)
    if len(loads) == 1:
        print("reading", flush=True)
    if scan.finished:
        break
last = loads[-1]
assert last.finished, early
for scan in loads:
    k = len(scan.position)
    assert scan.position.tolist() == list(range(k)), scan.position
    assert scan.n_planned == last.n_planned
    for name in ("raw_signal_v", "theta_i_deg", "theta_mes_deg", "time_s", "polarization"):
        np.testing.assert_array_equal(getattr(scan, name), getattr(last, name)[:k])
    assert np.all(np.isfinite(scan.r)) and np.all(scan.usable)
seen = [len(scan.position) for scan in loads]
assert seen == sorted(seen), seen
assert all("no position" in e or "no such file" in e or "first reading" in e for e in early), early
print(len(set(seen)))
"""

LONGER = """
title = "Watched"
[sample]
name = "coded sample"
[[wavelengths]]
start_nm = 840.0
stop_nm = 880.0
step_nm = 10.0
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = { start = 15.0, stop = 95.0, step = 2.0 }
"""


def test_another_process_reads_whole_positions_while_the_scan_runs(
    memory: ModuleType, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    reader = subprocess.Popen(
        [sys.executable, "-c", READ_UNTIL_FINISHED, str(path)], stdout=subprocess.PIPE, text=True
    )
    lines = reader.stdout
    assert lines is not None
    assert lines.readline() == "-\n"  # it has begun before there is a file
    waited: list[str] = []

    def wait_for_reader(snapshot: Snapshot) -> None:
        if snapshot.done == 10 and not waited:  # however busy the computer is
            waited.extend(iter(lines.readline, "reading\n"))
            waited.append("reading")

    world = memory.World(noise_dark_v=1e-6, noise_full=1e-4, real_delay_s=0.002)
    Runner(memory.rig(world), parse_plan(LONGER), path, on_snapshot=wait_for_reader).run()
    told, _ = reader.communicate(timeout=60)
    assert reader.returncode == 0
    assert int(told.split()[-1]) >= 2  # different numbers of positions were seen


def test_what_is_read_on_the_way_is_what_the_file_shows(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    seen: list[gonio.Scan] = []

    def look(snapshot: Snapshot) -> None:
        if snapshot.done == 5 and not seen:
            seen.append(gonio.load(path))
            runner.stop()

    world = memory.World(noise_dark_v=1e-6, noise_full=1e-4)
    runner = Runner(memory.rig(world), plan, path, on_snapshot=look)
    with pytest.raises(ScanStopped):
        runner.run()
    alone = tmp_path / "alone.h5"
    shutil.copy(path, alone)  # without its journal: read as HDF5
    stored = gonio.load(alone)
    assert not stored.finished
    for name in ("r", "r_sd", "gain_u", "offset_u", "dark_v", "baseline_v", "theta_o_deg", "quality"):
        np.testing.assert_array_equal(getattr(seen[0], name), getattr(stored, name))


def test_more_positions_than_a_cache_holds_are_read_on_the_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    bench = importlib.import_module("store_live")
    monkeypatch.setattr("gonio.acquire.session.Session.finish", lambda session, _end_time: session.close())
    path = tmp_path / "scan.h5"
    bench.write(path, 2000)
    assert journal_path(path).exists()
    scan = gonio.load(path)
    assert scan.position.tolist() == list(range(2000))
    np.testing.assert_array_equal(scan.raw_signal_v[:, 0], scan.position)


def test_an_unfinished_scan_loads_even_if_its_h5_is_gone(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    runner = Runner(memory.rig(), plan, path, on_snapshot=lambda s: runner.stop() if s.done == 3 else None)
    with pytest.raises(ScanStopped):
        runner.run()
    path.write_bytes(b"torn by a power cut")
    assert gonio.load(path).position.tolist() == [0, 1, 2]
    resume_scan(path, memory.rig()).run()
    assert gonio.load(path).finished


def test_reading_leaves_journal_and_file_as_they_are(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    runner = Runner(memory.rig(), plan, path, on_snapshot=lambda s: runner.stop() if s.done == 3 else None)
    with pytest.raises(ScanStopped):
        runner.run()
    before = [p.read_bytes() for p in (path, journal_path(path))]
    gonio.load(path)
    assert [p.read_bytes() for p in (path, journal_path(path))] == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scan.h5", "scan.h5.journal"]


def test_a_strange_journal_is_named(memory: ModuleType, plan: Plan, tmp_path: Path) -> None:
    path = Runner(memory.rig(), plan, tmp_path / "scan.h5").run()
    journal_path(path).write_text("a diary")
    with pytest.raises(StoreError, match=r"scan\.h5\.journal: is not the journal of a gonio scan"):
        gonio.load(path)


def test_a_plain_h5py_reader_that_ignores_the_lock_opens_the_file(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    counts: list[int] = []

    def look(snapshot: Snapshot) -> None:
        if snapshot.done == 4 and not counts:
            code = (
                "import sys, h5py, numpy as np\n"
                "with h5py.File(sys.argv[1], 'r', locking=False) as f:\n"
                "    print(np.isfinite(f['entry/data/theta_i'][...]).sum())\n"
            )
            told = subprocess.run(
                [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
            )
            counts.append(int(told.stdout))

    Runner(memory.rig(), plan, path, on_snapshot=look).run()
    assert counts == [4]
    with h5py.File(path, "r") as file:
        assert np.all(np.isfinite(file["entry/data/r"][...]))

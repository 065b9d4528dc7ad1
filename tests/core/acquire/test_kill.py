"""A process that scans is killed with SIGKILL again and again: no position lost, doubled or misplaced."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import IO

import h5py
import numpy as np
import pytest

import gonio
from gonio.acquire.journal import journal_path
from gonio.plan import parse_plan

KILLS = 24

PLAN = """
[[wavelengths]]
start_nm = 820.0
stop_nm = 900.0
step_nm = 20.0
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = { start = 15.0, stop = 114.0, step = 1.0 }
[[sweeps]]
theta_i_deg = 45.0
theta_mes_deg = { start = 15.0, stop = 114.0, step = 1.0 }
"""

# Imports once, then forks a process for every life of the scan, so that a life costs no second of imports.
NURSERY = """
import os, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import memory_rig
from gonio.acquire import Runner, resume_scan
from gonio.acquire.journal import journal_path
from gonio.plan import load_plan
plan, path = load_plan(Path(sys.argv[2])), Path(sys.argv[3])
for _ in sys.stdin:
    pid = os.fork()
    if pid == 0:
        rig = memory_rig.rig(memory_rig.World(real_delay_s=1e-4))
        runner = resume_scan(path, rig) if journal_path(path).exists() else Runner(rig, plan, path)
        runner.run()
        os._exit(0)
    print(pid, flush=True)
    sys.stdin.readline()  # until here the process keeps its number, dead or alive
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""


@contextmanager
def nursery(plan_path: Path, path: Path) -> Iterator[tuple[IO[str], IO[str]]]:
    command = [sys.executable, "-c", NURSERY, str(Path(__file__).parent), str(plan_path), str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield process.stdin, process.stdout
        process.stdin.close()
        assert process.wait(60) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL and fork are POSIX")
def test_killed_at_random_instants_and_resumed_until_complete(memory: ModuleType, tmp_path: Path) -> None:
    rng = random.Random(20221122)
    plan_path, path = tmp_path / "plan.toml", tmp_path / "scan.h5"
    plan_path.write_text(PLAN)
    kills = opened = 0
    with nursery(plan_path, path) as (orders, answers):
        while True:
            print("live", file=orders, flush=True)
            pid = int(answers.readline())
            killed = kills < KILLS
            if killed:
                wait_for_a_random_instant(path, rng)
                os.kill(pid, signal.SIGKILL)
            print("reap", file=orders, flush=True)
            status = int(answers.readline())
            assert status in ((0, -signal.SIGKILL) if killed else (0,))
            kills += status != 0
            if status != 0 and journal_path(path).exists() and path.exists():
                opened += opens(path)
            if status == 0:
                check(memory, path)
                if kills >= KILLS:
                    break
                path.unlink()  # finished before the last kill: begin another one
    assert opened > KILLS // 4
    assert sorted(p.name for p in tmp_path.iterdir()) == ["plan.toml", "scan.h5"]


def wait_for_a_random_instant(path: Path, rng: random.Random) -> None:
    """Return soon (while files are checked or made anew), or some records later, at any point of a record."""
    if rng.random() < 0.3:
        time.sleep(0.03 * rng.random())
        return
    deadline = time.monotonic() + 10.0
    enough = size(path) + rng.randint(1, 12_000)
    while size(path) < enough and time.monotonic() < deadline:
        time.sleep(0.0005)
        if path.exists() and size(path) == 0:
            return  # it is finished
    time.sleep(0.005 * rng.random())


def size(path: Path) -> int:
    try:
        return journal_path(path).stat().st_size
    except FileNotFoundError:
        return 0


def opens(path: Path) -> bool:
    """Say whether a killed scan's file opens with positions in it; one that was just being made may not."""
    try:
        with h5py.File(path, "r") as file:
            return bool(np.isfinite(file["entry/data/theta_i"][...]).any())
    except (OSError, KeyError):
        assert journal_path(path).stat().st_size < 10_000, "a file with positions in it does not open"
        return False


def check(memory: ModuleType, path: Path) -> None:
    scan = gonio.load(path)
    assert scan.finished
    assert not journal_path(path).exists()
    positions = parse_plan(PLAN).positions()
    assert scan.position.tolist() == list(range(len(positions)))
    np.testing.assert_allclose(scan.theta_i_deg, [p.theta_i_deg + 0.002 for p in positions], atol=1e-12)
    np.testing.assert_allclose(scan.theta_mes_deg, [p.theta_mes_deg - 0.003 for p in positions], atol=1e-12)
    assert scan.polarization.tolist() == [p.polarization for p in positions]
    truth = memory.true_r(scan.theta_i_deg, scan.theta_mes_deg, scan.polarization, scan.wavelength_nm)
    np.testing.assert_allclose(scan.r, truth, rtol=1e-12)
    assert np.all(np.diff(scan.time_s) > 0)

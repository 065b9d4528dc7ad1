"""A process that imports everything once and then forks a process for each life of a scan.

    python -m killing.lives memory|wire FOLDER        orders on standard input, answers on standard output

A life of `memory` runs on the bench in memory of the tests; one of `wire` is the command ``gonio scan`` on
the rig file of the folder.  An order is a line of JSON, `Order` or null; the answers are the number of the
process, and, after another line, how it ended, in which phase, and (for a life that ended by itself) the
typical time of each phase.
"""

from __future__ import annotations

import importlib.util
import json
import mmap
import os
import sys
import tempfile
from pathlib import Path
from statistics import median
from types import ModuleType
from typing import Any

from gonio.acquire import Runner, resume_scan
from gonio.acquire.journal import died_at_birth, journal_path
from gonio.cli import main as gonio
from gonio.plan import load_plan
from killing.phases import PHASES, Order, Watch

MEMORY_RIG = Path(__file__).parents[2] / "tests" / "core" / "acquire" / "memory_rig.py"
SLOW_S = 1e-4  # real seconds for a reading in memory, so that a position takes some time


def memory_rig() -> ModuleType:
    """Load the tests' bench in memory."""
    spec = importlib.util.spec_from_file_location("memory_rig", MEMORY_RIG)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["memory_rig"] = module
    spec.loader.exec_module(module)
    return module


def begun(path: Path) -> bool:
    """Say whether there is a scan to go on with; one that died at its birth is begun anew."""
    return journal_path(path).exists() and not died_at_birth(journal_path(path))


def scan_arguments(folder: Path) -> list[str]:
    """Return the arguments of `gonio` that begin the scan or go on with it."""
    path = folder / "scan.h5"
    policy = ["--retries", "3", "--on-fault", "abort"]
    if begun(path):
        return ["scan", "--resume", str(path), *policy]
    return ["scan", str(folder / "plan.toml"), "--rig", str(folder / "rig.toml"), "-o", str(path), *policy]


def live(kind: str, folder: Path) -> int:
    """Begin the scan of the folder or go on with it; return the exit code."""
    if kind == "wire":
        return int(gonio(scan_arguments(folder)))
    memory, path = memory_rig(), folder / "scan.h5"
    rig = memory.rig(memory.World(real_delay_s=SLOW_S))
    if begun(path):
        resume_scan(path, rig).run()
    else:
        Runner(rig, load_plan(folder / "plan.toml"), path).run()
    return 0


def main() -> None:
    """Serve orders until standard input closes."""
    kind, folder = sys.argv[1], Path(sys.argv[2])
    with tempfile.TemporaryFile() as shared_file:
        shared_file.write(bytes(mmap.PAGESIZE))
        shared_file.flush()
        shared = mmap.mmap(shared_file.fileno(), mmap.PAGESIZE)
        log = (folder / "lives.log").open("ab")
        for line in sys.stdin:
            order: dict[str, Any] | None = json.loads(line)
            shared[:] = bytes(mmap.PAGESIZE)
            pid = os.fork()
            if pid == 0:
                _be_born(kind, folder, order, shared, log.fileno())
            print(pid, flush=True)
            sys.stdin.readline()  # until here the process keeps its number, dead or alive
            status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            typical = json.loads(shared[1:].rstrip(b"\0") or b"{}")
            print(json.dumps([status, PHASES[shared[0]], typical]), flush=True)


def _be_born(kind: str, folder: Path, order: dict[str, Any] | None, shared: mmap.mmap, log: int) -> None:
    """Live in the forked process, and never return."""
    code = 70
    try:
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        watch = Watch(shared, None if order is None else Order(**order))
        code = live(kind, folder)
        typical = {phase: median(spent) for phase, spent in watch.spent_s.items()}
        text = json.dumps(typical).encode()
        shared[1 : 1 + len(text)] = text
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main()

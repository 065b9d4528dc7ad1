"""A scan is killed with SIGKILL a thousand times, at any instant, and resumed: is anything lost or wrong?

Three kinds of lives, all of them processes that end in the middle of whatever they do:

memory   the runner on the bench in memory of the tests, forked from a process that has imported everything;
         many lives in little time
wire     the command `gonio scan`, forked in the same way, against the simulated bench over its sockets
program  `gonio scan` as a program of its own, interpreter and imports included, against the same bench

Lives of the first two are killed by a timer of the kernel, set on entering one of the phases printed below
(or none), after a random share of the time that it takes; the last at a random time of the clock.  Before
each `--resume` the `.h5` is opened with plain h5py, and each row in it compared with the plan and with the
truth at its angles (the bench has neither noise nor drift).  After one kill in ten the files are torn as
well, as by a power cut: journal and `.h5` together.

lost       a position that was in the journal is not any more, or is missing in a finished file
doubled    a position or reference is in a finished file twice
half       of the rows read, those of which only a part had been flushed: the rest is NaN (no fault)
wrong      a row with other angles, another polarization or another r than the truth; a time that goes back
no open    a killed scan's `.h5` that plain h5py does not open (torn ones aside)
stuck      a life without a kill that does not end with a finished file

Run: python benchmarks/kill.py [--memory 700] [--wire 280] [--program 20] [--seed 1]
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from killing.lives import memory_rig, scan_arguments
from killing.phases import PHASES, Order
from killing.remains import Examiner, Tally, Truth

from gonio.acquire.journal import journal_path
from gonio.plan import Plan, parse_plan
from gonio.rig import default_rig_text

PLAN = """
title = "killed"
[[wavelengths]]
start_nm = 820.0
stop_nm = 900.0
step_nm = 20.0
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = { start = 15.0, stop = 60.0, step = 5.0 }
[[sweeps]]
theta_i_deg = 45.0
theta_mes_deg = { start = 30.0, stop = 120.0, step = 10.0 }
[references]
every_positions = 12
"""
CLOCK = 4000.0
LONGEST_S = 60.0  # a life takes less than two seconds
POWER_CUTS = 0.1
NTH = {"position": 6, "journal": 9, "rows": 6, "flush": 9, "confirming": 9, "reference": 2}
ROUND = tuple(p for p in PHASES for _ in range({"finish": 2, "outside": 2}.get(p, 1)))


class Nursery:
    """The process that forks lives."""

    def __init__(self, kind: str, folder: Path) -> None:
        environment = dict(os.environ) | {"PYTHONPATH": str(Path(__file__).parent)}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "killing.lives", kind, str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )

    def live(self, order: Order | None) -> tuple[int, str, dict[str, float]]:
        """Let one life run to its end; return its exit code, its last phase, and typical times of phases."""
        orders, answers = self._process.stdin, self._process.stdout
        assert orders is not None
        assert answers is not None
        print(json.dumps(None if order is None else asdict(order)), file=orders, flush=True)
        pid = int(answers.readline())
        # a life that hangs is no kill: it ends by another signal, and counts as stuck
        overdue = threading.Timer(LONGEST_S, os.kill, (pid, signal.SIGABRT))
        overdue.start()
        try:
            print("reap", file=orders, flush=True)
            status, phase, typical = json.loads(answers.readline())
        finally:
            overdue.cancel()
        return status, phase, typical

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(60)
        self._process.stdout.close()


def campaign(nursery: Nursery, folder: Path, examiner: Examiner, kills: int, rng: random.Random) -> Tally:
    """Kill, look and resume until there were so many kills and the last scan has come to its end."""
    tally, path = examiner.tally, folder / "scan.h5"
    typical = _calibrated(nursery, folder, examiner)
    known: set[int] = set()
    goal = tally.kills + kills
    while tally.kills < goal or journal_path(path).exists():
        order = None
        if tally.kills < goal:
            phase = rng.choice(ROUND)
            nth = rng.randint(1, NTH.get(phase, 1))
            order = Order(phase, nth, 1.1 * rng.random(), typical[phase])
        status, phase, _ = nursery.live(order)
        known = after_a_life(status, phase, path, examiner, known, rng)
    return tally


def after_a_life(
    status: int, phase: str, path: Path, examiner: Examiner, known: set[int], rng: random.Random
) -> set[int]:
    """Look at what a life left; return the positions that must be there from now on."""
    tally = examiner.tally
    if status == -signal.SIGKILL:
        tally.kills += 1
        tally.phases[phase] += 1
        if tally.kills % 50 == 0:
            print(f"{tally.kills} kills, {tally.bad} bad", file=sys.stderr, flush=True)
        if path.exists() and not journal_path(path).exists():  # killed after its last step
            examiner.finished(path)
            path.unlink()
            return set()
        known = examiner.killed(path, known)
        if journal_path(path).exists() and rng.random() < POWER_CUTS:
            examiner.tear(path, rng)
            return set()  # at most the last record is gone: the finished file will show
        return known
    if status == 0:
        examiner.finished(path)
    else:
        tally.not_resumed += 1
        hung = f"hung for {LONGEST_S:g} s" if status == -signal.SIGABRT else f"ended with exit code {status}"
        tally.complain(f"a life {hung} while in {phase}; see lives.log")
        journal_path(path).unlink(missing_ok=True)
    path.unlink(missing_ok=True)
    return set()


def _calibrated(nursery: Nursery, folder: Path, examiner: Examiner) -> dict[str, float]:
    """Let one scan live to its end, and return what each phase takes; what it did not meet gets a guess."""
    path = folder / "scan.h5"
    began_s = time.perf_counter()
    status, _, typical = nursery.live(None)
    whole_s = time.perf_counter() - began_s
    if status != 0:
        raise SystemExit(
            f"kill: the scan does not even run undisturbed:\n{(folder / 'lives.log').read_text()}"
        )
    examiner.finished(path)
    path.unlink()
    known = {phase: typical.get(phase, 0.0) for phase in PHASES}
    known["rebuild"] = max(known["creation"], 1e-3)
    known["outside"] = whole_s
    return known


def programs(folder: Path, examiner: Examiner, kills: int, rng: random.Random) -> None:
    """The same with `gonio scan` as a program, killed at a random time after its start."""
    path, tally = folder / "scan.h5", examiner.tally
    known: set[int] = set()
    goal = tally.kills + kills
    with (folder / "lives.log").open("ab") as log:
        while tally.kills < goal or journal_path(path).exists():
            process = subprocess.Popen(
                [sys.executable, "-m", "gonio.cli", *scan_arguments(folder)], stdout=log, stderr=log
            )
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.3 + 2.5 * rng.random() if tally.kills < goal else 120.0)
            if process.poll() is None:
                process.kill()
            known = after_a_life(process.wait(), "program", path, examiner, known, rng)


# -- the two benches


def memory_truth() -> tuple[Truth, tuple[float, float]]:
    """Return the truth of the bench in memory, and how far its axes are beside their targets."""
    memory = memory_rig()

    def truth(at: Any, theta_i: float, theta_mes: float, wavelength_nm: np.ndarray) -> np.ndarray:
        return np.asarray(memory.true_r(theta_i, theta_mes, at.polarization, wavelength_nm))

    return truth, (0.002, -0.003)


@contextlib.contextmanager
def wire_bench(folder: Path) -> Iterator[Truth]:
    """Serve the simulated bench without noise and drift; `rig.toml` in the folder leads to it."""
    from gonio_simulators.bench.config import BenchConfig
    from gonio_simulators.bench.scattering import Scattering

    text = re.sub(r"clock_speed = [\d.]+", f"clock_speed = {CLOCK}", default_rig_text())
    text = re.sub(r"(lamp_drift_per_hour|flicker|shot_at_full|floor) = \S+", r"\1 = 0.0", text)
    (folder / "bench.toml").write_text(text, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "gonio_simulators", str(folder / "bench.toml"), "--until-stdin-closes"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        for line in process.stdout:
            if line.strip() == "ready":
                break
            role, _, address = line.split()
            head = {"monochromator": "spectrometer.monochromator", "lockin": "spectrometer.lockin"}.get(
                role, role
            )
            text = re.sub(
                rf'(\[{re.escape(head)}\]\n(?:[^\[]*\n)?address = )"simulated"',
                rf'\1"{address}"',
                text,
                count=1,
            )
        (folder / "rig.toml").write_text(text, encoding="utf-8")
        scattering = Scattering(BenchConfig.from_tables(tomllib.loads(text), source="kill"))

        def truth(at: Any, theta_i: float, theta_mes: float, wavelength_nm: np.ndarray) -> np.ndarray:
            s = 1.0 if at.polarization == "s" else 0.0
            return np.array([scattering.r(theta_i, theta_mes, s, w) for w in wavelength_nm.tolist()])

        yield truth
    finally:
        process.stdin.close()
        process.wait(20)
        process.stdout.close()


def show(name: str, tally: Tally, seconds: float) -> None:
    print(
        f"{name:<9}{tally.kills:>6}{tally.power_cuts:>7}{tally.scans:>7}{tally.positions:>11}{tally.rows:>9}{tally.half:>6}"
        f"{tally.lost:>7}{tally.doubled:>9}{tally.wrong:>7}{tally.unopened:>8}{tally.not_resumed:>6}{seconds:>9.0f}",
        flush=True,
    )


def killed_in_memory(folder: Path, kills: int, rng: random.Random, plan: Plan | None = None) -> Tally:
    """Run the campaign of lives in memory."""
    plan = plan or parse_plan(PLAN)
    (folder / "plan.toml").write_text(plan.to_toml(), encoding="utf-8")
    truth, offset_deg = memory_truth()
    examiner = Examiner(
        plan, truth, Tally(), offset_deg=offset_deg, angle_deg=1e-9, relative=1e-9, absolute=0.0
    )
    nursery = Nursery("memory", folder)
    try:
        return campaign(nursery, folder, examiner, kills, rng)
    finally:
        nursery.close()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--memory", type=int, default=700, metavar="KILLS")
    parser.add_argument("--wire", type=int, default=280, metavar="KILLS")
    parser.add_argument("--program", type=int, default=20, metavar="KILLS")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = random.Random(options.seed)
    tallies: dict[str, tuple[Tally, float]] = {}
    with tempfile.TemporaryDirectory(prefix="gonio-kill-") as name:
        memory_folder, wire_folder = Path(name) / "memory", Path(name) / "wire"
        memory_folder.mkdir()
        wire_folder.mkdir()
        if options.memory:
            began_s = time.monotonic()
            tally = killed_in_memory(memory_folder, options.memory, rng)
            tallies["memory"] = tally, time.monotonic() - began_s
            show("memory", *tallies["memory"])
        if options.wire or options.program:
            plan = parse_plan(PLAN)
            (wire_folder / "plan.toml").write_text(PLAN, encoding="utf-8")
            with wire_bench(wire_folder) as truth:
                if options.wire:
                    began_s = time.monotonic()
                    nursery = Nursery("wire", wire_folder)
                    try:
                        tally = campaign(
                            nursery, wire_folder, Examiner(plan, truth, Tally()), options.wire, rng
                        )
                    finally:
                        nursery.close()
                    tallies["wire"] = tally, time.monotonic() - began_s
                    show("wire", *tallies["wire"])
                if options.program:
                    began_s = time.monotonic()
                    tally = Tally()
                    programs(wire_folder, Examiner(plan, truth, tally), options.program, rng)
                    tallies["program"] = tally, time.monotonic() - began_s
    print(
        "\nlives     kills power  scans  positions     rows  half   lost  doubled  wrong no open stuck"
        "  seconds\n"
        "                 cuts  ended   in them     read"
    )
    for name, (tally, seconds) in tallies.items():
        show(name, tally, seconds)
    kinds = list(tallies)
    print("\nkilled while in" + "".join(f"{kind:>10}" for kind in kinds))
    for phase in (*PHASES, "program"):
        counts = [tallies[kind][0].phases[phase] for kind in kinds]
        if any(counts):
            print(f"{phase:<15}" + "".join(f"{count:>10}" for count in counts))
    total = [t for t, _ in tallies.values()]
    print(
        f"\n{sum(t.kills for t in total)} kills: lost {sum(t.lost for t in total)}, doubled "
        f"{sum(t.doubled for t in total)}, wrong {sum(t.wrong for t in total)}, files that did not open "
        f"{sum(t.unopened for t in total)}"
    )
    for text in (text for t in total for text in t.complaints):
        print(f"  {text}")
    return 1 if any(t.bad for t in total) else 0


if __name__ == "__main__":
    sys.exit(main())

"""A simulated week of scanning with everything going wrong that goes wrong on a bench: is any number wrong?

The simulated bench runs on a fast clock without noise or drift, so that the value of every reading is known
to 0.2 % from the angles it is stored under.  Faults of the wires, drives, monochromator and amplifier strike
at random; the runner recovers and tries again, and where it gives up the rig is opened anew and the scan
resumed, as an operator would.  Scan follows scan until the bench's clock has seen the days asked for.  Each
finished file is read back: every position once (lost, doubled), every usable reading with the value that its
angles, wavelength and polarization have (wrong).

A stall that the controller denies (`stall:silent=true`) strikes only the Zaber stage, which has an encoder:
an open-loop stage cannot know of it, nor can anybody who asks it.  Lamps and detectors that change are left
out: they are the references' business.

Run: python benchmarks/soak.py [--days 7] [--clock 1000] [--seed 1] [--stage zaber] [--keep FOLDER]
"""

from __future__ import annotations

import argparse
import contextlib
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import gonio
from gonio.acquire import FaultPolicy, Runner, resume_scan
from gonio.acquire.journal import journal_path
from gonio.errors import DeviceError, GonioError
from gonio.plan import Plan, parse_plan
from gonio.rig import Rig, RigConfig, default_rig_text, open_rig, parse_rig, with_addresses
from gonio.store.records import EventRecord
from gonio_simulators.bench.config import BenchConfig
from gonio_simulators.bench.scattering import Scattering
from gonio_simulators.faults.log import read_fault_log

STAGES = {
    "zaber": 'driver = "zaber"',
    "modbus-rtu": 'driver = "applied-motion"\nframing = "rtu"',
    "modbus-tcp": 'driver = "applied-motion"\nframing = "tcp"\nword_order = "little"',
}
PLAN = """
title = "soak"
[[wavelengths]]
start_nm = 500.0
stop_nm = 1300.0
step_nm = 160.0
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = { start = 15.0, stop = 105.0, step = 9.0 }
[[sweeps]]
theta_i_deg = 55.0
theta_mes_deg = { start = 15.0, stop = 141.0, step = 9.0 }
"""
FAULTS = (  # probability per opportunity: replies, requests, moves, looks, changes
    "slow-reply:0.002:delay_s=0.1",
    "dropped-reply:0.001",
    "late-reply:0.001",
    "dropped-request:0.001",
    "hang:0.0002:hang_s=1.0",
    "garbage:0.002",
    "corrupt-reply:0.002",
    "corrupt-request:0.001",
    "split-reply:0.002:gap_s=0.002",
    "doubled-reply:0.002",
    "disconnect:0.0005:refuse_s=0.3",
    "echo-missing:0.001",
    "echo-doubled:0.002",
    "alarm@stage:0.01",
    "limit:0.01",
    "stall:0.01",
    "knob:0.01:by=knob",
    "knob:0.005:by=push",
    "knob:0.005:moving=true",
    "power-cycle:0.0002",
    "detector-saturated:0.002:hold_s=1.0",
    "lockin-overload:0.01",
    "filter-stuck:0.02",
    "grating-stuck:0.02",
    "shutter-stuck:0.05",
    "wavelength-stuck:0.01",
)
RELATIVE = 2e-3  # of a reading, as rounding of volts and angles have it without noise
ABSOLUTE = 2e-6  # of r
DAY_S = 86_400.0


@dataclass
class Tally:
    """What a soak has seen."""

    scans: int = 0
    positions: int = 0
    readings: int = 0
    flagged: int = 0
    lost: int = 0
    doubled: int = 0
    wrong: int = 0
    worst: float = 0.0  # |r - truth| over what is allowed
    retried_steps: int = 0
    reopened: int = 0
    bench_s: float = 0.0
    wire: Counter[str] = field(default_factory=Counter)
    gave_up: Counter[str] = field(default_factory=Counter)


def rig_text(stage: str, clock: float, seed: int) -> str:
    """Return the simulated rig without noise and drift, with faults."""
    text = default_rig_text().replace('driver = "zaber"', STAGES[stage], 1)
    text = re.sub(r"clock_speed = [\d.]+", f"clock_speed = {clock}", text)
    # a stall that the controller denies: only a stage with an encoder can know of it
    faults = [*FAULTS, "stall@stage:0.002:silent=true"] if stage == "zaber" else FAULTS
    text = re.sub(r"seed = \d+", f"seed = {seed}\nfaults = [{', '.join(map(repr, faults))}]", text)
    text = re.sub(r"(lamp_drift_per_hour|flicker|shot_at_full|floor) = \S+", r"\1 = 0.0", text)
    return text.replace("[aperture]", "[wire]\nreply_timeout_s = 0.25\n\n[aperture]", 1)


@contextlib.contextmanager
def bench(folder: Path, text: str, fault_log: Path) -> Iterator[RigConfig]:
    """Serve the bench in a process of its own."""
    rig_file = folder / "rig.toml"
    rig_file.write_text(text, encoding="utf-8")
    process = subprocess.Popen(
        [
            sys.executable,
            *("-m", "gonio_simulators", str(rig_file), "--until-stdin-closes", "--fault-log", str(fault_log)),
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        addresses = {}
        for line in process.stdout:
            if line.strip() == "ready":
                break
            role, _, address = line.split()
            addresses[role] = address
        yield with_addresses(parse_rig(text), addresses)
    finally:
        process.stdin.close()
        process.wait(20)


def count_wires(rig: Rig, tally: Tally) -> None:
    """Add up what the lines of a rig have seen."""
    spectrometer = rig.spectrometer
    owners = (rig.stage, rig.polarizer, spectrometer._monochromator, spectrometer._lockin)  # type: ignore[attr-defined]
    for owner in owners:
        line = owner._line
        statistics = getattr(line, "line", line).statistics
        for name in ("timeouts", "damaged", "stale_bytes", "retries", "reconnects"):
            tally.wire[name] += getattr(statistics, name)


def measure(config: RigConfig, plan: Plan, path: Path, tally: Tally) -> None:
    """Measure one scan to its end, with as many rigs opened as it takes."""

    def on_record(record: object) -> None:
        if isinstance(record, EventRecord) and "measured after" in record.message:
            tally.retried_steps += 1

    policy = FaultPolicy(retries=6, first_wait_s=0.05)
    while True:
        try:
            with open_rig(config) as rig:
                try:
                    if journal_path(path).exists():
                        runner = resume_scan(path, rig, policy=policy)
                    else:
                        runner = Runner(rig, plan, path, on_record=on_record, policy=policy)
                    runner.run()
                finally:
                    tally.bench_s += rig.clock.now_s()
                    count_wires(rig, tally)
            return
        except DeviceError as error:
            tally.reopened += 1
            tally.gave_up[re.sub(r"[\d.]+|'.*'", "#", error.fault)[:70]] += 1
            time.sleep(1.0)  # an operator is no faster


def examine(path: Path, plan: Plan, scattering: Scattering, tally: Tally) -> None:
    """Read a file back and compare every reading with the truth at its own angles."""
    scan = gonio.load(path)
    index = scan.position.tolist()
    tally.scans += 1
    tally.positions += len(index)
    tally.doubled += len(index) - len(set(index))
    tally.lost += plan.n_positions - len(set(index))
    planned = {p.index: p for p in plan.positions()}
    for row, i in enumerate(index):
        at = planned[i]
        s_fraction = 1.0 if at.polarization == "s" else 0.0
        if (
            abs(scan.theta_i_deg[row] - at.theta_i_deg) > 0.011
            or abs(scan.theta_mes_deg[row] - at.theta_mes_deg) > 0.011
            or scan.polarization[row] != at.polarization
        ):
            tally.wrong += len(scan.wavelength_nm)
            continue
        for column, wavelength_nm in enumerate(scan.wavelength_nm.tolist()):
            tally.readings += 1
            if not scan.usable[row, column]:
                tally.flagged += 1
                continue
            truth = scattering.r(
                float(scan.theta_i_deg[row]), float(scan.theta_mes_deg[row]), s_fraction, wavelength_nm
            )
            r = scan.r[row, column]
            off = abs(r - truth) / (RELATIVE * truth + ABSOLUTE)
            tally.worst = max(tally.worst, off)
            if off > 1.0:
                tally.wrong += 1
                print(
                    f"  WRONG {path.name} {at} {wavelength_nm:g} nm: r = {r:.6g}, truth {truth:.6g}, quality "
                    f"{int(scan.quality[row, column])}"
                )


def soak(stage: str, days: float, clock: float, seed: int, folder: Path) -> Tally:
    """Scan until the bench's clock has seen `days`, and print what happened."""
    text = rig_text(stage, clock, seed)
    scattering = Scattering(BenchConfig.from_tables(tomllib.loads(text), source="soak"))
    plan = parse_plan(PLAN)
    tally = Tally()
    fault_log = folder / f"{stage}-faults.log"
    began_s = time.monotonic()
    with bench(folder, text, fault_log) as config:
        while tally.bench_s < days * DAY_S:
            path = folder / f"{stage}-{tally.scans:04d}.h5"
            measure(config, plan, path, tally)
            examine(path, plan, scattering, tally)
            path.unlink()
    counts = Counter(injected.name for injected in read_fault_log(fault_log))
    print(
        f"{stage}: {tally.bench_s / DAY_S:.2f} bench days in {time.monotonic() - began_s:.0f} s; "
        f"{tally.scans} scans, {tally.positions} positions, {tally.readings} readings "
        f"({tally.flagged} flagged not usable)"
    )
    print(
        f"  lost {tally.lost}, doubled {tally.doubled}, wrong {tally.wrong} (worst {tally.worst:.2f} of the "
        "allowed)"
    )
    print(f"  faults injected: {sum(counts.values())}")
    for name, count in sorted(counts.items()):
        print(f"    {name:<20}{count:>7}")
    print(f"  on the wires: {', '.join(f'{n} {c}' for n, c in tally.wire.items())}")
    print(f"  steps measured anew: {tally.retried_steps}; rigs opened anew after giving up: {tally.reopened}")
    for fault, count in tally.gave_up.most_common(8):
        print(f"    {count} x {fault}")
    return tally


def main() -> int:
    """Run the benchmark; exit code 1 if anything was lost, doubled or wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--days", type=float, default=7.0, help="of bench time, for each stage")
    parser.add_argument("--clock", type=float, default=1000.0, help="bench seconds per real second")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--stage", choices=[*STAGES, "all"], default="all")
    parser.add_argument("--keep", type=Path, help="folder for the fault logs (default: a temporary one)")
    options = parser.parse_args()
    stages = list(STAGES) if options.stage == "all" else [options.stage]
    bad = 0
    with tempfile.TemporaryDirectory(prefix="gonio-soak-") as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for stage in stages:
            tally = soak(stage, options.days / len(stages), options.clock, options.seed, folder)
            bad += tally.lost + tally.doubled + tally.wrong
    return 1 if bad else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except GonioError as error:
        sys.exit(f"soak: {error}")

"""What does a position cost on the disk as a scan grows to 10^6 positions of 121 wavelengths?

Positions go through `Session.record` as in a scan (journal confirmed by the disk, correction, rows of the
`.h5`, flush), with references every 1000 positions.  Printed for each tenth of the way: milliseconds a
position, of them the journal and the `.h5`, memory in use, and bytes a position in each file.  Constant cost
and flat memory are asked for; the last lines compare the last tenth with the second.

Run: python benchmarks/store_large.py [--positions N] [--wavelengths M] [--random] [--folder DIR] [--no-sync]
10^6 positions of 121 wavelengths take 17 GB and hours; the default is a twentieth of that.  Without --no-sync
the disk's own waiting is in the figures.
"""

from __future__ import annotations

import argparse
import gc
import os
import resource
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from gonio.acquire import journal
from gonio.acquire.session import Session
from gonio.plan import Plan, parse_plan
from gonio.store import load
from gonio.store.file import ScanFile
from gonio.store.records import DetectorFacts, PositionRecord, ReferenceRecord, RigFacts, ScanHeader

BYTES_A_READING = 140  # journal and `.h5` together
EVERY = 1000  # positions between references


def plan_of(n: int, m: int, *, shuffled: bool) -> Plan:
    """Return a plan of n positions, or a few more, of m wavelengths."""
    per_sweep = min(1000, max(2, n // 20))
    sweeps = max(1, round(n / (2 * per_sweep)))
    step = 150.0 / (per_sweep - 1)
    text = ['title = "Large"', 'polarization = ["s", "p"]', "[sample]", 'name = "large"', "[[wavelengths]]"]
    text += ["start_nm = 300.0", f"stop_nm = {300.0 + 5.0 * (m - 1)}", "step_nm = 5.0"]
    for number in range(sweeps):
        text += ["[[sweeps]]", f"theta_i_deg = {80.0 * (number + 1) / sweeps:.6f}"]
        text += [
            f"theta_mes_deg = {{ start = 20.0, stop = {20.0 + step * (per_sweep - 1):.9f}, "
            f"step = {step:.9f} }}"
        ]
    if shuffled:
        text += ["[order]", 'kind = "random"', "seed = 1"]
    return parse_plan("\n".join(text))


def header_of(plan: Plan) -> ScanHeader:
    m = len(plan.wavelength_nm)
    detectors = (DetectorFacts("pmt", "PMT", 200.0, 860.0), DetectorFacts("ingaas", "InGaAs", 860.0, 1600.0))
    rig = RigFacts("large", 26.0, 18.0, 95.2353, 90.0, 180.0, 0.0, 90.0, detectors)
    index = (plan.wavelength_nm >= 860.0).astype(np.uint8)
    return ScanHeader(
        plan.to_toml(),
        'name = "large"\n',
        rig,
        index,
        {"stage": "none"},
        "benchmark",
        "2026-01-01T00:00:00+00:00",
        0.0,
        plan.wavelength_nm if m else None,
    )


def reference(
    kind: str, when: str, polarization: str, t_s: float, m: int, rng: np.random.Generator
) -> ReferenceRecord:
    signal = (1e-4 if kind == "dark" else 1.0) + 1e-6 * rng.standard_normal(m)
    return ReferenceRecord(
        kind, when, polarization, 90.0, 180.0, 4, t_s, np.arange(m) + 300.0, signal, np.full(m, 1e-6),
        t_s + 0.01 * np.arange(m), np.zeros(m, dtype=np.uint16),
    )  # type: ignore[arg-type]  # fmt: skip


class Clock:
    """Seconds spent in a function since last asked."""

    def __init__(self, owner: type, *names: str) -> None:
        self._spent_s = 0.0
        for name in names:
            original = getattr(owner, name)

            def timed(*args: object, original: object = original) -> object:
                began = time.perf_counter()
                try:
                    return original(*args)  # type: ignore[operator]
                finally:
                    self._spent_s += time.perf_counter() - began

            setattr(owner, name, timed)

    def take(self) -> float:
        """Return them, and begin anew."""
        spent_s, self._spent_s = self._spent_s, 0.0
        return spent_s


def memory_mb() -> float:
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--positions", type=int, default=50_000, metavar="N")
    parser.add_argument("--wavelengths", type=int, default=121, metavar="M")
    parser.add_argument("--random", action="store_true", help="positions in random order")
    parser.add_argument("--no-sync", action="store_true", help="do not wait for the disk")
    parser.add_argument("--folder", type=Path, default=Path(), metavar="DIR")
    options = parser.parse_args()
    free = shutil.disk_usage(options.folder).free
    needed = options.positions * options.wavelengths * BYTES_A_READING
    if needed > 0.9 * free:
        print(
            f"{needed / 1e9:.1f} GB are needed and {free / 1e9:.1f} GB free; take fewer --positions",
            file=sys.stderr,
        )
        return 1
    if options.no_sync:
        journal._sync = lambda _descriptor: None
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        return measure(
            Path(name) / "large.h5", options.positions, options.wavelengths, shuffled=options.random
        )


def measure(path: Path, n: int, m: int, *, shuffled: bool) -> int:
    began = time.perf_counter()
    plan = plan_of(n, m, shuffled=shuffled)
    positions = plan.positions()
    n = len(positions)
    print(
        f"plan of {n} positions x {m} wavelengths: {time.perf_counter() - began:.1f} s, {memory_mb():.0f} MB"
    )
    began = time.perf_counter()
    session = Session.begin(path, header_of(plan), plan)
    print(
        f"empty file: {time.perf_counter() - began:.1f} s, {path.stat().st_size / 1e6:.1f} MB, "
        f"{memory_mb():.0f} MB of memory"
    )
    in_journal = (
        Clock(journal.Journal, "append", "write", "confirm")
        if hasattr(journal.Journal, "confirm")
        else Clock(journal.Journal, "append")
    )
    in_rows, in_flush = Clock(ScanFile, "add_positions", "add_reference"), Clock(ScanFile, "flush")
    rng = np.random.default_rng(1)
    block = rng.random((64, m))
    quality = np.zeros(m, dtype=np.uint16)
    none = np.full(m, np.nan)
    print(
        f"{'positions':>10}{'ms each':>9}{'journal':>9}{'rows':>7}{'flush':>7}{'memory MB':>11}{'h5 B':>8}"
        f"{'journal B':>11}"
    )
    costs, memories = [], []
    marks = np.linspace(0, n, 11).astype(int)
    for low, high in zip(marks[:-1].tolist(), marks[1:].tolist(), strict=True):
        before_s = time.perf_counter()
        for i in range(low, high):
            t_s = 1.0 * i * m
            if i % EVERY == 0:
                when = f"before {i}" if i else "start"
                session.record(reference("dark", when, "any", t_s - 0.9 * m, m, rng))
                for k, polarization in enumerate("sp"):
                    session.record(
                        reference("baseline", when, polarization, t_s - (0.6 - 0.3 * k) * m, m, rng)
                    )
            p = positions[i]
            session.record(
                PositionRecord(
                    i,
                    p.polarization,
                    p.theta_i_deg,
                    p.theta_mes_deg,
                    0.0,
                    1,
                    t_s,
                    plan.wavelength_nm,
                    block[i % 64],
                    none,
                    t_s + 0.01 * np.arange(m),
                    quality,
                )
            )
        each_ms = 1e3 * (time.perf_counter() - before_s) / (high - low)
        parts = [1e3 * clock.take() / (high - low) for clock in (in_journal, in_rows, in_flush)]
        costs.append(each_ms)
        memories.append(memory_mb())
        print(
            f"{high:>10}{each_ms:>9.2f}{parts[0]:>9.2f}{parts[1]:>7.2f}{parts[2]:>7.2f}{memories[-1]:>11.0f}"
            f"{path.stat().st_size / high:>8.0f}{journal.journal_path(path).stat().st_size / high:>11.0f}",
            flush=True,
        )
    for k, (kind, polarization) in enumerate((("dark", "any"), ("baseline", "s"), ("baseline", "p"))):
        session.record(reference(kind, "end", polarization, 1.0 * n * m + k * m, m, rng))
    began = time.perf_counter()
    session.finish("2026-01-02T00:00:00+00:00")
    finish_s = time.perf_counter() - began
    print(
        f"correction with all references and end: {finish_s:.1f} s, {1e3 * finish_s / n:.3f} ms each, "
        f"{memory_mb():.0f} MB"
    )
    print(
        f"second tenth {costs[1]:.2f} ms and {memories[1]:.0f} MB, last {costs[-1]:.2f} ms and "
        f"{memories[-1]:.0f} MB"
    )
    if n * m < 2e7:
        began = time.perf_counter()
        scan = load(path)
        assert scan.finished
        assert len(scan.position) == n
        print(f"gonio.load: {time.perf_counter() - began:.1f} s")
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())

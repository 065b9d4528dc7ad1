"""What does another process see of a scan that is being written as fast as the disk allows?

One process writes positions of 121 wavelengths through `Session`, this one reads again and again: by
`gonio.load` (the journal), and by h5py without the lock, as other programs may.  Each read is compared with
what was measured: rows whose angle is there must hold its signal.

Run: python benchmarks/store_live.py [--positions N]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import h5py
import numpy as np
from store_large import header_of, plan_of, reference

import gonio
from gonio.acquire.session import Session
from gonio.errors import StoreError
from gonio.store.records import PositionRecord


def write(path: Path, n: int) -> None:
    """Write a scan without measuring anything."""
    plan = plan_of(n, 121, shuffled=False)
    session = Session.begin(path, header_of(plan), plan)
    rng = np.random.default_rng(1)
    for k, (kind, polarization) in enumerate((("dark", "any"), ("baseline", "s"), ("baseline", "p"))):
        session.record(reference(kind, "start", polarization, float(k), 121, rng))
    quality, none = np.zeros(121, dtype=np.uint16), np.full(121, np.nan)
    for p in plan.positions():
        time_s = 10.0 + p.index + 0.001 * np.arange(121)
        signal = p.index + 0.001 * np.arange(121.0)
        session.record(
            PositionRecord(
                p.index, p.polarization, p.theta_i_deg, p.theta_mes_deg, 0.0, 1, 0.0,
                plan.wavelength_nm, signal, none, time_s, quality,
            )
        )  # fmt: skip
    session.finish("2026-01-02T00:00:00+00:00")


def unlocked(path: Path) -> str:
    """Read the file without the lock and say what came of it."""
    try:
        with h5py.File(path, "r", locking=False) as file:
            there = np.flatnonzero(np.isfinite(file["entry/data/theta_i"][...]))
            raw = file["entry/data/raw_signal"][...][there]
    except (OSError, KeyError, RuntimeError) as error:
        return f"failed: {error}"[:70]
    whole = np.array_equal(raw, there[:, None] + 0.001 * np.arange(121.0))
    return "whole" if whole else "a row half written"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--positions", type=int, default=3000, metavar="N")
    parser.add_argument("--write", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.write is not None:
        write(options.write, options.positions)
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "live.h5"
        command = [sys.executable, __file__, "--positions", str(options.positions), "--write", str(path)]
        writer = subprocess.Popen(command)
        loads: Counter[str] = Counter()
        plain: Counter[str] = Counter()
        longest_s, most = 0.0, 0
        while writer.poll() is None:
            began = time.perf_counter()
            try:
                scan = gonio.load(path)
                expected = scan.position[:, None] + 0.001 * np.arange(121.0)
                right = np.array_equal(scan.raw_signal_v, expected) and np.all(np.diff(scan.position) == 1)
                loads["whole" if right else "wrong"] += 1
                if len(scan.position) >= most and not scan.finished:
                    longest_s, most = time.perf_counter() - began, len(scan.position)
            except StoreError as error:
                loads[str(error).partition(": ")[2][:60]] += 1
            if path.exists():
                for _ in range(20):
                    plain[unlocked(path)] += 1
    print(f"gonio.load: {dict(loads)}; {longest_s:.2f} s for {most} positions")
    print(f"h5py without the lock: {dict(plain)}")


if __name__ == "__main__":
    main()

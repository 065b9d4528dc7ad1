"""What does the runner cost per position, durable, against bluesky's RunEngine that stores nothing?

The paper's plan (292 positions, 121 wavelengths) on devices that answer at once, in rounds that alternate:

record   gonio: journal record confirmed by the disk, reduction, `.h5` rows and flush; the next position
         begins after it
event    bluesky: `create`, `read`, `save` of the same array, its documents kept in memory
step     from one record (or event) to the next, all that a runner does: choose the step, move, wait, read,
         verify, tell; bluesky's is `bp.list_scan` over two axes and a detector
moving   a step with axes that take 20 ms, less the 20 ms: what a scan really waits for its runner.  gonio's
         next motion begins before the record is written
floor    appending the same bytes to a file and waiting for the disk, nothing else

Medians of each round; the table has their median and, as spread, the smallest and largest round.

Run: python benchmarks/acquire.py [FOLDER] [--rounds 5]      (the folder decides which disk is measured)
Other programs that write to the disk are in gonio's figures, and in none of bluesky's.
Exit code 1 if gonio's whole step, durable, is not cheaper than bluesky's.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from killing.lives import memory_rig

from gonio.acquire import Runner
from gonio.acquire.journal import Journal
from gonio.acquire.session import Session
from gonio.devices import SpectrumReading
from gonio.plan import Plan
from gonio.status import ThreadStatus
from gonio.store.file import ScanFile

PLAN = Plan.paper()
N, M = PLAN.n_positions, 121
MOVE_S = 0.02
RECORD_BYTES = M * 34 + 400
Rounds = dict[str, list[float]]


def instant_spectrum(wavelength_nm: Any, now_s: float, beam: str, averages: int) -> SpectrumReading:
    m = len(wavelength_nm)
    level = {"sample": 0.01, "direct": 1.0, "dark": 1e-4}[beam]
    return SpectrumReading(
        wavelength_nm,
        np.full(m, level),
        np.full(m, 1e-5),
        averages,
        np.asarray(now_s + 0.01 * np.arange(m), dtype=np.float64),
        np.zeros(m, dtype=np.uint16),
    )


def bench(move_s: float) -> Any:
    """Return the tests' rig in memory, its spectrum at once and its axes as slow as asked."""
    memory = memory_rig()
    rig = memory.rig()

    class Instant(memory.MemorySpectrometer):  # type: ignore[misc, name-defined]
        def measure_spectrum(
            self, wavelength_nm: Any, _detector: Any, *, beam: str, averages: int, on_reading: Any
        ) -> SpectrumReading:
            self.world.clock.sleep(0.01 * len(wavelength_nm))
            return instant_spectrum(wavelength_nm, self.world.clock.now_s(), beam, averages)

    class Slow(memory.MemoryAxis):  # type: ignore[misc, name-defined]
        def start(self, target_deg: float) -> None:
            self.began_s = time.perf_counter()
            super().start(target_deg)

        def wait(self) -> float:
            while (left_s := self.began_s + move_s - time.perf_counter()) > 0:
                time.sleep(left_s)
            return float(super().wait())

    rig.spectrometer = Instant(rig.spectrometer.world, rig.stage)
    if move_s:
        for name in ("theta_i", "theta_mes"):
            axis = getattr(rig.stage, name)
            setattr(rig.stage, name, Slow(axis.world, axis.name, axis.where_deg, offset_deg=axis.offset_deg))
    return rig


def gonio_steps(folder: Path, rounds: Rounds, *, moving: bool) -> None:
    """Run the plan once; add the medians of this round, milliseconds."""
    spent: dict[str, list[float]] = defaultdict(list)
    owners = (
        (Session, "record"), (Journal, "write"), (Journal, "confirm"),
        (ScanFile, "add_positions"), (ScanFile, "flush"),
    )  # fmt: skip
    originals = {(owner, name): getattr(owner, name) for owner, name in owners}
    for (owner, name), original in originals.items():

        def timed(*args: Any, original: Any = original, into: list[float] = spent[name]) -> Any:
            began = time.perf_counter()
            try:
                return original(*args)
            finally:
                into.append(1e3 * (time.perf_counter() - began))

        setattr(owner, name, timed)
    marks: list[float] = []
    path = folder / "bench.h5"
    try:
        Runner(
            bench(MOVE_S if moving else 0.0),
            PLAN,
            path,
            on_record=lambda _: marks.append(time.perf_counter()),
        ).run()
    finally:
        for (owner, name), original in originals.items():
            setattr(owner, name, original)
    with h5py.File(path) as file:
        assert np.all(np.isfinite(file["entry/data/r"][...]))
    path.unlink()
    step_ms = 1e3 * float(np.median(np.diff(marks)))
    if moving:
        rounds["moving, gonio"].append(step_ms - 1e3 * MOVE_S)
        return
    rounds["step, gonio"].append(step_ms)
    for name, key in (
        ("record", "record, gonio"),
        ("write", "    journal: encode and hand to the system"),
        ("add_positions", "    reduction and rows of the .h5"),
        ("flush", "    flush of the .h5"),
        ("confirm", "    then waiting for the disk"),
    ):
        # each write asks first whether something is still to be confirmed: that is not the wait
        values = spent[name][1::2] if name == "confirm" else spent[name]
        rounds[key].append(float(np.median(values)))


def floor(folder: Path, rounds: Rounds) -> None:
    path = folder / "floor"
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT)
    sync = getattr(os, "fdatasync", os.fsync)
    spent = []
    for _ in range(N):
        began = time.perf_counter()
        os.write(descriptor, bytes(RECORD_BYTES))
        sync(descriptor)
        spent.append(1e3 * (time.perf_counter() - began))
    os.close(descriptor)
    path.unlink()
    rounds["floor: append and wait for the disk"].append(float(np.median(spent)))


class _Device:
    """A detector and an axis for bluesky; the axis takes its time as gonio's does."""

    parent = None

    def __init__(self, name: str, values: Any, move_s: float = 0.0) -> None:
        self.name = name
        self.values = values
        self.move_s = move_s

    def read(self) -> dict[str, Any]:
        return {self.name: {"value": self.values, "timestamp": time.time()}}

    def describe(self) -> dict[str, Any]:
        shape = list(np.shape(self.values))
        return {self.name: {"source": "bench", "dtype": "array" if shape else "number", "shape": shape}}

    def read_configuration(self) -> dict[str, Any]:
        return {}

    def describe_configuration(self) -> dict[str, Any]:
        return {}

    def trigger(self) -> Any:
        return _Done()

    def set(self, value: float) -> Any:
        self.values = value
        return ThreadStatus(lambda: time.sleep(self.move_s), self.name) if self.move_s else _Done()


class _Done:
    """A status that is done at once: no thread."""

    done = success = True

    def add_callback(self, callback: Any) -> None:
        callback(self)

    def exception(self, timeout: float | None = 0.0) -> None:
        return None

    def wait(self, timeout: float | None = None) -> None:
        return None


def bluesky_steps(rounds: Rounds, *, moving: bool) -> None:
    """Run bluesky's own plan over the same positions; then its events alone."""
    import bluesky.plans as bp
    from bluesky import RunEngine
    from bluesky.plan_stubs import close_run, create, open_run, read, save

    detector = _Device("spectrum", np.zeros(M))
    move_s = MOVE_S if moving else 0.0
    theta_i, theta_mes = _Device("theta_i", 0.0, move_s), _Device("theta_mes", 0.0, move_s)
    positions = PLAN.positions()
    documents: list[Any] = []
    marks: list[float] = []

    def keep(name: str, document: Any) -> None:
        documents.append((name, document))
        if name == "event":
            marks.append(time.perf_counter())

    RunEngine({})(
        bp.list_scan(
            [detector],
            theta_i, [p.theta_i_deg + 1e-3 * k for k, p in enumerate(positions)],
            theta_mes, [p.theta_mes_deg + 1e-3 * k for k, p in enumerate(positions)],
        ),
        keep,
    )  # fmt: skip
    step_ms = 1e3 * float(np.median(np.diff(marks)))
    assert len(marks) == N
    if moving:
        rounds["moving, bluesky"].append(step_ms - 1e3 * MOVE_S)
        return
    rounds["step, bluesky"].append(step_ms)
    marks.clear()

    def events() -> Any:
        yield from open_run()
        for _ in range(N):
            yield from create()
            yield from read(detector)
            yield from save()
        yield from close_run()

    RunEngine({})(events(), keep)
    rounds["event, bluesky"].append(1e3 * float(np.median(np.diff(marks))))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", default=".", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    rounds: Rounds = defaultdict(list)
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        for _ in range(options.rounds):
            gonio_steps(Path(name), rounds, moving=False)
            bluesky_steps(rounds, moving=False)
            floor(Path(name), rounds)
            gonio_steps(Path(name), rounds, moving=True)
            bluesky_steps(rounds, moving=True)
    print(f"{'per position, ms':<46}{'median':>8}{'smallest':>10}{'largest':>9}   ({options.rounds} rounds)")
    for label in (
        "record, gonio",
        "    journal: encode and hand to the system",
        "    reduction and rows of the .h5",
        "    flush of the .h5",
        "    then waiting for the disk",
        "event, bluesky",
        "floor: append and wait for the disk",
        "step, gonio",
        "step, bluesky",
        "moving, gonio",
        "moving, bluesky",
    ):
        values = rounds[label]
        print(f"{label:<46}{np.median(values):8.2f}{min(values):10.2f}{max(values):9.2f}")
    for ours, theirs in (("record", "event"), ("step", "step"), ("moving", "moving")):
        ratio = np.array(rounds[f"{ours}, gonio"]) / np.array(rounds[f"{theirs}, bluesky"])
        print(
            f"gonio's {ours} / bluesky's {theirs}: {np.median(ratio):.2f} "
            f"({ratio.min():.2f} to {ratio.max():.2f})"
        )
    return 0 if np.median(rounds["step, gonio"]) < np.median(rounds["step, bluesky"]) else 1


if __name__ == "__main__":
    sys.exit(main())

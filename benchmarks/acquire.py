"""What does the runner cost per position, durable, against bluesky's RunEngine that stores nothing?

The paper's plan (292 positions, 121 wavelengths) on devices that answer at once.  Three figures from one run:

- gonio: everything but the devices, that is journal record confirmed by the disk, reduction, `.h5` rows
and flush; - the floor of it: appending the same bytes to a file and waiting for the disk, nothing else; -
bluesky: one event per position with the same array, documents kept in memory.

Run: python benchmarks/acquire.py [FOLDER]      (the folder decides which disk is measured; the present
one by default)
"""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from gonio.acquire import Runner
from gonio.acquire.journal import Journal
from gonio.acquire.session import Session
from gonio.devices import SpectrumReading
from gonio.plan import Plan
from gonio.store.file import ScanFile

MEMORY_RIG = Path(__file__).parents[1] / "tests" / "core" / "acquire" / "memory_rig.py"


def memory_rig() -> Any:
    spec = importlib.util.spec_from_file_location("memory_rig", MEMORY_RIG)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["memory_rig"] = module
    spec.loader.exec_module(module)
    return module


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


def gonio_ms(folder: Path) -> tuple[dict[str, list[float]], int]:
    """Return per-position milliseconds of the whole and of its parts, and the bytes of one journal record."""
    memory = memory_rig()
    rig = memory.rig()
    spent: dict[str, list[float]] = {"record": [], "journal": [], "rows": [], "flush": []}

    class Instant(memory.MemorySpectrometer):  # type: ignore[misc, name-defined]
        def measure_spectrum(
            self, wavelength_nm: Any, _detector: Any, *, beam: str, averages: int, on_reading: Any
        ) -> SpectrumReading:
            self.world.clock.sleep(0.01 * len(wavelength_nm))
            return instant_spectrum(wavelength_nm, self.world.clock.now_s(), beam, averages)

    rig.spectrometer = Instant(rig.spectrometer.world, rig.stage)
    originals = {}
    for key, owner, name in (
        ("record", Session, "record"),
        ("journal", Journal, "write"),
        ("rows", ScanFile, "add_positions"),
        ("flush", ScanFile, "flush"),
    ):
        original = getattr(owner, name)
        originals[owner, name] = original

        def timed(*args: Any, original: Any = original, into: list[float] = spent[key]) -> Any:
            began = time.perf_counter()
            result = original(*args)
            into.append(1e3 * (time.perf_counter() - began))
            return result

        setattr(owner, name, timed)
    path = folder / "bench.h5"
    began = time.perf_counter()
    Runner(rig, Plan.paper(), path).run()
    spent["whole"] = [1e3 * (time.perf_counter() - began) / Plan.paper().n_positions]
    for (owner, name), original in originals.items():
        setattr(owner, name, original)
    with h5py.File(path) as file:
        assert np.all(np.isfinite(file["entry/data/r"][...]))
    path.unlink()
    return spent, 121 * 34 + 400


def floor_ms(folder: Path, n_bytes: int) -> list[float]:
    path = folder / "floor"
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT)
    sync = getattr(os, "fdatasync", os.fsync)
    spent = []
    for _ in range(292):
        began = time.perf_counter()
        os.write(descriptor, bytes(n_bytes))
        sync(descriptor)
        spent.append(1e3 * (time.perf_counter() - began))
    os.close(descriptor)
    path.unlink()
    return spent


def bluesky_ms() -> float:
    from bluesky import RunEngine
    from bluesky.plan_stubs import close_run, create, open_run, read, save

    values = np.zeros(121)

    class Detector:
        name = "spectrum"
        parent = None

        def read(self) -> dict[str, Any]:
            return {"spectrum": {"value": values, "timestamp": time.time()}}

        def describe(self) -> dict[str, Any]:
            return {"spectrum": {"source": "bench", "dtype": "array", "shape": [121]}}

        def read_configuration(self) -> dict[str, Any]:
            return {}

        def describe_configuration(self) -> dict[str, Any]:
            return {}

    detector = Detector()
    marks: list[float] = []

    def plan() -> Any:
        yield from open_run()
        for _ in range(292):
            yield from create()
            yield from read(detector)
            yield from save()
            marks.append(time.perf_counter())
        yield from close_run()

    documents: list[Any] = []
    RunEngine({})(plan(), lambda name, document: documents.append((name, document)))
    assert sum(name == "event" for name, _ in documents) == 292
    return float(1e3 * np.median(np.diff(marks)))


def main() -> None:
    with tempfile.TemporaryDirectory(dir=sys.argv[1] if len(sys.argv) > 1 else ".") as name:
        folder = Path(name)
        spent, n_bytes = gonio_ms(folder)
        floor = floor_ms(folder, n_bytes)
    print(f"{'per position, ms':<52}{'median':>8}{'90 %':>8}")
    for label, values in (
        ("gonio, durable: journal + reduction + rows + flush", spent["record"]),
        ("    journal record, confirmed by the disk", spent["journal"]),
        ("    reduction and rows of the .h5", spent["rows"]),
        ("    flush of the .h5", spent["flush"]),
        ("floor: append and wait for the disk", floor),
    ):
        print(f"{label:<52}{np.median(values):8.2f}{np.percentile(values, 90):8.2f}")
    print(f"{'gonio, whole run / 292 (start and end included)':<52}{spent['whole'][0]:8.2f}")
    print(f"{'bluesky RunEngine, event kept in memory':<52}{bluesky_ms():8.2f}")


if __name__ == "__main__":
    main()

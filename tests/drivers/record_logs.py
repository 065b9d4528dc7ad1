"""Record `logs/scan-*.log` anew: ``python -m tests.drivers.record_logs`` in the repository's root.

To be done when the drivers ask their devices other things than the recorded ones; `test_replay.py` says so.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from gonio.rig import Rig

from .conftest import STAGES, rig_text, running_bench
from .replaying import LOGS

CLOCK_SPEED = 1000.0  # slow enough that each move is polled some times

SCANS: dict[str, tuple[str, tuple[str, ...]]] = {
    **{kind: (kind, ()) for kind in STAGES},
    # what the drivers survive by themselves, so that the scan goes through
    "zaber-faults": (
        "zaber",
        (
            "split-reply:0.05",
            "doubled-reply@stage:0.05",
            "doubled-reply@monochromator:0.05",
            "dropped-reply@lockin:nth=20",
        ),
    ),
}
"""Kind of stage and faults of each recorded scan."""

RESULT = "# read back: "


def measure(rig: Rig) -> dict[str, Any]:
    """Move, turn and measure over the detector change; return everything that was read back."""
    wavelengths = np.array([840.0, 860.0, 880.0])
    detectors = rig.config.detector_for(wavelengths)
    first = rig.move_to(20.0, 60.0)
    angle = rig.polarizer.select("p")
    sample = rig.spectrometer.measure_spectrum(wavelengths, detectors, averages=2)
    second = rig.move_to(90.0, 180.0)
    direct = rig.spectrometer.measure_spectrum(wavelengths[1:], detectors[1:], beam="direct")
    return {
        "theta_deg": [*first, *second],
        "polarizer_deg": angle,
        "wavelength_nm": [*sample.wavelength_nm, *direct.wavelength_nm],
        "signal_v": [*sample.signal_v, *direct.signal_v],
        "sd_v": list(sample.signal_sd_v),
        "quality": [int(q) for q in (*sample.quality, *direct.quality)],
    }


def recorded(log: Path) -> dict[str, Any]:
    """Return what was read back when a log was recorded."""
    (line,) = (line for line in log.read_text(encoding="utf-8").splitlines() if line.startswith(RESULT))
    result: dict[str, Any] = json.loads(line.removeprefix(RESULT))
    return result


def record(name: str) -> None:
    """Record one of `SCANS`."""
    log = LOGS / f"scan-{name}.log"
    log.unlink(missing_ok=True)
    kind, faults = SCANS[name]
    text = rig_text(stage=STAGES[kind], clock_speed=CLOCK_SPEED)
    with (
        tempfile.TemporaryDirectory() as folder,
        running_bench(Path(folder), text, *(f"--fault={fault}" for fault in faults)) as bench,
        bench.open(wire_log=log) as rig,
    ):
        result = measure(rig)
    with log.open("a", encoding="utf-8") as file:
        file.write(RESULT + json.dumps(result) + "\n")


if __name__ == "__main__":
    for scan in SCANS:
        record(scan)

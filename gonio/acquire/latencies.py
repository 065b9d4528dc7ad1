"""What an exchange with each device, and a record on the disk, really takes: the rig's ``[latency]``,
measured.

Nothing is moved but the monochromator and its shutter.  The passes are those of a scan over the sample, so
that all that a reading costs besides settling and averaging is in the figures: the wire, the device's own
delay (on a simulated bench what it takes to compute the light), this program, and how late this computer
wakes up.
"""

from __future__ import annotations

import itertools
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import gonio
from gonio.acquire.session import Session, facts_of
from gonio.devices import SpectrumReading
from gonio.latency import LatencyConfig
from gonio.plan.channels import Channels, channels
from gonio.plan.model import Plan
from gonio.rig import Rig
from gonio.store.records import PositionRecord, ScanHeader

_QUERIES = 40
_PASSES = 3
_LONGEST_S = 15.0  # real seconds for one pass, at most
_RECORDS = 20
_BESIDE_NM = 0.01


def measured_latency(rig: Rig, plan: Plan, folder: Path) -> LatencyConfig:
    """Return the latencies of a connected rig.

    Parameters
    ----------
    rig
        Its axes stay where they are; the shutter is closed at the end.
    plan
        Which wavelengths are asked for.
    folder
        Where the scan will be written; a small file is made there and removed.
    """
    stage_s = _typical_s(rig.stage.theta_mes.position_deg, _QUERIES)
    columns = channels(plan, rig.config)
    monochromator_s, lockin_s = _spectrometer_s(rig, columns)
    return LatencyConfig(
        stage_s=_rounded(stage_s),
        polarizer_s=_rounded(stage_s),  # a line of the same kind, and it counts once per position
        monochromator_s=_rounded(monochromator_s),
        lockin_s=_rounded(lockin_s),
        record_s=_rounded(_record_s(rig, plan, columns, folder)),
    )


def _spectrometer_s(rig: Rig, columns: Channels) -> tuple[float, float]:
    """Return the real seconds per exchange of monochromator and lock-in.

    Two passes differ in the number of readings, and so in exchanges with the lock-in alone; what is left of
    the first belongs to the monochromator.
    """
    spectrometer, config = rig.spectrometer, rig.config.spectrometer
    speed = rig.clock.speed
    reading_s = config.pass_time(columns.wavelength_nm, columns.detector_index, 1).instrument_s
    most = max(2, int(_LONGEST_S * speed / max(reading_s / len(columns), 1e-9)))
    wavelength_nm, detector_index = columns.wavelength_nm[:most], columns.detector_index[:most]
    ends_nm = np.maximum(
        wavelength_nm, np.array([d.range_nm[1] for d in config.detectors])[detector_index] - 1.0
    )
    after = (float(wavelength_nm[-1]), int(detector_index[-1]))

    beside = itertools.count()

    def one_pass(averages: int) -> Callable[[], SpectrumReading]:
        # Each pass a little beside the one before: a simulated bench has to compute its light anew, as it
        # must at every new position of a scan.
        return lambda: spectrometer.measure_spectrum(
            np.clip(wavelength_nm + _BESIDE_NM * next(beside), None, ends_nm),
            detector_index,
            averages=averages,
        )

    one_pass(1)()  # finds the amplifier's ranges, and where everything stands
    left: dict[int, float] = {}
    counts: dict[int, dict[str, float]] = {}
    for averages in (1, 3):
        # as for a beam of known brightness: in passes over the same spot the range stays, once it is found
        expected = config.pass_time(wavelength_nm, detector_index, averages, beam="direct", after=after)
        counts[averages] = dict(expected.exchanges)
        left[averages] = max(0.0, _typical_s(one_pass(averages), _PASSES) - expected.instrument_s / speed)
    spectrometer.close_shutter()
    more = counts[3].get("lockin", 0.0) - counts[1].get("lockin", 0.0)
    if not more:
        return 0.0, 0.0  # a driver that counts no exchanges: its `pass_time` has to know
    lockin_s = max(0.0, (left[3] - left[1]) / more)
    rest_s = left[1] - lockin_s * counts[1].get("lockin", 0.0)
    return max(0.0, rest_s / max(counts[1].get("monochromator", 0.0), 1.0)), lockin_s


def _record_s(rig: Rig, plan: Plan, columns: Channels, folder: Path) -> float:
    """Return the real seconds until a record is safe, from a scan that measures nothing."""
    header = ScanHeader(
        plan_text=plan.to_toml(), rig_text="", rig=facts_of(rig.config),
        detector_index=columns.detector_index, wavelength_nm=columns.wavelength_nm,
        devices={}, program=f"gonio {gonio.__version__}", start_time="", unix_s=0.0,
    )  # fmt: skip
    nothing = np.zeros(len(columns))
    with tempfile.TemporaryDirectory(prefix=".gonio-latency-", dir=folder) as there:
        session = Session.begin(Path(there) / "latency.h5", header, plan)
        try:
            times: list[float] = []
            for index in range(min(_RECORDS, plan.n_positions)):
                record = PositionRecord(
                    index, "s", 0.0, 0.0, 0.0, 1, 0.0, nothing, nothing, nothing, nothing,
                    np.zeros(len(columns), dtype=np.uint16),
                )  # fmt: skip
                begin_s = time.perf_counter()
                session.record(record)
                times.append(time.perf_counter() - begin_s)
        finally:
            session.close()
    return statistics.fmean(times)


def _typical_s(action: Callable[[], object], repeats: int) -> float:
    """Return the mean duration without the slowest tenth: now and then the system does something else."""
    times: list[float] = []
    for _ in range(repeats):
        begin_s = time.perf_counter()
        action()
        times.append(time.perf_counter() - begin_s)
    kept = sorted(times)[: max(1, len(times) - len(times) // 10)]
    return statistics.fmean(kept)


def _rounded(seconds: float) -> float:
    """Return three digits, which is more than a second measurement would confirm."""
    return float(f"{seconds:.3g}")

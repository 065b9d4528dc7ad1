"""Each fault that a simulator can inject, at each device: the data are right, or a message says what failed.

A bench without noise serves a small scan while one fault strikes it again and again.  What the scan stores is
compared with the bench's own truth at the stored angles.  A fault that cannot be overcome must end the scan
with a message that names the device and a remedy, and the file must then hold nothing wrong.
`benchmarks/soak.py` mixes them all for a week.
"""

from __future__ import annotations

import re
import time
import tomllib
from pathlib import Path

import h5py
import numpy as np
import pytest

import gonio
from gonio.acquire import FaultPolicy, Runner, resume_scan
from gonio.acquire.journal import journal_path
from gonio.errors import DeviceError
from gonio.plan import parse_plan
from gonio.rig import open_rig
from gonio_simulators.bench.config import BenchConfig
from gonio_simulators.bench.scattering import Scattering
from gonio_simulators.faults import read_fault_log
from gonio_simulators.faults.catalogue import CATALOGUE

from ..drivers.conftest import STAGES, rig_text, running_bench

PLAN = parse_plan("""
title = "small"
[[wavelengths]]
start_nm = 650.0
stop_nm = 890.0
step_nm = 60.0
[[sweeps]]
theta_i_deg = 30.0
theta_mes_deg = [60.0, 100.0]
""")

LINES = ("stage", "polarizer", "monochromator", "lockin")
UNSEEN = {
    "lamp-drift",
    "lamp-out",
    "detector-change",
}
"""No device knows of these; the references before and after tell, see docs/decisions/drift.md."""

# name, target, when and how, kind of stage
CASES: list[tuple[str, str, str, str]] = []
ON_A_LINE = {
    "slow-reply": ":delay_s=0.03",
    "dropped-reply": "",
    "late-reply": "",
    "dropped-request": "",
    "hang": ":hang_s=0.25",
    "garbage": "",
    "corrupt-reply": "",
    "corrupt-request": "",
    "split-reply": ":gap_s=0.001",
    "doubled-reply": "",
    "disconnect": ":refuse_s=0.1",
}
EVERY = {"stage": 41, "polarizer": 8, "monochromator": 41, "lockin": 41}  # the polarizer is asked little
for name, keys in ON_A_LINE.items():
    CASES += [(name, role, f"every={EVERY[role]}{keys}", "zaber") for role in LINES]
    CASES += [(name, "stage", f"every=41{keys}", stage) for stage in ("modbus-rtu", "modbus-tcp")]
for name in ("echo-missing", "echo-doubled"):
    CASES += [(name, "monochromator", "every=23", "zaber")]
for name in ("alarm", "limit", "stall", "knob"):
    CASES += [(name, "stage", "every=5", stage) for stage in STAGES]
CASES += [("stall", "polarizer", "every=3", "zaber"), ("alarm", "polarizer", "every=3", "zaber")]
CASES += [("knob", "stage", "every=5:moving=true", stage) for stage in STAGES]
CASES += [("knob", "stage", "every=5:by=push", "zaber")]
CASES += [("stall", "stage", "every=5:silent=true", "zaber")]  # its encoder knows
CASES += [("power-cycle", role, f"every={EVERY[role] + 4}:boot_s=0.15", "zaber") for role in LINES]
CASES += [("power-cycle", "stage", "every=45:boot_s=0.15", stage) for stage in ("modbus-rtu", "modbus-tcp")]
CASES += [("detector-saturated", "pmt", "every=11:hold_s=1.0", "zaber")]
CASES += [("lockin-overload", "lockin", f"every=5:at={at}", "zaber") for at in ("input", "output")]
CASES += [(f"{what}-stuck", "monochromator", "every=3", "zaber") for what in ("filter", "grating", "shutter")]
CASES += [("wavelength-stuck", "monochromator", "every=7", "zaber")]


def test_every_fault_is_here() -> None:
    assert {name for name, *_ in CASES} | UNSEEN == set(CATALOGUE)


@pytest.fixture(scope="module")
def scattering() -> Scattering:
    return Scattering(BenchConfig.from_tables(tomllib.loads(quiet("zaber"))))


def quiet(stage: str, fault: str | None = None) -> str:
    """Return the rig without noise, with short timeouts, and with a fault."""
    text = rig_text(clock_speed=4000.0, stage=STAGES[stage])
    text = re.sub(r"(lamp_drift_per_hour|flicker|shot_at_full|floor) = \S+", r"\1 = 0.0", text)
    if fault is not None:
        text = re.sub(r"seed = (\d+)", rf"seed = \1\nfaults = ['{fault}']", text)
    return text.replace("[aperture]", "[wire]\nreply_timeout_s = 0.1\n\n[aperture]", 1)


def measured(config: object, path: Path) -> DeviceError | None:
    """Scan as an operator would: connect anew a few times if need be; return what it ended with."""
    policy = FaultPolicy(retries=4, first_wait_s=0.02)
    failure: DeviceError | None = None
    for _ in range(4):
        try:
            with open_rig(config) as rig:  # type: ignore[arg-type]
                if journal_path(path).exists():
                    resume_scan(path, rig, policy=policy).run()
                else:
                    Runner(rig, PLAN, path, policy=policy).run()
            return None
        except DeviceError as error:
            failure = error
            time.sleep(0.15)  # an operator is no faster
    return failure


def has_positions(path: Path) -> bool:
    """Say whether anything was measured before the scan ended."""
    if not path.exists():
        return False
    with h5py.File(path) as file:
        return bool(np.isfinite(file["entry/data/theta_i"][...]).any())


@pytest.mark.parametrize(
    ("name", "target", "when", "stage"), CASES, ids=[f"{n}-{t}-{s}-{w}" for n, t, w, s in CASES]
)
def test_right_or_told(
    tmp_path: Path, scattering: Scattering, name: str, target: str, when: str, stage: str
) -> None:
    log, path = tmp_path / "faults.log", tmp_path / "scan.h5"
    with running_bench(tmp_path, quiet(stage, f"{name}@{target}:{when}"), "--fault-log", str(log)) as bench:
        failure = measured(bench.config, path)
    assert {injected.name for injected in read_fault_log(log)} == {name}, "it never struck"
    if failure is not None:
        assert failure.device
        assert failure.fault
        assert failure.remedy
    else:
        assert gonio.load(path).position.tolist() == list(range(PLAN.n_positions))
    if failure is not None and not has_positions(path):
        return
    scan = gonio.load(path)
    planned = {p.index: p for p in PLAN.positions()}
    for row, index in enumerate(scan.position.tolist()):
        at = planned[index]
        assert scan.theta_i_deg[row] == pytest.approx(at.theta_i_deg, abs=0.011)
        assert scan.theta_mes_deg[row] == pytest.approx(at.theta_mes_deg, abs=0.011)
        assert scan.polarization[row] == at.polarization
        usable = scan.usable[row]
        truth = [
            scattering.r(
                float(scan.theta_i_deg[row]),
                float(scan.theta_mes_deg[row]),
                float(at.polarization == "s"),
                nm,
            )
            for nm in scan.wavelength_nm.tolist()
        ]
        np.testing.assert_allclose(scan.r[row][usable], np.array(truth)[usable], rtol=2e-3, atol=2e-6)

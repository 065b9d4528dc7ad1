"""A scan on benches made of devices that others wrote: the numbers are those of the bench's own truth."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

import gonio
from gonio.acquire import Runner
from gonio.plan import parse_plan
from gonio.rig import open_rig

from .applied_motion_servo import ServoLine
from .bench import ForeignBench, reflectance
from .cornerstone import Cornerstone
from .elliptec_bus import ElliptecBus
from .lockin import ForeignLockin
from .rigs import SERVO_STAGE, ZABER_STAGE, foreign_rig
from .wires import served
from .zaber_controller import ZaberController

PLAN = """
title = "Foreign"
polarization = ["s", "p"]
[sample]
name = "linear"
[[wavelengths]]
start_nm = 370.0
stop_nm = 870.0
step_nm = 500.0
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = [30.0, 120.0]
[references]
dark = ["start"]
baseline = ["start"]
"""


def bench_of_one_vendor_each(bench):
    return ZABER_STAGE, {
        "stage": ZaberController(bench),
        "polarizer": ElliptecBus(bench),
        "monochromator": Cornerstone(bench, echo=False, manner="early", wave=" {:.2f}"),
        "lockin": ForeignLockin(bench, unlocked_s=0.1),
    }


def bench_in_a_bad_mood(bench):
    return SERVO_STAGE, {
        "stage": ServoLine(bench, has_function_16=False, big=False, write_s=0.003),
        "polarizer": ElliptecBus(bench, ends_with_status=True, pulses_told=398),
        "monochromator": Cornerstone(bench, echo_end=b"\r", shutter=("closed", "open"), has_units=False),
        "lockin": ForeignLockin(bench, end=b"\r\n"),
    }


@pytest.mark.parametrize("make", [bench_of_one_vendor_each, bench_in_a_bad_mood])
def test_a_scan_with_foreign_devices_only(tmp_path, make):
    bench = ForeignBench()
    stage, devices = make(bench)
    with contextlib.ExitStack() as stack:
        addresses = {role: stack.enter_context(served(d, chunk=7)) for role, d in devices.items()}
        rig = stack.enter_context(open_rig(foreign_rig(stage, addresses, word_order="little")))
        path = Runner(rig, parse_plan(PLAN), tmp_path / "scan.h5").run()
    scan = gonio.load(path)
    truth = [
        reflectance(i, mes, pol)
        for i, mes, pol in zip(scan.theta_i_deg, scan.theta_mes_deg, scan.polarization, strict=True)
    ]
    assert scan.r.shape == (4, 2)
    assert scan.usable.all()
    np.testing.assert_allclose(scan.r, np.array(truth)[:, None] * np.ones(2), rtol=5e-4)
    assert scan.theta_mes_deg == pytest.approx([30.0, 120.0] * 2, abs=0.01)

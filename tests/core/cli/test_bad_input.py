"""Bad input: one clear message, exit code 1, nothing half-written."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from gonio.rig import default_rig_text

from .conftest import gonio

PLAN = """
title = "Two positions"
polarization = ["s"]
[sample]
name = "x"
[[wavelengths]]
start_nm = 500.0
stop_nm = 510.0
step_nm = 10.0
[[sweeps]]
theta_i_deg = 30.0
theta_mes_deg = [60.0, 63.0]
[references]
dark = ["start"]
baseline = ["start"]
averages = 2
"""


def edited(old: str, new: str, text: str = PLAN) -> str:
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("plan", "expected"),
    [
        (edited("theta_i_deg = 30.0", "theta_i_rad = 0.5"), ["theta_i_rad", "did you mean 'theta_i_deg'"]),
        (edited("60.0, 63.0", "12.0, 63.0"), ["theta_mes = 12 deg", "blind zone", "15"]),
        (edited("60.0, 63.0", "60.0, 200.0"), ["theta_mes = 200 deg", "180"]),
        (edited("theta_i_deg = 30.0", "theta_i_deg = 120.0"), ["theta_i_deg = 120.0", "90"]),
        (edited("stop_nm = 510.0", "stop_nm = 2500.0"), ["no detector"]),
        (edited("step_nm = 10.0", "step_nm = 0.0"), ["step_nm"]),
        (edited("start_nm = 500.0", 'start_nm = "500"'), ["start_nm"]),
        (edited('polarization = ["s"]', 'polarization = ["q"]'), ["polarization"]),
        ("title = \n", ["line 1"]),
        ("", ["missing"]),
    ],
)
def test_a_bad_plan_is_refused_before_anything_is_written(
    tmp_path: Path, plan: str, expected: list[str]
) -> None:
    (tmp_path / "plan.toml").write_text(plan)
    for command in (["plan", "plan.toml"], ["scan", "plan.toml", "-o", "out.h5"]):
        outcome = gonio(*command, cwd=tmp_path)
        assert outcome.code == 1
        for part in expected:
            assert part in outcome.err
    assert {path.name for path in tmp_path.iterdir()} == {"plan.toml"}


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("width_mm = 26.0 ", "width_cm = 2.6 ", ["aperture.width_cm", "did you mean 'width_mm'"]),
        ("height_mm = 18.0", "height_mm = -18.0", ["aperture.height_mm", "-18"]),
        ('driver = "zaber"', 'driver = "zabber"', ["zabber", "zaber"]),
        ("limits_deg = [0.0, 95.0]", "limits_deg = [95.0, 0.0]", ["stage.theta_i", "limits_deg"]),
        ("rho_s = 1.0", "rho_z = 1.0", ["rho_z", "rho_s"]),
        ("clock_speed = 4000.0", 'clock_speed = "fast"', ["clock_speed"]),
    ],
)
def test_a_bad_rig_is_refused(tmp_path: Path, old: str, new: str, expected: list[str]) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "rig.toml").write_text(edited(old, new, default_rig_text()))
    outcome = gonio("scan", "plan.toml", "--rig", "rig.toml", "-o", "out.h5", cwd=tmp_path)
    assert outcome.code == 1
    for part in expected:
        assert part in outcome.err
    assert {path.name for path in tmp_path.iterdir()} == {"plan.toml", "rig.toml"}


def test_an_unreachable_port_is_named(tmp_path: Path) -> None:
    with socket.socket() as probe:  # a port where nobody listens
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    (tmp_path / "plan.toml").write_text(PLAN)
    text = edited('address = "simulated"', f'address = "socket://127.0.0.1:{port}"', default_rig_text())
    (tmp_path / "rig.toml").write_text(text)
    for command in (["scan", "plan.toml", "-o", "out.h5"], ["devices"]):
        outcome = gonio(*command, "--rig", "rig.toml", cwd=tmp_path)
        assert outcome.code == 1
        assert f"127.0.0.1:{port}" in outcome.err
    assert not (tmp_path / "out.h5").exists()


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "out.h5").write_bytes(b"precious")
    outcome = gonio("scan", "plan.toml", "-o", "out.h5", cwd=tmp_path)
    assert outcome.code == 1
    assert "exists already" in outcome.err
    assert (tmp_path / "out.h5").read_bytes() == b"precious"


@pytest.mark.parametrize("command", [["fit"], ["report"], ["scan", "--resume"]])
@pytest.mark.parametrize("content", [None, b"", b"not hdf5 at all"])
def test_a_file_that_is_no_scan(tmp_path: Path, command: list[str], content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "x.h5").write_bytes(content)
    outcome = gonio(*command, "x.h5", cwd=tmp_path)
    assert outcome.code == 1
    assert "x.h5" in outcome.err


@pytest.mark.parametrize(
    "arguments", [[], ["scan"], ["scan", "p.toml"], ["frobnicate"], ["fit", "x.h5", "--aperture", "round"]]
)
def test_bad_usage_is_exit_code_two(tmp_path: Path, arguments: list[str]) -> None:
    assert gonio(*arguments, cwd=tmp_path).code == 2

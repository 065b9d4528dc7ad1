"""The scripts of `examples/` run as a lab runs them, on the simulated bench."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import gonio
from gonio.plan import load_plan, timetable
from gonio.plan.timetable import PlannedReference
from gonio.rig import load_rig

EXAMPLES = Path(__file__).parents[3] / "examples"

PLAN = """
[[wavelengths]]
values_nm = [500.0, 600.0]
[[sweeps]]
theta_i_deg = 30.0
theta_mes_deg = [40.0, 50.0, 56.0, 60.0, 64.0, 70.0]
[references]
averages = 2
"""


def run(script: str, *arguments: str, cwd: Path) -> str:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / script), *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_headless_scan(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN, encoding="utf-8")
    out = run("headless_scan.py", "plan.toml", "-", "white", cwd=tmp_path)
    assert "rho_d" in out
    scan = gonio.load(tmp_path / "white.h5")
    assert scan.finished
    assert scan.sample_name == "white"
    assert len(scan.position) == 12


def test_coarse_then_fine(tmp_path: Path) -> None:
    out = run("coarse_then_fine.py", "-", "panel", cwd=tmp_path)
    assert "the lobe is near theta_mes = 90.0 deg" in out
    fine = gonio.load(tmp_path / "panel-fine.h5")
    assert fine.theta_mes_deg.min() == pytest.approx(81.0, abs=0.02)
    assert fine.theta_mes_deg.max() == pytest.approx(99.0, abs=0.02)
    assert np.all(np.isfinite(fine.r))


def test_a_source_refines_around_the_lobe_and_goes_on_where_it_was_killed(tmp_path: Path) -> None:
    out = run("refine_the_lobe.py", "-", "panel", cwd=tmp_path)
    scan = gonio.load(tmp_path / "panel.h5")
    assert f"{scan.n_planned} positions of at most 37" in out
    coarse, fine = np.sort(scan.theta_mes_deg[:13]), scan.theta_mes_deg[13:]
    np.testing.assert_allclose(np.diff(coarse), 9.0, atol=0.05)
    assert 6 <= len(fine) < 24
    assert np.all(np.abs(fine - 90.0) < 30.0), "r is steep about the specular direction only"
    peak = scan.theta_mes_deg[np.argmax(scan.r[:, 0])]
    assert peak == pytest.approx(90.0, abs=3.1)

    (tmp_path / "again").mkdir()
    with subprocess.Popen(
        [sys.executable, str(EXAMPLES / "refine_the_lobe.py"), "-", "panel"], cwd=tmp_path / "again"
    ) as process:
        journal = tmp_path / "again" / "panel.h5.journal"
        while process.poll() is None and b'"decision", "index": 8' not in read(journal):
            time.sleep(0.002)
        process.kill()
    assert journal.exists(), "it was over before it was killed"
    run("refine_the_lobe.py", "-", "panel", cwd=tmp_path / "again")
    again = gonio.load(tmp_path / "again" / "panel.h5")
    assert again.finished
    np.testing.assert_allclose(again.theta_mes_deg[:13], scan.theta_mes_deg[:13], atol=0.05)
    assert 6 <= len(again.position) - 13 < 24


def read(journal: Path) -> bytes:
    try:
        return journal.read_bytes()
    except FileNotFoundError:  # not there yet, or not any more
        return b""


def test_bluesky_session(tmp_path: Path) -> None:
    pytest.importorskip("bluesky", reason="bluesky is not installed")
    out = run("bluesky_session.py", "-", "tile.h5", cwd=tmp_path)
    assert out.count("sample") == 5
    scan = gonio.load(tmp_path / "tile.h5")
    assert scan.sample_name == "tile"
    assert scan.title == "The lobe"
    assert scan.r[2].min() > 1.5 * scan.r[0].max(), "the lobe is at 90 deg"


def test_every_half_hour_there_is_a_reference() -> None:
    table = timetable(load_plan(EXAMPLES / "plans" / "half-hourly.toml"), load_rig())
    ends_s = np.cumsum(table.duration_s)
    dark_s = [
        end_s
        for step, end_s in zip(table.steps, ends_s.tolist(), strict=True)
        if isinstance(step.task, PlannedReference) and step.task.kind == "dark"
    ]
    apart_min = np.diff(dark_s) / 60.0
    assert len(apart_min) > 2
    assert np.all((apart_min[:-1] >= 29.0) & (apart_min[:-1] < 38.0))  # they take five themselves

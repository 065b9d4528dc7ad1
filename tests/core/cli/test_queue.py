"""`gonio queue` as a user runs it, on the simulated bench, and the queue in `examples/`."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path

import pytest

import gonio as package
from gonio.acquire import FaultPolicy
from gonio.bench_process import served
from gonio.cli import main

from .conftest import gonio

EXAMPLES = Path(__file__).parents[3] / "examples"

PLAN = """
[[wavelengths]]
values_nm = [500.0, 600.0]
[[sweeps]]
theta_i_deg = 30.0
theta_mes_deg = [60.0, 63.0]
[references]
averages = 2
"""
QUEUE = """
[[scans]]
sample = "white"
plan = "plan.toml"
output = "white.h5"
[[scans]]
sample = "grey"
plan = "plan.toml"
output = "grey.h5"
"""


def test_checked_refused_without_anybody_run_and_run_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.toml").write_text(PLAN, encoding="utf-8")
    (tmp_path / "queue.toml").write_text(QUEUE, encoding="utf-8")
    queue = str(tmp_path / "queue.toml")
    assert main(["queue", queue, "--check"]) == 0
    checked = capsys.readouterr().out
    assert "2 scans on rig 'arta-simulated'; every position of each is allowed" in checked
    assert not list(tmp_path.glob("*.h5"))
    assert main(["queue", queue]) == 1
    assert "nobody can answer here; run it at a terminal, or give --unattended" in capsys.readouterr().err
    ran = gonio("queue", "queue.toml", "--unattended", cwd=tmp_path)
    assert ran.code == 0, ran.err
    assert "4/4" in ran.out
    assert package.load(tmp_path / "grey.h5").sample_name == "grey"
    assert len(json.loads((tmp_path / "queue-summary.json").read_text())["scans"]) == 2
    before = (tmp_path / "grey.h5").read_bytes()
    assert main(["queue", queue, "--unattended"]) == 0
    assert "begins" not in capsys.readouterr().out
    assert (tmp_path / "grey.h5").read_bytes() == before


def test_a_person_at_the_terminal_is_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    (tmp_path / "plan.toml").write_text(PLAN, encoding="utf-8")
    (tmp_path / "queue.toml").write_text(QUEUE, encoding="utf-8")
    monkeypatch.setattr("sys.stdin", Terminal("s\n"))
    assert main(["queue", str(tmp_path / "queue.toml"), "--on-fault", "abort"]) == 1
    out = capsys.readouterr().out
    assert "put 'grey' in, then press Enter" in out
    assert "skipped" in out
    assert [path.name for path in tmp_path.glob("*.h5")] == ["white.h5"]


def test_a_refused_plan_is_said_with_its_sample(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace("60.0, 63.0", "6.0, 63.0"), encoding="utf-8")
    (tmp_path / "queue.toml").write_text(QUEUE, encoding="utf-8")
    assert main(["queue", str(tmp_path / "queue.toml"), "--unattended"]) == 1
    said = capsys.readouterr().err
    assert "refused: white: position 1 (theta_i = 30 deg, theta_mes = 6 deg, s)" in said
    assert "nothing is measured until they are corrected" in said


def test_the_queue_of_the_examples_passes_its_check(tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "queues", tmp_path / "queues")
    shutil.copytree(EXAMPLES / "plans", tmp_path / "plans")
    assert main(["queue", str(tmp_path / "queues" / "panels.toml"), "--check"]) == 0


def test_the_script_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (EXAMPLES.parent / "docs" / "acquisition.md").read_text(encoding="utf-8")
    code = page.split("```python")[1].split("```")[0]
    (tmp_path / "plan.toml").write_text(PLAN, encoding="utf-8")
    (tmp_path / "queue.toml").write_text(QUEUE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    exec(code, {"gonio": package, "served": served, "FaultPolicy": FaultPolicy})
    assert all(package.load(tmp_path / name).finished for name in ("white.h5", "grey.h5"))

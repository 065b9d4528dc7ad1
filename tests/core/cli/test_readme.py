"""What the README tells a reader to type works."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gonio.cli.main import build_parser

from .conftest import Demo, gonio

ROOT = Path(__file__).parents[3]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_there_are_examples() -> None:
    assert len(BLOCKS) >= 2


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_python_examples(demo: Demo, tmp_path: Path, block: str) -> None:
    shutil.copy(demo.folder / "hpl.h5", tmp_path)
    shutil.copy(ROOT / "examples" / "plans" / "quick.toml", tmp_path / "plan.toml")
    done = subprocess.run(
        [sys.executable, "-c", block], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr


def test_commands_of_the_table_exist() -> None:
    named = set(re.findall(r"`gonio ([a-z]+)", README))
    actions = next(a for a in build_parser()._actions if a.dest == "command")
    assert actions.choices is not None
    assert named <= set(actions.choices)
    assert named >= {"plan", "scan", "fit", "facade", "report", "simulate", "devices", "gui"}


def test_the_examples_are_what_the_demo_runs() -> None:
    for built_in, example in (("hpl.toml", "plans/hpl.toml"), ("street.toml", "scenes/street.toml")):
        texts = [ROOT / "gonio" / "data" / built_in, ROOT / "examples" / example]
        assert texts[0].read_text(encoding="utf-8") == texts[1].read_text(encoding="utf-8")


def test_links_lead_to_files() -> None:
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_headless_example_measures_and_fits(tmp_path: Path) -> None:
    plan = (ROOT / "examples" / "plans" / "quick.toml").read_text(encoding="utf-8")
    (tmp_path / "plan.toml").write_text(plan, encoding="utf-8")
    script = ROOT / "examples" / "headless_scan.py"
    command = [sys.executable, str(script), "plan.toml", "-", "panel-a", "panel-b"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("rho_d") == 2
    again = gonio("fit", "panel-b.h5", "--compare", cwd=tmp_path)
    assert again.code == 0
    assert "exact" in again.out


@pytest.mark.parametrize("rig", ["arta-modbus-rtu.toml", "arta-modbus-tcp.toml"])
def test_the_example_rigs_measure(tmp_path: Path, rig: str) -> None:
    plan = (ROOT / "examples" / "plans" / "quick.toml").read_text(encoding="utf-8")
    (tmp_path / "plan.toml").write_text(
        plan.replace("values_nm = [450.0, 550.0, 650.0]", "values_nm = [550.0]")
    )
    outcome = gonio(
        "scan", "plan.toml", "--rig", ROOT / "examples" / "rigs" / rig, "-o", "x.h5", cwd=tmp_path
    )
    assert outcome.code == 0, outcome.err
    assert gonio("fit", "x.h5", cwd=tmp_path).code == 0

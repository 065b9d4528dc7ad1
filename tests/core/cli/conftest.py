"""One quick demo, run as a user runs it, serves all tests of the command line."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


def gonio(*arguments: object, cwd: Path, timeout_s: float = 120.0) -> Outcome:
    """Run the installed command line in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "gonio.cli", *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return Outcome(done.returncode, done.stdout, done.stderr)


@dataclass(frozen=True)
class Demo:
    folder: Path
    outcome: Outcome


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    folder = tmp_path_factory.mktemp("demo")
    return Demo(folder, gonio("demo", "--quick", "--out", folder, cwd=folder, timeout_s=170))

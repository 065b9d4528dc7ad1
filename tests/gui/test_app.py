"""The entry point: options, what is missing on this machine, and an orderly end from outside."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication

import gonio_gui.app
from gonio.errors import ConfigError
from gonio_gui.app import explain_obstacle, main, needed_packages
from gonio_gui.model import Phase
from gonio_gui.window import MainWindow

BLOCKED = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == {name!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Blocker())
from gonio.cli import main
sys.exit(main(["gui"]))
"""


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize("package", ["PySide6", "pyqtgraph"])
def test_without_its_packages_it_says_how_to_install_them(package: str) -> None:
    done = run_python(BLOCKED.format(name=package))
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert package in done.stderr
    assert f"{sys.executable} -m pip install" in done.stderr
    for requirement in needed_packages():
        assert f'"{requirement}"' in done.stderr


def test_the_command_installs_what_the_extra_declares() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
    declared = [Requirement(text) for text in project["project"]["optional-dependencies"]["gui"]]
    wanted = {(r.name, r.specifier) for r in declared if r.marker is None or r.marker.evaluate()}
    assert {(r.name, r.specifier) for r in map(Requirement, needed_packages())} == wanted


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere there is always a display")
def test_without_a_display_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    assert "no display" in explain_obstacle()
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    assert explain_obstacle() == ""


@pytest.mark.parametrize("option", ["--rig", "--plan"])
def test_a_missing_file_is_refused_before_a_window_opens(option: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no such file"):
        main([option, str(tmp_path / "missing.toml")])


def test_bad_usage() -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["--nonsense"])
    assert exit_.value.code == 2


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGTERM to catch")
def test_sigterm_closes_the_window_and_releases_the_bench(
    qapp: QApplication, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[MainWindow] = []

    class Watched(MainWindow):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            opened.append(self)

    def terminate_when_ready() -> None:
        if opened and opened[0].model.phase is Phase.READY:
            waiting.stop()
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("gonio_gui.window.MainWindow", Watched)
    waiting = QTimer()
    waiting.timeout.connect(terminate_when_ready)
    waiting.start(20)
    before = signal.getsignal(signal.SIGTERM)
    assert gonio_gui.app.main(["-o", str(tmp_path / "x.h5")]) == 0
    assert opened[0].model.phase is Phase.CLOSED
    assert opened[0].bench.join(0.0)
    assert signal.getsignal(signal.SIGTERM) is before
    assert list(tmp_path.iterdir()) == []

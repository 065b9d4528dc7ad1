"""A window on a tiny plan over the real simulated bench, and the care that Qt objects need in tests."""

from __future__ import annotations

import gc
import os
import re

os.environ["QT_QPA_PLATFORM"] = "offscreen"
os.environ["PYQTGRAPH_QT_LIB"] = "PySide6"

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gonio.bench_process import served
from gonio.plan import Plan, parse_plan
from gonio.rig import RigConfig, default_rig_text, load_rig, parse_rig
from gonio_gui.model import Phase
from gonio_gui.window import MainWindow

SCAN_MS = 60_000  # longest wait for the bench, on a busy machine; nothing waits for as long as this

TINY = """
title = "Tiny"
[sample]
name = "tiny sample"
[[wavelengths]]
values_nm = [450.0, 550.0, 900.0]
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = [30.0, 40.0, 50.0, 60.0]
[[sweeps]]
theta_i_deg = 45.0
theta_mes_deg = [60.0, 90.0, 105.0]
[references]
averages = 2
"""


@pytest.fixture(autouse=True)
def _collect_garbage_only_between_tests() -> Iterator[None]:
    """A collection in the bench's thread would destroy Qt objects in the wrong thread."""
    gc.disable()
    yield
    gc.collect()
    gc.enable()


@pytest.fixture
def tiny_plan() -> Plan:
    return parse_plan(TINY)


@pytest.fixture
def long_plan() -> Plan:
    """So many positions that a scan is still running whenever a test looks."""
    return parse_plan(TINY.replace("[30.0, 40.0, 50.0, 60.0]", "{ start = 20.0, stop = 120.0, step = 0.5 }"))


@pytest.fixture
def rig() -> RigConfig:
    return load_rig()


@pytest.fixture
def slow_rig() -> RigConfig:
    """The bench at 4 x, where moves take long enough to be interrupted."""
    return at_speed(4.0)


def at_speed(speed: float) -> RigConfig:
    """The built-in rig with another clock."""
    text, count = re.subn(r"(?m)^clock_speed = \S+", f"clock_speed = {speed}", default_rig_text())
    assert count == 1
    return parse_rig(text)


@pytest.fixture(scope="session")
def running_bench() -> Iterator[RigConfig]:
    """A rig whose simulated bench runs already, for the tests to which its start does not matter."""
    with served(load_rig()) as reachable:
        yield reachable


Opener = Callable[..., MainWindow]


@pytest.fixture
def open_window(qtbot: Any, rig: RigConfig) -> Iterator[Opener]:
    """Open windows, wait until each is connected, and close them in order at the end."""
    windows: list[MainWindow] = []

    def open_one(
        plan: Plan, path: Path, on: RigConfig | None = None, expect: Phase = Phase.READY
    ) -> MainWindow:
        window = MainWindow(on or rig, plan, path)
        windows.append(window)
        window.show()
        wait_for(qtbot, window, expect)
        return window

    yield open_one
    for window in windows:
        window.shut_down()
        wait_for(qtbot, window, Phase.CLOSED)
        window.deleteLater()


def wait_for(qtbot: Any, window: MainWindow, *phases: Phase) -> None:
    """Run the event loop until the window is in one of these phases."""
    qtbot.waitUntil(lambda: window.model.phase in phases, timeout=SCAN_MS)

"""The window on the real simulated bench: every button, over real ports."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import QApplication

import gonio
from gonio.acquire.journal import journal_path
from gonio.plan import Plan
from gonio.rig import RigConfig, default_rig_text, parse_rig
from gonio_gui.model import Phase
from gonio_gui.window import MainWindow

from .conftest import SCAN_MS, Opener, wait_for


def click(qtbot: Any, button: Any) -> None:
    qtbot.mouseClick(button, Qt.MouseButton.LeftButton)


def positions_done(window: MainWindow) -> int:
    return window.model.snapshot.done if window.model.snapshot else 0


def logged(window: MainWindow, text: str) -> bool:
    return any(text in line.text for line in window.model.log)


def draw_all(window: MainWindow) -> None:
    for _ in range(4):  # a tick draws one plot
        window.tick()


class GapWatch:
    """Measures the longest time in which no timer of the event loop ran: how long the window was frozen."""

    def __init__(self) -> None:
        self.longest_s = 0.0
        self._last_s = time.perf_counter()
        self._timer = QTimer()
        self._timer.timeout.connect(self._beat)
        self._timer.start(5)

    def _beat(self) -> None:
        now_s = time.perf_counter()
        self.longest_s = max(self.longest_s, now_s - self._last_s)
        self._last_s = now_s

    def stop(self) -> float:
        self._timer.stop()
        return self.longest_s


def run_to_end(qtbot: Any, window: MainWindow) -> None:
    """Press Start and wait until nothing is measured any more."""
    click(qtbot, window.controls.start)
    assert window.model.phase.busy
    qtbot.waitUntil(lambda: not window.model.phase.busy, timeout=SCAN_MS)


def assert_complete(path: Path, plan: Plan) -> gonio.Scan:
    scan = gonio.load(path)
    assert scan.finished
    assert not journal_path(path).exists()
    assert scan.position.tolist() == list(range(plan.n_positions))
    planned = [(p.theta_i_deg, p.theta_mes_deg, p.polarization) for p in plan.positions()]
    np.testing.assert_allclose(scan.theta_i_deg, [p[0] for p in planned], atol=0.02)
    np.testing.assert_allclose(scan.theta_mes_deg, [p[1] for p in planned], atol=0.02)
    assert scan.polarization.tolist() == [p[2] for p in planned]
    return scan


def test_one_click_runs_the_plan(qtbot: Any, open_window: Opener, tiny_plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "tiny.h5"
    window = open_window(tiny_plan, path)
    assert set(window.model.devices) >= {"stage", "polarizer", "monochromator", "lockin"}
    watch = GapWatch()
    run_to_end(qtbot, window)
    longest_s = watch.stop()
    assert window.model.banner is not None
    assert window.model.banner.level == "info", window.model.banner.text
    scan = assert_complete(path, tiny_plan)
    # the curves on the screen are those in the file, corrected with all references
    draw_all(window)
    for number, theta_i in enumerate((20.0, 45.0)):
        for polarization in ("s", "p"):
            rows = (np.abs(scan.theta_i_deg - theta_i) < 0.1) & (scan.polarization == polarization)
            theta_o, percent = window.plots.polar[polarization].points(number)
            np.testing.assert_allclose(theta_o, scan.theta_o_deg[rows], atol=1e-9)
            np.testing.assert_allclose(percent, 100.0 * scan.r[rows, window.plots.column], rtol=1e-9)
    assert window.plots.spectrum.caption.startswith(f"Spectrum at position {tiny_plan.n_positions}")
    assert window.geometry_view.states()["measured"] == tiny_plan.n_positions
    assert window.controls.bar.value() == window.controls.bar.maximum()
    # a slot that waited for hardware would take a second and more; the figure itself belongs in a benchmark
    assert longest_s < 0.5


def test_live_values_appear_while_it_runs(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, long_plan: Plan, tmp_path: Path
) -> None:
    window = open_window(long_plan, tmp_path / "long.h5", running_bench)
    click(qtbot, window.controls.start)
    qtbot.waitUntil(lambda: window.plots.polar["s"].points(0)[0].size >= 3, timeout=SCAN_MS)
    assert window.model.phase.busy
    assert window.readbacks.values["theta_i"].text() == "20.00°"
    assert window.readbacks.values["polarization"].text() == "S"
    assert "left" in window.controls.time.text()
    assert window.geometry_view.states()["measured"] >= 3
    click(qtbot, window.controls.stop)
    wait_for(qtbot, window, Phase.READY)


def test_pause_is_deferred_and_continues(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, long_plan: Plan, tmp_path: Path
) -> None:
    window = open_window(long_plan, tmp_path / "long.h5", running_bench)
    click(qtbot, window.controls.start)
    wait_for(qtbot, window, Phase.RUNNING)
    qtbot.waitUntil(lambda: positions_done(window) >= 1, timeout=SCAN_MS)
    click(qtbot, window.controls.pause)
    assert window.model.phase is Phase.PAUSING
    wait_for(qtbot, window, Phase.PAUSED)
    done = positions_done(window)
    with h5py.File(tmp_path / "long.h5", "r") as file:  # whole positions only: a pause never cuts one
        measured = np.isfinite(file["entry/data/raw_signal"][...]).all(axis=1)
    assert measured.sum() == done
    assert window.controls.pause.text() == "Continue"
    qtbot.wait(150)
    assert positions_done(window) == done
    click(qtbot, window.controls.pause)
    qtbot.waitUntil(lambda: positions_done(window) > done, timeout=SCAN_MS)
    click(qtbot, window.controls.stop)
    wait_for(qtbot, window, Phase.READY)
    assert logged(window, "shutter closed")


def test_stop_then_resume_finishes_the_same_file(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, tiny_plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "tiny.h5"
    window = open_window(tiny_plan, path, running_bench)
    click(qtbot, window.controls.start)
    qtbot.waitUntil(
        lambda: window.model.live is not None and bool(window.model.live.measured.any()), timeout=SCAN_MS
    )
    window.stop_scan()
    wait_for(qtbot, window, Phase.READY)
    assert window.model.banner is not None
    assert window.model.banner.level == "warning"
    assert journal_path(path).exists()
    assert gonio.load(path).finished is False
    window.tick()
    assert window.controls.start.text() == "Resume scan"
    run_to_end(qtbot, window)
    assert_complete(path, tiny_plan)


def test_stop_motion_stops_a_move_half_way(
    qtbot: Any, open_window: Opener, slow_rig: RigConfig, tiny_plan: Plan, tmp_path: Path
) -> None:
    window = open_window(tiny_plan, tmp_path / "tiny.h5", slow_rig)
    qtbot.waitUntil(lambda: abs(window.model.theta_i_deg) < 0.1, timeout=SCAN_MS)
    click(qtbot, window.controls.start)
    wait_for(qtbot, window, Phase.RUNNING)
    # the sample turns from 0 to 90 deg for the first reference, more than a second at this speed
    qtbot.wait(300)
    assert window.controls.stop_motion.isEnabled()
    qtbot.keyClick(window, Qt.Key.Key_Escape)
    wait_for(qtbot, window, Phase.READY)
    qtbot.waitUntil(lambda: 0.0 < window.model.theta_i_deg < 89.0, timeout=SCAN_MS)
    assert window.model.banner is not None
    assert window.model.banner.level == "warning", window.model.banner.text
    stood_at = window.model.theta_i_deg
    qtbot.wait(1500)  # one more read-back of the axes
    assert window.model.theta_i_deg == pytest.approx(stood_at, abs=1e-6)


def test_stop_motion_works_with_nothing_running_and_nothing_connected(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, tiny_plan: Plan, tmp_path: Path
) -> None:
    window = open_window(tiny_plan, tmp_path / "tiny.h5", running_bench)
    click(qtbot, window.controls.stop_motion)
    qtbot.waitUntil(lambda: logged(window, "all motion stopped"), timeout=SCAN_MS)
    assert window.model.phase is Phase.READY
    nobody = parse_rig(
        default_rig_text().replace('address = "simulated"', 'address = "socket://127.0.0.1:9"')
    )
    window.model.set_rig(nobody)
    window.connect_rig()
    wait_for(qtbot, window, Phase.OFFLINE)
    window.tick()
    assert window.controls.stop_motion.isEnabled()
    assert not window.controls.start.isEnabled()
    click(qtbot, window.controls.stop_motion)
    qtbot.waitUntil(lambda: logged(window, "no motion to stop"), timeout=SCAN_MS)


def test_closing_during_a_scan_asks_and_keeps_it_resumable(
    qtbot: Any,
    open_window: Opener,
    running_bench: RigConfig,
    tiny_plan: Plan,
    long_plan: Plan,
    tmp_path: Path,
) -> None:
    path = tmp_path / "long.h5"
    window = open_window(long_plan, path, running_bench)
    click(qtbot, window.controls.start)
    qtbot.waitUntil(
        lambda: window.model.live is not None and bool(window.model.live.measured.any()), timeout=SCAN_MS
    )
    window.close()
    assert window.isVisible()
    captions = [button.text() for button in window.banner.buttons]
    assert captions == ["Stop and close", "Keep measuring"]
    click(qtbot, window.banner.buttons[1])
    assert window.model.phase is Phase.RUNNING
    assert window.banner.isHidden()
    window.close()
    click(qtbot, window.banner.buttons[0])
    wait_for(qtbot, window, Phase.CLOSED)
    qtbot.waitUntil(lambda: not window.isVisible())
    assert window.bench.join(5.0)
    kept = gonio.load(path)
    assert not kept.finished
    assert len(kept.position) >= 1
    # another window, opened on another plan, goes on with the scan's own
    second = open_window(tiny_plan, path, running_bench)
    second.tick()
    assert second.controls.start.text() == "Resume scan"
    click(qtbot, second.controls.start)
    qtbot.waitUntil(
        lambda: (
            second.model.plan == long_plan
            and second.model.live is not None
            and int(second.model.live.measured.sum()) > len(kept.position)
        ),
        timeout=SCAN_MS,
    )
    assert second.model.live is not None
    shown = second.model.live._r[: len(kept.position)]
    np.testing.assert_allclose(shown, kept.r, rtol=1e-9)  # the earlier part is on the screen again


def test_a_rig_that_does_not_answer_is_explained_and_can_be_tried_again(
    qtbot: Any, open_window: Opener, tiny_plan: Plan, rig: RigConfig, tmp_path: Path
) -> None:
    nobody = parse_rig(
        default_rig_text().replace('address = "simulated"', 'address = "socket://127.0.0.1:9"')
    )
    window = open_window(tiny_plan, tmp_path / "tiny.h5", nobody, Phase.OFFLINE)
    window.tick()
    assert "127.0.0.1:9" in window.banner.label.text()
    assert not window.controls.start.isEnabled()
    assert [button.text() for button in window.banner.buttons] == ["Reconnect"]
    window.model.set_rig(rig)
    click(qtbot, window.banner.buttons[0])
    wait_for(qtbot, window, Phase.READY)
    window.tick()
    assert window.banner.isHidden()
    assert window.controls.start.isEnabled()


def test_files_that_cannot_be_used_are_explained_in_the_window(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, tiny_plan: Plan, tmp_path: Path
) -> None:
    window = open_window(tiny_plan, tmp_path / "tiny.h5", running_bench)
    window.use_rig_file(tmp_path / "missing.toml")
    window.tick()
    assert "missing.toml: there is no such file" in window.banner.label.text()
    bad = tmp_path / "bad.toml"
    text = (
        "[[wavelengths]]\nvalues_nm = [550.0]\n[[sweeps]]\ntheta_i_deg = 20.0\ntheta_mes_deg = [5.0, 30.0]\n"
    )
    bad.write_text(text.replace("20.0", '"20"'))
    window.use_plan_file(bad)
    window.tick()
    assert "theta_i_deg" in window.banner.label.text()
    assert window.model.plan == tiny_plan
    bad.write_text(text)
    window.use_plan_file(bad)
    window.tick()
    assert "blind zone" in window.banner.label.text()
    assert not window.controls.start.isEnabled()
    assert window.geometry_view.states()["refused"] == 2


def test_a_file_that_exists_is_never_written_over(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, tiny_plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "precious.h5"
    path.write_text("precious")
    window = open_window(tiny_plan, path, running_bench)
    run_to_end(qtbot, window)
    assert window.model.banner is not None
    assert window.model.banner.level == "error"
    assert "exists already" in window.model.banner.text
    assert path.read_text() == "precious"


def test_stop_at_once_after_start_is_not_lost(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, long_plan: Plan, tmp_path: Path
) -> None:
    window = open_window(long_plan, tmp_path / "long.h5", running_bench)
    window.start()
    window.stop_scan()
    wait_for(qtbot, window, Phase.READY)
    assert window.model.banner is not None
    assert window.model.banner.level == "warning"
    assert positions_done(window) < long_plan.n_positions


def test_everything_follows_the_palette(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, tiny_plan: Plan, tmp_path: Path
) -> None:
    application = QApplication.instance()
    assert isinstance(application, QApplication)
    usual = application.palette()
    window = open_window(tiny_plan, tmp_path / "tiny.h5", running_bench)
    try:
        for ground, dark in (("#2b2d31", True), ("#efefef", False)):
            application.setPalette(QPalette(QColor(ground)))
            qtbot.wait(20)
            window.tick()
            for view in (window.geometry_view, window.plots.polar["s"], window.plots.spectrum):
                image = view.grab().toImage()
                corner = QColor(image.pixel(image.width() - 4, image.height() - 4))
                assert (corner.lightness() < 128) is dark
    finally:
        application.setPalette(usual)


def test_wavelength_slider_redraws_the_polar_plots(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, tiny_plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "tiny.h5"
    window = open_window(tiny_plan, path, running_bench)
    run_to_end(qtbot, window)
    scan = gonio.load(path)
    slider = window.plots.slider
    assert slider.value() == 1  # 550 nm
    slider.setFocus()
    qtbot.keyClick(slider, Qt.Key.Key_Right)
    draw_all(window)
    assert "900 nm" in window.plots.wavelength.text()
    _, percent = window.plots.polar["s"].points(0)
    np.testing.assert_allclose(percent, 100.0 * scan.r[:4, 2], rtol=1e-9)
    window.model.set_plan(Plan.paper())  # another plan leaves the wavelength where it is
    window.tick()
    assert "900 nm" in window.plots.wavelength.text()


KILLED = """
import os, signal, sys
from pathlib import Path
from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication
from gonio.plan import load_plan
from gonio.rig import load_rig
from gonio_gui.model import Phase
from gonio_gui.window import MainWindow

application = QApplication([])
window = MainWindow(load_rig(), load_plan(Path(sys.argv[1])), Path(sys.argv[2]))
window.show()

def watch():
    if window.model.phase is Phase.READY:
        window.start()
    elif window.model.live is not None and window.model.live.measured.sum() >= 2:
        os.kill(os.getpid(), signal.SIGKILL)

timer = QTimer()
timer.timeout.connect(watch)
timer.start(5)
application.exec()
"""


@pytest.mark.skipif(os.name == "nt", reason="kill -9 is POSIX")
def test_killing_the_process_loses_nothing(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, tiny_plan: Plan, tmp_path: Path
) -> None:
    plan_file, path = tmp_path / "plan.toml", tmp_path / "tiny.h5"
    plan_file.write_text(tiny_plan.to_toml(), encoding="utf-8")
    command = [sys.executable, "-c", KILLED, str(plan_file), str(path)]
    died = subprocess.run(command, capture_output=True, text=True, timeout=SCAN_MS / 1000, check=False)
    assert died.returncode == -signal.SIGKILL, died.stderr
    window = open_window(tiny_plan, path, running_bench)
    window.tick()
    assert window.controls.start.text() == "Resume scan"
    run_to_end(qtbot, window)
    assert_complete(path, tiny_plan)


def test_garbage_is_collected_in_the_gui_thread_alone(
    qtbot: Any, open_window: Opener, running_bench: RigConfig, tiny_plan: Plan, tmp_path: Path
) -> None:
    threads: set[threading.Thread] = set()

    def noted(phase: str, _info: object) -> None:
        if phase == "start":
            threads.add(threading.current_thread())

    gc.enable()
    window = open_window(tiny_plan, tmp_path / "tiny.h5", running_bench)
    gc.callbacks.append(noted)
    try:
        run_to_end(qtbot, window)
        # enough new objects for any Python's threshold; the timer of the GUI thread takes what is garbage
        kept: list[list[int]] = [[] for _ in range(2 * gc.get_threshold()[0])]
        qtbot.waitUntil(lambda: bool(threads), timeout=SCAN_MS)
    finally:
        gc.callbacks.remove(noted)
    assert len(kept) == 2 * gc.get_threshold()[0]
    assert threads == {threading.main_thread()}
    assert not gc.isenabled()
    window.shut_down()
    wait_for(qtbot, window, Phase.CLOSED)
    qtbot.waitUntil(gc.isenabled)

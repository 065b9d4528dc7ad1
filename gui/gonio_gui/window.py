"""The acquisition window: panels over one `Model`, fed by the bench's thread, drawn by one timer."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QEvent, Qt, QTimer
from PySide6.QtGui import QAction, QCloseEvent, QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QFileDialog,
    QMainWindow,
    QMessageBox,
    QSplitter,
    QVBoxLayout,
    QWidget,
)

from gonio.errors import GonioError
from gonio.plan import Plan, load_plan
from gonio.rig import RigConfig, load_rig
from gonio_gui.banner import BannerBar
from gonio_gui.bench_thread import BenchThread
from gonio_gui.collector import GuiThreadCollector
from gonio_gui.controls import Controls
from gonio_gui.geometry import GeometryView
from gonio_gui.log_pane import LogPane
from gonio_gui.model import Banner, Model, Phase
from gonio_gui.plots import Plots
from gonio_gui.readbacks import Readbacks
from gonio_gui.theme import theme_of

TICK_MS = 50  # 20 drawings a second is what an eye can follow
DRAIN_S = 0.015  # longest that one tick takes in messages; the rest waits for the next

SHORTCUTS = (
    ("Esc", "stop all motion, at any time"),
    ("Ctrl+R", "start the scan, or resume an interrupted one"),
    ("Ctrl+P", "pause after this position, or continue"),
    ("Ctrl+T", "stop the scan"),
    ("Ctrl+O", "open a plan"),
    ("Ctrl+S", "choose the file to write"),
    ("Left, Right", "another wavelength in the polar plots (slider in focus)"),
    ("Ctrl+Q", "close the window"),
)


class MainWindow(QMainWindow):
    """The window of ``gonio gui``; connects its rig as soon as it is made."""

    def __init__(self, rig: RigConfig, plan: Plan, path: Path | None = None) -> None:
        super().__init__()
        self.setWindowTitle("gonio")
        self.model = Model(rig, plan, path)
        self.bench = BenchThread()
        self.controls = Controls()
        self.banner = BannerBar()
        self.geometry_view = GeometryView()
        self.readbacks = Readbacks()
        self.plots = Plots()
        self.log = LogPane()
        self._shown_banner: Banner | None = None
        self._asking = False
        self._closing = False
        self._prepared: tuple[object, object, object] | None = None
        self._lay_out()
        self._make_menus()
        self._apply_theme()
        self._collector = GuiThreadCollector(self)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self.tick)
        self._timer.start(TICK_MS)
        self.connect_rig()

    def _lay_out(self) -> None:
        left, right = QWidget(), self.plots
        column = QVBoxLayout(left)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self.geometry_view, 1)
        column.addWidget(self.readbacks)
        halves = QSplitter(Qt.Orientation.Vertical)
        halves.addWidget(left)
        halves.addWidget(self.log)
        halves.setStretchFactor(0, 3)
        halves.setStretchFactor(1, 2)
        halves.setSizes([430, 250])
        views = QSplitter(Qt.Orientation.Horizontal)
        views.addWidget(halves)
        views.addWidget(right)
        views.setStretchFactor(0, 2)
        views.setStretchFactor(1, 3)
        views.setSizes([550, 850])
        for splitter in (views, halves):
            splitter.setChildrenCollapsible(False)
        middle = QWidget()
        rows = QVBoxLayout(middle)
        rows.setContentsMargins(10, 8, 10, 8)
        rows.addWidget(self.controls)
        rows.addWidget(self.banner)
        rows.addWidget(views, 1)
        self.setCentralWidget(middle)
        self.resize(1400, 860)
        self.controls.start_clicked.connect(self.start)
        self.controls.pause_clicked.connect(self.pause_or_continue)
        self.controls.stop_clicked.connect(self.stop_scan)
        self.controls.stop_motion_clicked.connect(self.stop_motion)

    def _make_menus(self) -> None:
        file = self.menuBar().addMenu("&File")
        scan = self.menuBar().addMenu("&Scan")
        help_menu = self.menuBar().addMenu("&Help")
        self.open_plan_action = self._action("&Open plan…", "Ctrl+O", self._ask_plan)
        self.paper_plan_action = self._action("The &paper's plan", "", lambda: self._use_plan(Plan.paper()))
        self.output_action = self._action("File to &write or resume…", "Ctrl+S", self._ask_output)
        self.new_output_action = self._action("&New scan file", "Ctrl+N", self._new_output)
        self.open_rig_action = self._action("Open &rig…", "", self._ask_rig)
        self.connect_action = self._action("Re&connect", "", self.connect_rig)
        quit_action = self._action("&Quit", "Ctrl+Q", self.close)
        file.addActions([self.open_plan_action, self.paper_plan_action])
        file.addSeparator()
        file.addActions([self.output_action, self.new_output_action])
        file.addSeparator()
        file.addActions([self.open_rig_action, self.connect_action])
        file.addSeparator()
        file.addAction(quit_action)
        self.start_action = self._action("&Start or resume", "Ctrl+R", self.start)
        self.pause_action = self._action("&Pause or continue", "Ctrl+P", self.pause_or_continue)
        self.stop_action = self._action("S&top scan", "Ctrl+T", self.stop_scan)
        # the one shortcut that must work whatever has the focus
        QShortcut(QKeySequence("Esc"), self, self.stop_motion, context=Qt.ShortcutContext.ApplicationShortcut)
        scan.addActions([self.start_action, self.pause_action, self.stop_action])
        scan.addSeparator()
        scan.addAction(self._action("Stop &motion\tEsc", "", self.stop_motion))
        help_menu.addAction(self._action("&Keyboard shortcuts", "F1", self._show_shortcuts))

    def _action(self, text: str, shortcut: str, slot: Callable[[], object]) -> QAction:
        action = QAction(text, self)
        if shortcut:
            action.setShortcut(QKeySequence(shortcut))
        action.triggered.connect(lambda: slot())  # without Qt's "checked"
        return action

    # -- what the user does -----------------------------------------------------------------------------

    def start(self) -> None:
        """Start the plan into the chosen file, or go on with it if it is an interrupted scan."""
        if not self.controls.start.isEnabled():
            return
        self.model.banner = None
        self.model.phase = Phase.STARTING
        if self.model.resumable:
            self.bench.continue_file(self.model.path)
        else:
            self.bench.start(self.model.plan, self.model.path)
        self.tick()

    def pause_or_continue(self) -> None:
        """Pause after the position being measured; or take the pause back."""
        if self.model.phase is Phase.RUNNING:
            self.model.phase = Phase.PAUSING
            self.bench.pause()
        elif self.model.phase in {Phase.PAUSING, Phase.PAUSED}:
            self.model.phase = Phase.RUNNING
            self.bench.resume()

    def stop_scan(self) -> None:
        """Stop within a reading; the scan can be resumed."""
        if self.model.phase.busy:
            self.model.phase = Phase.STOPPING
            self.bench.stop_scan()

    def stop_motion(self) -> None:
        """Stop every motor now."""
        if self.model.phase.busy:
            self.model.phase = Phase.STOPPING
        self.bench.stop_motion()

    def connect_rig(self) -> None:
        """Connect the rig in place of the connection there is."""
        if self.model.phase in {Phase.OFFLINE, Phase.READY}:
            self.model.phase = Phase.CONNECTING
            simulated = "starting the simulated bench of" if self.model.rig.is_simulated() else "connecting"
            self.model.say("info", "connection", f"{simulated} rig '{self.model.rig.name}'")
            self.bench.connect(self.model.rig)

    def use_plan_file(self, path: Path) -> None:
        """Load a plan; what is wrong with it is said in the banner."""
        try:
            self._use_plan(load_plan(path))
        except GonioError as error:
            self.model.banner = Banner("error", str(error))

    def use_rig_file(self, path: Path) -> None:
        """Load a rig and connect it; what is wrong with it is said in the banner."""
        if self.model.phase not in {Phase.OFFLINE, Phase.READY}:
            return  # the bench in use is described by the rig there is
        try:
            self.model.set_rig(load_rig(path))
        except GonioError as error:
            self.model.banner = Banner("error", str(error))
            return
        self.connect_rig()

    def _use_plan(self, plan: Plan) -> None:
        self.model.set_plan(plan)
        self._new_output()

    def _new_output(self) -> None:
        self.model.path = self.model.suggested_path()

    # -- dialogs: opened, never waited for --------------------------------------------------------------

    def _ask_plan(self) -> None:
        self._ask_file("Open a plan", "Plans (*.toml)", self.use_plan_file)

    def _ask_rig(self) -> None:
        self._ask_file("Open a rig", "Rigs (*.toml)", self.use_rig_file)

    def _ask_output(self) -> None:
        dialog = self._ask_file(
            "File to write, or interrupted scan to resume", "Scans (*.h5)", self._use_output
        )
        dialog.setFileMode(QFileDialog.FileMode.AnyFile)
        dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
        dialog.setOption(QFileDialog.Option.DontConfirmOverwrite)  # nothing is ever overwritten
        dialog.setDefaultSuffix("h5")

    def _use_output(self, path: Path) -> None:
        self.model.path = path

    def _ask_file(self, title: str, kinds: str, use: Callable[[Path], None]) -> QFileDialog:
        dialog = QFileDialog(self, title, str(self.model.path.parent), kinds)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.fileSelected.connect(lambda name: use(Path(name)))
        dialog.open()
        return dialog

    def _show_shortcuts(self) -> None:
        rows = "".join(
            f"<tr><td><b>{key}</b>&nbsp;&nbsp;</td><td>{what}</td></tr>" for key, what in SHORTCUTS
        )
        box = QMessageBox(
            QMessageBox.Icon.NoIcon, "Keyboard shortcuts", f"<table>{rows}</table>", parent=self
        )
        box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        box.open()

    # -- drawing ----------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Take in what has happened, and draw it."""
        began_s = time.perf_counter()
        try:
            while time.perf_counter() - began_s < DRAIN_S:
                self.model.apply(self.bench.outbox.get_nowait())
        except queue.Empty:
            pass
        if self.model.phase is Phase.CLOSED:
            self._timer.stop()
            self.close()
            return
        self._draw()

    def _draw(self) -> None:
        model = self.model
        shown = (model.plan, model.rig, model.live)
        if self._prepared is None or any(a is not b for a, b in zip(shown, self._prepared, strict=True)):
            self._prepared = shown
            refused = [refusal.position.index for refusal in model.refusals if refusal.position is not None]
            self.geometry_view.prepare(model.plan, model.rig, refused)
            self.plots.prepare(model.live)
        self.controls.draw(model)
        self.readbacks.draw(model)
        self.geometry_view.set_axes(model.theta_i_deg, model.theta_mes_deg)
        if model.live is not None:
            now = model.snapshot.position if model.snapshot and model.phase.busy else None
            self.geometry_view.set_progress(model.live.measured, now)
        self.plots.draw()
        self.log.draw(model)
        idle = not model.phase.busy and not self._closing
        for action in (
            self.open_plan_action, self.paper_plan_action, self.output_action, self.new_output_action,
        ):  # fmt: skip
            action.setEnabled(idle)
        for action in (self.open_rig_action, self.connect_action):
            action.setEnabled(idle and model.phase is not Phase.CONNECTING)
        self.start_action.setEnabled(self.controls.start.isEnabled())
        self.pause_action.setEnabled(self.controls.pause.isEnabled())
        self.stop_action.setEnabled(self.controls.stop.isEnabled())
        self._draw_banner()

    def _draw_banner(self) -> None:
        if self._asking and not self.model.phase.busy:
            self._asking = False  # the scan has ended while the question stood
            self._shown_banner = None
        if self._asking or self._closing or self.model.banner is self._shown_banner:
            return
        self._shown_banner = self.model.banner
        if self.model.banner is None:
            self.banner.hide()
            return
        choices = [("Reconnect", self.connect_rig)] if self.model.banner.reconnect else []
        self.banner.say(self.model.banner.level, self.model.banner.text, choices)

    def _apply_theme(self) -> None:
        theme = theme_of(self.palette())
        for view in (self.geometry_view, self.plots, self.log, self.banner):
            view.set_theme(theme)

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange and hasattr(self, "_collector"):
            self._apply_theme()

    # -- closing ----------------------------------------------------------------------------------------

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask while a scan runs; then stop it in order and release the devices before the window goes."""
        if self.model.phase is Phase.CLOSED:
            self._collector.release()
            event.accept()
            return
        event.ignore()
        if self._closing:
            return
        if not self.model.phase.busy:
            self.shut_down()
            return
        self._asking = True
        self.banner.say(
            "warning",
            "A scan is running. Closing stops it; everything measured is kept, and it can be resumed later.",
            [("Stop and close", self.shut_down), ("Keep measuring", self._keep_measuring)],
        )

    def shut_down(self) -> None:
        """Stop the scan, release the devices and close; the window goes when the devices are free."""
        if self._closing:
            return
        self._closing, self._asking = True, False
        if self.model.phase.busy:
            self.model.phase = Phase.STOPPING
        self.banner.say(
            "info", "Closing: stopping the motors, closing the shutter and releasing the devices …"
        )
        self.bench.close()

    def _keep_measuring(self) -> None:
        self._asking = False
        self._shown_banner = None
        self.banner.hide()

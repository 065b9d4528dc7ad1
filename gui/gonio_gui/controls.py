"""The row of buttons and the progress line: what can be done now, and how long it will take."""

from __future__ import annotations

import html
import math

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QWidget,
)

from gonio.cli.progress import readable_duration
from gonio_gui.model import Model, Phase

STOP_STYLE = (
    "QPushButton { background: #b3261e; color: white; font-weight: bold; border: none; border-radius: 4px;"
    " padding: 8px 26px; }"
    "QPushButton:hover { background: #c9382f; } QPushButton:pressed { background: #8c1d18; }"
    "QPushButton:focus { border: 2px solid white; }"
)


START_STYLE = (
    "QPushButton { background: #0b5cad; color: white; font-weight: bold; border: none; border-radius: 4px; }"
    "QPushButton:hover { background: #1a6dc0; } QPushButton:pressed { background: #084a8c; }"
    "QPushButton:focus { border: 2px solid palette(text); }"
    "QPushButton:disabled { background: transparent; color: #85898f; border: 1px solid #85898f; }"
)


class Controls(QWidget):
    """Start or resume, pause or continue, stop, and the button that stops all motion."""

    start_clicked = Signal()
    pause_clicked = Signal()
    stop_clicked = Signal()
    stop_motion_clicked = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.start = QPushButton("Start scan")
        self.start.setDefault(True)
        self.start.setStyleSheet(START_STYLE)
        self.pause = QPushButton("Pause")
        self.stop = QPushButton("Stop scan")
        self.stop_motion = QPushButton("STOP MOTION (Esc)")
        self.stop_motion.setStyleSheet(STOP_STYLE)
        self.stop_motion.setToolTip(
            "Stops every motor at once, whatever is going on; a running scan can be resumed"
        )
        self.pause.setToolTip(
            "Takes effect when the position being measured is complete; the shutter closes, the lamp stays on"
        )
        self.stop.setToolTip(
            "Stops within one reading; everything measured is kept and the scan can be resumed"
        )
        for button, signal in (
            (self.start, self.start_clicked),
            (self.pause, self.pause_clicked),
            (self.stop, self.stop_clicked),
            (self.stop_motion, self.stop_motion_clicked),
        ):
            button.setMinimumHeight(38)
            button.clicked.connect(signal)
        for button in (self.start, self.pause, self.stop):
            button.setMinimumWidth(112)
        self._shown: tuple[object, object, object] | None = None
        self.plan = QLabel()
        self.file = QLabel()
        for label in (self.plan, self.file):
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        texts = QGridLayout()
        texts.setSpacing(1)
        texts.addWidget(self.plan, 0, 0)
        texts.addWidget(self.file, 1, 0)
        self.bar = QProgressBar()
        self.bar.setRange(0, 1000)
        self.bar.setTextVisible(False)
        self.bar.setFixedHeight(12)
        self.where = QLabel()
        self.time = QLabel()
        buttons = QHBoxLayout()
        for button in (self.start, self.pause, self.stop):
            buttons.addWidget(button)
        buttons.addSpacing(14)
        buttons.addLayout(texts, 1)
        buttons.addWidget(self.stop_motion)
        layout = QGridLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(buttons, 0, 0, 1, 2)
        layout.addWidget(self.bar, 1, 0, 1, 2)
        layout.addWidget(self.where, 2, 0)
        layout.addWidget(self.time, 2, 1, Qt.AlignmentFlag.AlignRight)

    def draw(self, model: Model) -> None:
        """Show what can be done and how far the scan is."""
        phase = model.phase
        resumable = not phase.busy and model.resumable
        self.start.setText("Resume scan" if resumable else "Start scan")
        self.start.setEnabled(phase is Phase.READY and (resumable or not model.refusals))
        waiting = phase in {Phase.PAUSING, Phase.PAUSED}
        self.pause.setText("Continue" if waiting else "Pause")
        self.pause.setEnabled(phase is Phase.RUNNING or waiting)
        self.stop.setEnabled(phase.busy and phase is not Phase.STOPPING)
        self._draw_plan(model)
        self.where.setText(_progress(model))
        self.time.setText(time_text(model))
        snapshot = model.snapshot
        fraction = snapshot.readings_done / max(snapshot.readings_total, 1) if snapshot else 0.0
        if math.floor(1000 * fraction) != self.bar.value():
            self.bar.setValue(math.floor(1000 * fraction))

    def _draw_plan(self, model: Model) -> None:
        shown = (model.plan, model.rig, model.path)
        if self._shown is not None and all(a is b for a, b in zip(shown, self._shown, strict=True)):
            return
        self._shown = shown
        plan = model.plan
        self.plan.setText(
            f"<b>{html.escape(plan.title)}</b>, {plan.n_positions} positions × "
            f"{len(plan.wavelength_nm)} wavelengths, rig {html.escape(model.rig.name)}"
        )
        self.file.setText(f"into {model.path}")
        self.file.setToolTip(str(model.path))


def _progress(model: Model) -> str:
    text = model.phase.value.capitalize()
    snapshot = model.snapshot
    if snapshot is None:
        return text
    text += f"   ·   {snapshot.done} of {snapshot.total} positions"
    if snapshot.readings_total:
        text += f"   ·   {100.0 * snapshot.readings_done / snapshot.readings_total:.1f} %"
    if model.phase.busy and snapshot.message:
        text += f"   ·   {snapshot.message}"
    return text


def time_text(model: Model) -> str:
    """Return elapsed and left, in the user's seconds, and in the bench's where its clock runs faster."""
    speed = model.rig.clock_speed()
    fast = speed != 1.0
    whose = " of bench time" if fast else ""
    snapshot = model.snapshot
    if snapshot is None or not model.phase.busy:
        if snapshot is not None and snapshot.elapsed_s > 0:
            return f"took {readable_duration(snapshot.elapsed_s)}{whose}"
        if math.isnan(model.duration_s):
            return ""
        return f"estimated {readable_duration(model.duration_s)}{whose}"
    if model.phase in {Phase.STARTING, Phase.STOPPING}:
        return ""
    text = f"{readable_duration(snapshot.elapsed_s / speed)} elapsed"
    text += f"   ·   about {readable_duration(snapshot.left_s / speed)} left"
    if fast:
        text += f" ({readable_duration(snapshot.left_s)}{whose})"
    return text

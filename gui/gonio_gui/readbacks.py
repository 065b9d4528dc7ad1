"""Where the bench stands: the angles read back, polarization, wavelength."""

from __future__ import annotations

import math

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QGridLayout, QLabel, QWidget

from gonio_gui.model import Model

COLUMNS = (
    ("theta_i", "sample θ<sub>i</sub>"),
    ("theta_mes", "arm θ<sub>mes</sub>"),
    ("theta_o", "θ<sub>o</sub>"),
    ("polarization", "polarizer"),
    ("wavelength", "wavelength"),
)


class Readbacks(QWidget):
    """One large number per quantity, with its unit."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        layout = QGridLayout(self)
        layout.setContentsMargins(0, 4, 0, 0)
        layout.setHorizontalSpacing(14)
        layout.setVerticalSpacing(0)
        self.values: dict[str, QLabel] = {}
        for column, (name, caption) in enumerate(COLUMNS):
            label, value = QLabel(caption), QLabel("–")
            font = value.font()
            font.setPointSizeF(font.pointSizeF() * 1.45)
            value.setFont(font)
            value.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            value.setAccessibleName(name)
            layout.addWidget(label, 0, column)
            layout.addWidget(value, 1, column)
            layout.setColumnStretch(column, 1)
            self.values[name] = value

    def draw(self, model: Model) -> None:
        """Show the latest values; a dash stands for what is not known."""
        snapshot = model.snapshot if model.phase.busy else None
        polarization = snapshot.polarization if snapshot else None
        wavelength_nm = snapshot.wavelength_nm if snapshot else None
        for name, text in (
            ("theta_i", _degrees(model.theta_i_deg)),
            ("theta_mes", _degrees(model.theta_mes_deg)),
            ("theta_o", _degrees(model.theta_mes_deg - model.theta_i_deg)),
            ("polarization", polarization.upper() if polarization else "–"),
            ("wavelength", f"{wavelength_nm:g} nm" if wavelength_nm is not None else "–"),
        ):
            if self.values[name].text() != text:
                self.values[name].setText(text)


def _degrees(angle_deg: float) -> str:
    if not math.isfinite(angle_deg):
        return "–"
    return f"{round(angle_deg, 2) + 0.0:.2f}°".replace("-", "−")  # + 0.0: no "-0.00"

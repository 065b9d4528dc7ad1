"""The spectrum at the position measured last."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLabel, QVBoxLayout, QWidget

from gonio_gui.live import Spectrum, broken_at
from gonio_gui.theme import LIGHT, Theme


class SpectrumPlot(QWidget):
    """r in percent over wavelength in nm, interrupted where the detector changes."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._theme = LIGHT
        self._caption = QLabel("Spectrum at the last position")
        self._plot = pg.PlotWidget()
        self._plot.setMenuEnabled(False)
        self._plot.hideButtons()
        for axis, label in (("bottom", "wavelength / nm"), ("left", "r / %")):
            # units stand in the label: pyqtgraph's own prefixes would print "knm"
            self._plot.getAxis(axis).enableAutoSIPrefix(False)
            self._plot.getAxis(axis).setStyle(maxTickLevel=0)  # a grid of few lines: it is painted every time
            self._plot.setLabel(axis, label)
        self._plot.getAxis("left").setWidth(52)
        self._curve = pg.PlotDataItem(connect="finite")
        self._cursor = pg.InfiniteLine(angle=90)
        self._changes: list[Any] = []
        self._prepared: tuple[object, object] | None = None
        self._plot.addItem(self._curve)
        self._plot.addItem(self._cursor, ignoreBounds=True)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        layout.addWidget(self._caption)
        layout.addWidget(self._plot)
        self.setMinimumSize(260, 140)
        self.setAccessibleName("Spectrum at the last position")

    @property
    def caption(self) -> str:
        """Say which position is shown."""
        return self._caption.text()

    def points(self) -> tuple[Any, Any]:
        """Return what is drawn as (wavelength in nm, r in percent), gaps included."""
        wavelength_nm, r_percent = self._curve.getData()
        return wavelength_nm, r_percent

    def set_theme(self, theme: Theme) -> None:
        """Redraw in other colours."""
        self._theme = theme
        self._plot.setBackground(theme.ground)
        for axis in ("bottom", "left"):
            self._plot.getAxis(axis).setPen(pg.mkPen(theme.faint, width=1))
            self._plot.getAxis(axis).setTextPen(pg.mkPen(theme.text))
        self._plot.showGrid(x=True, y=True, alpha=0.18)
        self._curve.setPen(pg.mkPen(theme.cycle[0], width=1))
        self._curve.setSymbol("o")
        self._curve.setSymbolSize(4)
        self._curve.setSymbolPen(None)
        self._curve.setSymbolBrush(pg.mkBrush(theme.cycle[0]))
        self._cursor.setPen(pg.mkPen(theme.faint, width=1, style=Qt.PenStyle.DashLine))
        for line in self._changes:
            line.setPen(pg.mkPen(theme.faint, width=1, style=Qt.PenStyle.DotLine))
            line.label.setColor(theme.faint)

    def prepare(self, wavelength_nm: Sequence[float], changes_nm: Sequence[float]) -> None:
        """Clear the curve and set the axis for a plan."""
        self._curve.setData([], [])
        self._caption.setText("Spectrum at the last position: nothing measured yet")
        asked = (tuple(wavelength_nm), tuple(changes_nm))
        if asked == self._prepared:
            return
        self._prepared = asked
        low, high = float(min(wavelength_nm)), float(max(wavelength_nm))
        margin = 0.02 * (high - low) or 10.0
        self._plot.setXRange(low - margin, high + margin, padding=0.0)
        for line in self._changes:
            self._plot.removeItem(line)
        self._changes = []
        for change_nm in changes_nm:
            line = pg.InfiniteLine(
                change_nm,
                angle=90,
                label=f"detector change, {change_nm:g} nm",
                labelOpts={"position": 0.06, "anchors": [(0.0, 0.5), (0.0, 0.5)]},
            )
            self._plot.addItem(line, ignoreBounds=True)
            self._changes.append(line)
        self.set_theme(self._theme)

    def mark(self, wavelength_nm: float) -> None:
        """Show which wavelength the polar plots are drawn at."""
        self._cursor.setValue(wavelength_nm)

    def draw(self, spectrum: Spectrum, changes_nm: Sequence[float]) -> None:
        """Show one position's spectrum."""
        self._curve.setData(*broken_at(spectrum.wavelength_nm, 100.0 * spectrum.r, changes_nm))
        angles = (
            f"θᵢ = {spectrum.theta_i_deg:.2f}°, θₘₑₛ = {spectrum.theta_mes_deg:.2f}°, "
            f"θₒ = {spectrum.theta_mes_deg - spectrum.theta_i_deg:.2f}°"
        ).replace("-", "−")
        self._caption.setText(
            f"Spectrum at position {spectrum.index + 1}: {angles}, {spectrum.polarization.upper()}"
        )
        finite = 100.0 * spectrum.r[np.isfinite(spectrum.r)]
        if len(finite):
            low, high = float(finite.min()), float(finite.max())
            pad = 0.08 * (high - min(low, 0.0)) or 1e-6
            # zero stays in view: a spectrum's level is what one looks for first
            self._plot.setYRange(min(0.0, low - pad), max(high + pad, 1e-9), padding=0.0)

"""The polar plot r(theta_o): one half-disc per polarization, one curve per incidence.

The sample's surface is the horizontal line and its normal points up; the specular side is to the right, as in
the report: a reading r at theta_o lies at ``x = r sin(theta_o), y = r cos(theta_o)``.  The light of incidence
theta_i comes from the left, at theta_o = -theta_i.  pyqtgraph has no polar axes; these are circles and rays
on a view of locked aspect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QVBoxLayout, QWidget

from gonio.devices import FloatArray
from gonio_gui.theme import LIGHT, SYMBOLS, Theme

RAYS_DEG = range(-75, 90, 15)
LABELLED_DEG = (-60, -30, 0, 30, 60)
LABEL_RADIUS = 1.08  # in units of the outer circle
RINGS = 4
_ARC = np.radians(np.linspace(-90.0, 90.0, 121))


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One incidence: `theta_o_deg` and `r`, each (k,), and which colour and symbol it has."""

    number: int
    theta_i_deg: float
    theta_o_deg: FloatArray
    r: FloatArray


def outer_radius(peak: float) -> float:
    """Return the first of 1, 1.2, 1.6, 2, 3, 4, 6, 8, 10 x 10^k that holds `peak`; 1 if it is not positive.

    Each of them makes readable quarters, which the circles stand at.
    """
    if not np.isfinite(peak) or peak <= 0.0:
        return 1.0
    decade = 10.0 ** np.floor(np.log10(peak))
    for step in (1.0, 1.2, 1.6, 2.0, 3.0, 4.0, 6.0, 8.0):
        if peak <= step * decade * (1.0 + 1e-12):
            return float(step * decade)
    return float(10.0 * decade)


class PolarPlot(QWidget):
    """A half-disc of one polarization; the radial scale grows with the data and is labelled in percent.

    Everything is drawn in units of the outer circle, so that a new scale changes five numbers and no line.
    """

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._title = title
        self._theme = LIGHT
        self._radius = 1.0
        self._plot = pg.PlotWidget()
        self._plot.setMenuEnabled(False)
        self._plot.hideButtons()
        self._plot.setMouseEnabled(False, False)
        self._plot.setAspectLocked(True)
        for axis in ("left", "bottom"):
            self._plot.hideAxis(axis)
        self._plot.setRange(xRange=(-1.17, 1.17), yRange=(-0.14, 1.15), padding=0.0)
        self._grid: list[Any] = []
        self._scale: list[Any] = []
        self._curves: dict[int, Any] = {}
        self._beams: dict[int, Any] = {}
        self._theta_i_deg: dict[int, float] = {}
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self._plot)
        self.setMinimumSize(260, 165)
        self.setAccessibleName(f"Polar plot, {title}")

    @property
    def radius_percent(self) -> float:
        """Radius of the outer circle, percent of the incident power."""
        return self._radius

    def points(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Return what is drawn for curve `number` as (theta_o_deg, r in percent)."""
        x, y = self._curves[number].getData()
        if x is None:
            return np.empty(0), np.empty(0)
        return np.degrees(np.arctan2(x, y)), self._radius * np.hypot(x, y)

    def set_theme(self, theme: Theme) -> None:
        """Redraw in other colours."""
        self._theme = theme
        self._plot.setBackground(theme.ground)
        self._draw_grid()
        self._make_curves()

    def prepare(self, theta_i_deg: Sequence[float]) -> None:
        """Show empty curves for these incidences."""
        incidences = dict(enumerate(theta_i_deg))
        if incidences == self._theta_i_deg:
            for curve in self._curves.values():
                curve.setData([], [])
            return
        self._theta_i_deg = incidences
        self._make_curves()

    def _make_curves(self) -> None:
        for item in [*self._curves.values(), *self._beams.values()]:
            self._plot.removeItem(item)
        self._curves.clear()
        self._beams.clear()
        for number, theta_i in self._theta_i_deg.items():
            colour = self._theme.cycle[number % len(self._theme.cycle)]
            # a thick mark on the circle shows where this incidence's light comes from
            angle, length = np.radians(-theta_i), np.array([0.95, 1.0])
            beam = pg.PlotCurveItem(
                length * np.sin(angle), length * np.cos(angle), pen=pg.mkPen(colour, width=3), antialias=True
            )
            curve = pg.PlotDataItem(
                pen=pg.mkPen(colour, width=1),
                symbol=SYMBOLS[number % len(SYMBOLS)],
                symbolSize=5,
                symbolPen=None,
                symbolBrush=pg.mkBrush(colour),
                connect="finite",
                antialias=True,
            )
            for item in (beam, curve):
                self._plot.addItem(item, ignoreBounds=True)
            self._curves[number], self._beams[number] = curve, beam

    def draw(self, curves: Sequence[Curve]) -> None:
        """Show these values on the prepared curves."""
        peak = max((float(np.nanmax(c.r, initial=0.0)) for c in curves), default=0.0)
        self._set_radius(outer_radius(100.0 * peak))
        for curve in curves:
            angle, length = np.radians(curve.theta_o_deg), 100.0 * curve.r / self._radius
            self._curves[curve.number].setData(length * np.sin(angle), length * np.cos(angle))

    def _set_radius(self, radius: float) -> None:
        self._radius = radius
        for k, label in enumerate(self._scale):
            text = f"{radius * k / RINGS:.4g}"
            if label.toPlainText() != text:
                label.setText(text)

    def _draw_grid(self) -> None:
        theme = self._theme
        for item in self._grid:
            self._plot.removeItem(item)
        self._grid, self._scale = [], []
        faint, strong = pg.mkPen(theme.grid, width=1), pg.mkPen(theme.faint, width=1)
        dashed = pg.mkPen(theme.grid, width=1, style=Qt.PenStyle.DashLine)
        for k in range(1, RINGS + 1):
            self._line(np.sin(_ARC) * k / RINGS, np.cos(_ARC) * k / RINGS, strong if k == RINGS else faint)
        for ray in RAYS_DEG:
            angle = np.radians(ray)
            self._line([0.0, np.sin(angle)], [0.0, np.cos(angle)], dashed if ray == 0 else faint)
        self._line([-1.0, 1.0], [0.0, 0.0], strong)
        for degrees in LABELLED_DEG:
            angle = np.radians(degrees)
            at = (LABEL_RADIUS * np.sin(angle), LABEL_RADIUS * np.cos(angle))
            self._write(f"{degrees}°".replace("-", "−"), *at)
        self._scale = [self._write("", k / RINGS, 0.0, anchor=(0.5, -0.05)) for k in range(RINGS + 1)]
        self._write("r / %", -0.5, 0.0, anchor=(0.5, -0.05))
        self._write(self._title, -1.17, 1.11, anchor=(0.0, 0.3), colour=theme.text)
        self._set_radius(self._radius)

    def _line(self, x: Any, y: Any, pen: Any) -> None:
        self._keep(pg.PlotCurveItem(np.asarray(x), np.asarray(y), pen=pen, antialias=True))

    def _write(
        self, text: str, x: float, y: float, *, anchor: tuple[float, float] = (0.5, 0.5), colour: str = ""
    ) -> Any:
        item = pg.TextItem(text, color=colour or self._theme.faint, anchor=anchor)
        item.setPos(x, y)
        self._keep(item)
        return item

    def _keep(self, item: Any) -> None:
        item.setZValue(-10)
        self._plot.addItem(item, ignoreBounds=True)
        self._grid.append(item)

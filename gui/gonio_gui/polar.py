"""The polar plot r(theta_o): one half-disc per polarization, one curve per incidence.

The sample's surface is the horizontal line and its normal points up; the specular side is to the right, as in
the report: a reading r at theta_o lies at ``x = r sin(theta_o), y = r cos(theta_o)``.  The light of incidence
theta_i comes from the left, at theta_o = -theta_i.  pyqtgraph has no polar axes; these are circles and rays
on a view of locked aspect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyqtgraph as pg
from gonio.devices import FloatArray
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QVBoxLayout, QWidget

from gonio_gui.theme import LIGHT, SYMBOLS, Theme

RAYS_DEG = range(-90, 91, 15)
LABELLED_DEG = (-90, -60, -30, 0, 30, 60, 90)
LABEL_RADIUS = 1.075  # in units of the outer circle
_ARC = np.radians(np.linspace(-90.0, 90.0, 181))


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One incidence: `theta_o_deg` and `r`, each (k,), and which colour and symbol it has."""

    number: int
    theta_i_deg: float
    theta_o_deg: FloatArray
    r: FloatArray


def outer_radius(peak: float) -> float:
    """Return the first of 1, 1.5, 2, 3, 4, 5, 6, 8, 10 x 10^k that holds `peak`; 1 if it is not positive."""
    if not np.isfinite(peak) or peak <= 0.0:
        return 1.0
    decade = 10.0 ** np.floor(np.log10(peak))
    for step in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0):
        if peak <= step * decade * (1.0 + 1e-12):
            return float(step * decade)
    return float(10.0 * decade)


def ring_values(radius: float) -> tuple[float, ...]:
    """Return the radii of the circles, the outer one last: two, three or four equal steps."""
    mantissa = radius / 10.0 ** np.floor(np.log10(radius) + 1e-9)
    parts = 3 if round(mantissa, 6) in {1.5, 3.0, 6.0} else 4
    return tuple(radius * (i + 1) / parts for i in range(parts))


class PolarPlot(QWidget):
    """A half-disc of one polarization; the radial scale grows with the data and is labelled in percent."""

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._title = title
        self._theme = LIGHT
        self._radius = 0.0
        self._plot = pg.PlotWidget()
        self._plot.setMenuEnabled(False)
        self._plot.hideButtons()
        self._plot.setMouseEnabled(False, False)
        self._plot.setAspectLocked(True)
        for axis in ("left", "bottom"):
            self._plot.hideAxis(axis)
        self._plot.getViewBox().setDefaultPadding(0.0)
        self._grid: list[Any] = []
        self._curves: dict[int, Any] = {}
        self._beams: dict[int, Any] = {}
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self._plot)
        self.setMinimumSize(260, 165)
        self.setAccessibleName(f"Polar plot, {title}")

    @property
    def radius_percent(self) -> float:
        """Radius of the outer circle, percent of the incident power; zero before the first drawing."""
        return self._radius

    def points(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Return what is drawn for curve `number` as (theta_o_deg, r in percent)."""
        x, y = self._curves[number].getData()
        return np.degrees(np.arctan2(x, y)), np.hypot(x, y)

    def set_theme(self, theme: Theme) -> None:
        """Redraw in other colours."""
        self._theme = theme
        self._plot.setBackground(theme.ground)
        for item in [*self._curves.values(), *self._beams.values()]:
            self._plot.removeItem(item)
        self._curves.clear()
        self._beams.clear()
        self._draw_grid(self._radius or 1.0)

    def draw(self, curves: list[Curve]) -> None:
        """Show these curves in place of those before."""
        peak = max((float(np.nanmax(c.r, initial=0.0)) for c in curves), default=0.0)
        radius = outer_radius(100.0 * peak)
        rescaled = radius != self._radius
        if rescaled:
            self._draw_grid(radius)
        shown = {curve.number for curve in curves}
        for number in set(self._curves) - shown:
            self._plot.removeItem(self._curves.pop(number))
            self._plot.removeItem(self._beams.pop(number))
        for curve in curves:
            if curve.number not in self._curves:
                self._add(curve.number)
            angle = np.radians(curve.theta_o_deg)
            r_percent = 100.0 * curve.r
            self._curves[curve.number].setData(r_percent * np.sin(angle), r_percent * np.cos(angle))
            # a tick outside the circle marks where this incidence's light comes from
            at = np.radians(-curve.theta_i_deg) + np.zeros(2)
            length = radius * np.array([1.0, 1.05])
            self._beams[curve.number].setData(length * np.sin(at), length * np.cos(at))

    def _add(self, number: int) -> None:
        colour = self._theme.cycle[number % len(self._theme.cycle)]
        item = pg.PlotDataItem(
            pen=pg.mkPen(colour, width=1),
            symbol=SYMBOLS[number % len(SYMBOLS)],
            symbolSize=5,
            symbolPen=None,
            symbolBrush=pg.mkBrush(colour),
            connect="finite",
        )
        beam = pg.PlotCurveItem(pen=pg.mkPen(colour, width=3))
        for added in (item, beam):
            self._plot.addItem(added)
        self._curves[number], self._beams[number] = item, beam

    def _draw_grid(self, radius: float) -> None:
        theme = self._theme
        for item in self._grid:
            self._plot.removeItem(item)
        self._grid = []
        rings = ring_values(radius)
        for ring in rings:
            pen = pg.mkPen(theme.faint if ring == rings[-1] else theme.grid, width=1)
            self._keep(pg.PlotCurveItem(ring * np.sin(_ARC), ring * np.cos(_ARC), pen=pen))
        for ray in RAYS_DEG:
            angle = np.radians(ray)
            pen = pg.mkPen(theme.faint if abs(ray) == 90 else theme.grid, width=1)
            if ray == 0:
                pen.setStyle(Qt.PenStyle.DashLine)
            self._keep(
                pg.PlotCurveItem([0.0, radius * np.sin(angle)], [0.0, radius * np.cos(angle)], pen=pen)
            )
        for degrees in LABELLED_DEG:
            angle = np.radians(degrees)
            self._write(
                f"{degrees}°", LABEL_RADIUS * radius * np.sin(angle), LABEL_RADIUS * radius * np.cos(angle)
            )
        for ring in (0.0, *rings):
            self._write(f"{ring:.3g}", ring, 0.0, anchor=(0.5, -0.05))
        self._write(f"{self._title}", -1.16 * radius, 1.1 * radius, anchor=(0.0, 0.3), colour=theme.text)
        self._write("r / %", -0.5 * radius, 0.0, anchor=(0.5, -0.05))
        self._plot.setRange(
            xRange=(-1.16 * radius, 1.16 * radius), yRange=(-0.13 * radius, 1.14 * radius), padding=0.0
        )
        self._radius = radius

    def _write(
        self, text: str, x: float, y: float, *, anchor: tuple[float, float] = (0.5, 0.5), colour: str = ""
    ) -> None:
        item = pg.TextItem(text, color=colour or self._theme.faint, anchor=anchor)
        item.setPos(x, y)
        self._keep(item)

    def _keep(self, item: Any) -> None:
        item.setZValue(-10)
        self._plot.addItem(item, ignoreBounds=True)
        self._grid.append(item)

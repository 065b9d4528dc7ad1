"""The drawing of the bench, seen from above: where everything stands now and where it will be measured.

The source is on the left and its beam runs to the right, through the axis of both rotations.  Angles count
clockwise from the source: the sample's normal stands at theta_i, the detector arm at theta_mes (180 deg faces
the source), and theta_o = theta_mes - theta_i is the angle between the two.  Each incidence has a ring of
planned positions, two dots wide if S and P are measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import (
    QBrush,
    QColor,
    QPainter,
    QPainterPath,
    QPaintEvent,
    QPen,
    QPixmap,
    QPolygonF,
    QResizeEvent,
)
from PySide6.QtWidgets import QSizePolicy, QWidget

from gonio.plan import Plan
from gonio.rig import RigConfig
from gonio_gui.theme import LIGHT, Theme, translucent

INNER_RING, OUTER_RING = 0.46, 0.90  # of the drawing's radius
DOT = 2.4  # radius of a planned position, pixels
MAX_DOTS_PER_RING = 180  # more would touch each other; the ring is then drawn as every k-th


class GeometryView(QWidget):
    """Sample, beam, blind zone, detector arm, and every planned position: measured, now, to come, refused."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._theme = LIGHT
        self._plan: Plan | None = None
        self._rig: RigConfig | None = None
        self._measured: NDArray[np.bool_] = np.zeros(0, dtype=np.bool_)
        self._refused: frozenset[int] = frozenset()
        self._dots: list[tuple[int, float, float, int]] = []  # (index, ring, theta_mes_deg, colour number)
        self._rings: list[tuple[float, float, int]] = []  # (ring, theta_i_deg, colour number)
        self._now: int | None = None
        self._theta_i_deg = math.nan
        self._theta_mes_deg = math.nan
        self._still: QPixmap | None = None
        self.setMinimumSize(330, 225)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setAccessibleName("Drawing of the bench with the planned positions")

    # -- what is shown ----------------------------------------------------------------------------------

    def set_theme(self, theme: Theme) -> None:
        """Redraw in other colours."""
        self._theme = theme
        self._repaint_all()

    def prepare(self, plan: Plan, rig: RigConfig, refused: Sequence[int]) -> None:
        """Show the positions of a plan; `refused` holds the indices that the rig cannot go to."""
        self._plan, self._rig, self._refused = plan, rig, frozenset(refused)
        self._measured = np.zeros(plan.n_positions, dtype=np.bool_)
        self._now = None
        self._rings, self._dots = lay_out(plan)
        self._repaint_all()

    def set_progress(self, measured: NDArray[np.bool_], now: int | None) -> None:
        """Mark the positions that are measured, and the one that is being measured."""
        fresh = np.flatnonzero(measured != self._measured)
        if now == self._now and len(fresh) == 0:
            return
        self._measured, self._now = measured.copy(), now
        if self._still is not None and bool(measured[fresh].all()):
            # a measured dot covers the hollow one: nothing else of the still picture changes
            changed = set(fresh.tolist())
            with QPainter(self._still) as still:
                still.setRenderHint(QPainter.RenderHint.Antialiasing)
                self._draw_dots(still, [dot for dot in self._dots if dot[0] in changed])
            self.update()
        else:
            self._repaint_all()

    def set_axes(self, theta_i_deg: float, theta_mes_deg: float) -> None:
        """Turn the sample and the detector arm to the angles read back; NaN hides them."""
        if (theta_i_deg, theta_mes_deg) != (self._theta_i_deg, self._theta_mes_deg):
            self._theta_i_deg, self._theta_mes_deg = theta_i_deg, theta_mes_deg
            self.update()

    def states(self) -> dict[str, int]:
        """Return how many positions are in each state, also those that a thinned ring does not show."""
        refused, measured = len(self._refused), int(np.count_nonzero(self._measured))
        # the position that is measured now may have been finished this moment
        now = int(self._now is not None and not self._measured[self._now])
        to_come = len(self._measured) - refused - measured - now
        return {"measured": measured, "now": now, "to come": to_come, "refused": refused}

    def _lasting_state(self, index: int) -> str:
        if index in self._refused:
            return "refused"
        return "measured" if self._measured[index] else "to come"

    def _repaint_all(self) -> None:
        self._still = None
        self.update()

    def resizeEvent(self, event: QResizeEvent) -> None:
        self._still = None
        super().resizeEvent(event)

    # -- drawing ----------------------------------------------------------------------------------------

    def paintEvent(self, event: QPaintEvent) -> None:
        ratio = self.devicePixelRatioF()
        if self._still is None or self._still.devicePixelRatioF() != ratio:
            self._still = QPixmap(self.size() * ratio)
            self._still.setDevicePixelRatio(ratio)
            self._still.fill(QColor(self._theme.ground))
            with QPainter(self._still) as still:
                still.setRenderHint(QPainter.RenderHint.Antialiasing)
                self._draw_still(still)
        with QPainter(self) as painter:
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            painter.drawPixmap(0, 0, self._still)
            self._draw_moving(painter)

    def _frame(self) -> tuple[QPointF, float]:
        """Return the rotation axis in pixels and the drawing's radius."""
        radius = max(min((self.width() - 120) / 2.0, (self.height() - 100.0) / 1.27), 40.0)
        spare = self.height() - 100.0 - 1.27 * radius
        return QPointF(self.width() / 2.0, 58.0 + radius + spare / 2.0), radius

    def _at(self, theta_deg: float, distance: float) -> QPointF:
        centre, radius = self._frame()
        angle = math.radians(theta_deg)
        return centre + QPointF(-math.cos(angle), -math.sin(angle)) * (distance * radius)

    def _draw_still(self, painter: QPainter) -> None:
        theme = self._theme
        centre, radius = self._frame()
        self._draw_scale(painter)
        if self._rig is not None and self._rig.stage.theta_mes.blind_zone_deg > 0:
            zone = self._rig.stage.theta_mes.blind_zone_deg
            box = QRectF(centre.x() - radius, centre.y() - radius, 2 * radius, 2 * radius)
            painter.setPen(Qt.PenStyle.NoPen)
            # Qt counts counter-clockwise from the right in sixteenths of a degree: the source is at 180
            start, span = round((180.0 - zone) * 16), round(2.0 * zone * 16)
            painter.setBrush(translucent(theme.danger, 0.13))
            painter.drawPie(box, start, span)
            painter.setBrush(QBrush(translucent(theme.danger, 0.55), Qt.BrushStyle.BDiagPattern))
            painter.drawPie(box, start, span)
            painter.setPen(QColor(theme.danger))
            self._write(
                painter,
                centre + QPointF(-0.93 * radius, 0.30 * radius + 4.0),
                f"blind zone ±{zone:g}°",
                "left",
            )
        self._draw_beam(painter)
        self._draw_dots(painter, self._dots)
        for ring, theta_i, number in self._rings:
            painter.setPen(QColor(theme.cycle[number % len(theme.cycle)]))
            last = max((t for _, r, t, n in self._dots if n == number), default=0.0)
            self._write(painter, self._at(last, ring) + self._along(last) * 15.0, f"{theta_i:g}°", "middle")

    def _along(self, theta_deg: float) -> QPointF:
        """Return the unit vector of growing angle."""
        angle = math.radians(theta_deg)
        return QPointF(math.sin(angle), -math.cos(angle))

    def _draw_scale(self, painter: QPainter) -> None:
        theme = self._theme
        centre, radius = self._frame()
        painter.setPen(QPen(QColor(theme.grid), 1))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawArc(QRectF(centre.x() - radius, centre.y() - radius, 2 * radius, 2 * radius), 0, 180 * 16)
        for theta in range(0, 181, 30):
            painter.setPen(QPen(QColor(theme.grid), 1))
            painter.drawLine(self._at(theta, 1.0), self._at(theta, 1.025))
            if theta:
                out = (self._at(theta, 1.0) - centre) * (13.0 / radius)
                # below the line at 180 deg, where the detector stands for every reference
                label = self._at(theta, 1.0) + (QPointF(4.0, 19.0) if theta == 180 else out)
                painter.setPen(QColor(theme.faint))
                self._write(painter, label, f"{theta}°")
        painter.setPen(QColor(theme.faint))
        self._write(painter, QPointF(10.0, 14.0), "seen from above; scale: θₘₑₛ from the source", "left")
        if self._plan is not None:
            both = ": outer dots S, inner dots P" if len(self._plan.polarization) > 1 else ""
            self._write(painter, QPointF(10.0, 31.0), f"one ring per incidence{both}", "left")

    def _draw_beam(self, painter: QPainter) -> None:
        theme = self._theme
        centre, _ = self._frame()
        source = self._at(0.0, 1.0)
        painter.setPen(QPen(QColor(theme.beam), 2.5))
        painter.drawLine(source, centre)
        middle = (source * 0.62) + (centre * 0.38)
        painter.setBrush(QColor(theme.beam))
        painter.drawPolygon(
            QPolygonF([middle + QPointF(9, 0), middle + QPointF(-3, -5), middle + QPointF(-3, 5)])
        )
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(theme.body))
        painter.drawRoundedRect(QRectF(source.x() - 40, source.y() - 11, 40, 22), 3, 3)
        painter.setPen(QColor(theme.ground))
        self._write(painter, source + QPointF(-20, 0), "source")

    def _draw_dots(self, painter: QPainter, dots: Sequence[tuple[int, float, float, int]]) -> None:
        """Draw dots, all of one state and colour at once: a path costs less than its circles one by one."""
        paths: dict[tuple[str, int], QPainterPath] = {}
        for index, ring, theta_mes, number in dots:
            state, at = self._lasting_state(index), self._at(theta_mes, ring)
            if state == "refused":
                self._draw_dot(painter, state, at, number)
            else:
                paths.setdefault((state, number), QPainterPath()).addEllipse(at, DOT, DOT)
        for (state, number), path in paths.items():
            colour = QColor(self._theme.cycle[number % len(self._theme.cycle)])
            painter.setPen(QPen(colour, 1.0))
            painter.setBrush(colour if state == "measured" else QColor(self._theme.ground))
            painter.drawPath(path)

    def _draw_dot(self, painter: QPainter, state: str, at: QPointF, number: int) -> None:
        theme = self._theme
        colour = QColor(theme.cycle[number % len(theme.cycle)])
        if state == "refused":
            painter.setPen(QPen(QColor(theme.danger), 1.8))
            for dx in (-3.5, 3.5):
                painter.drawLine(at + QPointF(-dx, -3.5), at + QPointF(dx, 3.5))
            return
        if state == "now":
            painter.setPen(QPen(QColor(theme.text), 1.6))
            painter.setBrush(colour)
            painter.drawEllipse(at, 5.5, 5.5)
            return
        painter.setPen(QPen(colour, 1.0))
        painter.setBrush(colour if state == "measured" else QColor(theme.ground))
        painter.drawEllipse(at, DOT, DOT)

    def _draw_moving(self, painter: QPainter) -> None:
        theme = self._theme
        centre, radius = self._frame()
        if math.isfinite(self._theta_mes_deg):
            tip = self._at(self._theta_mes_deg, 0.955)
            painter.setPen(QPen(QColor(theme.body), 2.5))
            painter.drawLine(self._at(self._theta_mes_deg, 0.10), tip)
            painter.save()
            painter.translate(tip)
            painter.rotate(self._theta_mes_deg - 90.0)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(QColor(theme.body))
            painter.drawPolygon(
                QPolygonF([QPointF(-8, 0), QPointF(8, 0), QPointF(13, -15), QPointF(-13, -15)])
            )
            painter.restore()
        if math.isfinite(self._theta_i_deg):
            normal = self._at(self._theta_i_deg, 0.34)
            painter.setPen(QPen(QColor(theme.text), 1.2, Qt.PenStyle.DashLine))
            painter.drawLine(centre, normal)
            self._write(
                painter, self._at(self._theta_i_deg, 0.34) + (normal - centre) * (11.0 / (0.34 * radius)), "n"
            )
            painter.setPen(QPen(QColor(theme.text), 5.0, Qt.PenStyle.SolidLine, Qt.PenCapStyle.FlatCap))
            face = self._along(self._theta_i_deg) * (0.27 * radius)
            painter.drawLine(centre - face, centre + face)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(theme.body))
        painter.drawEllipse(centre, 4.0, 4.0)
        for index, ring, theta_mes, number in self._dots:
            if index == self._now:
                self._draw_dot(painter, "now", self._at(theta_mes, ring), number)
        self._draw_legend(painter)

    def _draw_legend(self, painter: QPainter) -> None:
        x, y = 14.0, self.height() - 13.0
        for state, count in self.states().items():
            if count == 0 and state == "refused":
                continue
            self._draw_dot(painter, state, QPointF(x, y), 0)
            painter.setPen(QColor(self._theme.text))
            text = f"{state} {count}" if state != "now" else "now"
            self._write(painter, QPointF(x + 10.0, y), text, "left")
            x += 28.0 + painter.fontMetrics().horizontalAdvance(text)

    @staticmethod
    def _write(painter: QPainter, at: QPointF, text: str, where: str = "middle") -> None:
        """Write text with its middle, or its left end, at a point."""
        width, height = painter.fontMetrics().horizontalAdvance(text) + 4.0, 20.0
        left = at.x() - (width / 2.0 if where == "middle" else 0.0)
        painter.drawText(
            QRectF(left, at.y() - height / 2.0, width, height),
            Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignHCenter,
            text,
        )


def lay_out(plan: Plan) -> tuple[list[tuple[float, float, int]], list[tuple[int, float, float, int]]]:
    """Return the rings (radius, theta_i_deg, number) and the dots (index, radius, theta_mes_deg, number).

    One ring per incidence, the first innermost; S lies on its outer edge and P on its inner.  Of a ring with
    more than `MAX_DOTS_PER_RING` positions an even choice is drawn, its last one included.
    """
    incidences = list(dict.fromkeys(sweep.theta_i_deg for sweep in plan.sweeps))
    spacing = (OUTER_RING - INNER_RING) / max(len(incidences), 3)
    middle = {theta_i: INNER_RING + (k + 0.5) * spacing for k, theta_i in enumerate(incidences)}
    offset = 0.17 * spacing if len(plan.polarization) > 1 else 0.0
    grouped: dict[tuple[float, str], list[tuple[int, float, float, int]]] = {}
    for position in plan.positions():
        ring = middle[position.theta_i_deg] + (offset if position.polarization == "s" else -offset)
        grouped.setdefault((position.theta_i_deg, position.polarization), []).append(
            (position.index, ring, position.theta_mes_deg, incidences.index(position.theta_i_deg))
        )
    dots: list[tuple[int, float, float, int]] = []
    for group in grouped.values():
        stride = -(-len(group) // MAX_DOTS_PER_RING)
        dots += group[::-1][::stride][::-1]
    return [(middle[t], t, k) for k, t in enumerate(incidences)], dots

"""The drawing of the bench: what is drawn, and that it is drawn where the angles say."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QPointF
from PySide6.QtGui import QColor, QImage

from gonio.plan import Plan, parse_plan
from gonio.rig import RigConfig
from gonio_gui.geometry import MAX_DOTS_PER_RING, GeometryView, lay_out
from gonio_gui.theme import LIGHT


@pytest.fixture
def view(qtbot: Any, tiny_plan: Plan, rig: RigConfig) -> GeometryView:
    made = GeometryView()
    qtbot.addWidget(made)
    made.resize(560, 420)
    made.set_theme(LIGHT)
    made.prepare(tiny_plan, rig, refused=[2])
    return made


def picture(view: GeometryView) -> QImage:
    return view.grab().toImage()


def near(image: QImage, at: QPointF, colour: str, reach: int = 2) -> bool:
    """Whether a colour is found within `reach` pixels of a point."""
    wanted = QColor(colour).rgb()
    pixels = range(-reach, reach + 1)
    return any(image.pixel(round(at.x()) + i, round(at.y()) + j) == wanted for i in pixels for j in pixels)


def from_the_axis(view: GeometryView, theta_deg: float, distance: float) -> QPointF:
    """Angles count clockwise from the source on the left: written out again, not taken from the view."""
    centre, radius = view._frame()
    angle = math.pi - math.radians(theta_deg)
    return QPointF(
        centre.x() + distance * radius * math.cos(angle), centre.y() - distance * radius * math.sin(angle)
    )


def test_every_position_is_shown_with_its_state(view: GeometryView, tiny_plan: Plan) -> None:
    measured = np.zeros(tiny_plan.n_positions, dtype=bool)
    assert view.states() == {"measured": 0, "now": 0, "to come": 13, "refused": 1}
    measured[:2] = True
    view.set_progress(measured, now=3)
    assert view.states() == {"measured": 2, "now": 1, "to come": 10, "refused": 1}


@pytest.mark.parametrize("theta_mes", [40.0, 90.0, 130.0, 180.0])
def test_arm_points_at_the_angle_read_back(view: GeometryView, theta_mes: float) -> None:
    view.set_axes(20.0, theta_mes)
    image = picture(view)
    assert near(image, from_the_axis(view, theta_mes, 0.35), LIGHT.body)
    assert not near(image, from_the_axis(view, theta_mes - 12.0, 0.35), LIGHT.body)


def test_sample_turns_with_the_incidence_and_faces_the_source_at_zero(view: GeometryView) -> None:
    for theta_i in (0.0, 20.0, 90.0):
        view.set_axes(theta_i, math.nan)
        image = picture(view)
        for side in (90.0, -90.0):  # the plate is perpendicular to its normal
            assert near(image, from_the_axis(view, theta_i + side, 0.2), LIGHT.text)


def test_measured_dots_are_filled_in_place(view: GeometryView, tiny_plan: Plan) -> None:
    index, ring, theta_mes, number = view._dots[0]
    at = from_the_axis(view, theta_mes, ring)
    assert not near(picture(view), at, LIGHT.cycle[number], reach=0)
    measured = np.zeros(tiny_plan.n_positions, dtype=bool)
    measured[index] = True
    view.set_progress(measured, now=None)
    assert near(picture(view), at, LIGHT.cycle[number], reach=0)
    view.set_progress(np.zeros_like(measured), now=None)  # a new scan begins
    assert not near(picture(view), at, LIGHT.cycle[number], reach=0)


def test_blind_zone_lies_around_the_source(view: GeometryView) -> None:
    image = picture(view)
    for theta, inside in ((10.0, True), (-10.0, True), (20.0, False), (-20.0, False)):
        at = from_the_axis(view, theta, 0.8)
        white = image.pixel(round(at.x()), round(at.y())) == QColor(LIGHT.ground).rgb()
        assert white is not inside


def test_a_fine_plan_is_thinned_but_keeps_its_ends() -> None:
    plan = parse_plan(
        "[[wavelengths]]\nvalues_nm = [550.0]\n[[sweeps]]\ntheta_i_deg = 20.0\n"
        "theta_mes_deg = { start = 20.0, stop = 120.0, step = 0.01 }\n"
    )
    rings, dots = lay_out(plan)
    assert len(rings) == 1
    assert len(dots) <= 2 * MAX_DOTS_PER_RING
    assert plan.n_positions - 1 in {index for index, *_ in dots}

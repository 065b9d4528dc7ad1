"""The view of the sky behind obstructions, by closed forms (Hamilton and Morgan 1952, Hottel 1954).

A receiver that sees a black obstruction with view factor F receives ``DHI (F_free - F)`` of an even sky.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from gonio.facade import Optics, Scene, Sun, Surface, simulate

BLACK = {"black": Optics(0.0)}
DHI = 100.0


def parallel(x: float, y: float, z: float) -> float:
    """Return the view factor between equal facing rectangles x by y at the distance z."""
    a, b = x / z, y / z
    p, q = 1.0 + a * a, 1.0 + b * b
    return (
        2.0 / (math.pi * a * b) * (
            0.5 * math.log(p * q / (p + q - 1.0))
            + a * math.sqrt(q) * math.atan(a / math.sqrt(q))
            + b * math.sqrt(p) * math.atan(b / math.sqrt(p))
            - a * math.atan(a) - b * math.atan(b)
        )
    )  # fmt: skip


def perpendicular(edge: float, depth: float, height: float) -> float:
    """Return the view factor between rectangles ``edge x depth`` and ``edge x height`` on one edge."""
    w, h = depth / edge, height / edge
    w2, h2 = w * w, h * h
    s = w2 + h2
    logs = (
        math.log((1 + w2) * (1 + h2) / (1 + s))
        + w2 * math.log(w2 * (1 + s) / ((1 + w2) * s))
        + h2 * math.log(h2 * (1 + s) / ((1 + h2) * s))
    )
    angles = w * math.atan(1 / w) + h * math.atan(1 / h) - math.sqrt(s) * math.atan(1 / math.sqrt(s))
    return (angles + 0.25 * logs) / (math.pi * w)


def sky_part(*surfaces: Surface, rows: int = 1, columns: int = 1, infinite: bool = False) -> np.ndarray:
    """Return the irradiance of the first surface, all from the sky, and its standard error."""
    scene = Scene(surfaces, BLACK, Sun(0.0, 45.0), 0.0, DHI, infinite=infinite)
    found = simulate(scene, rel_tol=0.002, seed=8)[surfaces[0].name]
    assert found.value.shape == (rows, columns)
    both = found.contributions["sky"]
    assert np.array_equal(found.value, both.value)  # black all around: nothing is reflected
    return np.array([both.value, both.standard_error])


@pytest.mark.parametrize(("x", "y", "z"), [(1, 1, 1), (4, 0.5, 0.2), (1, 3, 10), (8, 8, 0.5)])
def test_a_plate_under_a_plate(x: float, y: float, z: float) -> None:
    lower = Surface("lower", (0, 0, 0), (x, 0, 0), (0, y, 0), "black", 1, 1)
    upper = Surface("upper", (0, 0, z), (x, 0, 0), (0, y, 0), "black")
    value, error = sky_part(lower, upper)
    assert value[0, 0] == pytest.approx(DHI * (1.0 - parallel(x, y, z)), abs=4.0 * error[0, 0])
    assert 0.0 < error[0, 0] < 0.003 * value[0, 0]


@pytest.mark.parametrize(("edge", "depth", "height"), [(1.0, 1.0, 1.0), (5.0, 0.3, 2.0), (0.4, 3.0, 0.7)])
def test_a_plate_at_the_foot_of_a_wall(edge: float, depth: float, height: float) -> None:
    ground = Surface("ground", (0, 0, 0), (edge, 0, 0), (0, depth, 0), "black", 1, 1)
    wall = Surface("wall", (0, 0, 0), (edge, 0, 0), (0, 0, height), "black")
    value, error = sky_part(ground, wall)
    factor = perpendicular(edge, depth, height)
    assert value[0, 0] == pytest.approx(DHI * (1.0 - factor), abs=4.0 * error[0, 0])
    assert 0.0 < error[0, 0] < 0.003 * value[0, 0]


def test_the_rows_along_a_corner() -> None:
    # rows of a ground that touches a wall, from the corner outwards: differences of the closed form
    rows, edge, height = 6, 2.0, 3.0
    step = 0.25
    ground = Surface("ground", (0, 0, 0), (edge, 0, 0), (0, rows * step, 0), "black", rows, 1)
    wall = Surface("wall", (0, 0, 0), (edge, 0, 0), (0, 0, height), "black")
    value, error = sky_part(ground, wall, rows=rows)
    reach = [i * step * perpendicular(edge, i * step, height) if i else 0.0 for i in range(rows + 1)]
    expected = DHI * (1.0 - np.diff(reach) / step)
    assert value[:, 0] == pytest.approx(expected, abs=4.0 * float(np.max(error)))
    assert np.max(np.abs(value[:, 0] - expected) / error[:, 0]) < 4.0


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 63.0, 90.0, 120.0, 175.0, 178.0])
def test_a_tilted_plane_sees_half_of_one_plus_cosine(tilt_deg: float) -> None:
    t = math.radians(tilt_deg)
    u, v = (1.0, 0.0, 0.0), (0.0, math.cos(t), -math.sin(t))
    plane = Surface("plane", (3, 2, 1), u, v, "black", 1, 1)
    value, error = sky_part(plane)
    assert plane.normal[2] == pytest.approx(math.cos(t))
    expected = DHI * 0.5 * (1.0 + math.cos(t))
    assert value[0, 0] == pytest.approx(expected, abs=4.0 * error[0, 0] + 1e-12)
    assert error[0, 0] < 0.003 * expected + 1e-4 * DHI * (tilt_deg > 150.0)


@pytest.mark.parametrize(("height", "rows"), [(0.4, 3), (3.0, 6)])
def test_points_in_an_endless_street(height: float, rows: int, canyon: Callable[..., Scene]) -> None:
    # point by point: a wall sees the sky up to the opposite eaves, the ground between both eaves
    black = Optics(0.0)
    result = simulate(canyon(height=height, rows=rows, wall=black, ground=black, dhi=DHI), rel_tol=0.003)

    def wall(z: float) -> float:  # integral of the point's factor over height, width 1
        return 0.5 * (z + math.hypot(height - z, 1.0))

    def ground(x: float) -> float:
        return 0.5 * (math.hypot(x, height) - math.hypot(1.0 - x, height))

    edges = np.linspace(0.0, 1.0, rows + 1)
    for name, integral, scale in (("left", wall, height), ("right", wall, height), ("ground", ground, 1.0)):
        at = edges * scale
        expected = DHI * np.diff([integral(x) for x in at]) / np.diff(at)
        got = result[name].contributions["sky"]
        z = (got.value[:, 0] - expected) / got.standard_error[:, 0]
        assert np.max(np.abs(z)) < 4.0
        assert np.max(got.standard_error) < 0.01 * np.mean(expected)

"""The sun: its place, its disc cut by facades and by the horizon, and the normalisation of the DNI."""

from __future__ import annotations

import datetime
import math

import numpy as np
import pytest

from gonio.facade import Optics, Scene, Sun, Surface, simulate
from gonio.facade.lighting import light_notes, light_of
from gonio.facade.sun import ANGULAR_DIAMETER_DEG, Site, extraterrestrial, sun_at

RADIUS = math.radians(0.5 * ANGULAR_DIAMETER_DEG)
BLACK = {"black": Optics(0.0)}


def plate(normal: np.ndarray) -> Surface:
    """Return a square of 1 m2 that faces `normal`, well away from everything."""
    side = np.cross([0.0, 0.0, 1.0], normal) if abs(normal[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    u = side / np.linalg.norm(side)
    v = np.cross(normal, u)
    return Surface("plate", (0.0, 0.0, 10.0), tuple(u), tuple(v), "black", 1, 1)  # type: ignore[arg-type]


def direct(surface: Surface, sun: Sun, dni: float = 1000.0) -> tuple[float, float]:
    """Return the direct irradiance of a free plate and its standard error, W/m2."""
    result = simulate(Scene((surface,), BLACK, sun, dni, 0.0), rel_tol=1e-3, seed=5)
    found = result["plate"].mean_contributions["direct"]
    return float(found.value), float(found.standard_error)


def cut(x: float) -> tuple[float, float]:
    """Return the visible part of a disc and its mean height over a line, in half-diameters.

    The line runs `x` half-diameters below the centre.  Closed forms of a flat disc.
    """
    root = math.sqrt(1.0 - x * x)
    segment = (0.5 * math.pi + math.asin(x) + x * root) / math.pi
    moment = (x * (0.5 * math.pi + math.asin(x)) + root * (2.0 + x * x) / 3.0) / math.pi
    return segment, moment


@pytest.mark.parametrize("diameter_deg", [0.0, ANGULAR_DIAMETER_DEG, 5.0])
@pytest.mark.parametrize("angle_deg", [0.0, 37.0, 80.0])
def test_a_plate_receives_dni_times_the_cosine_of_the_centre(diameter_deg: float, angle_deg: float) -> None:
    sun = Sun(130.0, 50.0, diameter_deg)
    s = np.array(sun.direction)
    across = np.cross(s, [0.3, -0.2, 0.9])
    across /= np.linalg.norm(across)
    normal = math.cos(math.radians(angle_deg)) * s + math.sin(math.radians(angle_deg)) * across
    value, error = direct(plate(normal), sun)
    # exactly, however large the disc, as long as it is whole: its centre of mass lies on its axis
    expected = 1000.0 * math.cos(math.radians(angle_deg))
    assert value == pytest.approx(expected, abs=4.0 * error + 1e-9)
    assert error < 1e-3 * expected


@pytest.mark.parametrize("angle_deg", [89.75, 89.9, 90.0, 90.1, 90.2])
def test_a_grazing_disc_is_cut_by_the_facade(angle_deg: float) -> None:
    sun = Sun(0.0, 35.0)
    s = np.array(sun.direction)
    level = np.array([1.0, 0.0, 0.0])  # horizontal, across the sun: the facade is vertical only at 90 deg
    beyond = math.radians(90.0 - angle_deg)
    value, error = direct(plate(math.cos(beyond) * level + math.sin(beyond) * s), sun)
    expected = 1000.0 * RADIUS * cut(beyond / RADIUS)[1]
    assert value == pytest.approx(expected, abs=4.0 * error + 1e-4 * expected)
    assert error < 0.03 * expected


def test_a_disc_behind_the_facade_gives_nothing() -> None:
    sun = Sun(0.0, 35.0)
    s = np.array(sun.direction)
    beyond = math.radians(-0.27)
    normal = math.cos(beyond) * np.array([1.0, 0.0, 0.0]) + math.sin(beyond) * s
    assert direct(plate(normal), sun) == (0.0, 0.0)


@pytest.mark.parametrize("elevation_deg", [0.02, 0.1, 0.25])
def test_the_horizon_cuts_the_disc(elevation_deg: float) -> None:
    sun = Sun(90.0, elevation_deg)
    segment, moment = cut(math.radians(elevation_deg) / RADIUS)
    for normal, expected in (
        (np.array([1.0, 0.0, 0.0]), 1000.0 * segment),
        (np.array([0.0, 0.0, 1.0]), 1000.0 * RADIUS * moment),
    ):
        value, error = direct(plate(normal), sun)
        assert value == pytest.approx(expected, abs=4.0 * error + 1e-4 * expected)
    scene = Scene((plate(np.array([1.0, 0.0, 0.0])),), BLACK, sun, 1000.0, 0.0)
    assert f"hides {100.0 * (1.0 - segment):.1f} % of its disc" in light_notes(scene)[0]


def test_below_the_horizon_there_is_no_direct_light_and_it_is_said() -> None:
    scene = Scene((plate(np.array([1.0, 0.0, 0.0])),), BLACK, Sun(90.0, -0.01), 300.0, 0.0)
    assert light_of(scene).dni == 0.0
    result = simulate(scene, rel_tol=0.1)
    assert not np.any(result["plate"].value)
    assert [n for n in result.notes if "300.0 W/m2 is not used" in n]


def test_more_sun_than_there_is_outside_the_atmosphere_is_said() -> None:
    def said(dni: float) -> str:
        scene = Scene((plate(np.array([1.0, 0.0, 0.0])),), BLACK, Sun(90.0, 30.0), dni, 100.0)
        return " ".join(light_notes(scene))

    assert "DNI = 100000 W/m2 is more than arrives outside the atmosphere (1361 W/m2)" in said(1e5)
    assert said(1100.0) == ""


def test_position_of_the_example_of_the_solar_position_algorithm() -> None:
    # Reda and Andreas (2004), A.5: zenith angle 50.11162 deg, azimuth 194.34024 deg
    zone = datetime.timezone(datetime.timedelta(hours=-7))
    site = Site(39.742476, -105.1786, 1830.14, datetime.datetime(2003, 10, 17, 12, 30, 30, tzinfo=zone))
    sun = sun_at(site)
    assert 90.0 - sun.elevation_deg == pytest.approx(50.11162, abs=1e-3)
    assert sun.azimuth_deg == pytest.approx(194.34024, abs=1e-3)


def test_the_sun_is_nearest_in_january() -> None:
    def at(month: int, day: int) -> float:
        when = datetime.datetime(2023, month, day, 12, tzinfo=datetime.UTC)
        return extraterrestrial(Site(45.0, 3.0, 0.0, when))

    # (1 +- e)^-2 with the eccentricity 0.0167 of the Earth's orbit, at perihelion and aphelion
    assert at(1, 4) == pytest.approx(1361.0 / (1.0 - 0.0167) ** 2, rel=1e-3)
    assert at(7, 5) == pytest.approx(1361.0 / (1.0 + 0.0167) ** 2, rel=1e-3)

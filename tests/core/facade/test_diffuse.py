"""Direct light and diffuse exchange, against closed forms and an independent radiosity."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gonio.facade import Irradiance, Optics, Scene, Sun, Surface, simulate

from .peers import radiosity

REFERENCE = Path(__file__).parent / "canyon.csv"
NAMES = {"wall0": "left", "wall1": "right", "ground": "ground"}


def reference(case: str) -> np.ndarray:
    """Radiosity with crossed strings, 10 bands on left, right and ground; the file says how it was made."""
    with REFERENCE.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    found = {(r["surface"], int(r["band"])): float(r["irradiance"]) for r in rows if r["case"] == case}
    return np.array([found[surface, band] for surface in NAMES for band in range(10)])


@pytest.mark.parametrize(("case", "dni", "dhi"), [("sky", 0.0, 1.0), ("sun", 1.0, 0.15)])
def test_two_radiosities_agree(case: str, dni: float, dhi: float) -> None:
    found = radiosity.bands(1.0, walls=0.72, ground=0.2, dni=dni, dhi=dhi, strips=100)
    assert found == pytest.approx(reference(case), rel=3e-7)  # the file states 1.1e-6


@pytest.mark.parametrize(("case", "dni", "dhi"), [("sky", 0.0, 1.0), ("sun", 1.0, 0.15)])
def test_endless_diffuse_canyon(
    case: str, dni: float, dhi: float, canyon: Callable[..., Scene], bands
) -> None:  # type: ignore[no-untyped-def]
    result = simulate(canyon(dni=dni, dhi=dhi), rel_tol=0.0015, seed=1)
    value, se = bands(result)
    expected = reference(case)
    assert result.converged
    assert np.max(np.abs(value / expected - 1.0)) < 0.005
    assert np.max(np.abs(value - expected) / se) < 3.6  # 30 values: 3 would fail in one run of twelve
    assert np.sqrt(np.mean(((value - expected) / se) ** 2)) < 1.4


def test_standard_errors_are_honest_over_seeds(canyon: Callable[..., Scene], bands) -> None:  # type: ignore[no-untyped-def]
    expected = reference("sun")
    z = []
    for seed in range(60):
        value, se = bands(simulate(canyon(dni=1.0, dhi=0.15), rel_tol=0.03, seed=100 + seed))
        z.append((value - expected) / se)
    # 32 replicas: z is Student's t with 31 degrees of freedom, of variance 31/29.
    assert np.var(z) == pytest.approx(31 / 29, rel=0.15)
    assert abs(np.mean(z)) < 4.0 / math.sqrt(np.size(z))


@pytest.mark.parametrize("height", [0.5, 1.0, 3.0])
def test_direct_view_of_the_sky_is_the_view_factor(height: float, canyon: Callable[..., Scene]) -> None:
    result = simulate(canyon(height=height, dhi=100.0), rel_tol=0.003, seed=2)
    diagonal = math.hypot(height, 1.0)
    wall = (height + 1.0 - diagonal) / (2.0 * height)  # Hottel's crossed strings
    ground = diagonal - height
    for name, factor in (("left", wall), ("right", wall), ("ground", ground)):
        sky = result[name].mean_contributions["sky"]
        assert float(sky.value) == pytest.approx(100.0 * factor, abs=3.5 * float(sky.standard_error))
        assert float(sky.standard_error) < 0.2


@pytest.mark.parametrize(
    ("height", "dni", "dhi", "rel_tol", "limit"),
    [
        (1.0, 0.0, 1.0, 7e-5, 1e-4),
        (1.0, 1.0, 0.15, 7e-5, 1e-4),
        (2.0, 0.0, 1.0, 5e-4, 1e-3),
        (2.0, 1.0, 0.15, 5e-4, 1e-3),
    ],
)
def test_transport_rows_reach_the_radiosity(
    height: float, dni: float, dhi: float, rel_tol: float, limit: float, canyon: Callable[..., Scene], bands
) -> None:  # type: ignore[no-untyped-def]
    scene = canyon(height=height, dni=dni, dhi=dhi)
    value, se = bands(simulate(scene, rel_tol=rel_tol, seed=3, estimator="rows"))
    expected = radiosity.bands(height, walls=0.72, ground=0.2, dni=dni, dhi=dhi, strips=100)
    assert np.sqrt(np.mean((value - expected) ** 2)) / expected.mean() < limit
    # 16 replicas: Student's t; 30 bands that share their light
    assert np.max(np.abs(value - expected) / (se + 1e-6 * expected)) < 5.0


def test_white_canyon_under_a_white_sky_is_a_furnace(canyon: Callable[..., Scene], bands) -> None:  # type: ignore[no-untyped-def]
    white = Optics(1.0)
    value, _ = bands(simulate(canyon(wall=white, ground=white, height=2.0, dhi=math.pi), rel_tol=0.01))
    assert value == pytest.approx(np.full(30, math.pi), rel=1e-12)  # pi L with L = 1: no light is lost


def test_free_horizontal_and_vertical_plates() -> None:
    sun = Sun(azimuth_deg=90.0, elevation_deg=30.0, angular_diameter_deg=0.0)
    flat = Surface("flat", (0, 0, 0), (2, 0, 0), (0, 3, 0), "black", 1, 1)
    east = Surface("east", (-30, 0, 5), (0, 1, 0), (0, 0, 1), "black", 1, 1)
    result = simulate(Scene((flat, east), {"black": Optics(0.0)}, sun, 800.0, 100.0), rel_tol=0.005)
    assert float(result["flat"].mean_contributions["direct"].value) == pytest.approx(400.0, rel=1e-12)
    # the plate west of it faces east and stands high: half of the sky, and the whole of the sun
    assert float(result["east"].value[0, 0]) == pytest.approx(
        800 * math.cos(math.radians(30)) + 50.0, rel=3e-3
    )


def test_albedo_0_leaves_only_direct_light(canyon: Callable[..., Scene]) -> None:
    black = Optics(0.0)
    result = simulate(canyon(wall=black, ground=black, dni=1.0, dhi=0.5), rel_tol=0.02)
    for r in result.receivers:
        assert not np.any(r.contributions["diffuse"].value)
        assert not np.any(r.contributions["specular"].value)


def test_half_shadow_of_the_solar_disc() -> None:
    # A wall 200 m in front of a plate covers it from below; the sun is 1.8627 m wide there (0.533 deg).
    diameter_deg = 0.533
    distance = 200.0
    elevation_deg = 20.0
    edge = distance * math.tan(math.radians(elevation_deg))
    rows = 20
    plate = Surface("plate", (0, -0.5, -1.25), (0, 1, 0), (0, 0, 2.5), "black", rows, 1)  # faces east
    wall = Surface("wall", (distance, -500, -900), (0, 1000, 0), (0, 0, 900 + edge), "black")
    scene = Scene((plate, wall), {"black": Optics(0.0)}, Sun(90.0, elevation_deg, diameter_deg), 1000.0, 0.0)
    direct = simulate(scene, rel_tol=0.005, seed=4)["plate"].contributions["direct"]
    height = (np.arange(rows) + 0.5) / rows * 2.5 - 1.25
    # the rim of the wall is `below` half-diameters above the disc's centre
    rim_deg = np.degrees(np.arctan((edge - height) / distance)) - elevation_deg
    below = np.clip(rim_deg / (diameter_deg / 2.0), -1.0, 1.0)
    lit = (np.arccos(below) - below * np.sqrt(1.0 - below**2)) / math.pi
    expected = 1000.0 * math.cos(math.radians(elevation_deg)) * lit
    assert direct.value[:, 0] == pytest.approx(expected, abs=8.0)  # the patches are wide: chord against mean
    assert np.count_nonzero((expected > 20) & (expected < 900)) > 8


def test_a_sealed_room_stays_dark() -> None:
    def inside(name: str, o: tuple[float, ...], u: tuple[float, ...], v: tuple[float, ...]) -> Surface:
        return Surface(name, o, u, v, "white", 1, 1)  # type: ignore[arg-type]

    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    room = (
        inside("floor", (0, 0, 0), x, y), inside("ceiling", (0, 0, 1), y, x),
        inside("west", (0, 0, 0), y, z), inside("east", (1, 0, 0), z, y),
        inside("south", (0, 0, 0), z, x), inside("north", (0, 1, 0), x, z),
    )  # fmt: skip
    result = simulate(Scene(room, {"white": Optics(0.8)}, Sun(150.0, 60.0), 900.0, 100.0), rel_tol=0.05)
    assert all(not np.any(r.value) for r in result.receivers)
    assert result.converged


def test_the_same_bits_on_any_number_of_threads(canyon: Callable[..., Scene], bands) -> None:  # type: ignore[no-untyped-def]
    scene = canyon(wall=Optics(0.6, 1.0, 80.0, 1.5), dni=800.0, dhi=100.0, columns=2, rows=3)
    one, two, three = (simulate(scene, rel_tol=0.02, seed=9, threads=n) for n in (1, 2, 3))
    for other in (two, three):
        assert np.array_equal(bands(one)[0], bands(other)[0])
        assert np.array_equal(bands(one)[1], bands(other)[1])
        assert one.energy == other.energy
        assert one.rays == other.rays
    assert not np.array_equal(bands(one)[0], bands(simulate(scene, rel_tol=0.02, seed=10))[0])


def test_finite_street_tends_to_the_endless_one(canyon: Callable[..., Scene]) -> None:
    long = canyon(dhi=100.0, length=200.0, infinite=False, rows=2, columns=201)
    middle: Irradiance = simulate(long, rel_tol=0.02, seed=1)
    endless = simulate(canyon(dhi=100.0, rows=2), rel_tol=0.002, seed=1)
    for name in ("left", "right", "ground"):
        near = middle[name].value[:, 50:151].mean(axis=1)
        assert near == pytest.approx(endless[name].value[:, 0], rel=0.01)
    sky = middle["left"].contributions["sky"].value
    assert sky[:, [0, -1]].mean() > 1.1 * sky[:, 50:151].mean()  # the open ends show more sky


def test_rel_tol_that_is_out_of_reach_is_said(canyon: Callable[..., Scene]) -> None:
    result = simulate(canyon(dhi=1.0), rel_tol=1e-4, max_rays=300_000)
    assert not result.converged
    assert result.relative_error > 1e-4
    assert any("stopped after" in note for note in result.notes)
    assert replace(result, converged=True).converged

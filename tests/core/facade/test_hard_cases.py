"""Scenes that break renderers, against what must be true of them."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

from gonio.errors import SceneError
from gonio.facade import Irradiance, Optics, Scene, Sky, Sun, Surface, box, parse_scene, simulate, street
from gonio.facade.geometry import Mesh, Vector
from gonio.fresnel import reflectance

BLACK = Optics(0.0)
NOON = Sun(180.0, 45.0, 0.0)

both = pytest.mark.parametrize("estimator", ["rows", "paths"])


def run(scene: Scene, estimator: str, rel_tol: float = 0.01, seed: int = 1) -> Irradiance:
    """Simulate; any warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return simulate(scene, rel_tol=rel_tol, seed=seed, estimator=estimator)  # type: ignore[arg-type]


def mean(result: Irradiance, name: str) -> tuple[float, float]:
    """Return the mean irradiance of a receiver and its standard error."""
    found = result[name].mean
    return float(found.value), float(found.standard_error)


# -- mirrors


def mirrors(height: float, alpha: float, dni: float, dhi: float) -> Scene:
    """Return an endless street of width 1 between mirrors that return 0.9, on black ground."""
    mirror = Optics(0.0, 0.9, alpha, 1.0, constant=True)
    walls = street(
        width_m=1.0, length_m=1.0, height_left_m=height, height_right_m=height, azimuth_deg=0.0,
        left="mirror", right="mirror", ground="black",
    )  # fmt: skip
    return Scene(
        tuple(replace(s, rows=1, columns=1) for s in walls), {"mirror": mirror, "black": BLACK},
        Sun(90.0, 45.0, 0.0), dni, dhi, infinite=True,
    )  # fmt: skip


@both
@pytest.mark.parametrize("alpha", [1e6, 1e8])
def test_sun_between_mirrors_is_a_geometric_series(alpha: float, estimator: str) -> None:
    # At 45 deg the beam crosses the street every metre of depth: left, right, left, ... each time weaker.  At
    # a depth of 4.5 m one half of it arrives after four reflections, one half after five.
    result = run(mirrors(4.5, alpha, 1000.0, 0.0), estimator, rel_tol=0.003)
    beam = 1000.0 * math.sqrt(0.5)
    expected = {
        "left": beam * (1.0 + 0.9**2 + 0.5 * 0.9**4) / 4.5,
        "right": beam * (0.9 + 0.9**3) / 4.5,
        "ground": beam * 0.5 * (0.9**4 + 0.9**5),
    }
    for name, value in expected.items():
        got, error = mean(result, name)
        assert got == pytest.approx(value, abs=4.0 * error + 2e-4 * value)  # the lobe blurs the beam's rims
        assert error < 0.004 * value


@both
def test_sky_between_mirrors_is_a_row_of_images(estimator: str) -> None:
    height = 2.0
    result = run(mirrors(height, 1e8, 0.0, 100.0), estimator, rel_tol=0.003)

    def opening(n: int) -> float:  # view factor from the ground to image n of the opening, crossed strings
        return 0.5 * (math.hypot(n + 1, height) + math.hypot(n - 1, height) - 2.0 * math.hypot(n, height))

    expected = 100.0 * (opening(0) + 2.0 * sum(0.9**n * opening(n) for n in range(1, 300)))
    got, error = mean(result, "ground")
    assert got == pytest.approx(expected, abs=4.0 * error)
    assert error < 0.004 * expected


@both
def test_sun_grazing_a_glossy_facade(estimator: str) -> None:
    # At 89.9 deg the facade cuts the sun's disc, and what it sees is mirrored onto a screen across the way.
    length, height, width, top = 1000.0, 10.0, 0.5, 2.0
    elevation_deg, beyond_deg = 0.5, 0.1
    wall = Surface("wall", (0, 0, 0), (0, length, 0), (0, 0, height), "gloss")  # faces east
    screen = Surface("screen", (0, length + 1.0, 0), (width, 0, 0), (0, 0, top), "black", 1, 1)  # faces south
    sun = Sun(180.0 - beyond_deg, elevation_deg)
    scene = Scene((screen, wall), {"black": BLACK, "gloss": Optics(0.0, 1.0, 1e9, 1.5)}, sun, 1000.0, 0.0)
    assert wall.normal @ np.array(sun.direction) == pytest.approx(
        math.sin(math.radians(beyond_deg)), rel=1e-3
    )

    # the disc in rings and sectors; for each of its directions the part of the screen that its image lights
    radius = math.radians(0.5 * sun.angular_diameter_deg)
    q, turn = np.meshgrid((np.arange(200) + 0.5) / 200, 2.0 * np.pi * (np.arange(240) + 0.5) / 240)
    r, turn = radius * np.sqrt(q.ravel()), turn.ravel()
    s = np.array(sun.direction)
    across = np.array([-s[1], s[0], 0.0]) / math.hypot(s[0], s[1])
    above = np.cross(s, across)
    d = np.cos(r)[:, None] * s + np.sin(r)[:, None] * (
        np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * above
    )
    east, south, up = d[:, 0], -d[:, 1], d[:, 2]
    lit = (east > 0.0) & (up > 0.0)
    returned = reflectance(1.5, np.degrees(np.arccos(np.clip(east, 0.0, 1.0))), "unpolarized")
    part = np.zeros(len(d))
    for x in (np.arange(20) + 0.5) / 20 * width:
        back = np.divide(x * south, east, out=np.full(len(d), np.inf), where=lit) - 1.0
        drop = np.divide(x * up, east, out=np.full(len(d), np.inf), where=lit)
        for z in (np.arange(10) + 0.5) / 10 * top:
            part += lit & (back > 0.0) & (back < length) & (z + drop < height)
    expected = 1000.0 * float(np.mean(returned * south * part / 200.0))

    result = run(scene, estimator, rel_tol=0.01)
    specular = result["screen"].mean_contributions["specular"]
    error = float(specular.standard_error)
    assert float(specular.value) == pytest.approx(expected, abs=4.0 * error + 2e-3 * expected)
    assert error < 0.02 * expected


# -- albedo towards 1


def chamber(albedo: float, dni: float, dhi: float) -> Scene:
    """Return an endless chamber of 1 m x 1 m whose ceiling leaves a slot of 5 cm along its east wall."""
    y = (0.0, 1.0, 0.0)
    return Scene(
        (
            Surface("west", (0, 0, 0), y, (0, 0, 1), "white", 1, 1),
            Surface("east", (1, 0, 0), y, (0, 0, 1), "white", 1, 1, turned=True),
            Surface("floor", (0, 0, 0), y, (1, 0, 0), "white", 1, 1, turned=True),
            Surface("ceiling", (0, 0, 1), y, (0.95, 0, 0), "white", 1, 1),
        ),
        {"white": Optics(albedo)}, Sun(90.0, 60.0, 0.0), dni, dhi, infinite=True,
    )  # fmt: skip


def chamber_by_radiosity(albedo: float, dni: float, dhi: float) -> dict[str, float]:
    """Return the mean irradiances by crossed strings between 100 bands on each surface (all see all)."""
    n = 100
    corners = {
        "west": ((0, 0), (0, 1)), "east": ((1, 0), (1, 1)), "floor": ((0, 0), (1, 0)),
        "ceiling": ((0, 1), (0.95, 1)), "slot": ((0.95, 1), (1, 1)),
    }  # fmt: skip
    ends = np.array([np.linspace(p, q, n + 1) for p, q in corners.values()], float)
    a, b = ends[:, :-1].reshape(-1, 2), ends[:, 1:].reshape(-1, 2)

    def gap(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm(p[:, None] - q[None], axis=2))

    factor = np.abs(gap(a, a) + gap(b, b) - gap(a, b) - gap(b, a))
    factor /= 2.0 * np.linalg.norm(b - a, axis=1)[:, None]
    np.fill_diagonal(factor, 0.0)
    assert factor.sum(axis=1) == pytest.approx(np.ones(5 * n), abs=1e-9)
    first = dhi * factor[: 4 * n, 4 * n :].sum(axis=1)
    shift = 1.0 / math.tan(math.radians(60.0))
    covered = np.clip(np.minimum(b[:, 0], 1.0 - shift) - np.maximum(a[:, 0], 0.95 - shift), 0.0, None) * n
    first[2 * n : 3 * n] += dni * math.sin(math.radians(60.0)) * covered[2 * n : 3 * n]
    e = np.linalg.solve(np.eye(4 * n) - albedo * factor[: 4 * n, : 4 * n], first)
    return dict(zip(corners, e.reshape(4, n).mean(axis=1), strict=False))


@both
@pytest.mark.parametrize(("albedo", "dni", "dhi"), [(0.999, 0.0, 100.0), (0.98, 900.0, 50.0)])
def test_a_white_chamber_with_a_slot(albedo: float, dni: float, dhi: float, estimator: str) -> None:
    result = run(chamber(albedo, dni, dhi), estimator, rel_tol=0.01)
    for name, expected in chamber_by_radiosity(albedo, dni, dhi).items():
        got, error = mean(result, name)
        assert got == pytest.approx(expected, abs=4.0 * error + 2e-3 * expected)
        assert error < 0.02 * expected


@both
def test_a_perfectly_white_chamber_is_as_bright_as_the_sky(estimator: str) -> None:
    result = run(chamber(1.0, 0.0, 100.0), estimator)
    for name in ("west", "east", "floor", "ceiling"):
        assert mean(result, name)[0] == pytest.approx(100.0, rel=1e-6)


# -- thin gaps, seams, coincident surfaces


def corner_factor(width: float, height: float, distance: float) -> float:
    """Return the view factor from a point to a parallel rectangle with a corner straight ahead of it."""
    a, b = width / distance, height / distance
    p, q = math.sqrt(1.0 + a * a), math.sqrt(1.0 + b * b)
    return (a / p * math.atan(b / p) + b / q * math.atan(a / q)) / (2.0 * math.pi)


@both
def test_a_gap_of_1_m_in_a_wall_of_100_m(estimator: str) -> None:
    height, distance, low = 20.0, 10.0, 1.0
    south = Surface("south", (0, -50.0, 0), (0, 49.5, 0), (0, 0, height), "black")
    north = Surface("north", (0, 0.5, 0), (0, 49.5, 0), (0, 0, height), "black")
    behind = Surface("behind", (distance, -1.0, low), (0, 2.0, 0), (0, 0, 0.01), "black", 1, 8, turned=True)
    scene = Scene((behind, south, north), {"black": BLACK}, Sun(270.0, 30.0, 0.0), 1000.0, 100.0)
    result = run(scene, estimator, rel_tol=0.005)
    direct = result["behind"].contributions["direct"].value[0]
    assert direct == pytest.approx([0.0] * 2 + [1000.0 * math.cos(math.radians(30.0))] * 4 + [0.0] * 2)

    def wall(y: float) -> float:  # what both walls hide of the sky, seen from y at the height of the receiver
        def from_axis(at: float) -> float:
            return math.copysign(corner_factor(abs(at), height - low, distance), at)

        return sum(from_axis(b - y) - from_axis(a - y) for a, b in ((-50.0, -0.5), (0.5, 50.0)))

    sky = result["behind"].contributions["sky"]
    for column in range(8):
        y = -1.0 + 0.25 * (column + np.array([0.1127, 0.5, 0.8873]))
        expected = 100.0 * (0.5 - np.dot([5 / 18, 8 / 18, 5 / 18], [wall(v) for v in y]))
        error = sky.standard_error[0, column]
        assert sky.value[0, column] == pytest.approx(expected, abs=4.0 * error + 5e-3)


@both
@pytest.mark.parametrize("azimuth_deg", [0.0, 17.3])
def test_no_light_passes_the_seam_of_two_walls(azimuth_deg: float, estimator: str) -> None:
    turn = math.radians(azimuth_deg)
    ahead = np.array([math.sin(turn), math.cos(turn), 0.0])
    right = np.array([math.cos(turn), -math.sin(turn), 0.0])
    up = np.array([0.0, 0.0, 1.0])

    def at(name: str, o: np.ndarray, u: np.ndarray, v: np.ndarray, n: int = 0) -> Surface:
        vectors: list[Vector] = [(float(x[0]), float(x[1]), float(x[2])) for x in (o, u, v)]
        return Surface(name, *vectors, "black", n, n, sides=2)

    walls = [
        at("one", -30.0 * ahead - 50.0 * up, 30.7 * ahead, 100.0 * up),
        at("two", 0.7 * ahead - 50.0 * up, 31.1 * ahead, 50.3 * up),
        at("three", 0.7 * ahead + 0.3 * up, 31.1 * ahead, 40.0 * up),
    ]
    behind = at("behind", 0.3 * ahead + 2.0 * right, 0.8 * ahead, 0.8 * up, 4)
    sun = Sun(azimuth_deg - 90.0, 0.3, 0.0)
    result = run(Scene((behind, *walls), {"black": BLACK}, sun, 1000.0, 0.0), estimator)
    assert not np.any(result["behind"].contributions["direct"].value)


@both
def test_of_two_coincident_surfaces_the_later_one_counts(estimator: str) -> None:
    ground = Surface("ground", (-2, -2, 0), (4, 0, 0), (0, 4, 0), "black", 2, 2)
    first = Surface("first", (2, -2, 0), (0, 4, 0), (0, 0, 3), "white", turned=True)
    later = replace(first, name="later", material="grey")
    optics = {"black": BLACK, "white": Optics(0.9), "grey": Optics(0.3)}
    sun = Sun(270.0, 40.0)
    doubled = run(Scene((ground, first, later), optics, sun, 800.0, 100.0), estimator, seed=3)
    single = run(Scene((ground, later), optics, sun, 800.0, 100.0), estimator, seed=3)
    assert np.array_equal(doubled["ground"].contributions["diffuse"].value > 0.0, np.ones((2, 2), bool))
    assert doubled["ground"].value == pytest.approx(single["ground"].value, rel=1e-12)


@both
def test_faces_where_two_boxes_touch_are_dark(estimator: str) -> None:
    def block(name: str, x: float) -> tuple[Surface, ...]:
        return box(name, centre_m=(x, 0, 0), size_m=(4.0, 6.0, 5.0), azimuth_deg=0.0, material="white")

    faces = [replace(s, rows=2, columns=2) for s in (*block("a", 0.0), *block("b", 4.0))]
    result = run(Scene(tuple(faces), {"white": Optics(0.8)}, NOON, 800.0, 100.0), estimator, rel_tol=0.05)
    for name in ("a.right", "b.left"):
        assert not np.any(result[name].value)
        assert not np.any(result[name].standard_error)
    assert np.min(result["a.top"].value) > 500.0


# -- no light, no geometry, far away


@both
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (5e5, 4.6e6, 321.0)])
@pytest.mark.parametrize("azimuth_deg", [0.0, 23.7])
@pytest.mark.parametrize("optics", [Optics(0.8), Optics(0.3, 1.0, 1e4, 1.5)])
def test_a_sealed_room_is_dark(shift: Vector, azimuth_deg: float, optics: Optics, estimator: str) -> None:
    walls = box("room", centre_m=shift, size_m=(5.3, 7.1, 2.9), azimuth_deg=azimuth_deg, material="m")
    inside = tuple(replace(s, turned=not s.turned, rows=2, columns=3) for s in walls)
    result = run(
        Scene(inside, {"m": optics}, Sun(150.0, 60.0), 900.0, 100.0, sky=Sky("perez")),
        estimator,
        rel_tol=0.05,
    )
    for receiver in result.receivers:
        assert not np.any(receiver.value)
        assert not np.any(receiver.standard_error)
    assert result.converged


def town(shift: Vector, dni: float = 800.0, dhi: float = 100.0) -> Scene:
    """Return a street with a glossy and a matt side and a block at its end."""
    made = street(
        width_m=12.0, length_m=40.0, height_left_m=15.0, height_right_m=10.0, azimuth_deg=0.0,
        left="gloss", right="matt", ground="matt",
    ) + box("block", centre_m=(0, 30, 0), size_m=(6, 5, 9), azimuth_deg=90.0, material="matt")  # fmt: skip
    x, y, z = shift
    made = tuple(
        replace(
            s, origin_m=(s.origin_m[0] + x, s.origin_m[1] + y, s.origin_m[2] + z),
            rows=2 * (s.name in ("left", "right")), columns=3 * (s.name in ("left", "right")),
        )
        for s in made
    )  # fmt: skip
    optics = {"gloss": Optics(0.3, 1.0, 200.0, 1.5), "matt": Optics(0.6)}
    return Scene(made, optics, Sun(150.0, 35.0), dni, dhi, sky=Sky("cie_clear"))


@both
@pytest.mark.parametrize("shift", [(5e5, 4.6e6, 128.0), (-500000.3, 4600000.7, 123.456)])
def test_500_km_away_the_street_is_the_same(shift: Vector, estimator: str) -> None:
    near, far = (run(town(s), estimator, rel_tol=0.05, seed=4) for s in ((0.0, 0.0, 0.0), shift))
    for name in ("left", "right"):
        assert far[name].value == pytest.approx(near[name].value, rel=1e-6)
        assert far[name].standard_error == pytest.approx(near[name].standard_error, rel=1e-5, abs=1e-9)


@both
def test_without_light_everything_is_dark(estimator: str) -> None:
    result = run(town((0.0, 0.0, 0.0), 0.0, 0.0), estimator)
    assert result.converged
    for receiver in result.receivers:
        assert not np.any(receiver.value)
        assert not np.any(receiver.standard_error)


@both
def test_the_sun_below_the_horizon_leaves_the_sky(estimator: str) -> None:
    set_sun = replace(town((0.0, 0.0, 0.0)), sun=Sun(300.0, -1.0), sky=Sky())
    result = run(set_sun, estimator, rel_tol=0.02)
    without = run(replace(set_sun, dni_w_m2=0.0), estimator, rel_tol=0.02)
    for name in ("left", "right"):
        assert np.array_equal(result[name].value, without[name].value)
        assert not np.any(result[name].contributions["direct"].value)
    assert [n for n in result.notes if "below the horizon" in n and "800.0 W/m2 is not used" in n]


@both
def test_one_triangle(estimator: str) -> None:
    corners = np.array([[0.0, 0.0, 2.0], [3.0, 0.0, 2.0], [0.0, 1.0, 2.0]])
    alone = Mesh(
        "alone", corners, np.array([[0, 1, 2]]), ("m",), np.zeros(1, np.int64), receiver=True
    )  # fmt: skip
    scene = Scene((), {"m": Optics(0.5)}, NOON, 800.0, 100.0, meshes=(alone,))
    got, error = mean(run(scene, estimator, rel_tol=0.001), "alone")
    assert got == pytest.approx(800.0 * math.sqrt(0.5) + 100.0, abs=4.0 * error + 1e-9)


def test_scenes_without_anything_to_compute_are_refused() -> None:
    with pytest.raises(SceneError, match="the scene is empty"):
        Scene((), {"m": BLACK}, NOON, 800.0, 100.0)
    bare = Surface("bare", (0, 0, 0), (1, 0, 0), (0, 1, 0), "m")
    with pytest.raises(SceneError, match=r"empty|no receiver"):
        Scene((bare,), {"m": BLACK}, NOON, 800.0, 100.0)
    text = "receivers = []\n[materials.m]\nalbedo = 0.5\n[sun]\nazimuth_deg = 0.0\nelevation_deg = 45.0\n"
    with pytest.raises(SceneError, match="no surfaces"):
        parse_scene(text + "[irradiance]\ndni_w_m2 = 1.0\ndhi_w_m2 = 1.0\n")


@pytest.mark.parametrize(
    ("u", "v"),
    [((0, 0, 0), (0, 0, 1)), ((1, 0, 0), (2, 0, 0)), ((1, 0, 0), (1, 1e-12, 0)), ((1, 0, 0), (0, 0, 0))],
)
def test_receivers_without_area_are_refused(u: Vector, v: Vector) -> None:
    with pytest.raises(SceneError, match=r"'flat' has an area of (0|1e-12) m2"):
        Scene((Surface("flat", (0, 0, 0), u, v, "m", 1, 1),), {"m": BLACK}, NOON, 800.0, 100.0)

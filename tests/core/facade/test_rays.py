"""No ray leaves a closed body, and each hits what solving every primitive in float64 finds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numba import njit

from gonio.facade import Optics, Surface, box
from gonio.facade.geometry import Mesh
from gonio.facade.intersect import nearest, occluded
from gonio.facade.layout import Geometry
from gonio.facade.pack import pack

FAR = 5e5  # m, of a survey's origin


@njit(nogil=True, error_model="numpy")
def _shoot(g: Any, p: Any, d: Any, own: Any, hit: Any, t: Any, shadow: Any) -> None:
    for i in range(len(p)):
        start, ahead = (p[i, 0], p[i, 1], p[i, 2]), (d[i, 0], d[i, 1], d[i, 2])
        hit[i], t[i], _, _ = nearest(g, start, ahead, own[i])
        shadow[i] = occluded(g, start, ahead, own[i])


def shoot(g: Geometry, p: np.ndarray, d: np.ndarray, own: Any = -1) -> tuple[np.ndarray, np.ndarray]:
    """Return which primitive each ray hits and how far; shadow rays must agree."""
    n = len(p)
    hit, t, shadow = np.empty(n, np.int64), np.empty(n), np.empty(n, bool)
    own = np.ascontiguousarray(np.broadcast_to(np.asarray(own, np.int64), n))
    _shoot(g, np.ascontiguousarray(p), np.ascontiguousarray(d), own, hit, t, shadow)
    assert np.array_equal(shadow, hit >= 0)
    return hit, t


def mesh(corners: np.ndarray, shift: float = 0.0) -> tuple[Geometry, np.ndarray]:
    """Return triangles (n, 3, 3) packed, and the scene's centre."""
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    vertices = corners.reshape(-1, 3) + shift
    packed = pack(
        [], {"m": Optics(0.5)}, meshes=[Mesh("m", vertices, faces, ("m",), np.zeros(len(faces), np.int64))]
    )
    return packed.geometry, packed.centre_m


def rooms(surfaces: Sequence[Surface]) -> tuple[Geometry, np.ndarray]:
    packed = pack(surfaces, {"m": Optics(0.5)})
    return packed.geometry, packed.centre_m


def directions(rng: np.random.Generator, n: int) -> np.ndarray:
    d = rng.normal(size=(n, 3))
    return np.asarray(d / np.linalg.norm(d, axis=1)[:, None])


def sphere(rings: int, columns: int) -> np.ndarray:
    """Return the triangles of a closed sphere of radius 1; its columns make long thin ones."""
    theta, phi = np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, columns + 1)
    phi[-1] = 0.0
    s, c = np.sin(theta), np.cos(theta)
    s[-1] = 0.0
    point = np.stack(
        [s[:, None] * np.cos(phi), s[:, None] * np.sin(phi), np.repeat(c[:, None], columns + 1, 1)], 2
    )
    a, b, e, f = point[:-1, :-1], point[1:, :-1], point[1:, 1:], point[:-1, 1:]
    all_ = np.concatenate(
        [np.stack([a, b, e], 2).reshape(-1, 3, 3), np.stack([a, e, f], 2).reshape(-1, 3, 3)]
    )
    area = np.linalg.norm(np.cross(all_[:, 1] - all_[:, 0], all_[:, 2] - all_[:, 0]), axis=1)
    return np.asarray(all_[area > 0])


@pytest.mark.parametrize("shift", [0.0, FAR])
@pytest.mark.parametrize(("rings", "columns", "stretch"), [(20, 30, 1.0), (2, 3000, 1.0), (30, 40, 1e-3)])
def test_no_ray_leaves_a_closed_mesh(rings: int, columns: int, stretch: float, shift: float) -> None:
    rng = np.random.default_rng(1)
    corners = sphere(rings, columns) * (50.0, 50.0, 50.0 * stretch)
    g, centre = mesh(corners, shift)
    assert len(g.nodes) > 1
    n = 20_000
    inside = directions(rng, n) * (50.0, 50.0, 50.0 * stretch) * rng.uniform(0, 0.6, (n, 1)) + shift - centre
    assert np.all(shoot(g, inside, directions(rng, n))[0] >= 0)
    # aimed at the vertices and at the middles of edges, where neighbours meet
    pick = rng.integers(0, len(corners), n)
    w = rng.integers(0, 2, (n, 2)) * 0.5
    aim = corners[pick, 0] + w[:, :1] * (corners[pick, 1] - corners[pick, 0])
    aim = aim + (w[:, 0] == 0)[:, None] * w[:, 1:] * (corners[pick, 2] - corners[pick, 0]) + shift - centre
    d = aim - inside
    d /= np.linalg.norm(d, axis=1)[:, None]
    assert np.all(shoot(g, inside, d)[0] >= 0)
    for axis in range(3):
        along = np.zeros((n, 3))
        along[:, axis] = rng.choice([-1.0, 1.0], n)
        assert np.all(shoot(g, inside, along)[0] >= 0)


@pytest.mark.parametrize("shift", [0.0, FAR])
@pytest.mark.parametrize("azimuth_deg", [0.0, 33.0])
def test_no_ray_leaves_a_room_from_its_faces_edges_and_corners(azimuth_deg: float, shift: float) -> None:
    rng = np.random.default_rng(2)
    surfaces = box(
        "b", centre_m=(shift, shift, 0.0), size_m=(100.0, 1.0, 30.0), azimuth_deg=azimuth_deg, material="m"
    )
    g, _ = rooms(surfaces)
    n = 30_000
    own = rng.integers(0, 6, n)
    a, b = rng.random((2, n, 1))
    a[: n // 2] = rng.integers(0, 2, (n // 2, 1))  # edges
    b[: n // 4] = rng.integers(0, 2, (n // 4, 1))  # corners
    p = g.origin[own] + a * g.u[own] + b * g.v[own]
    d = directions(rng, n)
    inward = np.einsum("ij,ij->i", d, g.normal[own]) < 0
    d[~inward] *= -1.0
    grazing = rng.random(n) < 0.5  # 89.9999 deg from the normal
    flat = d - np.einsum("ij,ij->i", d, g.normal[own])[:, None] * g.normal[own]
    flat /= np.linalg.norm(flat, axis=1)[:, None]
    d[grazing] = (flat - 1.745e-6 * g.normal[own])[grazing]
    hit, t = shoot(g, p, d, own)
    assert np.all(hit >= 0)
    assert np.all(g.plane[hit] != g.plane[own])
    where = p + t[:, None] * d  # no further out than the room is
    for k in range(6):
        outside = (where - g.origin[k]) @ g.normal[k]
        assert np.max(outside) < 1e-7
    along = np.stack([g.u[own], g.v[own]])[rng.integers(0, 2, n), np.arange(n)] * rng.choice([-1, 1], (n, 1))
    along /= np.linalg.norm(along, axis=1)[:, None]
    middle = 0.5 * (g.origin.min(axis=0) + (g.origin + g.u + g.v).max(axis=0))
    assert np.all(shoot(g, 0.9 * (p - middle) + middle, along)[0] >= 0)
    on_face = np.concatenate([g.origin, g.origin + g.u]) + 0.3 * np.concatenate([g.v, g.v])
    away = np.concatenate([g.u, -g.u])
    found, _ = shoot(g, on_face, away / np.linalg.norm(away, axis=1)[:, None])  # in the plane of a face
    assert np.all(found >= 0)


def test_a_gap_of_a_metre_lets_through_what_it_should() -> None:
    up, east = np.array([0, 0, 100.0]), np.array([1.0, 0, 0])
    walls = [
        Surface("left", (0.0, 0.0, 0.0), tuple(49.5 * east), tuple(up), "m"),
        Surface("right", (50.5, 0.0, 0.0), tuple(49.5 * east), tuple(up), "m"),
    ]
    g, centre = rooms(walls)
    rng = np.random.default_rng(3)
    aim = np.stack([rng.uniform(0.01, 99.99, 20_000), np.zeros(20_000), rng.uniform(0.01, 99.99, 20_000)], 1)
    d = np.array([40.0, -30.0, 50.0]) - aim
    d /= -np.linalg.norm(d, axis=1)[:, None]
    hit, _ = shoot(g, aim - 50.0 * d - centre, d)
    assert np.array_equal(hit < 0, (aim[:, 0] > 49.5) & (aim[:, 0] < 50.5))


def solved(g: Geometry, p: np.ndarray, d: np.ndarray) -> tuple[int, float]:
    """Return the nearest primitive by Cramer's rule for all of them at once."""
    r = p - g.origin
    q = np.cross(d, g.v)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = 1.0 / np.einsum("ij,ij->i", g.u, q)
        a = f * np.einsum("ij,ij->i", r, q)
        s = np.cross(r, g.u)
        b = f * (s @ d)
        t = f * np.einsum("ij,ij->i", g.v, s)
        inside = (a >= 0) & (b >= 0) & (a <= 1) & (b <= 1) & ((g.triangle == 0) | (a + b <= 1)) & (t > 0)
    t = np.where(inside, t, np.inf)
    k = int(np.argmin(t))
    return (k, float(t[k])) if np.isfinite(t[k]) else (-1, np.inf)


def soup(rng: np.random.Generator, m: int, kind: str) -> np.ndarray:
    start = rng.uniform(-100, 100, (m, 3))
    edges = rng.normal(size=(2, m, 3)) * rng.uniform(0.1, 15, (m, 1))
    if kind == "needles":
        edges = np.stack([edges[0] * 5, edges[0] * 4.9 + 1e-3 * edges[1]])
    if kind == "nested":  # a tree that every division makes deeper
        scale = (0.995 ** np.arange(m))[:, None]
        start, edges = start * scale, edges * scale
    if kind == "one place":
        start, edges = 0.0 * start - 0.5 * (edges[0] + edges[1]), edges
    return np.stack([start, start + edges[0], start + edges[1]], 1)


@pytest.mark.parametrize("shift", [0.0, FAR])
@pytest.mark.parametrize("kind", ["any", "needles", "nested", "one place"])
def test_the_nearest_of_many_is_hit(kind: str, shift: float) -> None:
    rng = np.random.default_rng(4)
    g, _ = mesh(soup(rng, 700, kind), shift)
    n = 300
    p = rng.uniform(-120, 120, (n, 3))
    p[:20] *= 1e5  # from far outside
    d = (g.origin + 0.3 * (g.u + g.v))[rng.integers(0, 700, n)] - p + rng.normal(scale=1e-3, size=(n, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    hit, t = shoot(g, p, d)
    expected = [solved(g, *ray) for ray in zip(p, d, strict=True)]
    assert np.mean([k >= 0 for k, _ in expected]) > 0.6
    assert list(hit) == [k for k, _ in expected]
    assert t == pytest.approx([s for _, s in expected], rel=1e-7)


@pytest.mark.parametrize("m", [0, 1, 3, 8, 9, 33])
def test_few_primitives_and_none(m: int) -> None:
    rng = np.random.default_rng(5)
    corners = soup(rng, m, "any") if m else np.zeros((0, 3, 3))
    if m:
        g, _ = mesh(corners)
    else:
        g = pack([], {"m": Optics(0.5)}).geometry
    p, d = rng.uniform(-100, 100, (400, 3)), directions(rng, 400)
    if m:
        d[:200] = (g.origin + 0.3 * (g.u + g.v))[rng.integers(0, m, 200)] - p[:200]
        d[:200] /= np.linalg.norm(d[:200], axis=1)[:, None]
    hit, _ = shoot(g, p, d)
    assert np.sum(hit >= 0) >= (200 if m else 0)
    assert list(hit) == [solved(g, *ray)[0] if m else -1 for ray in zip(p, d, strict=True)]


def test_of_coplanar_primitives_the_one_declared_last_is_hit_at_any_incidence() -> None:
    rng = np.random.default_rng(6)
    wall = Surface("wall", (-50.0, 3.0, 0.0), (100.0, 30.0, 0.0), (0.0, 0.0, 40.0), "m")
    frames = [
        Surface(f"w{i}", (-50 + 100 * x, 3 + 30 * x, z), (1.0, 0.3, 0.0), (0.0, 0.0, 2.0), "m")
        for i, (x, z) in enumerate(zip(rng.uniform(0, 0.9, 30), rng.uniform(0, 37, 30), strict=True))
    ]
    g, _ = rooms([wall, *frames])
    module = np.flatnonzero(g.rank > 0)[rng.integers(0, 30, 5000)]
    a, b = rng.uniform(0.01, 0.99, (2, 5000, 1))
    aim = g.origin[module] + a * g.u[module] + b * g.v[module]
    normal = g.normal[module]
    across = np.cross(normal, directions(rng, 5000))
    across /= np.linalg.norm(across, axis=1)[:, None]
    sine = 10.0 ** rng.uniform(-4, 0, (5000, 1))
    back = sine * normal + np.sqrt(1 - sine**2) * across
    hit, _ = shoot(g, aim + 20.0 * back, -back)
    assert np.all(hit >= 0)
    inside = np.array(
        [
            max(r for r, o, du, dv in zip(g.rank, g.origin, g.dual_u, g.dual_v, strict=True)
                if 0 <= du @ (x - o) <= 1 and 0 <= dv @ (x - o) <= 1)
            for x in aim[:400]
        ]
    )  # fmt: skip
    assert np.array_equal(g.rank[hit[:400]], inside)
    assert np.all(g.rank[hit] > 0)
    assert np.all(shoot(g, aim, back, module)[0] < 0)  # and from it the rays leave the wall behind


def test_trees_are_the_same_each_time_and_shallow_enough_for_the_stack() -> None:
    corners = soup(np.random.default_rng(7), 3000, "nested")
    g, again = mesh(corners)[0], mesh(corners)[0]
    assert g.nodes.tobytes() == again.nodes.tobytes()
    assert np.array_equal(g.rank, again.rank)
    child = g.nodes.view(np.int32)[:, 6]
    depth = np.zeros(len(child), int)
    for node, children in enumerate(child):
        for c in children[children > 0]:
            depth[c] = depth[node] + 1
    assert 7 * (depth.max() + 1) < 512
    assert sorted(g.rank) == list(range(3000))

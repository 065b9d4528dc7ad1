"""Planes and covers against integer geometry and sampling."""

from __future__ import annotations

import numpy as np

from gonio.facade.coplanar import covers, planes


def frame(rng: np.random.Generator) -> np.ndarray:
    """Return a random rotation, (3, 3); its rows are the plane's axes and normal."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.asarray(q * np.sign(np.linalg.det(q)))


def flat(
    corner: np.ndarray, edge_1: np.ndarray, edge_2: np.ndarray, axes: np.ndarray, height: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return origin, u, v, normal of shapes drawn on planes ``height`` along the normal."""
    origin = corner @ axes[:2] + height[:, None] * axes[2]
    u, v = edge_1 @ axes[:2], edge_2 @ axes[:2]
    normal = np.cross(u, v)
    return origin, u, v, normal / np.linalg.norm(normal, axis=1)[:, None]


def test_planes_are_told_apart_at_their_tolerance_and_not_chained() -> None:
    rng = np.random.default_rng(3)
    m = 3000
    corner = rng.uniform(-40, 40, (m, 2))
    edge_1, edge_2 = rng.normal(size=(2, m, 2))
    level = rng.integers(0, 60, m)
    height = level * 0.9 - 25.0 + rng.uniform(-1, 1, m) * 1e-9  # rounding of a file, far below 1e-9 x 100 m
    origin, u, v, normal = flat(corner, edge_1, edge_2, frame(rng), height)
    plane = planes(origin, u, v, normal, 100.0)
    assert len(np.unique(plane)) == len(np.unique(level))
    assert all(len(np.unique(plane[level == i])) == 1 for i in np.unique(level))

    steps = np.arange(50) * 0.6e-7  # each within 1e-7 m of the next, the ends far apart
    square = np.tile([[1.0, 0.0]], (50, 1)), np.tile([[0.0, 1.0]], (50, 1))
    origin, u, v, normal = flat(np.zeros((50, 2)), *square, np.eye(3), steps)
    plane = planes(origin, u, v, normal, 100.0)
    for i in np.unique(plane):
        assert np.ptp(steps[plane == i]) <= 2.001e-7


def test_neighbours_on_a_sphere_are_not_coplanar_however_small_it_is() -> None:
    rng = np.random.default_rng(4)
    n = rng.normal(size=(2000, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    u = np.cross(n, [0.3, 0.5, 0.8])
    u /= np.linalg.norm(u, axis=1)[:, None]
    for radius in (1.0, 1e-4):
        edge = 0.02 * radius
        plane = planes(radius * n, edge * u, edge * np.cross(n, u), n, 1.0)
        assert len(np.unique(plane)) == 2000


def test_covers_are_the_overlaps_of_whole_numbers_and_no_common_edge() -> None:
    rng = np.random.default_rng(5)
    m = 300
    low = rng.integers(0, 60, (m, 2))
    size = rng.integers(1, 7, (m, 2))
    level = rng.integers(0, 3, m)
    turned = rng.random(m) < 0.4
    edge_1, edge_2 = np.zeros((2, m, 2))
    edge_1[:, 0], edge_2[:, 1] = size[:, 0], size[:, 1]
    origin, u, v, normal = flat(low.astype(float), edge_1, edge_2, frame(rng), 7.0 * level)
    normal[turned] *= -1.0
    plane = planes(origin, u, v, normal, 100.0)
    first, cover = covers(
        origin, u, v, normal, plane, np.ones(m, np.uint8), triangle=np.zeros(m, np.uint8), periodic=False
    )
    touching = 0
    for i in range(m):
        gap = np.maximum(low, low[i]) - np.minimum(low + size, low[i] + size[i])
        same = (level == level[i]) & (np.arange(m) != i)
        touching += int(np.sum(same & (gap.max(axis=1) == 0)))
        over = same & (gap.max(axis=1) < 0) & ((np.arange(m) > i) | (turned != turned[i]))
        assert sorted(cover[first[i] : first[i + 1]]) == list(np.flatnonzero(over))
    assert touching > 100


def test_triangles_cover_what_random_points_find_covered() -> None:
    rng = np.random.default_rng(6)
    m = 60
    corner = rng.uniform(0, 10, (m, 2))
    edge_1, edge_2 = rng.normal(scale=1.5, size=(2, m, 2))
    triangle = (rng.random(m) < 0.7).astype(np.uint8)
    origin, u, v, normal = flat(corner, edge_1, edge_2, frame(rng), np.zeros(m))
    plane = planes(origin, u, v, normal, 20.0)
    assert np.all(plane == 0)
    first, cover = covers(
        origin, u, v, normal, plane, np.ones(m, np.uint8), triangle=triangle, periodic=False
    )
    s = rng.random((10_000, 2))
    missed = extra = 0
    for i in range(m):
        a, b = s[:, 0], s[:, 1]
        keep = (a + b <= 1.0) | (triangle[i] == 0)
        point = corner[i] + np.outer(a[keep], edge_1[i]) + np.outer(b[keep], edge_2[i])
        for j in range(m):
            x = np.linalg.solve(np.column_stack([edge_1[j], edge_2[j]]), (point - corner[j]).T)
            inside = (x.min(axis=0) >= 0) & (x.max(axis=0) <= 1) & ((x.sum(axis=0) <= 1) | (triangle[j] == 0))
            wanted = j != i and (j > i or normal[i] @ normal[j] < 0)
            listed = j in cover[first[i] : first[i + 1]]
            missed += bool(wanted and inside.any() and not listed)
            extra += bool(listed and not (wanted and inside.mean() > 0))
    assert missed == 0
    assert len(cover) > 100
    assert extra <= 0.03 * len(cover)  # slivers that the points do not find


def test_a_mesh_with_common_edges_covers_nothing_and_a_module_on_it_is_found() -> None:
    k = 40
    a, b = (x.ravel().astype(float) for x in np.meshgrid(np.arange(k), np.arange(k)))
    corner = np.concatenate([np.stack([a, b], 1), np.stack([a + 1, b + 1], 1), [[3.25, 4.25]]])
    one = np.ones(len(a))
    edge_1 = np.concatenate([np.outer(one, [1, 0]), np.outer(one, [-1, 0]), [[0.5, 0.0]]])
    edge_2 = np.concatenate([np.outer(one, [0, 1]), np.outer(one, [0, -1]), [[0.0, 0.5]]])
    origin, u, v, normal = flat(
        corner, edge_1, edge_2, frame(np.random.default_rng(7)), np.zeros(len(corner))
    )
    triangle = np.ones(len(corner), np.uint8)
    triangle[-1] = 0
    plane = planes(origin, u, v, normal, 60.0)
    assert np.all(plane == 0)
    first, cover = covers(
        origin, u, v, normal, plane, np.ones(len(corner), np.uint8), triangle=triangle, periodic=False
    )
    assert np.all(cover == len(corner) - 1)
    assert sorted(np.flatnonzero(np.diff(first))) == [4 * k + 3, k * k + 4 * k + 3]


def test_bands_of_an_endless_street_overlap_by_their_width() -> None:
    origin = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 4], [0, 0, 2]])
    u = np.tile([10.0, 0, 0], (4, 1))
    v = np.array([[0, 0, 5.0], [0, 0, 1.0], [0, 0, 3.0], [0, 0, 2.0]])
    normal = np.tile([0, -1.0, 0], (4, 1))
    first, cover = covers(
        origin, u, v, normal, np.zeros(4, np.int64), np.ones(4, np.uint8),
        triangle=np.zeros(4, np.uint8), periodic=True,
    )  # fmt: skip
    assert [list(cover[first[i] : first[i + 1]]) for i in range(4)] == [[1, 2, 3], [], [], []]

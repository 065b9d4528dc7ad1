from __future__ import annotations

import numpy as np
import pytest

from gonio.facade import Mesh, Optics, Surface, box, module
from gonio.facade.layout import Geometry
from gonio.facade.pack import Packed, pack, triangle_cells
from gonio.facade.tracing import patch_at

MATERIALS = {"a": Optics(0.1), "b": Optics(0.2, 1.5, 30.0, 1.4), "c": Optics.two_coefficients(0.3, 0.4)}
WALL = Surface("wall", (0, 0, 0), (4, 0, 0), (0, 0, 3), "a", 3, 2)
SHEET = Surface("sheet", (0, 5, 0), (2, 0, 0), (0, 0, 1), "b", 2, 2, turned=True, sides=2)
SCREEN = Surface("screen", (0, 9, 0), (2, 0, 0), (0, 0, 1), "c")
TENT = Mesh(
    name="tent",
    vertices_m=np.array([(0, 20, 0), (3, 20, 0), (0, 20, 3), (0, 24, 0)], float),
    faces=np.array([(0, 1, 2), (0, 2, 3)]),
    materials=("c", "a"),
    face_material=np.array([1, 0]),
    receiver=True,
    sides=2,
)


def at(packed: Packed, declared: int) -> int:
    """Where a primitive is stored."""
    return int(np.flatnonzero(packed.geometry.rank == declared)[0])


def test_primitives_keep_what_they_were_declared_as() -> None:
    packed = pack((WALL, SHEET, SCREEN), MATERIALS, meshes=(TENT,))
    g = packed.geometry
    assert sorted(g.rank) == [0, 1, 2, 3, 4]
    assert packed.cells == 3 * 2 + 2 * 2 + 2
    corners = np.array([(0, 0, 0), (4, 24, 3)], float)
    assert packed.centre_m == pytest.approx(corners.mean(axis=0))
    assert g.extent == pytest.approx(np.linalg.norm(corners[1] - corners[0]) / 2)
    materials = [MATERIALS[n].row() for n in ("a", "b", "c", "a", "c")]
    for k, (u, v, row, sides, triangle) in enumerate(
        zip(
            [(4, 0, 0), (2, 0, 0), (2, 0, 0), (3, 0, 0), (0, 0, 3)],
            [(0, 0, 3), (0, 0, 1), (0, 0, 1), (0, 0, 3), (0, 4, 0)],
            materials, [1, 2, 1, 2, 2], [0, 0, 0, 1, 1], strict=True,
        )
    ):  # fmt: skip
        i = at(packed, k)
        assert (tuple(g.u[i]), tuple(g.v[i])) == (u, v)
        assert g.sides[i] == sides
        assert g.triangle[i] == triangle
        assert tuple(g.materials[g.optics[i]]) == row
        normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v)) * (-1 if k == 1 else 1)
        assert g.normal[i] == pytest.approx(normal)
        assert g.area[i] == pytest.approx(np.linalg.norm(np.cross(u, v)) * (0.5 if triangle else 1.0))
        dual = np.array([g.dual_u[i], g.dual_v[i]]) @ np.array([g.u[i], g.v[i]]).T
        assert dual == pytest.approx(np.eye(2), abs=1e-15)


def test_patches_cover_both_sides_and_belong_to_the_cells_of_the_result() -> None:
    packed = pack(
        (WALL, SHEET, SCREEN), MATERIALS, meshes=(TENT,),
        grids={"wall": (6, 4), "screen": (1, 5), "tent": (3, 3)},
    )  # fmt: skip
    g, p = packed.geometry, packed.patches
    assert len(p.area) == 24 + 2 * 4 + 5 + 2 * 2 * 9
    expected = [12.0, 2.0, 2.0, 4.5, 6.0]
    for k, area in enumerate(expected):
        for back in (0, 1):
            own = (p.primitive == at(packed, k)) & (p.back == back)
            assert p.area[own].sum() == pytest.approx(area if back < g.sides[at(packed, k)] else 0.0)
            if np.any(own):  # patches of one side follow each other, where the geometry says
                first, rows, columns = g.patch[at(packed, k), back]
                count = rows * rows if g.triangle[at(packed, k)] else rows * columns
                assert np.array_equal(np.flatnonzero(own), first + np.arange(count))
            else:
                assert g.patch[at(packed, k), back, 0] == -1
    # every cell of the result is made of patches of its size, on fronts only
    assert np.all(p.receiver[p.back == 1] == -1)
    area = np.bincount(p.receiver[p.receiver >= 0], p.area[p.receiver >= 0], packed.cells)
    assert area == pytest.approx([2.0] * 6 + [0.5] * 4 + [4.5, 6.0])
    # cell 5 of the wall is its upper right one: rows of patches 4 and 5, columns 2 and 3
    place = p.cell[(p.receiver == 5) & (p.primitive == at(packed, 0))]
    assert sorted(zip(np.round(place[:, 1] * 6), np.round(place[:, 0] * 4), strict=True)) == [
        (4, 2), (4, 3), (5, 2), (5, 3)
    ]  # fmt: skip


@pytest.mark.parametrize("k", [1, 2, 3, 7])
def test_cells_of_a_triangle_are_found_where_they_lie(k: int) -> None:
    packed = pack((), MATERIALS, meshes=(TENT,), grids={"tent": (k, k)})
    g, p = packed.geometry, packed.patches
    assert len(triangle_cells(k)) == k * k
    rng = np.random.default_rng(k)
    for i in range(len(p.area)):
        s, t = rng.random(2)
        if s + t > 1.0:
            s, t = 1.0 - s, 1.0 - t
        a, b = p.cell[i, 0] + s * p.cell[i, 2], p.cell[i, 1] + t * p.cell[i, 3]
        assert a >= 0.0
        assert b >= 0.0
        assert a + b <= 1.0 + 1e-12
        assert patch_at.py_func(g, p.primitive[i], p.back[i], a, b) == i
        assert p.area[i] == pytest.approx(g.area[p.primitive[i]] / k**2)


def test_a_survey_far_away_changes_nothing() -> None:
    def shifted(by: np.ndarray) -> Geometry:
        blocks = box("b", centre_m=tuple(by), size_m=(4.0, 6.0, 8.0), azimuth_deg=33.0, material="a")
        return pack((*blocks, module("m", blocks[0], at_m=(1.0, 1.0), size_m=(1.0, 2.0))), MATERIALS).geometry

    here, there = shifted(np.zeros(3)), shifted(np.array([512_345.678, 4_612_345.678, 1234.5]))
    for name in ("origin", "u", "v", "normal", "area"):
        a, b = getattr(here, name)[np.argsort(here.rank)], getattr(there, name)[np.argsort(there.rank)]
        assert b == pytest.approx(a, abs=2e-9)  # half a unit in the last place of 4.6e6 m
    for g in (here, there):
        plane = g.plane[np.argsort(g.rank)]
        assert plane[6] == plane[0]  # the module lies on its host
        assert len(set(plane)) == 6
        host, on = (int(np.flatnonzero(g.rank == k)[0]) for k in (0, 6))
        assert on in g.cover[g.cover_first[host] : g.cover_first[host + 1]]
        assert host not in g.cover[g.cover_first[on] : g.cover_first[on + 1]]


def test_patches_of_many_faces_are_made_together() -> None:
    n = 30
    x, y = (c.ravel() for c in np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0)))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + n + 1], 1), np.stack([i + n + 2, i + n + 1, i + 1], 1)])
    height = np.sin(x) * np.cos(y)
    land = Mesh(
        "land", np.stack([x, y, height], 1), faces, ("a",), np.zeros(2 * n * n, np.int64), receiver=True
    )
    packed = pack((), MATERIALS, meshes=(land,), grids={"land": (2, 2)})
    assert packed.cells == 2 * n * n
    assert np.array_equal(np.bincount(packed.patches.receiver), np.full(2 * n * n, 4))
    corner = land.vertices_m[faces]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    assert np.bincount(packed.patches.receiver, packed.patches.area) == pytest.approx(area)

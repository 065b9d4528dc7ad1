"""How do surfaces and meshes become the arrays that the kernels read?

Coordinates are shifted so that the scene's centre is the origin: what a ray loses by rounding then depends on
the size of the scene, not on where a survey put it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.facade import bvh
from gonio.facade.coplanar import covers, planes
from gonio.facade.geometry import Mesh, Surface
from gonio.facade.layout import FloatArray, Geometry, IntArray, Patches
from gonio.facade.optics import Optics


@dataclass(frozen=True, slots=True)
class Packed:
    """A scene for the kernels.

    `cells` is the number of cells of the result: those of the receiving surfaces in their order (rows x
    columns, row by row), then one for each face of the receiving meshes.
    """

    geometry: Geometry
    patches: Patches
    centre_m: FloatArray
    cells: int


@dataclass(slots=True)
class _Shapes:
    """Primitives in the order in which they were declared."""

    origin: FloatArray  # (m, 3) world
    u: FloatArray
    v: FloatArray
    turned: NDArray[np.bool_]
    triangle: NDArray[np.uint8]
    sides: NDArray[np.uint8]
    optics: IntArray
    grid: IntArray  # (m, 2) rows, columns of patches on each reflecting side, 0: none
    receiver: IntArray  # (m, 3) first cell of the result or -1, rows, columns


def pack(
    surfaces: Sequence[Surface],
    materials: Mapping[str, Optics],
    *,
    meshes: Sequence[Mesh] = (),
    periodic: bool = False,
    grids: Mapping[str, tuple[int, int]] | None = None,
) -> Packed:
    """Return the arrays of a scene.

    Parameters
    ----------
    grids
        Patches of each surface as (rows, columns), multiples of its receiver's; of a mesh as (k, k), which
        divides every face into k^2.  Surfaces and meshes without an entry have those of their receivers, or
        none.
    """
    shapes, table, cells = _collect(surfaces, materials, meshes, grids or {})
    corners = np.concatenate([shapes.origin, shapes.origin + shapes.u, shapes.origin + shapes.v])
    fourth = shapes.triangle == 0
    corners = np.concatenate([corners, (shapes.origin + shapes.u + shapes.v)[fourth]])
    if len(corners):
        centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        extent = float(np.max(np.linalg.norm(corners - centre, axis=1)))
    else:
        centre, extent = np.zeros(3), 1.0
    origin = shapes.origin - centre
    cross = np.cross(shapes.u, shapes.v).reshape(-1, 3)
    length = np.linalg.norm(cross, axis=1)
    normal = cross / length[:, None]
    dual_u = np.cross(shapes.v, normal) / length[:, None]
    dual_v = np.cross(normal, shapes.u) / length[:, None]
    normal[shapes.turned] *= -1.0
    plane = planes(origin, shapes.u, shapes.v, normal, extent)
    cover_first, cover = covers(
        origin, shapes.u, shapes.v, normal, plane, shapes.sides, triangle=shapes.triangle, periodic=periodic
    )
    tree = bvh.build(
        origin, shapes.u, shapes.v, normal, dual_u, dual_v, shapes.triangle, plane, extent, periodic=periodic
    )
    order = tree.order

    side_grid, patches = _patches(shapes, length)
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    first, from_declared = _reordered(cover_first, order)
    geometry = Geometry(
        origin=_stored(origin, order),
        u=_stored(shapes.u, order),
        v=_stored(shapes.v, order),
        normal=_stored(normal, order),
        dual_u=_stored(dual_u, order),
        dual_v=_stored(dual_v, order),
        area=_stored(length * np.where(shapes.triangle > 0, 0.5, 1.0), order),
        triangle=np.ascontiguousarray(shapes.triangle[order]),
        sides=np.ascontiguousarray(shapes.sides[order]),
        plane=np.ascontiguousarray(plane[order]),
        rank=np.ascontiguousarray(order.astype(np.int64)),
        optics=np.ascontiguousarray(shapes.optics[order]),
        patch=np.ascontiguousarray(side_grid[order]),
        cover_first=first,
        cover=place[cover[from_declared]],
        materials=table,
        nodes=tree.nodes,
        leaves=tree.leaves,
        record=tree.record,
        extent=extent,
        periodic=periodic,
    )
    return Packed(geometry, patches._replace(primitive=place[patches.primitive]), centre, cells)


def _reordered(first: IntArray, order: IntArray) -> tuple[IntArray, IntArray]:
    """Return the starts (m + 1,) of lists put into another order, and where their items were before."""
    count = np.diff(first)[order]
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    return start, np.arange(start[-1]) + np.repeat(first[:-1][order] - start[:-1], count)


def _stored(array: FloatArray, order: IntArray) -> FloatArray:
    return np.ascontiguousarray(array[order])


def _collect(
    surfaces: Sequence[Surface],
    materials: Mapping[str, Optics],
    meshes: Sequence[Mesh],
    grids: Mapping[str, tuple[int, int]],
) -> tuple[_Shapes, FloatArray, int]:
    names = list(materials)
    number = {name: i for i, name in enumerate(names)}
    table = np.array([materials[name].row() for name in names], np.float64).reshape(-1, 5)
    cells = 0
    parts: list[_Shapes] = []
    n = len(surfaces)
    receiver = np.full((n, 3), -1, np.int64)
    grid = np.zeros((n, 2), np.int64)
    for i, s in enumerate(surfaces):
        if s.rows:
            receiver[i] = cells, s.rows, s.columns
            cells += s.rows * s.columns
        grid[i] = grids.get(s.name, (s.rows, s.columns))
    origin, u, v = (
        np.array([getattr(s, key) for s in surfaces], np.float64).reshape(-1, 3)
        for key in ("origin_m", "u_m", "v_m")
    )
    parts.append(
        _Shapes(
            origin=origin,
            u=u,
            v=v,
            turned=np.array([s.turned for s in surfaces], bool),
            triangle=np.zeros(n, np.uint8),
            sides=np.array([s.sides for s in surfaces], np.uint8),
            optics=np.array([number[s.material] for s in surfaces], np.int64),
            grid=grid,
            receiver=receiver,
        )
    )
    for mesh in meshes:
        corner = mesh.vertices_m[mesh.faces]
        count = len(mesh.faces)
        receiver = np.full((count, 3), -1, np.int64)
        if mesh.receiver:
            receiver[:, 0] = cells + np.arange(count)
            receiver[:, 1:] = 1
            cells += count
        each = grids.get(mesh.name, (1, 1) if mesh.receiver else (0, 0))
        parts.append(
            _Shapes(
                corner[:, 0],
                corner[:, 1] - corner[:, 0],
                corner[:, 2] - corner[:, 0],
                np.zeros(count, bool),
                np.ones(count, np.uint8),
                np.full(count, mesh.sides, np.uint8),
                np.array([number[name] for name in mesh.materials], np.int64)[mesh.face_material],
                np.tile(np.array(each, np.int64), (count, 1)),
                receiver,
            )
        )
    joined = _Shapes(*(np.concatenate([getattr(p, key) for p in parts]) for key in _Shapes.__slots__))
    return joined, table, cells


def _patches(shapes: _Shapes, length: FloatArray) -> tuple[IntArray, Patches]:
    """Return first patch, rows, columns of both sides, (m, 2, 3), and the patches, in declared order."""
    m = len(shapes.grid)
    sides = shapes.sides.astype(np.int64)
    each = np.where(shapes.triangle > 0, shapes.grid[:, 0] ** 2, shapes.grid[:, 0] * shapes.grid[:, 1])
    start = np.concatenate([[0], np.cumsum(each * sides)]).astype(np.int64)
    count = int(start[-1])
    side_grid = np.full((m, 2, 3), -1, np.int64)
    used = each > 0
    for side in (0, 1):
        here = used & (sides > side)
        side_grid[here, side, 0] = start[:-1][here] + side * each[here]
        side_grid[here, side, 1:] = shapes.grid[here]
    primitive = np.repeat(np.arange(m), each * sides)
    back = np.zeros(count, np.uint8)
    cell = np.zeros((count, 4))
    receiver = np.full(count, -1, np.int64)
    kind = np.column_stack([shapes.triangle, shapes.grid, shapes.receiver[:, 1:]])[used]
    kinds, which = np.unique(kind, axis=0, return_inverse=True)  # primitives with one grid have one pattern
    for number, (triangle, rows, columns, r_rows, r_columns) in enumerate(kinds):
        members = np.flatnonzero(used)[which.reshape(-1) == number]
        cells, own = _pattern(triangle, rows, columns, r_rows, r_columns)
        front = start[members][:, None] + np.arange(len(cells))
        cell[front] = cells
        first = shapes.receiver[members, :1]
        receiver[front] = np.where(first >= 0, first + own, -1)
        behind = front[sides[members] == 2] + len(cells)
        cell[behind] = cells
        back[behind] = 1
    share = np.abs(cell[:, 2] * cell[:, 3]) * np.where(shapes.triangle[primitive] > 0, 0.5, 1.0)
    return side_grid, Patches(
        primitive=primitive, back=back, cell=cell, area=share * length[primitive], receiver=receiver
    )


def _pattern(
    triangle: int, rows: int, columns: int, r_rows: int, r_columns: int
) -> tuple[FloatArray, IntArray]:
    """Return the cells of one primitive, (n, 4), and in which cell of its receiver each one lies, (n,)."""
    if triangle:
        cells = triangle_cells(rows)
        return cells, np.zeros(len(cells), np.int64)
    b, a = (x.ravel() for x in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    cells = np.stack([a / columns, b / rows, np.full(a.size, 1 / columns), np.full(a.size, 1 / rows)], 1)
    return cells, (b * r_rows // rows) * r_columns + a * r_columns // columns


def triangle_cells(k: int) -> FloatArray:
    """Return the k^2 cells of the triangle ``a + b <= 1``, (k^2, 4), as `tracing.patch_at` counts them."""
    cells = []
    for i in range(k):
        for j in range(k - i):
            cells.append((i / k, j / k, 1 / k, 1 / k))
            if j < k - i - 1:
                cells.append(((i + 1) / k, (j + 1) / k, -1 / k, -1 / k))
    return np.array(cells, np.float64)

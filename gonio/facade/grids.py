"""Into how many patches is each surface divided for the exchange of diffuse light?

Patches hold one exitance each, which is the only thing the exchange leaves out; how much that is worth is
measured by solving again with neighbours merged two by two (`coarser`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from gonio.facade.geometry import Mesh
from gonio.facade.layout import Geometry, IntArray, Patches
from gonio.facade.scene import Scene

_PATCHES = 128
"""Patches of a scene of one size, about, before they are divided further."""


def choose(scene: Scene, fineness: Mapping[str, int]) -> dict[str, tuple[int, int]]:
    """Return rows and columns of every surface, k and k of every mesh.

    `fineness` 2, 4, ... divides edges further, by name.  A receiver's patches divide the cells of its own
    grid.  In an endless street nothing depends on the place along it, and only the rows are divided.  What
    reflects nothing diffusely is divided no further than its receiver.
    """
    emitting = {
        name
        for band in range(max(1, len(scene.bands)))
        for name, optics in scene.in_band(band).materials.items()
        if optics.rho_d > 0.0
    }
    area = sum(s.area_m2 for s in scene.surfaces) + sum(float(np.sum(_face_areas(m))) for m in scene.meshes)
    usual = math.sqrt(area / _PATCHES)
    if scene.infinite:
        usual = 2.0 * sum(float(np.linalg.norm(s.v_m)) for s in scene.surfaces) / _PATCHES
    found: dict[str, tuple[int, int]] = {}
    for s in scene.surfaces:
        rows, columns = s.rows or 1, s.columns or 1
        if s.material in emitting:
            height, width = (float(np.linalg.norm(x)) for x in (s.v_m, s.u_m))
            edge = usual / fineness.get(s.name, 1)
            rows = _divided(rows, height, edge)
            columns = columns if scene.infinite else _divided(columns, width, edge)
        found[s.name] = rows, columns
    for m in scene.meshes:
        largest = float(np.max(_face_areas(m), initial=0.0))
        k = max(1, round(math.sqrt(2.0 * largest) / usual * fineness.get(m.name, 1)))
        found[m.name] = k, k
    return found


def count(scene: Scene, fineness: Mapping[str, int]) -> int:
    """Return the number of patches of all reflecting sides."""
    grids = choose(scene, fineness)
    flat = sum(s.sides * math.prod(grids[s.name]) for s in scene.surfaces)
    return flat + sum(m.sides * len(m.faces) * math.prod(grids[m.name]) for m in scene.meshes)


def _divided(cells: int, length: float, edge: float) -> int:
    """Return a multiple of `cells` that makes pieces of about `edge`; even, so that they merge in pairs."""
    each = max(1, round(length / cells / edge))
    if length / cells > 0.5 * edge and each * cells % 2:
        each += 1
    return cells * each


def _face_areas(mesh: Mesh) -> np.ndarray:
    corner = mesh.vertices_m[mesh.faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.asarray(0.5 * np.linalg.norm(cross, axis=1))


def coarser(g: Geometry, patches: Patches) -> IntArray:
    """Return for every patch the number of the group it belongs to when neighbours merge, (n,).

    Two by two on rectangles, four by four parts on triangles; what has no neighbour stays alone.
    """
    n = len(patches.area)
    k = patches.primitive
    side = patches.back.astype(np.int64)
    first, rows, columns = (g.patch[k, side, i] for i in range(3))
    a0, b0, da, db = patches.cell.T
    low_a, low_b = np.minimum(a0, a0 + da), np.minimum(b0, b0 + db)
    column = np.rint(low_a * columns).astype(np.int64) // 2
    row = np.rint(low_b * rows).astype(np.int64) // 2
    # in a triangle, pieces that stand on their head merge with those around them where they fill a larger one
    key = np.stack([first, row, column], axis=1)
    _, group = np.unique(key, axis=0, return_inverse=True)
    return np.asarray(group, np.int64).reshape(n)

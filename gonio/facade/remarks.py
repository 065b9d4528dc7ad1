"""What in a scene can be computed but is probably not meant?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gonio.facade.coplanar import TOLERANCE
from gonio.facade.geometry import FloatArray, Mesh, Surface

_POINTS = 4  # along each edge of a patch
_EDGE = 1e-9


def remarks(surfaces: Sequence[Surface], meshes: Sequence[Mesh], *, periodic: bool) -> tuple[str, ...]:
    """Return a sentence for each receiver that lies under another surface or under the ground.

    Coverings are found by points, 4 x 4 in each patch; of meshes only faces that stand on a rectangle.
    """
    found: list[str] = []
    corners = {s.name: _corners(s) for s in surfaces}
    everything = [*corners.values(), *(m.vertices_m for m in meshes)]
    if not everything:
        return ()
    points = np.concatenate(everything)
    tolerance_m = TOLERANCE * float(np.linalg.norm(np.ptp(points, axis=0)))
    for i, s in enumerate(surfaces):
        if s.rows:
            hidden = _hidden_patches(i, surfaces, tolerance_m, periodic=periodic)
            if hidden == s.rows * s.columns:
                found.append(f"receiver '{s.name}' lies wholly under other surfaces: nothing reaches it")
            elif hidden:
                found.append(
                    f"receiver '{s.name}': {hidden} of {s.rows * s.columns} patches lie wholly under other "
                    "surfaces; nothing reaches them"
                )
    for mesh in meshes:
        if mesh.receiver:
            under = int(np.sum(_standing_faces(mesh, surfaces, tolerance_m)))
            if under:
                found.append(
                    f"receiver '{mesh.name}': {under} of {len(mesh.faces)} faces stand wholly on other "
                    "surfaces; nothing reaches them"
                )
    ground_m = _level(surfaces, tolerance_m)
    if ground_m is not None:
        receivers = [(s.name, corners[s.name]) for s in surfaces if s.rows]
        receivers += [(m.name, m.vertices_m[m.faces].reshape(-1, 3)) for m in meshes if m.receiver]
        for name, at in receivers:
            top = float(np.max(at[:, 2]))
            if top < ground_m - tolerance_m:
                found.append(f"receiver '{name}' lies {ground_m - top:.4g} m and more below the ground")
    return tuple(found)


def _corners(s: Surface) -> FloatArray:
    o, u, v = (np.asarray(x, np.float64) for x in (s.origin_m, s.u_m, s.v_m))
    return np.array([o, o + u, o + v, o + u + v])


def _level(surfaces: Sequence[Surface], tolerance_m: float) -> float | None:
    """Return the height of the surface called "ground" if it is level."""
    for s in surfaces:
        if s.name == "ground" and np.ptp(_corners(s)[:, 2]) <= tolerance_m:
            return float(s.origin_m[2])
    return None


def _hidden_patches(i: int, surfaces: Sequence[Surface], tolerance_m: float, *, periodic: bool) -> int:
    """Return how many patches of surface `i` lie under coplanar surfaces of higher rank or that touch it."""
    s = surfaces[i]
    o, u, v = (np.asarray(x, np.float64) for x in (s.origin_m, s.u_m, s.v_m))
    covers = []
    for j, other in enumerate(surfaces):
        if j == i or (j < i and float(other.normal @ s.normal) > 0.0):
            continue
        if np.max(np.abs((_corners(other) - o) @ s.normal)) <= tolerance_m:
            covers.append(other)
    if not covers:
        return 0
    b, a = np.meshgrid(
        (np.arange(s.rows * _POINTS) + 0.5) / (s.rows * _POINTS),
        (np.arange(s.columns * _POINTS) + 0.5) / (s.columns * _POINTS),
        indexing="ij",
    )
    p = o + a[..., None] * u + b[..., None] * v
    under = np.zeros(a.shape, bool)
    for other in covers:
        edges = np.array([other.u_m, other.v_m], np.float64)
        place = (p - np.asarray(other.origin_m)) @ np.linalg.pinv(edges)
        inside = (place[..., 1] >= 0.0) & (place[..., 1] <= 1.0)
        if not periodic:
            inside &= (place[..., 0] >= 0.0) & (place[..., 0] <= 1.0)
        under |= inside
    cells = under.reshape(s.rows, _POINTS, s.columns, _POINTS)
    return int(np.sum(np.all(cells, axis=(1, 3))))


def _standing_faces(mesh: Mesh, surfaces: Sequence[Surface], tolerance_m: float) -> NDArray[np.bool_]:
    """Return which faces of a mesh lie on a surface that faces them, (f,)."""
    corner = mesh.vertices_m[mesh.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    standing = np.zeros(len(corner), bool)
    for s in surfaces:
        o = np.asarray(s.origin_m)
        flat = np.all(np.abs((corner - o) @ s.normal) <= tolerance_m, axis=1)
        flat &= normal @ s.normal < 0.0
        if np.any(flat):
            place = (corner[flat] - o) @ np.linalg.pinv(np.array([s.u_m, s.v_m], np.float64))
            standing[flat] |= np.all((place >= -_EDGE) & (place <= 1.0 + _EDGE), axis=(1, 2))
    return standing

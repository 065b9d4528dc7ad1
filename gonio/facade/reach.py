"""Which simplifications change nothing at all?  Found from the scene alone, without a ray.

- Bands whose materials are the same: transport is linear, so the sum over bands is one band.
- Polarization when light cannot go from lobe to lobe: sun, sky and diffuse reflections are unpolarised, so a
  first lobe returns the mean of S and P, and what follows is blind to the rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.facade.reduce import glossy_materials, used_materials

if TYPE_CHECKING:
    from gonio.facade.scene import Scene

FloatArray = NDArray[np.float64]

MANY = 1500
"""Glossy faces beyond which pairs are not looked at, and light is taken to go from lobe to lobe."""

FLAT = 1e-9
"""Height over a plane, relative to the size of the scene, that counts as in the plane (as in the tracer)."""


def is_grey(scene: Scene) -> bool:
    """Say whether every band has the materials of the average, so that one band is exact."""
    used = used_materials(scene)
    return all(band.materials[name] == scene.materials[name] for band in scene.bands for name in used)


def lobe_meets_lobe(scene: Scene) -> bool:
    """Say whether light may go straight from one glossy face to another: each is partly before the other.

    What stands between is not looked at, so the answer may be true in vain, never false in vain.  Faces of an
    endless street keep their planes wherever they repeat, so the test holds there too.
    """
    corners, normals, sides = _glossy_faces(scene)
    count = len(corners)
    if count > MANY:
        return True
    if count < 2:
        return False
    span = float(np.max(np.ptp(corners.reshape(-1, 3), axis=0)))
    # height of corner c of face j over the plane of face i
    offset = corners - corners[:, :1].mean(axis=0)
    own = np.einsum("ik,ik->i", normals, offset[:, 0])
    height = np.einsum("ik,jck->ijc", normals, offset) - own[:, None, None]
    before = np.where(
        sides[:, None] == 2, np.max(np.abs(height), axis=2), np.max(height, axis=2)
    ) > FLAT * max(span, 1e-300)
    return bool(np.any(before & before.T))


def _glossy_faces(scene: Scene) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Return corners (m, 4, 3), unit normals (m, 3) and sides (m,); a triangle repeats its last corner."""
    glossy = set(glossy_materials(scene))
    corners: list[FloatArray] = []
    normals: list[FloatArray] = []
    sides: list[int] = []
    for s in scene.surfaces:
        if s.material in glossy:
            o, u, v = (np.asarray(x, np.float64) for x in (s.origin_m, s.u_m, s.v_m))
            corners.append(np.stack([o, o + u, o + v, o + u + v])[None])
            normals.append(s.normal[None])
            sides.append(s.sides)
    for mesh in scene.meshes:
        chosen = np.isin(mesh.face_material, [k for k, name in enumerate(mesh.materials) if name in glossy])
        if not np.any(chosen):
            continue
        found = mesh.vertices_m[mesh.faces[chosen]]
        cross = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
        corners.append(np.concatenate([found, found[:, 2:]], axis=1))
        normals.append(cross / np.linalg.norm(cross, axis=1)[:, None])
        sides += [mesh.sides] * len(found)
    if not corners:
        return np.zeros((0, 4, 3)), np.zeros((0, 3)), np.zeros(0, np.int64)
    return np.concatenate(corners), np.concatenate(normals), np.array(sides, np.int64)

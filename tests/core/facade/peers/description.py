"""What do the peers get?  A scene as plain arrays: triangles, materials, light, and the patches to measure.

Nothing here comes from the arrays of our own kernels (`gonio.facade.pack`), so that a mistake made there
shows.  Endless streets become streets so long that their ends do not matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.facade import Scene
from gonio.facade.lighting import light_of

FloatArray = NDArray[np.float64]

END_EFFECT = 1e-5
"""Part of a patch's view that may leave through the far ends of a street that stands for an endless one.

All surfaces of such a street have normals across it, so the part within an angle x of its axis is of the
order x^3: 46 times the cross-section suffice.
"""


@dataclass(frozen=True, slots=True)
class Patch:
    """Where irradiance is wanted, n patches: ``origin + a u + b v``, on a triangle only ``a + b <= 1``."""

    origin: FloatArray  # (n, 3) m
    u: FloatArray
    v: FloatArray
    normal: FloatArray  # (n, 3) unit, towards the side that is lit
    triangle: NDArray[np.bool_]  # (n,)


@dataclass(frozen=True, slots=True)
class Description:
    """A scene for a peer, metres from the centre of its bounding box.

    `materials` has the rows (rho_d, rho_s, alpha, n2, constant); `sky` the seven numbers of the formula in
    `gonio.facade.skylight`, which the peers evaluate themselves.
    """

    corners: FloatArray  # (t, 3, 3) triangles, counter-clockwise seen from the reflecting side
    material: NDArray[np.int64]  # (t,)
    two_sided: NDArray[np.bool_]  # (t,)
    materials: FloatArray  # (k, 5)
    conserving: bool
    sun: FloatArray  # (3,) unit, towards the sun
    sun_diameter: float  # rad
    dni: float  # W/m2
    sky: FloatArray  # (7,)
    patches: Patch
    extent: float  # m, radius of what is not made longer


def sky_numbers(scene: Scene) -> FloatArray:
    """Return the seven numbers of the scene's sky; a test checks that they make its DHI."""
    return light_of(scene).sky


def sky_radiance(numbers: FloatArray, sun: FloatArray, d: FloatArray) -> FloatArray:
    """Return the radiance (n,) of the sky in unit directions d (n, 3), W/m2/sr; black below the horizon."""
    scale, a, b, k, c, d_, e = numbers
    cosine = np.clip(d @ sun, -1.0, 1.0)
    gamma = np.arccos(cosine)
    gradation = 1.0 + a * np.exp(b / np.maximum(d[:, 2], 0.01))
    value = scale * gradation * (k + c * np.exp(d_ * gamma) + e * cosine**2)
    return np.where(d[:, 2] > 0.0, np.maximum(value, 0.0), 0.0)


def describe(scene: Scene) -> Description:
    """Return the scene for a peer; patches row by row, receiver after receiver, then mesh faces."""
    names = list(scene.materials)
    corners: list[FloatArray] = []
    material: list[int] = []
    two_sided: list[bool] = []
    patches: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, bool]] = []
    spread = [np.asarray(p) for s in scene.surfaces for p in _corners(s)]
    spread += [m.vertices_m.reshape(-1, 3) for m in scene.meshes]
    points = np.concatenate([p.reshape(-1, 3) for p in spread])
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    extent = float(np.max(np.linalg.norm(points - centre, axis=1)))
    for s in scene.surfaces:
        o, u, v = (np.array(x, np.float64) for x in (s.origin_m, s.u_m, s.v_m))
        o = o - centre
        for row in range(s.rows):
            for column in range(s.columns):
                start = o + column / s.columns * u + row / s.rows * v
                patches.append((start, u / s.columns, v / s.rows, s.normal, False))
        for first, length in _pieces(extent / float(np.linalg.norm(u))) if scene.infinite else [(0.0, 1.0)]:
            start, along = o + first * u, length * u
            quad = np.array([start, start + along, start + along + v, start + v])
            if s.turned:
                quad = quad[::-1]
            corners += [quad[[0, 1, 2]], quad[[0, 2, 3]]]
            material += 2 * [names.index(s.material)]
            two_sided += 2 * [s.sides == 2]
    for mesh in scene.meshes:
        for face, number in zip(mesh.faces, mesh.face_material, strict=True):
            p = mesh.vertices_m[face] - centre
            corners.append(p)
            material.append(names.index(mesh.materials[number]))
            two_sided.append(mesh.sides == 2)
            if mesh.receiver:
                normal = np.cross(p[1] - p[0], p[2] - p[0])
                patches.append((p[0], p[1] - p[0], p[2] - p[0], normal / np.linalg.norm(normal), True))
    columns = list(zip(*patches, strict=True))
    return Description(
        corners=np.array(corners),
        material=np.array(material, np.int64),
        two_sided=np.array(two_sided, bool),
        materials=np.array([_row(scene, name) for name in names], np.float64),
        conserving=scene.energy == "conserving",
        sun=np.array(scene.sun.direction),
        sun_diameter=math.radians(scene.sun.angular_diameter_deg),
        dni=scene.direct_w_m2,
        sky=sky_numbers(scene),
        patches=Patch(*(np.array(c, np.float64) for c in columns[:4]), np.array(columns[4], bool)),
        extent=extent,
    )


def _pieces(extent: float) -> list[tuple[float, float]]:
    """Return (start, length) of the pieces of an endless surface, in units of its cell.

    The piece around the patches is short, because a renderer in float32 loses a far corner's digits there.
    """
    far = math.ceil(extent * END_EFFECT ** (-1.0 / 3.0))
    near = math.ceil(2.0 * extent)
    return [(-float(far), far - near), (-float(near), 2.0 * near + 1.0), (near + 1.0, far - near)]


def _corners(s: object) -> tuple[FloatArray, ...]:
    o, u, v = (np.array(getattr(s, key), np.float64) for key in ("origin_m", "u_m", "v_m"))
    return o, o + u, o + v, o + u + v


def _row(scene: Scene, name: str) -> tuple[float, float, float, float, float]:
    m = scene.materials[name]
    return m.rho_d, m.rho_s, m.alpha, m.n2, float(m.constant)

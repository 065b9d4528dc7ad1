"""Where are the surfaces?  Rectangles, meshes, streets, boxes.

World coordinates in metres: x east, y north, z up.  Azimuths are clockwise from north.  A `Surface` is the
rectangle ``origin + a u + b v``, 0 <= a, b <= 1; its reflecting side is where ``u x v`` points, or the other
if `turned`.

A street runs along its azimuth.  Seen that way the facade "left" stands on the left hand and "right" on the
right, both facing the street.  Receiver columns run along the azimuth, rows from the ground up (on the
ground: from the left facade to the right one).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Surface:
    """A named opaque rectangle; `rows` and `columns` (0: none) divide it into the patches of a receiver.

    With `sides` 2 it reflects on its back as well, which is black otherwise.  The patches of a receiver are
    on its front, whatever its sides.  Where surfaces lie in one plane, the one declared last hides the rest.
    """

    name: str
    origin_m: Vector
    u_m: Vector
    v_m: Vector
    material: str
    rows: int = 0
    columns: int = 0
    turned: bool = False
    sides: int = 1

    @property
    def area_m2(self) -> float:
        """Area in m2."""
        return float(np.linalg.norm(np.cross(self.u_m, self.v_m)))

    @property
    def normal(self) -> FloatArray:
        """Unit normal of the reflecting side, (3,)."""
        n = np.cross(self.u_m, self.v_m)
        return np.asarray((-n if self.turned else n) / np.linalg.norm(n))


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Opaque triangles; with `receiver` every face is a patch of the result, on its front.

    From a file by `gonio.facade.mesh.read_mesh`, or from arrays.

    Parameters
    ----------
    vertices_m, faces
        (k, 3) float64 in metres, and (f, 3) int64; the front is where the vertices run counter-clockwise.
    materials, face_material
        Names, and the number of the name for each face, (f,) int64.
    sides
        2: both sides reflect; 1: the back is black.
    """

    name: str
    vertices_m: FloatArray
    faces: NDArray[np.int64]
    materials: tuple[str, ...]
    face_material: NDArray[np.int64]
    receiver: bool = False
    sides: int = 1


def heading(azimuth_deg: float) -> Vector:
    """Return the horizontal unit vector of an azimuth (clockwise from north), exact at every 90 deg."""
    quarter, rest = divmod(azimuth_deg, 90.0)
    s, c = math.sin(math.radians(rest)), math.cos(math.radians(rest))
    east, north = [(s, c), (c, -s), (-s, -c), (-c, s)][int(quarter) % 4]
    return east, north, 0.0


def street(
    *,
    width_m: float,
    length_m: float,
    height_left_m: float,
    height_right_m: float,
    azimuth_deg: float,
    left: str,
    right: str,
    ground: str,
) -> tuple[Surface, Surface, Surface]:
    """Return the facades "left" and "right" and the "ground" between them, centred at (0, 0, 0)."""
    ahead = np.array(heading(azimuth_deg))
    to_right = np.array(heading(azimuth_deg + 90.0))
    up = np.array([0.0, 0.0, 1.0])
    along = length_m * ahead
    start_left = -0.5 * along - 0.5 * width_m * to_right
    start_right = -0.5 * along + 0.5 * width_m * to_right
    return (
        Surface("left", _vector(start_left), _vector(along), _vector(height_left_m * up), left),
        Surface(
            "right", _vector(start_right), _vector(along), _vector(height_right_m * up), right, turned=True
        ),
        Surface(
            "ground", _vector(start_left), _vector(along), _vector(width_m * to_right), ground, turned=True
        ),
    )


def box(
    name: str, *, centre_m: Vector, size_m: Vector, azimuth_deg: float, material: str
) -> tuple[Surface, ...]:
    """Return the six outward faces of a box: ``name.front``, back, left, right, top, bottom.

    `centre_m` is the middle of the base, `size_m` is (width across, depth along the azimuth, height).  The
    front face looks along the azimuth; "left" and "right" are those of somebody inside who looks out of the
    front.
    """
    ahead = np.array(heading(azimuth_deg))
    to_right = np.array(heading(azimuth_deg + 90.0))
    width, depth, height = size_m
    base = np.array(centre_m)
    r, a, up = width * to_right, depth * ahead, np.array([0.0, 0.0, height])
    corner = base - 0.5 * r - 0.5 * a  # rear left, at the base
    faces = {
        "front": (corner + a + r, -r, up),
        "back": (corner, r, up),
        "left": (corner + a, -a, up),
        "right": (corner + r, a, up),
        "top": (corner + up, r, a),
        "bottom": (corner + r, -r, a),
    }
    return tuple(
        Surface(f"{name}.{face}", _vector(o), _vector(u), _vector(v), material)
        for face, (o, u, v) in faces.items()
    )


def _vector(array: FloatArray) -> Vector:
    x, y, z = (float(c) + 0.0 for c in array)
    return x, y, z

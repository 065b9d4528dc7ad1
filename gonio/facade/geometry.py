"""Where are the surfaces?  Streets, boxes, and the tree that finds what a ray hits.

World coordinates in metres: x east, y north, z up.  Azimuths are clockwise from north.  A `Surface` is the
rectangle ``origin + a u + b v``, 0 <= a, b <= 1; its reflecting side is where ``u x v`` points, or the other
if `turned`.

A street runs along its azimuth.  Seen that way the facade "left" stands on the left hand and "right" on the
right, both facing the street.  Receiver columns run along the azimuth, rows from the ground up (on the
ground: from the left facade to the right one).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.errors import SceneError
from gonio.facade.layout import Surfaces
from gonio.facade.optics import Optics

FloatArray = NDArray[np.float64]
Vector = tuple[float, float, float]

_LEAF = 4  # surfaces that share a leaf of the tree


@dataclass(frozen=True, slots=True)
class Surface:
    """A named opaque rectangle; `rows` and `columns` (0: none) divide it into the patches of a receiver."""

    name: str
    origin_m: Vector
    u_m: Vector
    v_m: Vector
    material: str
    rows: int = 0
    columns: int = 0
    turned: bool = False

    @property
    def area_m2(self) -> float:
        """Area in m2."""
        return float(np.linalg.norm(np.cross(self.u_m, self.v_m)))

    @property
    def normal(self) -> FloatArray:
        """Unit normal of the reflecting side, (3,)."""
        n = np.cross(self.u_m, self.v_m)
        return np.asarray((-n if self.turned else n) / np.linalg.norm(n))


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


def check(surfaces: Sequence[Surface], materials: Mapping[str, Optics], *, periodic: bool) -> None:
    """Raise `SceneError` for a surface that cannot be traced: no area, no material, a name used twice."""
    seen: set[str] = set()
    for s in surfaces:
        if s.name in seen:
            raise SceneError(f"two surfaces are called '{s.name}'; give each its own name")
        seen.add(s.name)
        edges = np.array([s.origin_m, s.u_m, s.v_m])
        if not np.all(np.isfinite(edges)):
            raise SceneError(
                f"surface '{s.name}' has a coordinate that is not a finite number of metres; correct it"
            )
        lengths = np.linalg.norm(edges[1:], axis=1)
        if np.min(lengths) == 0.0 or s.area_m2 < 1e-9 * float(np.prod(lengths)):
            raise SceneError(
                f"surface '{s.name}' has an area of {s.area_m2:g} m2 "
                f"(edges {lengths[0]:g} m and {lengths[1]:g} m); "
                "give it two edges that span a rectangle"
            )
        if s.material not in materials:
            raise SceneError(
                f"surface '{s.name}' is made of '{s.material}', which is not among the materials "
                f"({', '.join(sorted(materials)) or 'none'}); name one of them or add it"
            )
        if (s.rows > 0) != (s.columns > 0) or min(s.rows, s.columns) < 0:
            raise SceneError(
                f"receiver '{s.name}' has {s.rows} x {s.columns} patches; give at least 1 row and 1 column"
            )
    if periodic:
        cell = np.asarray(surfaces[0].u_m) if surfaces else np.zeros(3)
        for s in surfaces:
            u = np.asarray(s.u_m)
            if np.linalg.norm(u - cell) > 1e-9 * np.linalg.norm(cell):
                raise SceneError(
                    f"surface '{s.name}' does not run along the infinite street for the length of its cell; "
                    "set street.infinite = false to mix the street with other bodies"
                )


def pack(
    surfaces: Sequence[Surface], materials: Mapping[str, Optics], *, periodic: bool
) -> tuple[Surfaces, list[int]]:
    """Return the surfaces as the kernels want them, and the order in which they are stored.

    The first patch of each receiver is numbered in the order of `surfaces`, not of storage.
    """
    origin, u, v = (
        np.array([getattr(s, key) for s in surfaces], dtype=np.float64).reshape(-1, 3)
        for key in ("origin_m", "u_m", "v_m")
    )
    corners = np.stack([origin, origin + u, origin + v, origin + u + v], axis=1)
    low, high = corners.min(axis=1), corners.max(axis=1)
    margin = (
        1e-8 * np.maximum(np.linalg.norm(u, axis=1), np.linalg.norm(v, axis=1))[:, None]
    )  # as the kernels' edges
    low, high = low - margin, high + margin
    if periodic:
        low, high = np.full_like(low, -np.inf), np.full_like(high, np.inf)
    boxes, links, order = _tree(low, high)

    first, patch = 0, np.full((len(surfaces), 3), -1, dtype=np.int64)
    for i, s in enumerate(surfaces):
        if s.rows > 0:
            patch[i] = first, s.rows, s.columns
            first += s.rows * s.columns

    cross = np.cross(u, v).reshape(-1, 3)
    area = np.linalg.norm(cross, axis=1)
    normal = cross / area[:, None]
    dual_u = np.cross(v, normal) / area[:, None]
    dual_v = np.cross(normal, u) / area[:, None]
    normal[[s.turned for s in surfaces]] *= -1.0
    optics = [materials[s.material] for s in surfaces]
    material = np.array([(m.rho_d, m.rho_s, m.alpha, m.n2) for m in optics], dtype=np.float64).reshape(-1, 4)

    def stored(array: FloatArray) -> FloatArray:
        return np.ascontiguousarray(array[order])

    return (
        Surfaces(
            origin=stored(origin),
            u=stored(u),
            v=stored(v),
            normal=stored(normal),
            dual_u=stored(dual_u),
            dual_v=stored(dual_v),
            area=stored(area),
            material=stored(material),
            patch=np.ascontiguousarray(patch[order]),
            low=np.ascontiguousarray(boxes[:, 0]),
            high=np.ascontiguousarray(boxes[:, 1]),
            link=links,
        ),
        [int(i) for i in order],
    )


def _tree(low: FloatArray, high: FloatArray) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]:
    """Return boxes (nodes, 2, 3), links (nodes, 3) and the order of the surfaces, depth first.

    Every node is split where the surface area heuristic (sum of child area times child count) is least.
    """
    boxes: list[FloatArray] = []
    links: list[list[int]] = []
    order: list[int] = []

    def build(members: NDArray[np.int64]) -> None:
        node = len(boxes)
        boxes.append(np.array([low[members].min(axis=0), high[members].max(axis=0)]))
        links.append([0, 0, 0])
        if len(members) <= _LEAF or not np.all(np.isfinite(boxes[node])):
            links[node][1:] = [len(order), len(members)]
            order.extend(int(m) for m in members)
        else:
            for part in _best_split(members, low, high):
                build(part)
        links[node][0] = len(boxes)

    if len(low):
        build(np.arange(len(low), dtype=np.int64))
    return (
        np.array(boxes, dtype=np.float64).reshape(-1, 2, 3),
        np.array(links, dtype=np.int64).reshape(-1, 3),
        np.array(order, dtype=np.int64),
    )


def _best_split(
    members: NDArray[np.int64], low: FloatArray, high: FloatArray
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    count = len(members)
    best_cost, best = math.inf, (members[: count // 2], members[count // 2 :])
    for axis in range(3):
        ordered = members[np.argsort(low[members, axis] + high[members, axis], kind="stable")]
        ahead = _half_areas(low[ordered], high[ordered])
        behind = _half_areas(low[ordered[::-1]], high[ordered[::-1]])[::-1]
        left = np.arange(1, count)
        cost = ahead[:-1] * left + behind[1:] * (count - left)
        at = int(np.argmin(cost))
        if cost[at] < best_cost:
            best_cost, best = float(cost[at]), (ordered[: at + 1], ordered[at + 1 :])
    return best


def _half_areas(low: FloatArray, high: FloatArray) -> FloatArray:
    """Half the surface area of the box around the first 1, 2, ... members, (n,)."""
    d = np.maximum.accumulate(high, axis=0) - np.minimum.accumulate(low, axis=0)
    return np.asarray(d[:, 0] * d[:, 1] + d[:, 1] * d[:, 2] + d[:, 2] * d[:, 0])

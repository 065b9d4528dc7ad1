"""How does a mesh file become a `Mesh` of the scene?  Placed, given materials, checked, turned outwards."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gonio.errors import SceneError
from gonio.facade.geometry import Mesh, Vector, heading
from gonio.facade.mesh_file import METRES, Part, read_parts
from gonio.facade.winding import FloatArray, IntArray, wind

EVERYTHING_ELSE = "*"
"""In a mapping of materials: the parts of the file that are not named."""

SLIVER = 1e-9
"""Height of a triangle over its longest edge below which its normal is noise."""

_Y_UP = (".gltf", ".glb")  # by their standard
_LARGE_M, _SMALL_M = 1e4, 1e-3
_COARSE_M = 1e-3


def read_mesh(
    path: str | Path,
    material: str | Mapping[str, str],
    *,
    name: str | None = None,
    metres_per_unit: float | None = None,
    position_m: Vector = (0.0, 0.0, 0.0),
    azimuth_deg: float = 0.0,
    up: Literal["z", "y"] | None = None,
    sides: Literal["auto", 1, 2] = "auto",
    receiver: bool = False,
) -> tuple[Mesh, tuple[str, ...]]:
    """Return the mesh of a file, and sentences on what was assumed and changed.

    Parameters
    ----------
    path
        A file that trimesh can read.
    material
        Of the whole mesh, or by the name of a material, group, object or node of the file; ``"*"`` stands for
        those not named.
    name
        None: the file's, without its ending.
    metres_per_unit
        None: the unit the file states, or else metres.
    position_m, azimuth_deg
        Where the file's origin stands, and the azimuth of the file's y axis (once z is up).
    up
        The file's vertical axis; None: y for glTF, whose standard says so, z for all others.
    sides
        Reflecting sides of each face.  ``"auto"``: a closed mesh is turned outwards and has one; an open one
        has two, and its fronts are where its vertices run counter-clockwise.
    receiver
        Whether the irradiance on the front of every face is wanted.

    Raises
    ------
    SceneError
        No such file, none that holds faces, coordinates that are not finite, faces that are almost but not
        quite without area, a material name that the file does not have or that is given to no part.
    """
    path = Path(path)
    name = path.stem if name is None else name
    parts, unit = read_parts(path)
    notes: list[str] = []
    scale = metres_per_unit
    if scale is None:
        scale = METRES.get(unit or "", 1.0)
        if scale != 1.0:
            notes.append(f"the file's unit is '{unit}'")
    if not (0.0 < scale < np.inf):
        raise SceneError(f"{path}: metres_per_unit = {scale:g} is no length; give metres, such as 0.001")
    vertices, faces, used, of_face, labels = _joined(path, parts, material)
    _check_precision(vertices, scale, notes)
    vertices, faces, keep = _without_doubles(path, vertices, faces, labels, notes)
    both_ways = keep.both_ways
    if both_ways and sides == 1:
        raise SceneError(
            f"{path}: {labels(keep.first_double)} lies on another face that looks the other way; "
            'such thin walls need sides = 2 (or "auto")'
        )
    of_face = of_face[keep.faces]
    vertices = _placed(vertices * scale, up or ("y" if path.suffix.lower() in _Y_UP else "z"), azimuth_deg)
    reflecting = sides if sides != "auto" else 2
    if sides == "auto" and not both_ways:
        wound = wind(vertices, faces)
        faces = wound.faces
        reflecting = 1 if wound.closed else 2
        if wound.turned:
            notes.append(f"{wound.turned} faces were turned outwards")
    if sides == "auto":
        notes.append("open, both sides reflect" if reflecting == 2 else "closed, one side reflects")
    extent = np.ptp(vertices[faces].reshape(-1, 3), axis=0)
    size = " x ".join(f"{x:.4g}" for x in extent)
    if not _SMALL_M < float(np.max(extent)) < _LARGE_M:
        notes.append(f"measures {size} m: is metres_per_unit = {scale:g} right?")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    head = f"mesh '{name}': {path.name} (sha256 {digest}), {len(faces)} faces, {size} m"
    mesh = Mesh(
        name=name,
        vertices_m=vertices + np.asarray(position_m),
        faces=faces,
        materials=used,
        face_material=of_face,
        receiver=receiver,
        sides=reflecting,
    )
    return mesh, ("; ".join([head, *notes]),)


# -- materials


class _Labels:
    """Name a face for a message: its number counts from 0 in its part of the file."""

    def __init__(self, parts: list[Part]) -> None:
        self.first = np.cumsum([0, *(len(p.faces) for p in parts)])
        self.names = [p.names[0] for p in parts]

    def __call__(self, face: int) -> str:
        part = int(np.searchsorted(self.first, face, side="right")) - 1
        here = f" of '{self.names[part]}'" if len(self.names) > 1 else ""
        return f"face {face - int(self.first[part])}{here}"


def _joined(
    path: Path, parts: list[Part], material: str | Mapping[str, str]
) -> tuple[FloatArray, IntArray, tuple[str, ...], IntArray, _Labels]:
    """Return vertices, faces, material names, the material of each face, and names for messages."""
    chosen = [_material_of(path, p, parts, material) for p in parts]
    if not isinstance(material, str):
        there = {n for p in parts for n in p.names} | {EVERYTHING_ELSE}
        unknown = [n for n in material if n not in there]
        if unknown:
            raise SceneError(
                f"{path}: has no material, group or object '{unknown[0]}'; it has "
                + ", ".join(dict.fromkeys(p.names[0] for p in parts))
            )
    used = tuple(dict.fromkeys(chosen))
    offset = np.cumsum([0, *(len(p.vertices) for p in parts)])
    for p in parts:
        if not np.all(np.isfinite(p.vertices)):
            bad = int(np.argmin(np.all(np.isfinite(p.vertices), axis=1)))
            raise SceneError(
                f"{path}: vertex {bad} of '{p.names[0]}' has a coordinate that is not a finite number; "
                "repair the file"
            )
    return (
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + k for p, k in zip(parts, offset, strict=False)]),
        used,
        np.repeat([used.index(c) for c in chosen], [len(p.faces) for p in parts]),
        _Labels(parts),
    )


def _material_of(path: Path, part: Part, parts: list[Part], material: str | Mapping[str, str]) -> str:
    if isinstance(material, str):
        return material
    for name in (*part.names, EVERYTHING_ELSE):
        if name in material:
            return material[name]
    raise SceneError(
        f"{path}: '{part.names[0]}' is given no material; name it, or give all others one by "
        f'"{EVERYTHING_ELSE}" (the file has {", ".join(dict.fromkeys(p.names[0] for p in parts))})'
    )


# -- shape


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    faces: NDArray[np.bool_]
    both_ways: bool
    first_double: int


def _without_doubles(
    path: Path, vertices: FloatArray, faces: IntArray, labels: _Labels, notes: list[str]
) -> tuple[FloatArray, IntArray, _Kept]:
    """Join vertices at one place; leave out faces without area, and those on the corners of another."""
    vertices, place = np.unique(vertices + 0.0, axis=0, return_inverse=True)  # + 0.0: -0 is 0
    faces = place.reshape(-1)[faces]
    corner = vertices[faces]
    edge = np.linalg.norm(corner - np.roll(corner, -1, axis=1), axis=2)
    longest = edge.max(axis=1)
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    height = np.divide(2.0 * area, longest, out=np.zeros_like(area), where=longest > 0.0)
    rounding = 8.0 * np.finfo(np.float64).eps * np.max(np.abs(corner), axis=(1, 2))
    flat = height <= rounding
    sliver = ~flat & (height < SLIVER * longest)
    if np.any(sliver):
        bad = int(np.argmax(sliver))
        raise SceneError(
            f"{path}: {labels(bad)} has almost no area (edges up to {longest[bad]:.4g}, height "
            f"{height[bad]:.2g}, in the file's unit); repair the file"
        )
    if np.all(flat):
        raise SceneError(f"{path}: no face has any area; repair the file")
    if np.any(flat):
        notes.append(
            f"{int(np.sum(flat))} faces without area left out, the first is {labels(int(np.argmax(flat)))}"
        )
    keep = ~flat
    index = np.flatnonzero(keep)
    corners = np.sort(faces[index], axis=1)
    _, first, which = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    under = index[first[which.reshape(-1)]]
    double = np.flatnonzero(under != index)
    both_ways = False
    if len(double):
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        agreement = np.sum(normal[index[double]] * normal[under[double]], axis=1)
        both_ways = bool(np.any(agreement < 0.0))
        keep[index[double]] = False
        first_double = labels(int(index[double[0]]))
        notes.append(f"{len(double)} faces left out that lie on another, the first is {first_double}")
    return vertices, faces[keep], _Kept(keep, both_ways, int(index[double[0]]) if len(double) else -1)


def _check_precision(vertices: FloatArray, scale: float, notes: list[str]) -> None:
    """Say if the file's coordinates have single precision and lie far from their origin."""
    with np.errstate(over="ignore"):
        single = bool(np.all(vertices.astype(np.float32) == vertices))
    step_m = scale * float(np.max(np.abs(vertices))) * 2.0**-23
    if single and step_m > _COARSE_M and not np.all(vertices == np.round(vertices, 2)):
        notes.append(f"its coordinates are stored in steps of {1e3 * step_m:.2g} mm; move its origin nearer")


def _placed(vertices_m: FloatArray, up: str, azimuth_deg: float) -> FloatArray:
    """Return the vertices with z up, turned clockwise so that y points along the azimuth."""
    x, y, z = vertices_m.T
    if up == "y":
        y, z = -z, y
    ahead, right = np.array(heading(azimuth_deg)), np.array(heading(azimuth_deg + 90.0))
    return np.asarray(x[:, None] * right + y[:, None] * ahead + z[:, None] * np.array([0.0, 0.0, 1.0]))

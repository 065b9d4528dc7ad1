"""Can these surfaces and meshes be traced?  The same questions to files and to what Python code builds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gonio.errors import SceneError
from gonio.facade.geometry import Mesh, Surface
from gonio.facade.mesh import SLIVER
from gonio.facade.optics import Optics

LEAST_AREA = 1e-9
"""Of a surface, in units of the product of its edges: the sine of the angle between them."""


def check_shapes(
    surfaces: Sequence[Surface],
    meshes: Sequence[Mesh],
    materials: Mapping[str, Optics],
    *,
    periodic: bool,
) -> None:
    """Raise `SceneError` for the first thing that cannot be traced, with its name and its numbers."""
    if not surfaces and not meshes:
        raise SceneError("the scene is empty; give it surfaces or meshes")
    seen: set[str] = set()
    for kind, name in [*(("surface", s.name) for s in surfaces), *(("mesh", m.name) for m in meshes)]:
        if not name or "/" in name:
            raise SceneError(f"{kind} '{name}': a name needs a character and no '/'")
        if name in seen:
            raise SceneError(f"two surfaces or meshes are called '{name}'; give each its own name")
        seen.add(name)
    if not _fine(surfaces, materials):
        for s in surfaces:
            _check_surface(s, materials)
    for mesh in meshes:
        _check_mesh(mesh, materials)
    if periodic:
        _check_endless(surfaces, meshes)


def _check_material(what: str, name: str, materials: Mapping[str, Optics]) -> None:
    if name not in materials:
        raise SceneError(
            f"{what} is made of '{name}', which is not among the materials "
            f"({', '.join(sorted(materials)) or 'none'}); name one of them or add it"
        )


def _fine(surfaces: Sequence[Surface], materials: Mapping[str, Optics]) -> bool:
    """Say whether `_check_surface` has nothing against any of them, at once: planners make many scenes."""
    try:
        edges = np.array([(s.origin_m, s.u_m, s.v_m) for s in surfaces], np.float64).reshape(-1, 3, 3)
    except (TypeError, ValueError):
        return False
    with np.errstate(invalid="ignore", over="ignore"):
        lengths = np.linalg.norm(edges[:, 1:], axis=2)
        area = np.linalg.norm(np.cross(edges[:, 1], edges[:, 2]), axis=1)
        shaped = np.all(np.isfinite(edges)) and np.all(lengths > 0.0)
        shaped = shaped and np.all(area >= LEAST_AREA * np.prod(lengths, axis=1))
    return bool(shaped) and all(
        s.material in materials
        and s.sides in (1, 2)
        and (s.rows > 0) == (s.columns > 0)
        and min(s.rows, s.columns) >= 0
        for s in surfaces
    )


def _check_surface(s: Surface, materials: Mapping[str, Optics]) -> None:
    edges = np.array([s.origin_m, s.u_m, s.v_m], np.float64)
    if edges.shape != (3, 3) or not np.all(np.isfinite(edges)):
        raise SceneError(
            f"surface '{s.name}' has a coordinate that is not a finite number of metres; correct it"
        )
    lengths = np.linalg.norm(edges[1:], axis=1)
    if np.min(lengths) == 0.0 or s.area_m2 < LEAST_AREA * float(np.prod(lengths)):
        raise SceneError(
            f"surface '{s.name}' has an area of {s.area_m2:g} m2 "
            f"(edges {lengths[0]:g} m and {lengths[1]:g} m); "
            "give it two edges that span a rectangle"
        )
    _check_material(f"surface '{s.name}'", s.material, materials)
    if s.sides not in (1, 2):
        raise SceneError(f"surface '{s.name}' has {s.sides} sides; 1 or 2 of them can reflect")
    if (s.rows > 0) != (s.columns > 0) or min(s.rows, s.columns) < 0:
        raise SceneError(
            f"receiver '{s.name}' has {s.rows} x {s.columns} patches; give at least 1 row and 1 column"
        )


def _check_mesh(mesh: Mesh, materials: Mapping[str, Optics]) -> None:
    here = f"mesh '{mesh.name}'"
    vertices, faces = np.asarray(mesh.vertices_m), np.asarray(mesh.faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1:] != (3,):
        raise SceneError(
            f"{here} has vertices {vertices.shape} and faces {faces.shape}; give arrays of (k, 3) and (f, 3)"
        )
    if not len(faces):
        raise SceneError(f"{here} has no faces; leave it out")
    if not np.issubdtype(faces.dtype, np.integer) or faces.min() < 0 or faces.max() >= len(vertices):
        raise SceneError(f"{here}: faces must be numbers of its {len(vertices)} vertices, from 0")
    if not np.all(np.isfinite(vertices)):
        bad = int(np.argmin(np.all(np.isfinite(vertices), axis=1)))
        raise SceneError(f"{here}: vertex {bad} has a coordinate that is not a finite number of metres")
    corner = vertices[faces]
    longest = np.linalg.norm(corner - np.roll(corner, -1, axis=1), axis=2).max(axis=1)
    twice = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    flat = ~(twice > SLIVER * longest**2)
    if np.any(flat):
        bad = int(np.argmax(flat))
        raise SceneError(
            f"{here}: face {bad} has an area of {0.5 * twice[bad]:g} m2 (edges up to {longest[bad]:g} m); "
            "leave it out"
        )
    if mesh.sides not in (1, 2):
        raise SceneError(f"{here} has {mesh.sides} sides; 1 or 2 of them can reflect")
    number = np.asarray(mesh.face_material)
    if number.shape != (len(faces),) or number.min() < 0 or number.max() >= len(mesh.materials):
        raise SceneError(
            f"{here}: face_material must be (f,) numbers of its {len(mesh.materials)} materials, from 0"
        )
    for name in mesh.materials:
        _check_material(here, name, materials)


def _check_endless(surfaces: Sequence[Surface], meshes: Sequence[Mesh]) -> None:
    if meshes:
        raise SceneError(
            f"mesh '{meshes[0].name}' cannot repeat along an endless street; set street.infinite = false"
        )
    cell = np.asarray(surfaces[0].u_m)
    for s in surfaces:
        if np.linalg.norm(np.asarray(s.u_m) - cell) > 1e-9 * np.linalg.norm(cell):
            raise SceneError(
                f"surface '{s.name}' does not run along the infinite street for the length of its cell; "
                "set street.infinite = false to mix the street with other bodies"
            )

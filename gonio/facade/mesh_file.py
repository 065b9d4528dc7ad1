"""What does a mesh file hold?  Its parts and their names, by trimesh: OBJ, PLY, STL, glTF and others."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gonio.errors import SceneError
from gonio.facade.winding import FloatArray, IntArray

METRES = {
    "meters": 1.0, "meter": 1.0, "metre": 1.0, "m": 1.0, "centimeters": 0.01, "centimeter": 0.01, "cm": 0.01,
    "millimeters": 1e-3, "millimeter": 1e-3, "mm": 1e-3, "micron": 1e-6, "microns": 1e-6, "inches": 0.0254,
    "inch": 0.0254, "in": 0.0254, "feet": 0.3048, "foot": 0.3048, "ft": 0.3048,
}  # fmt: skip
"""Metres in the units that trimesh reports."""


@dataclass(slots=True)
class Part:
    """A part of a file with one material: what it may be called, best name first."""

    names: tuple[str, ...]
    vertices: FloatArray  # (k, 3) in the file's unit
    faces: IntArray  # (f, 3)


def read_parts(path: Path) -> tuple[list[Part], str | None]:
    """Return the parts of a file and the unit it states.

    `SceneError` if there is no such file, trimesh cannot read it, or it holds no faces.
    """
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file; correct the name, or put it beside the scene")
    import trimesh  # a second, which a scene without meshes does not pay

    names: dict[str, tuple[str, ...]] = {}
    try:
        if path.suffix.lower() == ".obj":
            scene, names = _obj(path)
        else:
            scene = trimesh.load_scene(path, process=False)
    except Exception as error:
        known = ", ".join(sorted(trimesh.available_formats()))
        raise SceneError(
            f"{path}: cannot be read as a mesh ({type(error).__name__}: {error}); "
            f"give one of the formats {known}"
        ) from None
    parts: list[Part] = []
    nodes = list(scene.graph.nodes_geometry)
    if names:
        nodes.reverse()  # trimesh reads an OBJ file's groups from its end
    for node in nodes:
        transform, key = scene.graph[node]
        body = scene.geometry[key]
        if not isinstance(body, trimesh.Trimesh) or not len(body.faces):
            continue
        transform = np.asarray(transform, np.float64)
        faces = np.array(body.faces, np.int64)
        if np.linalg.det(transform[:3, :3]) < 0.0:
            faces = faces[:, ::-1]  # a mirror image
        if np.shape(body.vertices)[1:] != (3,):
            raise SceneError(f"{path}: vertices of '{key}' lack coordinates; the file is damaged")
        if faces.min() < 0 or faces.max() >= len(body.vertices):
            raise SceneError(
                f"{path}: a face of '{key}' asks for vertex {faces.max()}, of {len(body.vertices)}; "
                "the file is damaged"
            )
        own = getattr(getattr(body.visual, "material", None), "name", None)
        called = names.get(str(key), (str(key), str(node)))
        with np.errstate(invalid="ignore"):  # what is not finite is refused by name later
            vertices = np.array(body.vertices, np.float64) @ transform[:3, :3].T + transform[:3, 3]
        parts.append(
            Part(
                tuple(dict.fromkeys([*([str(own)] if own else []), *called])),
                vertices,
                np.ascontiguousarray(faces),
            )
        )
    if not parts:
        raise SceneError(f"{path}: holds no faces (a point cloud, lines, or nothing); give a surface mesh")
    return parts, scene.units


def _obj(path: Path) -> tuple[Any, dict[str, tuple[str, ...]]]:
    """Return the scene of an OBJ file in the file's order, and the groups and objects behind each geometry.

    The colours of its materials are not wanted but their names are, which trimesh knows from an .mtl only: it
    is given one that holds nothing else.
    """
    import trimesh

    text = path.read_text(encoding="utf-8", errors="replace")
    found = {
        word: list(dict.fromkeys(re.findall(rf"(?m)^[ \t]*{word}[ \t]+(.+?)[ \t\r]*$", text)))
        for word in ("usemtl", "g", "o")
    }
    library = "".join(f"newmtl {material}\n" for material in found["usemtl"])
    scene = trimesh.load_scene(
        io.BytesIO(f"mtllib names.mtl\n{text}".encode()),
        file_type="obj",
        resolver={"names.mtl": library.encode()},
        process=False,
        maintain_order=True,
        split_objects=True,
        split_groups=True,
    )
    names: dict[str, tuple[str, ...]] = {}
    for key, body in scene.geometry.items():
        own = getattr(getattr(body.visual, "material", None), "name", None)
        stem = str(key).removesuffix(f"_{own}") if own else str(key)
        # trimesh joins object, group and material by underscores, of which the names may have their own
        groups = [g for g in found["g"] if stem == g or any(stem == f"{o}_{g}" for o in found["o"])]
        objects = [o for o in found["o"] if stem == o or any(stem == f"{o}_{g}" for g in found["g"])]
        names[str(key)] = (*groups, *objects, str(key))
    return scene, names

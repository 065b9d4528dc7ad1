"""Random scenes that no one has chosen: streets, boxes, tilted modules, suns, skies, albedos, from a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gonio.facade import Optics, Scene, Sun, Surface, box, street
from gonio.facade.geometry import Mesh
from gonio.facade.sky import Sky

SKIES = ("isotropic", "cie_clear", "perez", "cie_overcast", "cie4", "perez")


@dataclass(frozen=True, slots=True)
class Named:
    """A scene and what is in it, for a table."""

    name: str
    scene: Scene


def matte(seed: int) -> Named:
    """Return a random scene of Lambert surfaces."""
    rng = np.random.default_rng([6, seed])
    kind = ("endless", "street", "street with boxes", "street with modules")[seed % 4]
    azimuth_deg = float(rng.uniform(0.0, 360.0))
    width, length = float(rng.uniform(6.0, 20.0)), float(rng.uniform(10.0, 40.0))
    heights = rng.uniform(0.3, 2.0, 2) * width
    materials = {name: Optics(float(rng.uniform(0.05, 0.9))) for name in ("left", "right", "ground", "other")}
    surfaces = list(
        street(
            width_m=width, length_m=length, height_left_m=float(heights[0]), height_right_m=float(heights[1]),
            azimuth_deg=azimuth_deg, left="left", right="right", ground="ground",
        )
    )  # fmt: skip
    meshes: tuple[Mesh, ...] = ()
    endless = kind == "endless"
    columns = 1 if endless else 3
    surfaces[0] = replace(surfaces[0], rows=6, columns=columns)
    surfaces[1] = replace(surfaces[1], rows=4, columns=columns)
    if kind != "street with boxes":  # a patch that is half under a box has another mean for a peer
        surfaces[2] = replace(surfaces[2], rows=4, columns=columns)
    if kind == "street with boxes":
        for number in range(2):
            size = (
                float(rng.uniform(1.0, 0.3 * width)),
                float(rng.uniform(1.0, 6.0)),
                float(rng.uniform(1.0, 8.0)),
            )
            middle = _within(rng, azimuth_deg, 0.25 * width, 0.3 * length)
            faces = box(
                f"box{number}", centre_m=(*middle, 0.0), size_m=size,
                azimuth_deg=float(rng.uniform(0.0, 90.0)), material="other",
            )  # fmt: skip
            surfaces += [
                replace(f, rows=2, columns=2) if f.name.endswith(("top", "front")) else f for f in faces
            ]
    if kind == "street with modules":
        for number in range(3):
            surfaces.append(_module(rng, number, azimuth_deg, width, length, sides=1 + number % 2))
        meshes = (_tent(rng, azimuth_deg, width, length),)
    sun = Sun(
        float(rng.uniform(0.0, 360.0)),
        float(np.degrees(np.arcsin(rng.uniform(0.05, 0.95)))),
        float(rng.choice([0.0, 0.533])),
    )
    dni, dhi = (
        float(rng.choice([0.0, rng.uniform(200.0, 900.0)], p=[0.2, 0.8])),
        float(rng.uniform(50.0, 300.0)),
    )
    sky = Sky(SKIES[int(rng.integers(len(SKIES)))])
    scene = Scene(
        surfaces=tuple(surfaces), materials=materials, sun=sun, dni_w_m2=dni, dhi_w_m2=dhi, infinite=endless,
        meshes=meshes, sky=sky,
    )  # fmt: skip
    return Named(f"{seed}: {kind}, {sky.model}, DNI {dni:.0f}, sun {sun.elevation_deg:.0f} deg", scene)


def glossy(seed: int) -> Named:
    """Return a random street with lobes broad enough for a renderer that walks backwards from the eye."""
    rng = np.random.default_rng([7, seed])
    base = matte(4 * (seed % 2)) if seed % 2 else matte(4 * seed + 3)
    alpha = float(np.exp(rng.uniform(0.0, math.log(60.0))))
    lobe = Optics(
        float(rng.uniform(0.1, 0.7)), float(rng.uniform(0.5, 2.0)), alpha, float(rng.uniform(1.2, 1.8))
    )
    materials = dict(base.scene.materials) | {"left": lobe}
    if seed % 3 == 0:
        materials["ground"] = Optics(0.15, 1.0, float(rng.uniform(2.0, 20.0)), 1.4)
    scene = replace(base.scene, materials=materials)
    return Named(f"lobe {seed}: alpha {alpha:.0f}, {base.name}", scene)


def _within(
    rng: np.random.Generator, azimuth_deg: float, across_m: float, along_m: float
) -> tuple[float, float]:
    a = math.radians(azimuth_deg)
    x, y = float(rng.uniform(-across_m, across_m)), float(rng.uniform(-along_m, along_m))
    return y * math.sin(a) + x * math.cos(a), y * math.cos(a) - x * math.sin(a)


def _module(
    rng: np.random.Generator, number: int, azimuth_deg: float, width: float, length: float, *, sides: int
) -> Surface:
    """Return a tilted panel that floats in the street."""
    tilt, turn = math.radians(float(rng.uniform(10.0, 80.0))), float(rng.uniform(0.0, 2.0 * math.pi))
    x, y = _within(rng, azimuth_deg, 0.25 * width, 0.3 * length)
    u = 1.5 * np.array([math.cos(turn), math.sin(turn), 0.0])
    v = 1.0 * np.array([-math.sin(turn) * math.cos(tilt), math.cos(turn) * math.cos(tilt), math.sin(tilt)])
    o = np.array([x, y, 1.0 + 2.0 * number]) - 0.5 * (u + v)
    o[2] = max(float(o[2]), 0.2)

    def plain(p: np.ndarray) -> tuple[float, float, float]:
        return float(p[0]), float(p[1]), float(p[2])

    return Surface(f"module{number}", plain(o), plain(u), plain(v), "other", 2, 2, sides=sides)


def _tent(rng: np.random.Generator, azimuth_deg: float, width: float, length: float) -> Mesh:
    """Return an open pyramid on four feet, a mesh whose faces are receivers."""
    x, y = _within(rng, azimuth_deg, 0.2 * width, 0.4 * length)
    corners = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0], [0, 0, 1]], float) * [0.8, 1.2, 1.5]
    corners += [x, y, 0.1]
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    return Mesh("tent", corners, faces, ("other",), np.zeros(4, np.int64), receiver=True, sides=2)

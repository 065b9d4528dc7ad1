"""Rays per second and lost rays, beside Embree, in one run.

    python benchmarks/rays.py [--lost N]

A town of boxes on a ground, at about 100, 10 000 and 1 000 000 triangles; incoherent rays on one core:
uniform from random points of the scene's box, and cosine-distributed from random points of its surfaces.
Embree runs through embreex, a ray at a time, and its times include embreex's.  Each time is the best of five,
in process time.  Lost rays start inside closed bodies.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

from _one_core import machine  # isort: skip - before numpy, which reads its settings once

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numba import njit

from gonio.facade import Optics, box
from gonio.facade.geometry import Mesh
from gonio.facade.intersect import nearest, occluded
from gonio.facade.pack import Packed, pack

RAYS = 200_000


def town(boxes: int) -> np.ndarray:
    """Return the triangles of `boxes` boxes of ten, and of their ground, (n, 3, 3)."""
    rng = np.random.default_rng(1)
    side = int(np.ceil(np.sqrt(boxes)))
    turn = rng.uniform(0, 2 * np.pi, boxes)
    cell = np.stack(np.divmod(np.arange(boxes), side), 1)
    middle = np.column_stack([(cell + 0.5) * 30.0 + rng.uniform(-5, 5, (boxes, 2)), np.zeros(boxes)])
    u = rng.uniform(4, 10, (boxes, 1)) * np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
    v = rng.uniform(4, 10, (boxes, 1)) * np.stack([-np.sin(turn), np.cos(turn), 0 * turn], 1)
    up = rng.uniform(5, 30, (boxes, 1)) * np.array([0.0, 0.0, 1.0])
    foot = [middle - u - v, middle + u - v, middle + u + v, middle - u + v]
    head = [p + up for p in foot]
    faces = [(head[0], head[1], head[2]), (head[0], head[2], head[3])]
    for k in range(4):
        n = (k + 1) % 4
        faces += [(foot[k], foot[n], head[n]), (foot[k], head[n], head[k])]
    size = side * 30.0
    ground = np.array(
        [[[0, 0, 0], [size, 0, 0], [size, size, 0]], [[0, 0, 0], [size, size, 0], [0, size, 0]]]
    )
    return np.concatenate([ground, *(np.stack(f, 1) for f in faces)])


def packed(corners: np.ndarray) -> Packed:
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    mesh = Mesh("m", corners.reshape(-1, 3), faces, ("m",), np.zeros(len(faces), np.int64))
    return pack([], {"m": Optics(0.5)}, meshes=[mesh])


@njit(nogil=True, error_model="numpy")
def hits(g: Any, p: Any, d: Any, own: Any, found: Any) -> None:
    for i in range(len(p)):
        found[i] = nearest(g, (p[i, 0], p[i, 1], p[i, 2]), (d[i, 0], d[i, 1], d[i, 2]), own[i])[0]


@njit(nogil=True, error_model="numpy")
def shadows(g: Any, p: Any, d: Any, own: Any, found: Any) -> None:
    for i in range(len(p)):
        found[i] = occluded(g, (p[i, 0], p[i, 1], p[i, 2]), (d[i, 0], d[i, 1], d[i, 2]), own[i])


def unit(x: np.ndarray) -> np.ndarray:
    return np.asarray(x / np.linalg.norm(x, axis=1)[:, None])


def best(*tasks: Callable[[], Any]) -> list[float]:
    """Return Mrays/s of each task; they take turns, so that all see the same machine."""
    seconds = np.full(len(tasks), np.inf)
    for _ in range(5):
        for i, task in enumerate(tasks):
            start = time.process_time()
            task()
            seconds[i] = min(seconds[i], time.process_time() - start)
    return [float(RAYS / s / 1e6) for s in seconds]


def speed() -> None:
    rng = np.random.default_rng(2)
    print(f"{'triangles':>10}{'rays':>10}{'ours':>8}{'Embree':>8}{'ratio':>7}   {'shadow':>7}{'Embree':>8}"
          f"{'ratio':>7}{'pack s':>8}{'other hit':>11}")  # fmt: skip
    for boxes in (10, 1000, 100_000):
        corners = town(boxes)
        start = time.process_time()
        scene = packed(corners)
        seconds = time.process_time() - start
        g = scene.geometry
        embree = rtcore_scene.EmbreeScene()
        TriangleMesh(embree, corners.astype(np.float32))
        low, high = corners.min((0, 1)), corners.max((0, 1))
        for kind in ("uniform", "cosine"):
            own = np.full(RAYS, -1)
            p, d = rng.uniform(low, high, (RAYS, 3)), unit(rng.normal(size=(RAYS, 3)))
            if kind == "cosine":
                own = rng.choice(len(g.area), RAYS, p=g.area / g.area.sum())
                a, b = rng.random((2, RAYS, 1))
                a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
                p = g.origin[own] + a * g.u[own] + b * g.v[own] + scene.centre_m
                d = unit(g.normal[own] + d)
            q = p - scene.centre_m
            # Embree skips nothing: its rays start a little above their surface
            p32 = (p + (1e-3 * g.normal[own] if kind == "cosine" else 0.0)).astype(np.float32)
            d32 = d.astype(np.float32)
            found, seen = np.empty(RAYS, np.int64), np.empty(RAYS, np.int64)
            ours, theirs, ours_dark, theirs_dark = best(
                lambda: hits(g, q, d, own, found),  # noqa: B023
                lambda: embree.run(p32, d32),  # noqa: B023
                lambda: shadows(g, q, d, own, seen),  # noqa: B023
                lambda: embree.run(p32, d32, query="OCCLUDED"),  # noqa: B023
            )
            other = np.mean(np.where(found >= 0, g.rank[found], -1) != np.asarray(embree.run(p32, d32)))
            print(f"{len(corners):>10}{kind:>10}{ours:>8.2f}{theirs:>8.2f}{ours / theirs:>7.2f}   "
                  f"{ours_dark:>7.2f}{theirs_dark:>8.2f}{ours_dark / theirs_dark:>7.2f}{seconds:>8.2f}"
                  f"{other:>11.1e}")  # fmt: skip


def lost(rays: int) -> None:
    rng = np.random.default_rng(3)
    ring = np.linspace(0, 2 * np.pi, 1001)
    ring[-1] = 0.0
    rim = np.stack([np.cos(ring), np.sin(ring), 0 * ring], 1) * 50.0
    top = np.tile([0.0, 0.0, 50.0], (1000, 1))
    cone = np.concatenate([np.stack([rim[:-1], rim[1:], top], 1), np.stack([rim[1:], rim[:-1], -top], 1)])
    room = box("b", centre_m=(5e5, 5e5, 0.0), size_m=(100, 1, 30), azimuth_deg=33.0, material="m")
    bodies = {
        "2000 thin triangles": packed(cone),
        "2000 thin triangles, 500 km": packed(cone + 5e5),
        "room 100 x 1 x 30 m, 500 km": pack(room, {"m": Optics(0.5)}),
    }
    print(f"\n{'lost rays from faces and edges':<40}{'rays':>10}{'lost':>8}{'grazing':>10}{'lost':>8}")
    step = 500_000
    for name, scene in bodies.items():
        g = scene.geometry
        counts = []
        for grazing in (False, True):
            gone = 0
            for _ in range(max(1, rays // step)):
                own = rng.integers(0, len(g.area), step)
                a, b = rng.random((2, step, 1))
                if g.triangle[0]:
                    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
                a[: step // 4] = 0.0
                d = unit(rng.normal(size=(step, 3)))
                height = np.einsum("ij,ij->i", d, g.normal[own])[:, None]
                d -= (height + np.abs(height)) * g.normal[own]  # inwards
                if grazing:  # 89.9999 deg
                    flat = unit(d + np.abs(height) * g.normal[own])
                    d = unit(flat - 1.745e-6 * g.normal[own])
                found = np.empty(step, np.int64)
                hits(g, g.origin[own] + a * g.u[own] + b * g.v[own], d, own, found)
                gone += int(np.sum(found < 0))
            counts += [max(1, rays // step) * step, gone]
        print(f"{name:<40}{counts[0]:>10}{counts[1]:>8}{counts[2]:>10}{counts[3]:>8}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--lost", type=int, default=10_000_000, help="rays of each kind that may be lost")
    options = parser.parse_args()
    print(machine())
    g = packed(town(10)).geometry
    one, none = np.ones((1, 3)), np.full(1, -1)
    for name, kernel in (("nearest", hits), ("occluded", shadows)):
        start = time.process_time()
        kernel(g, one, one, none, none.copy())
        print(f"compiling {name}: {time.process_time() - start:.1f} s")
    small = town(30)
    start = time.process_time()
    for _ in range(20):
        packed(small)
    print(f"packing {len(small)} triangles: {(time.process_time() - start) / 20 * 1e3:.2f} ms\n")
    speed()
    lost(options.lost)


if __name__ == "__main__":
    main()

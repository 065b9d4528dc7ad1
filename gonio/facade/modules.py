"""Where are windows and panels?  Rectangles on a surface, or free-standing.

A module on a surface lies in its plane, is declared after it and hides the part under it.  Its place is
counted like the rows and columns of the surface: along its first edge (a street's azimuth), up its second.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gonio.errors import SceneError
from gonio.facade.geometry import Surface, Vector, heading

Place = tuple[str, tuple[float, float], tuple[float, float]]
"""Name, `at_m` and `size_m` of a module."""

_EDGE = 1e-9  # of the host's edge: a module may touch it


def module(
    name: str,
    host: Surface,
    *,
    at_m: tuple[float, float],
    size_m: tuple[float, float],
    material: str | None = None,
    rows: int = 1,
    columns: int = 1,
) -> Surface:
    """Return a rectangle on `host`, to be declared after it.

    Parameters
    ----------
    at_m, size_m
        Its first corner, and its size: along the host's first edge and up its second.
    material
        None: the host's.
    rows, columns
        Patches; 0 and 0 for a module that is no receiver.

    Raises
    ------
    SceneError
        The module is not wholly on its host, or has no size.
    """
    edges = [np.asarray(host.u_m, np.float64), np.asarray(host.v_m, np.float64)]
    lengths = [float(np.linalg.norm(e)) for e in edges]
    for at, size, length in zip(at_m, size_m, lengths, strict=True):
        if not (size > 0.0 and at >= -_EDGE * length and at + size <= (1.0 + _EDGE) * length):
            raise SceneError(
                f"module '{name}' covers {_range(at_m[0], size_m[0])} along and {_range(at_m[1], size_m[1])} "
                f"up, which is not inside '{host.name}' of {lengths[0]:g} m x {lengths[1]:g} m; "
                "move it or make it smaller"
            )
    origin = np.asarray(host.origin_m, np.float64)
    spans: list[Vector] = []
    for edge, length, at, size in zip(edges, lengths, at_m, size_m, strict=True):
        origin = origin + (at / length) * edge
        whole = abs(size - length) <= _EDGE * length
        x, y, z = (float(c) for c in (edge if whole else (size / length) * edge))
        spans.append((x, y, z))
    return Surface(
        name,
        (float(origin[0]), float(origin[1]), float(origin[2])),
        spans[0],
        spans[1],
        host.material if material is None else material,
        rows=rows,
        columns=columns,
        turned=host.turned,
        sides=host.sides,
    )


def panel(
    name: str,
    *,
    centre_m: Vector,
    size_m: tuple[float, float],
    azimuth_deg: float,
    material: str,
    tilt_deg: float = 90.0,
    rows: int = 1,
    columns: int = 1,
    sides: int = 1,
) -> Surface:
    """Return a free-standing rectangle.

    Parameters
    ----------
    centre_m, size_m
        Its centre, and its size across and up its slope.
    azimuth_deg, tilt_deg
        Where its front looks, clockwise from north; 0: it looks up, 90: it is vertical, 180: it looks down.
        Columns run from left to right of somebody who looks at its front, rows up its slope.
    sides
        1: its back is black; 2: it reflects like its front.
    """
    sine, cosine, _ = heading(tilt_deg)
    ahead, right = np.array(heading(azimuth_deg)), np.array(heading(azimuth_deg + 90.0))
    u = -size_m[0] * right
    v = size_m[1] * (np.array([0.0, 0.0, sine]) - cosine * ahead)
    origin = np.asarray(centre_m, np.float64) - 0.5 * u - 0.5 * v
    o, along, up = ((float(c[0]) + 0.0, float(c[1]) + 0.0, float(c[2]) + 0.0) for c in (origin, u, v))
    return Surface(name, o, along, up, material, rows=rows, columns=columns, sides=sides)


def check_places(host: Surface, places: Sequence[Place]) -> None:
    """Raise `SceneError` if two modules of one host overlap."""
    lengths = [float(np.linalg.norm(e)) for e in (host.u_m, host.v_m)]
    for j, (name, at, size) in enumerate(places):
        for other, other_at, other_size in places[:j]:
            common = [
                min(a + s, b + t) - max(a, b)
                for a, s, b, t in zip(at, size, other_at, other_size, strict=True)
            ]
            if all(c > _EDGE * length for c, length in zip(common, lengths, strict=True)):
                raise SceneError(
                    f"modules '{other}' and '{name}' overlap on '{host.name}' by {common[0]:g} m along and "
                    f"{common[1]:g} m up; move one of them"
                )


def check_spans(name: str, host: Surface, at_m: tuple[float, float], size_m: tuple[float, float]) -> None:
    """Raise `SceneError` if a module of an endless street leaves gaps, for the street repeats its cell."""
    length = float(np.linalg.norm(host.u_m))
    if abs(at_m[0]) > _EDGE * length or abs(size_m[0] - length) > _EDGE * length:
        raise SceneError(
            f"module '{name}' covers {_range(at_m[0], size_m[0])} along an endless street, whose surfaces "
            f"have no ends; give it at_m[0] = 0 and size_m[0] = {length:g}, or set street.infinite = false"
        )


def _range(at: float, size: float) -> str:
    return f"{at:g}...{at + size:g} m"

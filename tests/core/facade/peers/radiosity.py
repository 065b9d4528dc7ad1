"""What is the irradiance in an endless matte canyon?  Galerkin radiosity with exact view factors, in 2-D.

Strips are constant in exitance; the view factor of two strips that see each other is Hottel's: crossed
strings minus uncrossed ones, over twice the length.  The shadow's edge falls on a strip's edge, and two
widths of strips give the limit by Richardson's extrapolation.  Nothing of `gonio.facade` is used.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def bands(
    height: float,
    *,
    walls: float,
    ground: float,
    dni: float,
    dhi: float,
    elevation_deg: float = 50.0,
    azimuth_deg: float = 60.0,
    per_surface: int = 10,
    strips: int = 200,
) -> FloatArray:
    """Return the mean irradiance of each band, (3 per_surface,): wall at x = 0, wall at x = 1, ground.

    The canyon is 1 wide; bands run upwards on the walls and from x = 0 on the ground.  `walls` and `ground`
    are albedos; the sun's azimuth is taken from the canyon's axis and it stands on the side of x > 0.
    """
    coarse, fine = (
        _solve(height, walls, ground, dni, dhi, elevation_deg, azimuth_deg, per_surface, n)
        for n in (strips, 2 * strips)
    )
    return np.asarray(fine + (fine - coarse) / 3.0)


def _solve(
    height: float, walls: float, ground: float, dni: float, dhi: float, elevation_deg: float,
    azimuth_deg: float, per_surface: int, strips: int,
) -> FloatArray:  # fmt: skip
    elevation, azimuth = math.radians(elevation_deg), math.radians(azimuth_deg)
    fall = math.tan(elevation) / math.sin(azimuth)  # drop of a ray of the sun while it crosses the canyon
    shadow_wall = max(height - fall, 0.0)  # the wall at x = 0 is lit above
    shadow_ground = 1.0 - height / fall  # the ground is lit below this x
    edges = [_edges(height, shadow_wall, per_surface, strips), _edges(height, 0.0, per_surface, strips)]
    edges.append(_edges(1.0, shadow_ground, per_surface, strips))
    starts, ends = [], []
    for surface, e in enumerate(edges):
        points = np.stack([np.full_like(e, [0.0, 1.0, 0.0][surface]), e], 1)
        if surface == 2:
            points = points[:, ::-1]
        starts.append(points[:-1])
        ends.append(points[1:])
    a, b = np.concatenate(starts), np.concatenate(ends)
    surface = np.repeat(np.arange(3), [len(e) - 1 for e in edges])
    length = np.linalg.norm(b - a, axis=1)

    def distance(p: FloatArray, q: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(p[:, None] - q[None], axis=2))

    def view(p0: FloatArray, p1: FloatArray) -> FloatArray:
        crossed, straight = distance(a, p0) + distance(b, p1), distance(a, p1) + distance(b, p0)
        return np.asarray(np.abs(crossed - straight) / (2.0 * length[:, None]))

    between = np.where(surface[:, None] == surface[None], 0.0, view(a, b))
    sky = view(np.array([[0.0, height]]), np.array([[1.0, height]]))[:, 0]
    middle = 0.5 * (a + b)
    lit_wall = (surface == 0) & (middle[:, 1] > shadow_wall)
    lit_ground = (surface == 2) & (middle[:, 0] < shadow_ground)
    direct = dni * (lit_wall * math.cos(elevation) * math.sin(azimuth) + lit_ground * math.sin(elevation))
    albedo = np.array([walls, walls, ground])[surface]
    first = direct + dhi * sky
    irradiance = np.linalg.solve(np.eye(len(first)) - between * albedo[None], first)
    size = np.array([height, height, 1.0])[surface] / per_surface
    place = np.where(surface == 2, middle[:, 0], middle[:, 1])
    band = surface * per_surface + np.minimum((place / size).astype(int), per_surface - 1)
    total = np.bincount(band, irradiance * length, 3 * per_surface)
    return np.asarray(total / np.bincount(band, length, 3 * per_surface))


def _edges(length: float, shadow: float, per_surface: int, strips: int) -> FloatArray:
    """Return the edges of about `strips` strips, with one at each band's edge and one at the shadow's."""
    inner = [shadow] if 0.0 < shadow < length else []
    marks = np.unique(np.concatenate([np.linspace(0.0, length, per_surface + 1), inner]))
    each = strips // per_surface
    return np.concatenate([*(np.linspace(p, q, each + 1)[:-1] for p, q in pairwise(marks)), [length]])

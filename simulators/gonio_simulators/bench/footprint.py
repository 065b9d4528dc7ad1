"""Where the beam falls on the sample, and from where it comes: the points and directions that stand for it.

Axes of the sample: x in the plane of incidence towards the mirror side, y out of it, z the normal.  A beam of
width W lights W/cos(theta_i) along x; what overfills the sample is lost.  Directions of a divergent beam fill
a square cone evenly; tilts out of the plane come in pairs, of which the positive one is kept with double
weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gonio_simulators.bench.config import BeamTable, SampleTable

MOST_NODES = 24


@dataclass(frozen=True, slots=True)
class Direction:
    """One direction of incidence, and its mirror direction as a unit vector in the sample's axes."""

    weight: float
    cos_theta_i: float
    mirror: tuple[float, float, float]
    s_share: float  # part of nominally S light that is S for this direction's own plane of incidence


@dataclass(frozen=True, slots=True)
class Point:
    """One point of the footprint; the weights add up to the part of the beam that hits the sample."""

    weight: float
    x_mm: float
    y_mm: float


@lru_cache(maxsize=32)
def _gauss(n: int) -> list[tuple[float, float]]:
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return list(zip(nodes.tolist(), weights.tolist(), strict=True))


def _rule(length: float, smallest: float, *, half: bool = False) -> list[tuple[float, float]]:
    """Gauss-Legendre (weight, offset) over ``-length/2...length/2``, weights adding to 1.

    At least 3 nodes, more where something of width `smallest` passes over them; `half` keeps the offsets that
    are not negative and doubles the weights of the others' partners.
    """
    if length == 0:
        return [(1.0, 0.0)]
    ratio = length / smallest
    n = 3 if ratio < 0.5 else min(MOST_NODES, 3 + math.ceil(2.0 * ratio))
    rule = [(0.5 * w, 0.5 * length * x) for x, w in _gauss(n)]
    if not half:
        return rule
    tiny = 1e-12 * length
    return [(w if abs(x) <= tiny else 2.0 * w, max(x, 0.0)) for w, x in rule if x >= -tiny]


def directions(theta_i_rad: float, beam: BeamTable, lobe_width_rad: float) -> list[Direction]:
    """Return the directions of incidence on the front of the sample; the weights add to 1."""
    divergence = math.radians(beam.divergence_deg)
    result = []
    for w_in, tilt in _rule(divergence, lobe_width_rad):
        for w_out, out in _rule(divergence, lobe_width_rad, half=True):
            sin_i, cos_i = math.sin(theta_i_rad + tilt), math.cos(theta_i_rad + tilt)
            sin_d, cos_d = math.sin(out), math.cos(out)
            if cos_i <= 0:
                continue
            # The plane of incidence of a tilted ray is turned by chi about the ray; pairs of +-chi mix S and
            # P.
            turned = sin_d**2 + (sin_i * cos_d) ** 2
            s_share = sin_i**2 / turned if turned > 0 else 1.0
            mirror = (sin_i * cos_d, -sin_d, cos_i * cos_d)
            result.append(Direction(w_in * w_out, cos_i * cos_d, mirror, s_share))
    return result


def points(
    theta_i_rad: float, beam: BeamTable, sample: SampleTable, lobe_width_mm: float, *, symmetric: bool
) -> list[Point]:
    """Return the points of the footprint; `symmetric` keeps one of each pair of +-y."""
    cos_i = math.cos(theta_i_rad)
    along = min(beam.width_mm / cos_i, sample.width_mm)
    across = min(beam.height_mm, sample.height_mm)
    hit = (along * cos_i / beam.width_mm if beam.width_mm > 0 else 1.0) * (
        across / beam.height_mm if beam.height_mm > 0 else 1.0
    )
    return [
        Point(hit * w_x * w_y, x, y)
        for w_x, x in _rule(along, lobe_width_mm)
        for w_y, y in _rule(across, lobe_width_mm, half=symmetric)
    ]

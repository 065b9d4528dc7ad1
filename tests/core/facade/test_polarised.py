"""Polarisation from lobe to lobe: against Malus, Brewster and fields that are reflected as vectors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gonio.facade import Optics, Surface, kernels, layout, stokes
from gonio.facade.layout import Light
from gonio.facade.pack import Packed, pack
from gonio.facade.sobol import sobol_directions
from gonio.facade.starts import chances

MIRROR = 1e8
GAIN = 1e4  # of a mirror, so that no photon gets light enough to gamble: the result is exact
Vector = Any


def amplitudes(n2: float, cosine: float) -> tuple[float, float]:
    q = math.sqrt(n2 * n2 - 1.0 + cosine * cosine)
    return (cosine - q) / (cosine + q), (n2 * n2 * cosine - q) / (n2 * n2 * cosine + q)


def unit(v: Vector) -> np.ndarray:
    return np.asarray(v, float) / np.linalg.norm(v)


def reflect(d: Vector, normal: Vector) -> np.ndarray:
    return np.asarray(d) - 2.0 * np.dot(d, normal) * np.asarray(normal)


def throughput(d: Vector, normals: list[np.ndarray], n2: list[float]) -> float:
    """Reflect the fields of two perpendicular vibrations as three-dimensional vectors; unpolarised light."""
    total = 0.0
    first = unit(np.cross(d, [0.3, 0.5, 0.8]))
    for field in (first, np.cross(d, first)):
        at = np.array(d)
        for normal, n in zip(normals, n2, strict=True):
            out = reflect(at, normal)
            r_s, r_p = amplitudes(n, -float(np.dot(at, normal)))
            s = unit(np.cross(at, normal))
            # the field in the plane of incidence turns as the mirror turns it; r_p of this sign is -r_p
            field = r_s * np.dot(field, s) * s + r_p * np.dot(field, np.cross(at, s)) * np.cross(out, s)
            at = out
        total += 0.5 * float(np.dot(field, field))
    return total


def mirrors(d: Vector, normals: list[np.ndarray], n2: list[float]) -> Packed:
    """Small mirrors 10 m apart that pass a beam on from one to the next, then a black screen."""
    centre = np.array([0.0, 0.0, 100.0])
    surfaces, materials = [], {"black": Optics(0.0)}
    at = np.array(d)
    for i, (normal, n) in enumerate(zip(normals, n2, strict=True)):
        u = unit(np.cross(normal, [0.2, 0.9, 0.4])) * (0.1 if i == 0 else 2.0)
        v = np.cross(normal, u)
        surfaces.append(Surface(f"m{i}", tuple(centre - 0.5 * (u + v)), tuple(u), tuple(v), f"m{i}"))
        materials[f"m{i}"] = Optics(0.0, GAIN, MIRROR, n)
        at = reflect(at, normal)
        centre = centre + 10.0 * at
    u = unit(np.cross(at, [0.1, 0.7, 0.3])) * 3.0
    v = -np.cross(at, u)
    screen = Surface("screen", tuple(centre - 0.5 * (u + v)), tuple(u), tuple(v), "black", 1, 1)
    return pack((*surfaces, screen), materials)


def arriving(packed: Packed, d: Vector, *, polarised: bool, alone: int) -> float:
    """Return the power on the screen over that which meets the first mirror, of light along `d`."""
    g = packed.geometry
    light = Light(
        sun=-np.asarray(d), disc=0.0, dni=1.0, dhi=0.0, sky=np.zeros(7), conserving=False, renormalize=False
    )
    chance = chances(g, light, layout.SUN, follow=False)
    assert chance is not None
    first = int(np.flatnonzero(g.rank == alone)[0])
    chance = np.where(np.arange(len(chance)) < 2 * first, 0.0, 1.0)  # start on the first mirror only
    tally, energy = np.zeros((1, 1)), np.zeros((1, 8))
    kernels.photons(
        g, light, packed.patches, chance, sobol_directions(), np.uint64(1), layout.SUN, 1, False, polarised,
        0, (0, 1, 0, 16), tally, tally.copy(), energy,
    )  # fmt: skip
    cosine = -float(np.dot(d, g.normal[first]))
    count = len(g.materials) - 1
    return float(tally[0, 0]) / 16 / (float(g.area[first]) * cosine) / GAIN**count


def pair_of_mirrors(theta: float, *, crossed: bool) -> tuple[np.ndarray, list[np.ndarray]]:
    """Two mirrors met at `theta`, their planes of incidence parallel or perpendicular; light from above."""
    d = unit([0.05, 0.1, -1.0])
    s = unit(np.cross(d, [1.0, 0.3, 0.2]))
    n0 = math.sin(theta) * np.cross(d, s) - math.cos(theta) * d
    out = reflect(d, n0)
    side = s if crossed else -np.cross(out, s)  # parallel: the beam goes on along `d`, displaced
    n1 = math.sin(theta) * side - math.cos(theta) * out
    return d, [n0, n1]


@pytest.mark.parametrize("theta_deg", [math.degrees(math.atan(1.5)), 30.0, 75.0])
@pytest.mark.parametrize("crossed", [False, True])
def test_two_mirrors_with_parallel_and_crossed_planes_of_incidence(theta_deg: float, crossed: bool) -> None:
    theta = math.radians(theta_deg)
    d, normals = pair_of_mirrors(theta, crossed=crossed)
    packed = mirrors(d, normals, [1.5, 1.5])
    r_s, r_p = (r * r for r in amplitudes(1.5, math.cos(theta)))
    expected = r_s * r_p if crossed else 0.5 * (r_s * r_s + r_p * r_p)
    assert arriving(packed, d, polarised=True, alone=0) == pytest.approx(expected, rel=1e-3, abs=1e-9)
    mean = (0.5 * (r_s + r_p)) ** 2
    assert arriving(packed, d, polarised=False, alone=0) == pytest.approx(mean, rel=1e-3)


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_three_mirrors_in_any_position_reflect_like_fields(seed: int) -> None:
    random = np.random.default_rng(seed)
    d = unit([0.1, -0.2, -1.0])
    normals, at = [], d
    for _ in range(3):
        side = unit(np.cross(at, random.normal(size=3)))
        theta = random.uniform(0.2, 1.35)
        normals.append(math.sin(theta) * side - math.cos(theta) * at)
        at = reflect(at, normals[-1])
    n2 = [1.5, 1.3, 2.2]
    packed = mirrors(d, normals, n2)
    assert arriving(packed, d, polarised=True, alone=0) == pytest.approx(throughput(d, normals, n2), rel=2e-3)


vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@settings(max_examples=60, deadline=None)
@given(m=vectors, d=vectors, e=vectors)
def test_the_reference_follows_a_scattered_direction_as_a_rotation_takes_it(m: Any, d: Any, e: Any) -> None:
    m, d = unit(m), unit(d)
    e = np.cross(m, e)
    if np.linalg.norm(e) < 0.05 or np.dot(m, d) < 0.0:
        return
    e = unit(e)
    turned = np.array(stokes.carried(tuple(e), tuple(m), tuple(d)))
    assert np.dot(turned, d) == pytest.approx(0.0, abs=1e-14)
    assert np.linalg.norm(turned) == pytest.approx(1.0, abs=1e-14)
    axis = np.cross(m, d)
    assert np.dot(turned, axis) == pytest.approx(np.dot(e, axis), abs=1e-14)  # what is on the axis stays


@settings(max_examples=60, deadline=None)
@given(
    q=st.floats(-1.0, 1.0),
    turn=st.floats(0.0, math.pi),
    cosine=st.floats(0.0, 1.0),
    n2=st.floats(1.0, 3.0),
)
def test_reflection_polarises_at_most_completely(q: float, turn: float, cosine: float, n2: float) -> None:
    r_s, r_p = stokes.amplitudes(cosine, n2)
    r, a, b = stokes.reflected(q * math.cos(turn), q * math.sin(turn), r_s, r_p)
    assert 0.0 <= r <= 1.0 + 1e-15
    assert math.hypot(a, b) <= 1.0 + 1e-12

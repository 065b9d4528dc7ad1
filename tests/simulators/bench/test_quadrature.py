"""The aperture quadrature against 30-digit references, mpmath on other coordinates, and closed forms."""

from __future__ import annotations

import csv
import dataclasses
import math
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest

from gonio_simulators.bench.quadrature import diffuse_power, lobe_power, lobe_powers
from gonio_simulators.bench.truth import lobe_above_horizon
from gonio_simulators.bench.view import view

WIDTH, HEIGHT, DISTANCE = 26.0, 18.0, 95.2353


def reference_rows() -> list[tuple[float, float, float]]:
    lines = Path(__file__).with_name("aperture_lobe.csv").read_text().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    return [(float(r["alpha"]), float(r["delta_deg"]), float(r["integral"])) for r in rows]


def in_plane_mirror(theta_i_deg: float) -> tuple[float, float, float]:
    return math.sin(math.radians(theta_i_deg)), 0.0, math.cos(math.radians(theta_i_deg))


@pytest.mark.parametrize(("alpha", "delta_deg", "expected"), reference_rows())
@pytest.mark.parametrize("theta_o_deg", [0.0, 33.0, -20.0])
def test_reference_file(alpha: float, delta_deg: float, expected: float, theta_o_deg: float) -> None:
    seen = view(
        width_mm=WIDTH,
        height_mm=HEIGHT,
        distance_mm=DISTANCE,
        theta_o_rad=math.radians(theta_o_deg),
        point_mm=(0.0, 0.0),
        mirror=in_plane_mirror(theta_o_deg + delta_deg),
    )
    assert seen is not None
    assert lobe_power(seen, alpha) == pytest.approx(expected, rel=1e-10)


def mpmath_powers(theta_o_deg, point, mirror, alpha, width=WIDTH, height=HEIGHT, distance=DISTANCE):
    """(diffuse, lobe) by mpmath over millimetres of the aperture, in 3-D vectors, no change of variables.

    The domain is cut where the integrand has kinks: the horizon, the rim of the lobe, and the peak.
    """
    theta = mp.radians(theta_o_deg)
    a = (mp.sin(theta), mp.mpf(0), mp.cos(theta))
    u = (mp.cos(theta), mp.mpf(0), -mp.sin(theta))
    origin = (mp.mpf(point[0]), mp.mpf(point[1]), mp.mpf(0))
    m = [mp.mpf(c) for c in mirror]

    def ray(s, t):
        return [distance * a[k] + s * u[k] + (t if k == 1 else 0) - origin[k] for k in range(3)]

    def element(p):
        length = mp.sqrt(sum(c * c for c in p))
        return sum(p[k] * a[k] for k in range(3)) / length**3, length

    def diffuse(s, t):
        p = ray(s, t)
        omega, length = element(p)
        return omega * max(p[2] / length, 0) / mp.pi

    def lobe(s, t):
        p = ray(s, t)
        omega, length = element(p)
        cosine = sum(p[k] * m[k] for k in range(3)) / length
        return omega * cosine**alpha * (alpha + 1) / (2 * mp.pi) if cosine > 0 and p[2] > 0 else mp.mpf(0)

    half_w, half_h = mp.mpf(width) / 2, mp.mpf(height) / 2
    s_cuts = [-half_w, half_w]
    m_u = sum(m[k] * u[k] for k in range(3))
    m_a = sum(m[k] * a[k] for k in range(3))
    if theta != 0:
        s_cuts.append(distance * mp.cos(theta) / mp.sin(theta))  # horizon
    rim = None
    if m_u != 0 and m[1] == 0:
        offset = sum(origin[k] * m[k] for k in range(3))
        rim = (offset - distance * m_a) / m_u
        s_cuts.append(rim)
    if m_a > 0:
        s_cuts.append(distance * m_u / m_a + point[0] * mp.cos(theta))
    s_cuts = sorted(c for c in s_cuts if -half_w <= c <= half_w)
    t_cuts = sorted({-half_h, mp.mpf(point[1]), half_h})
    rule = "tanh-sinh" if rim is not None and rim in s_cuts else "gauss-legendre"
    return (
        mp.quad(diffuse, s_cuts, t_cuts, method="gauss-legendre"),
        mp.quad(lobe, s_cuts, t_cuts, method=rule),
    )


@pytest.mark.parametrize(
    ("alpha", "theta_i_deg", "theta_o_deg", "point", "tilt_deg"),
    [
        (80.0, 20.0, 26.0, (3.0, -2.0), 0.0),  # off-centre footprint
        (25.0, 45.0, 45.0, (-12.0, 6.0), 1.5),  # and a ray out of the plane
        (8.0, 60.0, 86.0, (2.0, 1.0), 0.0),  # cut by the horizon
        (0.7, 55.0, -31.0, (0.0, 0.0), 0.0),  # cut by the rim of the lobe, where cos^0.7 is not smooth
        (3.0, 70.0, -86.0, (1.0, 0.5), 0.0),  # turned away from the lobe, horizon on the other side
    ],
)
def test_against_mpmath(alpha, theta_i_deg, theta_o_deg, point, tilt_deg) -> None:
    tilt, theta_i = math.radians(tilt_deg), math.radians(theta_i_deg)
    mirror = (math.sin(theta_i) * math.cos(tilt), math.sin(tilt), math.cos(theta_i) * math.cos(tilt))
    seen = view(
        width_mm=WIDTH,
        height_mm=HEIGHT,
        distance_mm=DISTANCE,
        theta_o_rad=math.radians(theta_o_deg),
        point_mm=point,
        mirror=mirror,
    )
    with mp.workdps(15):
        diffuse, lobe = mpmath_powers(theta_o_deg, point, mirror, alpha)
    if seen is None:
        assert lobe == 0
        return
    assert diffuse_power([(1.0, seen)]) == pytest.approx(float(diffuse), rel=1e-11)
    assert lobe_power(seen, alpha) == pytest.approx(float(lobe), rel=1e-9)


@pytest.mark.parametrize("alpha", [0.0, 0.02, 0.5, 1.0, 7.3, 100.0, 1e4])
@pytest.mark.parametrize("theta_i_deg", [0.0, 8.0, 55.0, 80.0])
def test_whole_hemisphere_has_all_the_light(alpha: float, theta_i_deg: float) -> None:
    # Three strips of 90 deg, as high as the sky, see every direction above the sample once.
    strips = [
        view(
            width_mm=2.0,
            height_mm=2e7,
            distance_mm=1.0,
            theta_o_rad=math.radians(theta_o_deg),
            point_mm=(0.0, 0.0),
            mirror=in_plane_mirror(theta_i_deg),
        )
        for theta_o_deg in (-90.0, 0.0, 90.0)
    ]
    seen = [s for s in strips if s is not None]
    assert sum(diffuse_power([(1.0, s)]) for s in seen) == pytest.approx(1.0, abs=1e-7)
    expected = lobe_above_horizon(theta_i_deg, alpha)
    assert sum(lobe_power(s, alpha) for s in seen) == pytest.approx(expected, abs=3e-7)


@pytest.mark.parametrize("theta_i_deg", [1.0, 30.0, 75.0, 89.0])
def test_lobe_above_horizon_closed_forms(theta_i_deg: float) -> None:
    # alpha = 0: a lune of the sphere; alpha = 1: the form factor of a tilted plane's sky.
    assert lobe_above_horizon(theta_i_deg, 0.0) == pytest.approx(1.0 - theta_i_deg / 180.0, rel=1e-12)
    cosine = math.cos(math.radians(theta_i_deg))
    assert lobe_above_horizon(theta_i_deg, 1.0) == pytest.approx(0.5 * (1.0 + cosine), rel=1e-12)


def test_diffuse_light_in_a_small_aperture() -> None:
    for theta_o_deg in (0.0, 40.0, -75.0):
        seen = view(
            width_mm=0.02,
            height_mm=0.03,
            distance_mm=100.0,
            theta_o_rad=math.radians(theta_o_deg),
            point_mm=(0.0, 0.0),
            mirror=(0.0, 0.0, 1.0),
        )
        assert seen is not None
        solid_angle = 0.02 * 0.03 / 100.0**2
        expected = math.cos(math.radians(theta_o_deg)) / math.pi * solid_angle
        assert diffuse_power([(1.0, seen)]) == pytest.approx(expected, rel=1e-6)


def test_solid_angle_of_the_aperture_from_a_flat_lobe() -> None:
    seen = view(
        width_mm=WIDTH,
        height_mm=HEIGHT,
        distance_mm=DISTANCE,
        theta_o_rad=0.0,
        point_mm=(0.0, 0.0),
        mirror=(0.0, 0.0, 1.0),
    )
    assert seen is not None
    diagonal = math.sqrt(DISTANCE**2 + WIDTH**2 / 4 + HEIGHT**2 / 4)
    omega = 4.0 * math.atan(WIDTH * HEIGHT / (4.0 * DISTANCE * diagonal))
    assert lobe_power(seen, 0.0) * 2.0 * math.pi == pytest.approx(omega, rel=1e-13)


def test_behind_the_sample_and_behind_the_aperture_is_nothing() -> None:
    def look(theta_o_deg: float, x_mm: float) -> object:
        return view(
            width_mm=WIDTH,
            height_mm=HEIGHT,
            distance_mm=DISTANCE,
            theta_o_rad=math.radians(theta_o_deg),
            point_mm=(x_mm, 0.0),
            mirror=(0.0, 0.0, 1.0),
        )

    assert look(100.0, 0.0) is None
    assert look(-100.0, 0.0) is None
    assert look(89.0, 200.0) is None  # this part of the sample lies beyond the aperture's plane
    assert look(95.0, 0.0) is not None  # the rim of the aperture still sees the sample


def test_sharing_nodes_loses_no_digits() -> None:
    views = []
    for k, x_mm in enumerate((-9.0, -0.3, 0.0, 0.4, 12.0)):
        seen = view(
            width_mm=WIDTH,
            height_mm=HEIGHT,
            distance_mm=DISTANCE,
            theta_o_rad=math.radians(-38.0),
            point_mm=(x_mm, 0.2 * k),
            mirror=in_plane_mirror(45.0),
        )
        assert seen is not None
        views.append((1.0 + k, seen))
    for alphas in (np.geomspace(0.01, 20.0, 30), np.geomspace(1.0, 1e6, 30)):
        together = lobe_powers(views, alphas)
        alone = sum(
            weight * np.array([lobe_power(seen, a) for a in alphas.tolist()]) for weight, seen in views
        )
        np.testing.assert_allclose(together, alone, rtol=1e-9, atol=1e-30)
    on_peak = [(w, dataclasses.replace(v, mirror=(0.05, 0.0, math.sqrt(1 - 0.05**2)))) for w, v in views]
    alphas = np.geomspace(1.0, 1e6, 30)
    alone = sum(w * np.array([lobe_power(v, a) for a in alphas.tolist()]) for w, v in on_peak)
    np.testing.assert_allclose(lobe_powers(on_peak, alphas), alone, rtol=1e-10)

"""The aperture integral against 30-digit references, an independent quadrature, and closed forms."""

from __future__ import annotations

import csv
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mp_lobe import lobe_integral_mp

from gonio.aperture import Aperture, InPlaneAverage
from gonio.errors import ConfigError

ARTA = Aperture(26.0, 18.0, 95.2353)
REFERENCE = Path(__file__).parent / "aperture_lobe.csv"


def reference_rows() -> list[tuple[float, float, float]]:
    lines = [line for line in REFERENCE.read_text().splitlines() if not line.startswith("#")]
    return [(float(r["alpha"]), float(r["delta_deg"]), float(r["integral"])) for r in csv.DictReader(lines)]


@pytest.mark.parametrize(("alpha", "delta_deg", "integral"), reference_rows())
def test_lobe_integral_equals_the_30_digit_reference(alpha: float, delta_deg: float, integral: float) -> None:
    assert float(ARTA.lobe_integral(alpha, delta_deg)) == pytest.approx(integral, rel=1e-13, abs=0.0)


@pytest.mark.parametrize(
    ("aperture", "alpha", "delta_deg", "theta_o_deg"),
    [
        (ARTA, 3.0, 4.4, None),
        (ARTA, 40.0, -7.9, 84.0),
        (ARTA, 3e5, 7.7, None),
        (ARTA, 1e8, 7.7729, None),
        (Aperture(5.0, 40.0, 60.0), 700.0, 3.3, -88.5),
        (Aperture(40.0, 4.0, 50.0), 12.0, 31.0, 70.0),
    ],
)
def test_lobe_integral_off_centre_and_cut_by_the_horizon(
    aperture: Aperture, alpha: float, delta_deg: float, theta_o_deg: float | None
) -> None:
    expected = float(lobe_integral_mp(aperture, alpha, delta_deg, theta_o_deg))
    assert float(aperture.lobe_integral(alpha, delta_deg, theta_o_deg)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("alpha", [0.01, 0.3, 1.5, 29.7, 30.3])
@pytest.mark.parametrize("delta_deg", [44.0, 97.7, 128.0])
@pytest.mark.parametrize("aperture", [ARTA, Aperture(180.0, 150.0, 95.0)], ids=["arta", "wide"])
def test_edge_of_the_lobe_inside_the_aperture(aperture: Aperture, alpha: float, delta_deg: float) -> None:
    """Where cos_+ ends inside the aperture, or just outside: a singularity for fractional alpha."""
    expected = float(lobe_integral_mp(aperture, alpha, delta_deg))
    assert float(aperture.lobe_integral(alpha, delta_deg)) == pytest.approx(expected, rel=1e-12, abs=0.0)


def random_case(kind: str, seed: int) -> tuple[Aperture, float, float, float | None]:
    """An aperture of ±0.06...±45 degrees, a lobe and a detector angle, half of them about the horizon."""
    rng = np.random.default_rng(seed)
    distance = float(rng.uniform(20.0, 400.0))
    tangents = np.exp(rng.uniform(np.log(1e-3), np.log(0.99), 2))
    aperture = Aperture(*(2.0 * distance * tangents), distance)
    half = aperture.half_angles_deg[0]
    if kind == "rim":
        alpha, delta = rng.choice([0.5, rng.uniform(0.0, 40.0)]), 90.0 + rng.uniform(-1.5, 0.9) * half
    elif kind == "flank":  # down to 1e-243 of the peak, but not where one rounding of delta is all of it
        alpha = np.exp(rng.uniform(np.log(1.0), np.log(1e8)))
        delta = half + min(np.rad2deg(np.arccos(np.exp(-rng.uniform(0.0, 560.0) / alpha))), 89.9)
    elif kind == "border":
        alpha = np.exp(rng.uniform(np.log(1e3), np.log(1e8)))
        delta = half + np.rad2deg(rng.uniform(-3.0, 3.0) / np.sqrt(alpha))
    else:
        alpha = np.exp(rng.uniform(np.log(1e-2), np.log(1e8)))
        delta = rng.uniform(0.0, half + min(80.0, 300.0 / np.sqrt(alpha + 1.0)))
    delta *= rng.choice([-1.0, 1.0])
    horizon = rng.choice([-1.0, 1.0]) * (90.0 + rng.uniform(-1.2, 0.9) * half)
    return aperture, float(alpha), float(delta), float(horizon) if seed % 2 else None


@pytest.mark.parametrize("kind", ["rim", "flank", "border", "any"])
@pytest.mark.parametrize("seed", range(4))
def test_random_apertures_and_lobes(kind: str, seed: int) -> None:
    aperture, alpha, delta_deg, theta_o_deg = random_case(kind, seed)
    expected = lobe_integral_mp(aperture, alpha, delta_deg, theta_o_deg)
    if expected < mp.mpf("1e-280"):  # the horizon leaves only what a double cannot hold
        assert float(aperture.lobe_integral(alpha, delta_deg, theta_o_deg)) <= 1e-279
        return
    found = mp.mpf(float(aperture.lobe_integral(alpha, delta_deg, theta_o_deg)))
    assert abs(found / expected - 1) < 1e-12


def test_solid_angle_is_the_lobe_of_exponent_zero() -> None:
    assert ARTA.solid_angle_sr == pytest.approx(0.0509005, abs=5e-8)
    assert 2.0 * np.pi * float(ARTA.lobe_integral(0.0, 12.0)) == pytest.approx(ARTA.solid_angle_sr, rel=1e-14)
    assert ARTA.half_angles_deg == pytest.approx((7.7731, 5.3986), abs=1e-4)


@given(
    width=st.floats(1.0, 100.0),
    height=st.floats(1.0, 100.0),
    alpha=st.floats(0.0, 2e3),
    delta_deg=st.floats(-100.0, 100.0),
)
def test_lobe_integral_is_symmetric_and_grows_with_the_aperture(
    width: float, height: float, alpha: float, delta_deg: float
) -> None:
    small, large = Aperture(width, height, 120.0), Aperture(width * 1.1, height * 1.1, 120.0)
    value = float(small.lobe_integral(alpha, delta_deg))
    assert value == pytest.approx(float(small.lobe_integral(alpha, -delta_deg)), rel=1e-11, abs=1e-300)
    assert 0.0 <= value <= min(float(large.lobe_integral(alpha, delta_deg)) * (1.0 + 1e-12), 1.0 + 1e-13)


def test_small_aperture_tends_to_the_point_receiver() -> None:
    """Eq 18: the error of the dsf at the axis falls with the area of the aperture."""
    errors = []
    for size in (2.0, 1.0, 0.5):
        aperture = Aperture(size, size, 100.0)
        exact = aperture.lobe_integral(50.0, [0.0, 5.0, 12.0], [10.0, 40.0, 70.0])
        point = aperture.variant("point").lobe_integral(50.0, [0.0, 5.0, 12.0], [10.0, 40.0, 70.0])
        errors.append(np.abs(point / exact - 1.0))
    assert np.all(errors[0] < 3e-3)
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=2e-2)
    np.testing.assert_allclose(errors[1] / errors[2], 4.0, rtol=2e-2)


def lambert_polygon(aperture: Aperture, theta_o_deg: float) -> float:
    """∫ cos(theta) dOmega / pi of the rectangle above the horizon by Lambert's polygon formula."""
    o = np.deg2rad(theta_o_deg)
    axis, across = np.array([np.sin(o), 0.0, np.cos(o)]), np.array([np.cos(o), 0.0, -np.sin(o)])
    u = np.array([-0.5, 0.5]) * aperture.width_mm
    horizon = aperture.distance_mm / np.tan(o) if o != 0.0 else np.inf  # u with z = 0
    u = np.minimum(u, horizon) if o > 0.0 else np.maximum(u, horizon if o < 0.0 else -np.inf)
    v = np.array([0.0, 0.5 * aperture.height_mm, 0.0])
    centre = axis * aperture.distance_mm
    corners = [centre + u[0] * across - v, centre + u[1] * across - v, centre + u[1] * across + v]
    corners.append(centre + u[0] * across + v)
    unit = [c / np.linalg.norm(c) for c in corners]
    total = 0.0
    for first, second in zip(unit, unit[1:] + unit[:1], strict=True):
        normal = np.cross(first, second)
        total += np.arctan2(np.linalg.norm(normal), first @ second) * normal[2] / np.linalg.norm(normal)
    return abs(total) / (2.0 * np.pi)


@pytest.mark.parametrize("theta_o_deg", [-89.0, -60.0, 10.0, 45.0, 81.0, 84.0, 86.0, 90.0, 95.0])
@pytest.mark.parametrize("aperture", [ARTA, Aperture(60.0, 50.0, 90.0)])
def test_diffuse_integral_is_lamberts_polygon_cut_by_the_horizon(
    aperture: Aperture, theta_o_deg: float
) -> None:
    expected = lambert_polygon(aperture, theta_o_deg)
    assert float(aperture.diffuse_integral(theta_o_deg)) == pytest.approx(expected, rel=1e-11, abs=1e-16)


def test_nothing_is_received_from_below_the_sample_plane() -> None:
    below = [98.0, -120.0, 150.0]
    for name in ("exact", "eq22", "point"):
        receiver = ARTA.variant(name)
        assert np.all(receiver.diffuse_integral(below) == 0.0)
        assert np.all(receiver.lobe_integral(2.0, [0.0, 5.0, 20.0], below) == 0.0)


def test_table_equals_single_integrals() -> None:
    rng = np.random.default_rng(5)
    alpha = np.exp(rng.uniform(np.log(0.1), np.log(1e6), 25))
    theta_o = rng.uniform(-85.0, 89.0, 60)
    delta = rng.uniform(-95.0, 95.0, 60)
    for receiver in (ARTA, ARTA.variant("eq22"), Aperture.published()):
        table = receiver.lobe_table(alpha, delta, theta_o)
        single = receiver.lobe_integral(alpha[:, None], delta, theta_o)
        np.testing.assert_allclose(table, single, rtol=1e-11, atol=1e-13 * single.max())


def test_ratio_of_eq22_to_the_exact_integral_at_the_peak() -> None:
    """The table in PHYSICS.md, 26 x 18 mm at 94.6 mm, given there to two digits."""
    aperture = Aperture(26.0, 18.0, 94.6)
    alpha = np.array([10.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 5000.0])
    ratio = aperture.variant("eq22").lobe_integral(alpha, 0.0) / aperture.lobe_integral(alpha, 0.0)
    np.testing.assert_allclose(ratio, [1.01, 1.07, 1.14, 1.30, 1.74, 2.38, 5.31], rtol=0.01)


def test_published_pair_is_not_a_rectangle() -> None:
    published = Aperture.published()
    assert published == InPlaneAverage(13.0, 0.0516)
    assert Aperture(26.0, 18.0, 94.5787).solid_angle_sr == pytest.approx(0.0516, abs=5e-7)
    # cos averaged over ±13 deg, not over ±7.8
    mean = np.sin(np.deg2rad(13.0)) / np.deg2rad(13.0)
    assert float(published.diffuse_integral(0.0)) == pytest.approx(0.0516 / np.pi * mean, rel=1e-14)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0.0, 18.0, 95.0), "width_mm = 0.0"),
        ((26.0, float("nan"), 95.0), "height_mm = nan"),
        ((26.0, 18.0, 10.0), "check the distance"),
    ],
)
def test_impossible_apertures_are_refused(arguments: tuple[float, float, float], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        Aperture(*arguments)


def test_nan_stays_nan_and_shapes_broadcast() -> None:
    value = ARTA.lobe_integral(np.array([[10.0], [np.nan]]), np.array([0.0, 5.0, np.nan]))
    assert value.shape == (2, 3)
    assert np.array_equal(np.isnan(value), [[False, False, True], [True, True, True]])

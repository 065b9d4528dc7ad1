"""The instrument function against the bench's two-dimensional quadrature, point by point of the spot."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate

from gonio.aperture import Aperture, IncidentBeam, InstrumentFunction, leaving_out
from gonio.errors import ConfigError, RefusedError
from gonio_simulators.bench.quadrature import diffuse_power, lobe_powers
from gonio_simulators.bench.view import View, view

ARTA = Aperture(26.0, 18.0, 95.2353)
SLIT = Aperture(60.0, 1.5, 120.0)


def one_view(
    aperture: Aperture, theta_o: float, x: float, y: float, mirror: tuple[float, float, float]
) -> View | None:
    return view(
        width_mm=aperture.width_mm,
        height_mm=aperture.height_mm,
        distance_mm=aperture.distance_mm,
        theta_o_rad=theta_o,
        point_mm=(x, y),
        mirror=mirror,
    )


def rule(length: float, panels: int, count: int = 8) -> list[tuple[float, float]]:
    """Gauss-Legendre (weight, offset) of panels over ``±length/2``; the weights add to 1."""
    if length == 0.0:
        return [(1.0, 0.0)]
    nodes, weights = np.polynomial.legendre.leggauss(count)
    half = 0.5 * length / panels
    return [
        (0.5 * w / panels, -0.5 * length + half * (2 * k + 1 + x))
        for k in range(panels)
        for x, w in zip(nodes, weights, strict=True)
    ]


def views_of(
    aperture: Aperture, beam: IncidentBeam, alpha: float, theta_i_deg: float, theta_o_deg: float
) -> list[tuple[float, View]]:
    """Panels of about a lobe's width over the spot and over the cone."""
    theta_i, theta_o = math.radians(theta_i_deg), math.radians(theta_o_deg)
    lobe = 1.0 / math.sqrt(alpha + 1.0)
    cone, spot = math.radians(beam.divergence_deg), beam.width_mm / math.cos(theta_i)
    along = max(2, math.ceil(spot / aperture.distance_mm / lobe))
    across = max(1, math.ceil(beam.height_mm / aperture.distance_mm / lobe))
    count = 4 if alpha < 500.0 else 8
    turns = rule(cone, max(1, math.ceil(0.5 * cone / lobe)), count)
    found = []
    for w_a, a in turns:
        for w_b, b in turns:
            mirror = (
                math.sin(theta_i + a) * math.cos(b),
                -math.sin(b),
                math.cos(theta_i + a) * math.cos(b),
            )
            for w_x, x in rule(spot, along, count):
                for w_y, y in rule(beam.height_mm, across, count):
                    seen = one_view(aperture, theta_o, x, y, mirror)
                    if seen is not None:
                        found.append((w_a * w_b * w_x * w_y, seen))
    return found


CASES = [
    (ARTA, IncidentBeam(1.0, 1.0, 0.0), 300.0, 55.0, 63.0),
    (ARTA, IncidentBeam(10.0, 3.0, 0.0), 30.0, 55.0, 40.0),
    (ARTA, IncidentBeam(4.0, 0.0, 0.0), 3e4, 45.0, 52.4),
    (ARTA, IncidentBeam(0.0, 9.0, 0.0), 0.3, 20.0, 31.0),
    (ARTA, IncidentBeam(0.0, 0.0, 2.0), 3e3, 20.0, 27.6),
    (ARTA, IncidentBeam(2.0, 2.0, 1.0), 100.0, 55.0, 70.0),
    (SLIT, IncidentBeam(0.0, 4.0, 0.0), 1e4, 30.0, 33.0),
    (SLIT, IncidentBeam(0.0, 0.0, 1.5), 2e4, 60.0, 71.0),
    (SLIT, IncidentBeam(3.0, 1.0, 0.5), 10.0, 60.0, -20.0),
]


@pytest.mark.parametrize(("aperture", "beam", "alpha", "theta_i", "theta_o"), CASES, ids=str)
def test_lobe_is_the_mean_over_spot_and_cone(
    aperture: Aperture, beam: IncidentBeam, alpha: float, theta_i: float, theta_o: float
) -> None:
    expected = float(lobe_powers(views_of(aperture, beam, alpha, theta_i, theta_o), np.array([alpha]))[0])
    peak = float(aperture.lobe_integral(alpha, 0.0))
    instrument = InstrumentFunction(aperture, beam)
    found = float(instrument.lobe_integral(alpha, theta_i - theta_o, theta_o, theta_i))
    assert expected > 1e-9 * peak
    assert found == pytest.approx(expected, rel=0.0, abs=1e-11 * peak)
    table = instrument.lobe_table(
        np.array([0.2, alpha, 9e5]), np.array([theta_i - theta_o]), np.array([theta_o])
    )
    assert table[1, 0] == pytest.approx(expected, rel=0.0, abs=1e-11 * peak)


@pytest.mark.parametrize(("alpha", "theta_o"), [(1e6, 52.7), (1e5, 53.1), (1e6, 83.0)])
def test_a_lobe_that_enters_within_the_spot(alpha: float, theta_o: float) -> None:
    """Only part of the spot sends its narrow lobe into the aperture; adaptive quadrature along the spot."""
    theta_i, beam = (45.0, IncidentBeam(3.0, 1.0)) if theta_o < 80.0 else (75.0, IncidentBeam(0.8, 1.0))
    mirror = (math.sin(math.radians(theta_i)), 0.0, math.cos(math.radians(theta_i)))
    half = 0.5 * beam.width_mm / math.cos(math.radians(theta_i))

    def at(x: float) -> float:
        seen = one_view(ARTA, math.radians(theta_o), x, 0.2, mirror)
        return 0.0 if seen is None else float(lobe_powers([(1.0, seen)], np.array([alpha]))[0])

    # at the edge the rim of the aperture lies in the mirror direction
    low, high = -half, half
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if (at(middle) > 0.5) == (at(half) > 0.5) else (middle, high)
    near = [low + k * 0.3 * ARTA.distance_mm / math.sqrt(alpha) for k in (-9, -3, 0, 3, 9)]
    expected = integrate.quad(at, -half, half, points=near, epsabs=1e-13, epsrel=0.0, limit=400)[0] / (
        2.0 * half
    )
    assert 0.02 < expected < 0.98
    # narrow as it is, nothing is cut out of the plane, wherever on the spot's height
    found = float(InstrumentFunction(ARTA, beam).lobe_integral(alpha, theta_i - theta_o, theta_o))
    assert found == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("theta_o", [-60.0, 20.0, 81.0, 86.0, 90.0, 95.0])
def test_diffuse_is_the_mean_over_the_spot(theta_o: float) -> None:
    beam = IncidentBeam(5.0, 8.0, 1.0)
    instrument = InstrumentFunction(ARTA, beam)
    spot = IncidentBeam(5.0, 8.0)
    # at the horizon the mean has a kink where it enters the aperture, which panels only approach
    tolerance = 1e-13 if abs(theta_o) < 80.0 else 1e-7
    expected = diffuse_power(views_of(ARTA, spot, 400.0, 55.0, theta_o))
    assert float(instrument.diffuse_integral(theta_o, 55.0)) == pytest.approx(
        expected, rel=tolerance, abs=1e-11
    )


def test_a_line_of_light_is_the_aperture() -> None:
    line = InstrumentFunction(ARTA, IncidentBeam())
    theta_o = np.array([20.0, 25.0, 88.0])
    delta = 20.0 - theta_o
    np.testing.assert_array_equal(
        line.lobe_integral(100.0, delta, theta_o), ARTA.lobe_integral(100.0, delta, theta_o)
    )
    np.testing.assert_array_equal(line.diffuse_integral(theta_o), ARTA.diffuse_integral(theta_o))


def test_a_small_beam_differs_by_the_square_of_its_size() -> None:
    change = [
        InstrumentFunction(ARTA, IncidentBeam(size, size, size)).lobe_integral(200.0, 6.0, 30.0)
        - ARTA.lobe_integral(200.0, 6.0, 30.0)
        for size in (0.2, 0.1, 0.05)
    ]
    np.testing.assert_allclose([change[0] / change[1], change[1] / change[2]], 4.0, rtol=1e-3)


@settings(max_examples=20, deadline=None)
@given(
    width=st.floats(0.0, 8.0),
    height=st.floats(0.0, 8.0),
    divergence=st.floats(0.0, 2.0),
    log_alpha=st.floats(-2.0, 13.8),
    theta_i=st.floats(0.0, 70.0),
    theta_o=st.floats(-88.0, 88.0),
)
def test_table_and_single_values_agree_and_stay_a_fraction(
    width: float, height: float, divergence: float, log_alpha: float, theta_i: float, theta_o: float
) -> None:
    instrument = InstrumentFunction(ARTA, IncidentBeam(width, height, divergence))
    alpha = np.exp([log_alpha, -2.3, 13.8])
    delta, out = np.array([theta_i - theta_o]), np.array([theta_o])
    table = instrument.lobe_table(alpha, delta, out)
    single = float(instrument.lobe_integral(alpha[0], delta[0], out[0]))
    assert -1e-13 <= single <= 1.0 + 1e-12
    assert table[0, 0] == pytest.approx(single, rel=0.0, abs=2e-12)
    assert float(instrument.lobe_integral(alpha[0], -delta[0], -out[0])) == pytest.approx(single, abs=2e-12)


def test_moments_of_the_tilt_expand_any_reflectance() -> None:
    """R(theta_i + a) = 1 + 3 a + 40 a^2 over the cone, against a sum over parallel beams."""
    cone = math.radians(1.0)
    coefficients = [1.0 + 40.0 * cone**2 / 12.0, 3.0 * cone / 2.0, 40.0 * cone**2 / 6.0]  # of P_0, P_1, P_2
    delta, out, alpha = np.array([-7.0]), np.array([52.0]), np.array([3000.0])
    moments = InstrumentFunction(ARTA, IncidentBeam(0.0, 0.0, 1.0)).lobe_moments(alpha, delta, out)
    expected = 0.0
    for w_a, a in rule(cone, 6):
        for w_b, b in rule(cone, 6):
            i = math.radians(45.0) + a
            mirror = (math.sin(i) * math.cos(b), -math.sin(b), math.cos(i) * math.cos(b))
            seen = one_view(ARTA, math.radians(52.0), 0.0, 0.0, mirror)
            assert seen is not None
            lobe = float(lobe_powers([(1.0, seen)], alpha)[0])
            expected += w_a * w_b * (1.0 + 3.0 * a + 40.0 * a**2) * lobe
    assert float(np.dot(coefficients, moments[:, 0, 0])) == pytest.approx(expected, rel=1e-11)


def test_what_is_left_out_is_what_the_bench_changes_by() -> None:
    beam, alpha = IncidentBeam(2.0, 3.0, 0.5), 250.0
    theta_i, theta_o = np.array([20.0, 45.0, 55.0]), np.array([26.0, 52.0, 55.0])
    found = {part.part: part for part in leaving_out(InstrumentFunction(ARTA, beam), alpha, theta_i, theta_o)}
    read = partial(lobes_of_bench, alpha=alpha, theta_i=theta_i, theta_o=theta_o)
    whole = read(beam)
    for part, without in (
        ("length of the spot", IncidentBeam(0.0, 3.0, 0.5)),
        ("height of the spot", IncidentBeam(2.0, 0.0, 0.5)),
        ("divergence", IncidentBeam(2.0, 3.0, 0.0)),
        ("the beam as a whole", IncidentBeam()),
    ):
        change = np.abs(read(without) - whole)
        assert found[part].lobe == pytest.approx(np.max(change), rel=1e-7)
        assert found[part].relative_lobe == pytest.approx(np.max(change) / np.max(whole), rel=1e-7)
    assert found["divergence"].diffuse == 0.0
    assert found["height of the aperture"].relative_lobe > 0.1
    spot = found["length of the spot"]
    assert spot.reading(0.72, 0.04) == pytest.approx(0.72 * spot.diffuse + 0.04 * spot.lobe)


def lobes_of_bench(beam: IncidentBeam, alpha: float, theta_i: np.ndarray, theta_o: np.ndarray) -> np.ndarray:
    return np.array(
        [
            float(lobe_powers(views_of(ARTA, beam, alpha, i, o), np.array([alpha]))[0])
            for i, o in zip(theta_i, theta_o, strict=True)
        ]
    )


def test_parts_that_are_not_there_are_not_listed() -> None:
    parts = leaving_out(InstrumentFunction(ARTA, IncidentBeam(1.0, 0.0)), [10.0, 1e3], 45.0, [40.0, 45.0])
    assert [p.part for p in parts] == ["height of the aperture", "length of the spot"]


def test_what_cannot_be_integrated_is_refused() -> None:
    instrument = InstrumentFunction(ARTA, IncidentBeam(2.0, 2.0))
    with pytest.raises(RefusedError, match=r"at theta_i = 89.5 deg the beam of 2 mm lights 229"):
        instrument.lobe_integral(10.0, 0.0, 89.5)
    with pytest.raises(ConfigError, match="give theta_o_deg"):
        instrument.lobe_integral(10.0, 0.0)
    with pytest.raises(ConfigError, match="give theta_i_deg"):
        instrument.diffuse_integral(10.0)
    with pytest.raises(ConfigError, match="width_mm = -1"):
        IncidentBeam(-1.0)
    with pytest.raises(ConfigError, match="divergence_deg = 30 deg is more than"):
        IncidentBeam(0.0, 0.0, 30.0)
    values = instrument.lobe_integral([10.0, np.nan], 0.0, [20.0, 20.0])
    assert np.array_equal(np.isnan(values), [False, True])

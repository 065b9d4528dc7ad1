"""The derivatives of the lobe integral by log(alpha), those of the border and those of the fit's table."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from mp_lobe import lobe_integral_mp

from gonio.aperture import Aperture, IncidentBeam, InstrumentFunction
from gonio.fitting.lobe_table import ALPHA_MAX, ALPHA_MIN, LobeTable

ARTA = Aperture(26.0, 18.0, 95.2353)


@pytest.mark.parametrize(
    ("aperture", "alpha", "delta_deg", "theta_o_deg"),
    [
        (ARTA, 0.2, 5.0, None),
        (ARTA, 3.0, 95.0, None),
        (ARTA, 130.0, 11.4, 84.0),
        (ARTA, 2000.0, -7.0, None),
        (ARTA, 5e4, 8.5, None),
        (Aperture(4.0, 60.0, 100.0), 1400.0, 0.6, -89.7),
        (Aperture(120.0, 100.0, 95.0), 12.0, 50.0, 70.0),
    ],
)
def test_derivatives_are_differences_of_30_digit_values(
    aperture: Aperture, alpha: float, delta_deg: float, theta_o_deg: float | None
) -> None:
    with mp.workdps(30):
        step = mp.mpf("1e-5")
        low, middle, high = (
            lobe_integral_mp(aperture, mp.mpf(alpha) * mp.exp(k * step), delta_deg, theta_o_deg)
            for k in (-1, 0, 1)
        )
        wider = [
            lobe_integral_mp(aperture, mp.mpf(alpha) * mp.exp(2 * k * step), delta_deg, theta_o_deg)
            for k in (-1, 1)
        ]
        # the error of five points is step^4 times a higher derivative
        first = (8 * (high - low) - (wider[1] - wider[0])) / (12 * step)
        second = (16 * (high + low) - (wider[1] + wider[0]) - 30 * middle) / (12 * step**2)
        expected = float(first), float(second)
    found = [
        float(aperture.lobe_integral_dlog_alpha(alpha, delta_deg, theta_o_deg, order=order))
        for order in (1, 2)
    ]
    assert found[0] == pytest.approx(expected[0], rel=1e-11, abs=0.0)
    assert found[1] == pytest.approx(expected[1], rel=1e-10, abs=0.0)


def test_a_lobe_caught_whole_keeps_the_digits_of_its_derivative() -> None:
    """Along the axis of a wide square aperture, ``1 - L`` is four integrals of cos^(alpha+1) over angle."""
    aperture, alpha = Aperture(80.0, 80.0, 100.0), 900.0
    with mp.workdps(40):
        a, t = mp.mpf(alpha), mp.mpf("0.4")
        # the border in polar coordinates: cos(theta) = 1/sqrt(1 + t^2 / cos(phi)^2), |phi| <= 45 deg

        def lost(power: mp.mpf) -> mp.mpf:
            cosine = lambda phi: (1 + (t / mp.cos(phi)) ** 2) ** mp.mpf("-0.5")  # noqa: E731
            return mp.quad(lambda phi: cosine(phi) ** power * mp.log(cosine(phi)), [-mp.pi / 4, 0, mp.pi / 4])

        expected = float(-a * 4 * lost(a + 1) / (2 * mp.pi))
    assert 1e-40 < expected < 1e-25
    found = float(aperture.lobe_integral_dlog_alpha(alpha, 0.0))
    assert found == pytest.approx(expected, rel=1e-12, abs=0.0)


def test_the_derivative_vanishes_at_alpha_zero_and_below_the_horizon() -> None:
    assert float(ARTA.lobe_integral_dlog_alpha(0.0, 10.0)) == 0.0
    assert float(ARTA.lobe_integral_dlog_alpha(50.0, 10.0, 99.0)) == 0.0
    values = ARTA.lobe_integral_dlog_alpha([[5.0], [np.nan]], [0.0, 3.0])
    assert values.shape == (2, 2)
    assert np.array_equal(np.isnan(values), [[False, False], [True, True]])


@pytest.mark.parametrize("aperture", [ARTA, Aperture(3.0, 3.0, 200.0), Aperture(80.0, 60.0, 100.0)])
def test_the_fits_table_has_values_and_derivatives(aperture: Aperture) -> None:
    rng = np.random.default_rng(11)
    theta_i = np.repeat([20.0, 55.0], 30)
    theta_o = np.clip(theta_i + rng.uniform(-70.0, 31.0, 60), -80.0, 89.0)
    log_alpha = rng.uniform(np.log(ALPHA_MIN), np.log(ALPHA_MAX), 80)
    found = LobeTable.of(aperture, theta_i, theta_o).evaluate(log_alpha, derivatives=2)
    alpha, delta = np.exp(log_alpha)[:, None], theta_i - theta_o
    value = aperture.lobe_integral(alpha, delta, theta_o)
    size = np.max(value, axis=1)
    expected = [value, *(aperture.lobe_integral_dlog_alpha(alpha, delta, theta_o, order=k) for k in (1, 2))]
    for table, exact, limit in zip(found, expected, (1e-12, 1e-10, 1e-7), strict=True):
        assert np.max(np.abs(table - exact.T) / size) < limit


def test_the_fits_table_of_a_beam() -> None:
    instrument = InstrumentFunction(ARTA, IncidentBeam(2.0, 1.0, 0.3))
    theta_i, theta_o = np.array([20.0, 45.0, 55.0, 55.0]), np.array([21.0, 52.6, 47.0, 84.0])
    log_alpha = np.log([0.13, 4.0, 77.0, 3.1e3, 8.3e4, 9.9e5])
    (found,) = LobeTable.of(instrument, theta_i, theta_o).evaluate(log_alpha)
    expected = instrument.lobe_integral(np.exp(log_alpha)[:, None], theta_i - theta_o, theta_o)
    size = np.max(expected, axis=1)
    assert np.max(np.abs(found - expected.T) / size) < 1e-11

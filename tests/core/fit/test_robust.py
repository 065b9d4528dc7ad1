"""Readings that are no measurements: robust losses bear them, and claim what they lose by it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import optimize
from simulated_readings import FloatArray, Positions, instrument_noise

from gonio.aperture import Aperture
from gonio.fitting import FitResult, fit_readings
from gonio.fitting.robust import variance_factor, weight_factor

Readings = Callable[..., FloatArray]
TRUTH = (0.72, 1.0, 90.0, 1.5)


def run(at: Positions, y: FloatArray, aperture: Aperture, **options: object) -> FitResult:
    return fit_readings(at.theta_i_deg, at.theta_o_deg, at.polarization, y, instrument=aperture, **options)  # type: ignore[arg-type]


def with_noise(r: FloatArray, seed: int, m: int) -> FloatArray:
    return r[:, None] + instrument_noise(r)[:, None] * np.random.default_rng(seed).standard_normal(
        (r.size, m)
    )


@pytest.mark.parametrize(("loss", "bias"), [("tukey", 0.45), ("huber", 0.9)])
def test_outliers_do_little_harm(
    positions: Positions, exact_readings: Readings, aperture: Aperture, loss: str, bias: float
) -> None:
    """3 % of the readings half again too large: dust on the sample, all to one side."""
    y = with_noise(exact_readings(*TRUTH), 1, 60)
    y = np.where(np.random.default_rng(2).random(y.shape) < 0.03, 1.5 * y, y)
    fit = run(positions, y, aperture, loss=loss)
    z = (fit.value - TRUTH) / fit.se
    assert np.all(np.abs(np.mean(z, axis=0)) < bias)
    assert np.all(np.abs(np.std(z, axis=0) - 1.0) < 0.3)
    covered = np.mean((fit.lower <= TRUTH) & (fit.upper >= TRUTH), axis=0)
    assert np.all(covered > (0.88 if loss == "tukey" else 0.75))
    plain = run(positions, y, aperture)
    assert np.all(np.median(plain.se, axis=0) > 8.0 * np.median(fit.se, axis=0))


@pytest.mark.parametrize("loss", ["tukey", "huber"])
def test_without_outliers_a_robust_loss_costs_five_percent(
    positions: Positions, exact_readings: Readings, aperture: Aperture, loss: str
) -> None:
    y = with_noise(exact_readings(*TRUTH), 3, 100)
    fit, plain = run(positions, y, aperture, loss=loss), run(positions, y, aperture)
    # 95 % efficiency: standard errors larger by 1/sqrt(0.95)
    np.testing.assert_allclose(np.median(fit.se / plain.se, axis=0), 1.026, atol=0.02)
    spread = np.std(fit.value, axis=0) / np.std(plain.value, axis=0)
    assert np.all(np.abs(spread - 1.026) < 0.08)


def test_hubers_optimum_is_scipys(positions: Positions, exact_readings: Readings, aperture: Aperture) -> None:
    """scipy's huber loss with f_scale = 1.345 s is the same function, s being the fit's own scale."""
    y = with_noise(exact_readings(*TRUTH), 4, 1)
    y[::40] *= 1.3
    fit = run(positions, y, aperture, loss="huber", weights="none")
    delta, diffuse = (
        positions.theta_i_deg - positions.theta_o_deg,
        aperture.diffuse_integral(positions.theta_o_deg),
    )
    is_s = positions.polarization == "s"

    def residual(p: FloatArray) -> FloatArray:
        from simulated_readings import fresnel_textbook

        lobe = aperture.lobe_integral(np.exp(p[2]), delta, positions.theta_o_deg)
        r = fresnel_textbook(p[3], positions.theta_i_deg, np.where(is_s, "s", "p"))
        return (p[0] * diffuse + p[1] * r * lobe - y[:, 0]) / scale

    size = np.sort(np.abs(fit.residual[:, 0]))
    # of 292 residuals the 4 smallest belong to the 4 parameters
    scale = 1.4826022185056018 * 0.5 * (size[4 + 143] + size[4 + 144])
    found = optimize.least_squares(
        residual, [0.7, 1.1, 4.4, 1.45], loss="huber", f_scale=1.345, xtol=1e-15, ftol=1e-15, gtol=1e-15,
        x_scale=[0.7, 1.0, 4.0, 1.5],
    )  # fmt: skip
    np.testing.assert_allclose(fit.value[0, [0, 1, 3]], found.x[[0, 1, 3]], rtol=1e-5)


@pytest.mark.parametrize(("loss", "efficiency"), [("huber", 0.95), ("tukey", 0.95)])
def test_efficiency_for_normal_noise_is_that_of_the_textbooks(loss: str, efficiency: float) -> None:
    """Huber (1964) and Holland & Welsch (1977): the tuning constants give 95 %."""
    u = np.random.default_rng(5).standard_normal((400_000, 1))
    factor = variance_factor(u, np.ones_like(u, bool), loss, 0)  # type: ignore[arg-type]
    np.testing.assert_allclose(1.0 / factor, efficiency, atol=0.003)
    assert float(weight_factor(np.array([0.0]), loss)[0]) == 1.0  # type: ignore[arg-type]
    assert float(weight_factor(np.array([50.0]), loss)[0]) == pytest.approx(  # type: ignore[arg-type]
        1.345 / 50.0 if loss == "huber" else 0.0
    )

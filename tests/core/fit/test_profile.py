"""Profile likelihood: against a constrained minimisation of our own by scipy, and against closed forms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import optimize, stats
from simulated_readings import FloatArray, Positions, fresnel_textbook, instrument_noise

from gonio.aperture import Aperture
from gonio.brdf import PublishedLobe
from gonio.errors import FitError
from gonio.fitting import FitResult, fit_readings
from gonio.fitting.accepted import profile

Readings = Callable[..., FloatArray]


def fitted(
    positions: Positions, r: FloatArray, aperture: Aperture, *, noise: float, m: int = 3, **options: object
) -> tuple[FitResult, FloatArray]:
    rng = np.random.default_rng(3)
    y = r[:, None] + noise * instrument_noise(r)[:, None] * rng.standard_normal((r.size, m))
    fit = fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization, y,
        instrument=aperture, wavelength_nm=500.0 + 10.0 * np.arange(m), **options,  # type: ignore[arg-type]
    )  # fmt: skip
    return fit, y


def coefficient(name: str, theta: FloatArray) -> float:
    rho_d, rho_s, alpha, n2 = theta
    lobe = PublishedLobe(rho_d, rho_s, alpha, n2)
    if name == "k_s":
        return float(lobe.specular_albedo(8.0, "unpolarized"))
    if name == "k_g":
        return float(lobe.directional_albedo(8.0, "unpolarized"))
    return float(theta[("rho_d", "rho_s", "alpha", "n2").index(name)])


@pytest.mark.parametrize("name", ["rho_d", "rho_s", "alpha", "n2", "k_s", "k_g"])
def test_ends_are_where_scipy_s_constrained_minimum_reaches_the_threshold(
    positions: Positions, exact_readings: Readings, aperture: Aperture, name: str
) -> None:
    """min chi2 with g = end, by SLSQP over the four published parameters, is min + t^2 s^2."""
    fit, y = fitted(positions, exact_readings(0.72, 1.0, 90.0, 1.5), aperture, noise=8.0, m=1)
    found = profile(fit, name, points=0)
    delta = positions.theta_i_deg - positions.theta_o_deg
    diffuse = aperture.diffuse_integral(positions.theta_o_deg)
    unit = fit.value[0]

    def chi2(scaled: FloatArray) -> float:
        rho_d, rho_s, alpha, n2 = scaled * unit
        lobe = aperture.lobe_integral(alpha, delta, positions.theta_o_deg)
        fresnel = fresnel_textbook(n2, positions.theta_i_deg, positions.polarization)
        residual = y[:, 0] - rho_d * diffuse - rho_s * fresnel * lobe
        return float(np.sum((residual / fit.sigma[:, 0]) ** 2))

    dof = int(fit.dof[0])
    allowed = float(stats.t.ppf(0.975, dof)) ** 2 * fit.chi2[0] / dof
    for end in (found.lower[0], found.upper[0]):
        constraint = {"type": "eq", "fun": lambda p, end=end: coefficient(name, p * unit) / end - 1.0}
        best = optimize.minimize(
            lambda p: (chi2(p) - fit.chi2[0]) / allowed, np.ones(4), method="SLSQP",
            constraints=[constraint], options={"ftol": 1e-10, "maxiter": 300},
        )  # fmt: skip
        assert best.fun == pytest.approx(1.0, abs=2e-3)
    assert found.lower[0] < coefficient(name, unit) < found.upper[0]


def test_profile_of_a_linear_quantity_is_wald_s(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """With n2 given and little noise the problem is nearly linear: the curve is a parabola."""
    fit, _ = fitted(positions, exact_readings(0.72, 1.0, 90.0, 1.5), aperture, noise=1.0, n2=1.5)
    found = profile(fit, "rho_d", points=21)
    np.testing.assert_allclose(found.lower, fit.lower[:, 0], rtol=1e-6)
    np.testing.assert_allclose(found.upper, fit.upper[:, 0], rtol=1e-6)
    s2 = fit.chi2 / fit.dof
    parabola = ((found.value - found.estimate) / fit.se[:, 0]) ** 2 * s2
    np.testing.assert_allclose(found.chi2, parabola, rtol=1e-3, atol=1e-4 * s2.max())
    np.testing.assert_allclose(found.threshold, fit.quantile**2 * s2)
    held = profile(fit, "n2", points=5)
    np.testing.assert_allclose([held.lower, held.upper], 1.5)
    assert np.all(np.isnan(held.chi2))


def test_ends_do_not_depend_on_the_parametrisation(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    fit, _ = fitted(positions, exact_readings(0.72, 1.0, 90.0, 1.5), aperture, noise=20.0)
    alpha, log_alpha = profile(fit, "alpha"), profile(fit, "log_alpha")
    np.testing.assert_allclose(np.log(alpha.lower), log_alpha.lower, rtol=1e-9)
    np.testing.assert_allclose(np.log(alpha.upper), log_alpha.upper, rtol=1e-9)
    # the curve: its own chi2 at its ends, 1/4 of the interval beyond; and its minimum at the estimate
    inside = (alpha.value >= alpha.lower) & (alpha.value <= alpha.upper)
    np.testing.assert_array_equal(inside, alpha.chi2 <= alpha.threshold)
    assert np.all(np.min(alpha.chi2, axis=0) < 1e-2 * alpha.threshold)


def test_a_lobe_inside_one_aperture_has_an_alpha_without_upper_end(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    few = positions[np.arange(0, 292, 4)]
    r = exact_readings(0.3, 0.5, 1e5, 1.5)[np.arange(0, 292, 4)]
    rng = np.random.default_rng(0)
    y = r[:, None] * (1.0 + 0.5 * rng.standard_normal((r.size, 4)))
    fit = fit_readings(few.theta_i_deg, few.theta_o_deg, few.polarization, y, instrument=aperture)
    found = profile(fit, "alpha", points=7)
    assert np.any(np.isposinf(found.upper))
    k = int(np.argmax(np.isposinf(found.upper)))
    assert found.text(k).startswith("alpha >= ")
    assert found.lower[k] < 1e5
    # the fit's own open end is the same limit
    assert np.isposinf(fit.upper[k, 2])
    assert found.lower[k] == pytest.approx(fit.lower[k, 2], rel=2e-3)
    k_s = profile(fit, "k_s", points=0)
    assert np.all(np.isfinite([k_s.lower[k], k_s.upper[k]]))


def test_an_index_without_lower_end_leaves_rho_s_without_an_upper_one(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """n2 = 1.02: R is nearly 0 everywhere, its trend that of n2 = 1; rho_s n2's mirror image, k_s known."""
    fit, _ = fitted(positions, exact_readings(0.3, 8.0, 60.0, 1.02), aperture, noise=2.0, m=6)
    n2, rho_s, k_s = (profile(fit, name, points=0) for name in ("n2", "rho_s", "k_s"))
    endless = np.isneginf(n2.lower) | (n2.lower <= 1.0)
    assert np.any(endless)
    np.testing.assert_array_equal(np.isposinf(rho_s.upper), endless)
    assert np.all(np.isfinite(k_s.lower) & np.isfinite(k_s.upper))
    assert rho_s.text(int(np.argmax(endless))).startswith("rho_s >= ")


def test_common_uncertainty_widens_in_quadrature(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = exact_readings(0.72, 1.0, 90.0, 1.5)
    fit, _ = fitted(positions, r, aperture, noise=1.0, gain_u=0.004, offset_u=4e-5)
    for name, column in (("rho_d", 0), ("rho_s", 1), ("alpha", 2), ("n2", 3)):
        found = profile(fit, name, points=0)
        np.testing.assert_allclose(
            found.upper - found.lower, fit.upper[:, column] - fit.lower[:, column], rtol=2e-2
        )
    shared, _ = fitted(positions, r, aperture, noise=1.0, m=12, n2="constant")
    found = profile(shared, "n2", [500.0, 510.0], points=0)
    np.testing.assert_allclose(found.lower, shared.lower[:2, 3], rtol=1e-9)


def test_the_fit_offers_profile_intervals(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = exact_readings(0.3, 0.5, 20.0, 1.1)
    fit, _ = fitted(positions, r, aperture, noise=3.0, intervals="profile")
    wald, _ = fitted(positions, r, aperture, noise=3.0)
    assert fit.intervals == "profile"
    for column, name in enumerate(fit.parameters):
        found = profile(wald, name, points=0)
        np.testing.assert_allclose(fit.upper[:, column], found.upper, rtol=1e-9)
    np.testing.assert_array_equal(fit.se, wald.se)
    assert np.all(fit.upper[:, 1] - fit.value[:, 1] > fit.value[:, 1] - fit.lower[:, 1])


def test_without_a_lobe_only_the_diffuse_part_has_an_interval(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    fit, _ = fitted(positions, exact_readings(0.5, 0.0, 90.0, 1.5), aperture, noise=1.0)
    assert profile(fit, "alpha").text(0) == "alpha is undefined"
    assert np.all(np.isnan(profile(fit, "k_s").lower))
    np.testing.assert_array_equal(profile(fit, "k_d").lower, fit.lower[:, 0])
    lambert, _ = fitted(positions, exact_readings(0.5, 0.0, 90.0, 1.5), aperture, noise=1.0, model="lambert")
    k_d = profile(lambert, "k_g")
    np.testing.assert_allclose(k_d.lower, lambert.lower[:, 0], rtol=1e-6)
    assert profile(lambert, "k_s").text(0) == "k_s is undefined"
    robust, _ = fitted(positions, exact_readings(0.72, 1.0, 90.0, 1.5), aperture, noise=1.0, loss="huber")
    with pytest.raises(FitError, match="loss = 'huber' has no profile"):
        profile(robust, "alpha")
    with pytest.raises(FitError, match="'gloss' is no quantity of model 'published lobe'; use one of rho_d"):
        profile(fit, "gloss")

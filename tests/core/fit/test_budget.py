"""The uncertainty budget: against the bench's own quadrature, refits with another aperture, and trials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated_readings import FloatArray, Positions, instrument_noise, plane_quadrature

from gonio.aperture import Aperture
from gonio.brdf import PublishedLobe
from gonio.errors import ConfigError, FitError
from gonio.fitting import FitResult, fit_readings
from gonio.fitting.bands import band_average
from gonio.fitting.budget import Budget, budget
from gonio.fitting.changes import Seen, changes
from gonio.fitting.identifiability import identifiability
from gonio.fitting.inputs import Input, inputs_of, stated_in
from gonio.fitting.jcgm101 import monte_carlo
from gonio.fitting.misaligned import Bench, readings_on
from gonio.fitting.problem import Problem
from gonio.rig import default_rig_text
from gonio.rig.uncertainty import Stated, UncertaintyConfig

Readings = Callable[..., FloatArray]
TRUTH = (0.72, 1.0, 90.0, 1.5)
FIELDS = {
    "aperture_width": "width_mm", "aperture_height": "height_mm", "distance": "distance_mm",
    "arm_zero": "arm_zero_deg", "theta_i_zero": "theta_i_zero_deg", "sample_offset": "offset_mm",
    "sample_tilt": "tilt_deg",
}  # fmt: skip


def fitted(
    positions: Positions, r: FloatArray, aperture: Aperture, m: int = 5, **options: object
) -> FitResult:
    rng = np.random.default_rng(1)
    y = r[:, None] + instrument_noise(r)[:, None] * rng.standard_normal((r.size, m))
    return fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization, y,
        instrument=aperture, wavelength_nm=500.0 + 10.0 * np.arange(m), **options,  # type: ignore[arg-type]
    )  # fmt: skip


def by_quadrature(positions: Positions, bench: Bench, truth: tuple[float, ...] = TRUTH) -> FloatArray:
    surface = PublishedLobe(*truth)
    return readings_on(
        bench, (surface, surface), positions.theta_i_deg, positions.theta_o_deg,
        positions.polarization == "s", sharpness=4.0 * truth[2],
    )[:, 0]  # fmt: skip


def test_quadrature_of_an_aligned_bench_is_that_of_the_plane(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """Two quadratures by different hands; near the horizon ours does not end where the sample does."""
    inside = positions.theta_o_deg < 80.0
    r = by_quadrature(positions, Bench.nominal(aperture))
    np.testing.assert_allclose(r[inside], exact_readings(*TRUTH)[inside], rtol=1e-8)


def test_quadrature_of_a_displaced_surface_is_a_bench_seen_from_elsewhere(aperture: Aperture) -> None:
    """At normal incidence, seen along the normal: a surface 2 mm ahead is an aperture 2 mm nearer."""
    at = Positions(np.zeros(1), np.zeros(1), np.array(["s"]))
    nominal = Bench.nominal(aperture)
    moved = by_quadrature(at, replace(nominal, offset_mm=2.0))
    nearer = plane_quadrature(at, *TRUTH, Aperture(26.0, 18.0, aperture.distance_mm - 2.0))
    np.testing.assert_allclose(moved, nearer, rtol=1e-9)
    # a tilt of 1 deg turns the lobe out of the plane by 2 deg: to a square aperture as if in plane
    square = replace(nominal, height_mm=26.0)
    tilted = by_quadrature(at, replace(square, tilt_deg=1.0), (0.0, 1.0, 90.0, 1.5))
    turned = plane_quadrature(
        Positions(np.full(1, 1.0), np.full(1, -1.0), np.array(["s"])),
        0.0,
        1.0,
        90.0,
        1.5,
        Aperture(26, 26, 95.2353),
    )
    np.testing.assert_allclose(tilted, turned, rtol=1e-3)  # R(1 deg) for S against the mean of S and P


@pytest.mark.parametrize("alpha", [20.0, 90.0, 1000.0])
def test_changes_of_the_readings_are_those_of_the_quadrature(
    positions: Positions, aperture: Aperture, alpha: float
) -> None:
    truth = (0.72, 1.0, alpha, 1.5)
    seen = Seen(
        Problem, aperture, positions.theta_i_deg, positions.theta_o_deg, positions.polarization == "s",
        np.array([[0.72, 0.04, np.log(alpha), 1.5]]),
    )  # fmt: skip
    nominal = Bench.nominal(aperture)
    inside = positions.theta_o_deg < 80.0
    sizes = {"sample_tilt": (0.3, 0.12), "sample_offset": (0.1, 0.03), "theta_i_zero": (0.05, 1e-3)}
    for name, field in FIELDS.items():
        u, tolerance = sizes.get(name, (0.05, 3e-4))
        given = Input(name, "", 0.0, u, even=name == "sample_tilt")
        found = changes(seen, (given,))[0, inside, 0]
        at = float(getattr(nominal, field))
        up, down = (
            by_quadrature(positions, replace(nominal, **{field: at + s * u}), truth) for s in (1.0, -1.0)
        )
        expected = 0.5 * (up - down)
        if given.even:
            expected = np.sqrt(3.0) * (0.5 * (up + down) - by_quadrature(positions, nominal, truth))
        distance = np.linalg.norm(found - expected[inside]) / np.linalg.norm(expected[inside])
        assert distance < tolerance, name


def test_a_sensitivity_is_what_a_refit_with_another_distance_gives(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """GUM: the same readings, another value of the input.  1 % of distance is 2 % of rho_d, upwards."""
    r = exact_readings(*TRUTH)
    at = (positions.theta_i_deg, positions.theta_o_deg, positions.polarization)
    fit = fitted(positions, r, aperture)
    y = fit.residual + fit.predict(*at)
    u = 0.01 * aperture.distance_mm
    found = budget(fit, UncertaintyConfig(distance_mm=Stated(u=u), zero_offset_r=Stated(u=1e-3)))
    step = 1e-3 * aperture.distance_mm
    values = []
    for sign in (1.0, -1.0):
        other = replace(aperture, distance_mm=aperture.distance_mm + sign * step)
        refit = fit_readings(*at, y, instrument=other, r_sd=fit.sigma, weights="r_sd")
        k = refit.hemispherical(8.0)
        values.append(
            np.concatenate([np.stack([k.k_d.value, k.k_s.value, k.k_g.value], axis=1), refit.value], axis=1)
        )
    sensitivity = (values[0] - values[1]) / (2.0 * step)
    names = [given.name for given in found.inputs]
    line = found.contribution[names.index("distance")]
    np.testing.assert_allclose(line[:, [0, 1, 2, 3, 5]] / u, sensitivity[:, [0, 1, 2, 3, 5]], rtol=2e-2)
    np.testing.assert_allclose(line[:, 0] / 0.72, 0.0196, rtol=5e-3)
    # 0.1 % of the 100 % beam, against r = 1.2 % at the normal and less elsewhere
    line = found.contribution[names.index("zero_offset")]
    assert np.all((line[:, 0] / 0.72 < -0.085) & (line[:, 0] / 0.72 > -0.14))


def test_combined_is_the_root_of_all_squares_and_the_fit_carries_it(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    fit = fitted(positions, exact_readings(*TRUTH), aperture, gain_u=0.002, offset_u=1e-5)
    config = stated_in(default_rig_text())
    found = budget(fit, config)
    parts = np.concatenate([found.contribution, found.noise[None], found.references[None]])
    np.testing.assert_allclose(found.combined, np.sqrt(np.sum(parts**2, axis=0)), rtol=1e-9)
    k = found.fit.hemispherical(8.0)
    carried = np.concatenate([np.stack([k.k_d.se, k.k_s.se, k.k_g.se], axis=1), found.fit.se], axis=1)
    np.testing.assert_allclose(carried, found.combined, rtol=1e-6)
    assert np.all(found.fit.lower < fit.lower)
    assert np.all(found.fit.upper > fit.upper)
    # each is exact at its own: what a baseline error does to everything that is linear
    names = [given.name for given in found.inputs]
    baseline = found.contribution[names.index("baseline")]
    np.testing.assert_allclose(baseline[:, :3], -0.002 * found.estimate[:, :3], rtol=1e-3)
    assert found.dominant(0, "k_g") == "distance"
    # a band's average does not lose it
    band = band_average(found.fit, 500.0, 540.0, weight="flat").k_d
    modes = np.sqrt(np.sum(np.mean(found.contribution[:, :, 0], axis=1) ** 2))
    assert band.u_common == pytest.approx(modes, rel=1e-2)
    with pytest.raises(FitError, match="hold a budget already"):
        budget(found.fit, config)


def test_what_is_not_stated_is_named_and_adds_nothing(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    fit = fitted(positions, exact_readings(*TRUTH), aperture)
    found = budget(fit, None)
    np.testing.assert_array_equal(found.fit.se, fit.se)
    assert len(found.not_stated) == len(UncertaintyConfig.model_fields)
    table = found.table(521.0)
    assert "budget at 520 nm" in table
    assert "not stated in [uncertainty], taken as 0: aperture_width, aperture_height, distance" in table
    alone = fitted(positions, exact_readings(*TRUTH), aperture, polarization="s")
    assert "baseline_p" not in budget(alone, None).table()
    plain = fitted(positions, exact_readings(0.5, 0.0, 90.0, 1.5), aperture)
    found = budget(plain, UncertaintyConfig(distance_mm=Stated(u=0.5), wavelength_nm=Stated(u=1.0)))
    names = [given.name for given in found.inputs]
    line = found.contribution[names.index("distance")]
    np.testing.assert_allclose(line[:, 0] / 0.5, 2.0 * 0.5 / 95.2353, rtol=3e-2)
    assert np.all(np.isnan(line[:, 1]))
    with pytest.raises(FitError, match="no lobe"):
        monte_carlo(found)


def test_a_wavelength_error_follows_the_slope_of_the_spectrum(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = exact_readings(*TRUTH)
    scale = 1.0 + 1e-3 * 10.0 * np.arange(5)  # 0.1 % per nm
    rng = np.random.default_rng(2)
    y = (r[:, None] + 1e-7 * rng.standard_normal((r.size, 5))) * scale
    fit = fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization, y,
        instrument=aperture, wavelength_nm=500.0 + 10.0 * np.arange(5),
    )  # fmt: skip
    found = budget(fit, UncertaintyConfig(wavelength_nm=Stated(expanded=0.6, coverage_factor=2.0)))
    line = found.contribution[[given.name for given in found.inputs].index("wavelength")]
    np.testing.assert_allclose(line[:, 0], -0.3e-3 * 0.72, rtol=1e-2)


@pytest.fixture(scope="module")
def small_budget(positions: Positions, exact_readings: Readings, aperture: Aperture) -> Budget:
    few = np.arange(1, 292, 5)
    fit = fitted(positions[few], exact_readings(*TRUTH)[few], aperture, gain_u=0.002, offset_u=1e-5)
    return budget(fit, stated_in(default_rig_text()))


def test_monte_carlo_of_the_inputs_agrees_with_the_linear_budget(small_budget: Budget) -> None:
    """Standard deviations of 1000 trials are known to 2.2 %; nothing but u is common to both ways."""
    found = monte_carlo(small_budget, trials=1000, seed=3)
    k = small_budget.at(None)
    np.testing.assert_allclose(np.std(found.sample, axis=0), small_budget.combined[k], rtol=0.09)
    off = (np.mean(found.sample, axis=0) - small_budget.estimate[k]) / small_budget.combined[k]
    assert np.all(np.abs(off) < 0.15)
    assert found.failed == 0
    assert all(c.verdict != "not validated" for c in found.comparisons if c.name in ("k_d", "k_g"))
    assert "JCGM 101: 1000 trials at 520 nm" in found.table()
    again = monte_carlo(small_budget, trials=200, seed=3)
    np.testing.assert_array_equal(again.sample, monte_carlo(small_budget, trials=200, seed=3).sample)
    with pytest.raises(FitError, match="trials = 10 are too few"):
        monte_carlo(small_budget, trials=10)


def test_monte_carlo_says_where_the_linear_budget_fails(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """A tilt of 3 deg moves the lobe by its own width: the effect is one-sided, and k_s biased."""
    few = np.arange(1, 292, 5)
    fit = fitted(positions[few], exact_readings(*TRUTH)[few], aperture)
    found = monte_carlo(budget(fit, UncertaintyConfig(sample_tilt_deg=Stated(u=3.0))), trials=600)
    verdicts = {c.name: c.verdict for c in found.comparisons}
    assert verdicts["k_s"] == "not validated"
    assert "does not hold for" in found.table()


def test_statements_of_uncertainty(aperture: Aperture) -> None:
    text = """
    [uncertainty]
    distance_mm = { half_width = 0.3 }
    aperture_width_mm = { expanded = 0.04, coverage_factor = 2.0 }
    arm_zero_deg = 0.02
    """
    by_name = {given.name: given for given in inputs_of(stated_in(text), aperture)}
    assert by_name["distance"].u == pytest.approx(0.3 / np.sqrt(3.0))
    assert by_name["distance"].value == 95.2353
    assert by_name["aperture_width"].u == pytest.approx(0.02)
    assert by_name["arm_zero"].u == 0.02
    assert by_name["wavelength"].u is None
    rng = np.random.default_rng(0)
    draws = by_name["distance"].draw(rng, 20000)
    assert np.max(np.abs(draws)) <= 0.3
    assert np.std(draws) == pytest.approx(0.3 / np.sqrt(3.0), rel=0.02)
    fourth = np.sqrt(np.mean(draws**4)) / np.var(draws)
    assert fourth == pytest.approx(by_name["distance"].root_mean_fourth, rel=0.02)
    assert stated_in("name = 'x'") is None
    for wrong, message in (
        ("distance_mm = -1.0", "greater than or equal to 0"),
        ("distance_mm = { expanded = 1.0 }", "belong together"),
        ("distance_mm = { u = 1.0, half_width = 1.0 }", "one way"),
        ("distanc_mm = 1.0", "did you mean 'distance_mm'"),
    ):
        with pytest.raises(ConfigError, match=message):
            stated_in(f"[uncertainty]\n{wrong}")


def test_identifiability_names_what_moves_together(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = exact_readings(*TRUTH)
    joint, alone = (identifiability(fitted(positions, r, aperture, polarization=p)) for p in ("joint", "s"))
    assert np.all(alone.condition > joint.condition)
    assert "rho_s and n2 move together" in alone.text[0]
    assert "rho_s R at 55 deg changes by" in alone.text[0]
    # the direction is that of the covariance: rho_s and n2 against each other
    assert np.all(alone.direction[:, 1] * alone.direction[:, 3] < 0.0)
    fit = fitted(positions, r, aperture, polarization="s")
    off = ~np.eye(4, dtype=bool)
    np.testing.assert_allclose(alone.correlation[:, off], fit.correlation[:, off], rtol=1e-9)
    given = identifiability(fitted(positions, r, aperture, n2=1.5))
    assert given.text == ("",) * 5
    one = positions.theta_i_deg == 45.0
    one &= positions.polarization == "s"
    single = identifiability(fitted(positions[one], r[one], aperture))
    assert np.all(np.isposinf(single.condition))
    assert "are not determined by these data" in single.text[0]

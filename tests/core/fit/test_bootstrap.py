"""The parametric bootstrap: reproducible, like Wald's where the fit is linear, better where it is not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats
from simulated_readings import FloatArray, Positions, instrument_noise

from gonio.aperture import Aperture
from gonio.errors import FitError
from gonio.fitting import FitResult, fit_readings
from gonio.fitting.bootstrap import bootstrap

Readings = Callable[..., FloatArray]


def fitted(
    positions: Positions, r: FloatArray, aperture: Aperture, noise: float, m: int, **options: object
) -> FitResult:
    rng = np.random.default_rng(5)
    y = r[:, None] + noise * instrument_noise(r)[:, None] * rng.standard_normal((r.size, m))
    return fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization, y,
        instrument=aperture, wavelength_nm=500.0 + 10.0 * np.arange(m), **options,  # type: ignore[arg-type]
    )  # fmt: skip


def test_replicas_are_the_same_numbers_whatever_else_is_asked_for(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    fit = fitted(positions, exact_readings(0.72, 1.0, 90.0, 1.5), aperture, 1.0, 3, gain_u=0.004)
    whole = bootstrap(fit, replicas=300, seed=7, common=True, keep_sample=True)
    one = bootstrap(fit, replicas=520, seed=7, common=True, keep_sample=True, wavelength_nm=510.0)
    assert whole.sample is not None
    assert one.sample is not None
    np.testing.assert_array_equal(whole.sample[:, 1], one.sample[:300, 0])
    other = bootstrap(fit, replicas=300, seed=8, common=True, wavelength_nm=510.0)
    assert np.all(other.mean != whole.mean[1])
    assert bootstrap(fit, replicas=300, wavelength_nm=510.0).sample is None


def test_intervals_are_order_statistics_and_their_mirror(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    fit = fitted(positions, exact_readings(0.72, 1.0, 90.0, 1.5), aperture, 5.0, 1)
    found = bootstrap(fit, replicas=399, keep_sample=True)
    assert found.sample is not None
    ordered = np.sort(found.sample[:, 0], axis=0)
    np.testing.assert_array_equal(found.percentile.lower[0], ordered[9])
    np.testing.assert_array_equal(found.percentile.upper[0], ordered[389])
    column = found.names.index("k_g")
    k_g = fit.hemispherical(8.0).k_g.value[0]
    assert found.basic.lower[0, column] == pytest.approx(2.0 * k_g - ordered[389, column], abs=1e-12)
    assert found.basic.upper[0, 2] == pytest.approx(fit.value[0, 2] ** 2 / ordered[9, 2], rel=1e-12)


@pytest.mark.parametrize("options", [{}, {"gain_u": 0.004, "offset_u": 4e-5}, {"n2": "constant"}])
def test_replicas_scatter_as_the_covariance_says(
    positions: Positions, exact_readings: Readings, aperture: Aperture, options: dict[str, object]
) -> None:
    fit = fitted(positions, exact_readings(0.72, 1.0, 90.0, 1.5), aperture, 1.0, 8, **options)
    found = bootstrap(fit, replicas=1023, common=True, wavelength_nm=[500.0, 510.0], keep_sample=True)
    k = fit.hemispherical(8.0)
    se = np.concatenate([fit.se, np.stack([k.k_d.se, k.k_s.se, k.k_g.se], axis=1)], axis=1)[:2]
    # the standard deviation of 1023 replicas is known to 2.2 %
    np.testing.assert_allclose(found.sd, se, rtol=0.09)
    np.testing.assert_allclose((found.mean - found.estimate) / se, 0.0, atol=0.15)
    assert np.all(found.failed == 0)
    assert found.sample is not None
    together = np.corrcoef(found.sample[:, 0, 3], found.sample[:, 1, 3])[0, 1]
    if "n2" in options:  # one number
        assert together > 0.999
    else:
        assert abs(together) < 0.15


def test_few_degrees_of_freedom_widen_the_interval_as_students_t(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    few = positions[np.arange(5, 292, 24)]
    r = exact_readings(0.72, 1.0, 90.0, 1.5)[np.arange(5, 292, 24)]
    fit = fitted(few, r, aperture, 0.05, 1, weights="none", n2=1.5)
    dof = int(fit.dof[0])
    assert dof < 11
    found = bootstrap(fit, replicas=1999)
    half = 0.5 * (found.percentile.upper - found.percentile.lower)[0, 0] / fit.se[0, 0]
    assert half == pytest.approx(stats.t.ppf(0.975, dof), rel=0.09)
    assert half > 1.05 * stats.norm.ppf(0.975)


def test_percentile_intervals_cover_where_wald_s_do_not(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """rho_s at n2 = 1.1 has a long tail: over 80 scans Wald's upper end misses it far too often."""
    few = np.arange(0, 292, 4)
    fit = fitted(positions[few], exact_readings(0.3, 0.5, 20.0, 1.1)[few], aperture, 3.0, 80)
    found = bootstrap(fit, replicas=199)
    missed = {
        "wald": int(np.sum(fit.upper[:, 1] < 0.5)),
        "percentile": int(np.sum(found.percentile.upper[:, 1] < 0.5)),
        "basic": int(np.sum(found.basic.upper[:, 1] < 0.5)),
    }
    most = int(stats.binom.ppf(0.999, 80, 0.025))
    assert missed["wald"] > most
    assert missed["percentile"] <= most
    outside = (found.percentile.lower[:, 1] > 0.5) | (found.percentile.upper[:, 1] < 0.5)
    assert np.sum(outside) <= stats.binom.ppf(0.999, 80, 0.05)


def test_an_estimate_at_the_end_of_its_range_is_an_open_end(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    fit = fitted(positions, exact_readings(0.3, 8.0, 60.0, 1.02), aperture, 2.0, 3)
    found = bootstrap(fit, replicas=199)
    endless = np.isposinf(found.percentile.upper[:, 1])
    assert np.any(endless)
    np.testing.assert_array_equal(found.percentile.lower[endless, 3], 1.0)
    assert np.all(np.isnan(found.sd[endless, 1]))
    assert np.all(np.isfinite(found.sd[:, 4:]))


def test_too_few_replicas_are_refused_and_a_plain_surface_has_its_own_interval(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    fit = fitted(positions, exact_readings(0.5, 0.0, 90.0, 1.5), aperture, 1.0, 2)
    with pytest.raises(FitError, match=r"replicas = 50 are too few .* at least 199"):
        bootstrap(fit, replicas=50)
    found = bootstrap(fit, replicas=199)
    np.testing.assert_array_equal(found.percentile.lower[:, 0], fit.lower[:, 0])
    assert np.all(np.isnan(found.percentile.lower[:, 2]))

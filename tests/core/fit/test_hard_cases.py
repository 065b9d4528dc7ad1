"""Data that do not determine everything: the right answer, or a clear word on what is missing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from simulated_readings import FloatArray, Positions, fresnel_textbook, instrument_noise, plane_quadrature

from gonio.aperture import Aperture
from gonio.errors import FitError
from gonio.fitting import FitResult, fit_readings

Readings = Callable[..., FloatArray]
TRUTH = (0.72, 1.0, 90.0, 1.5)


def run(at: Positions, r: FloatArray, instrument: Aperture, /, **options: object) -> FitResult:
    readings = r if r.ndim == 2 else r[:, None]
    return fit_readings(
        at.theta_i_deg, at.theta_o_deg, at.polarization, readings, instrument=instrument, **options
    )  # type: ignore[arg-type]


def noisy(r: FloatArray, seed: int, m: int = 8) -> FloatArray:
    rng = np.random.default_rng(seed)
    return r[:, None] + instrument_noise(r)[:, None] * rng.standard_normal((r.size, m))


@pytest.mark.parametrize("noise", [True, False])
def test_without_a_lobe_alpha_and_n2_are_undefined(
    positions: Positions, exact_readings: Readings, aperture: Aperture, noise: bool
) -> None:
    r = exact_readings(0.6, 0.0, 50.0, 1.5)
    fit = run(positions, noisy(r, 1) if noise else r, aperture)
    assert np.all(fit.value[:, 1] == 0.0)
    assert np.all(np.isnan(fit.value[:, 2:]))
    assert np.all(np.isnan(fit.se[:, 1:]))
    assert all("no lobe is seen" in note for note in fit.notes)
    np.testing.assert_allclose(fit.value[:, 0], 0.6, atol=6e-4 if noise else 1e-9)
    k = fit.hemispherical(8.0)
    np.testing.assert_array_equal(k.k_g.value, fit.value[:, 0])
    np.testing.assert_allclose(k.k_g.se, fit.se[:, 0], rtol=1e-13)
    assert np.all(np.isnan(k.k_s.se))
    assert np.all(np.isfinite(fit.predict(30.0, 30.0, "s")))


def test_lobe_inside_one_aperture_bounds_alpha_from_below(positions: Positions, aperture: Aperture) -> None:
    """A mirror under its diffuse light: the aperture catches all of the specular beam or nothing."""
    diffuse = plane_quadrature(positions, 0.72, 0.0, 0.0, 1.5, aperture, panels=3)
    inside = np.abs(positions.theta_o_deg - positions.theta_i_deg) < aperture.half_angles_deg[0]
    r = diffuse + fresnel_textbook(1.5, positions.theta_i_deg, positions.polarization) * inside
    fit = run(positions, noisy(r, 3), aperture)
    assert np.all(np.isposinf(fit.upper[:, 2]))
    assert np.all(fit.lower[:, 2] > 3e3)
    assert np.all(np.isnan(fit.se[:, 2]))
    assert all("alpha >= " in note for note in fit.notes)
    # what is left is as well known as ever
    others = [0, 1, 3]
    z = (fit.value[:, others] - [0.72, 1.0, 1.5]) / fit.se[:, others]
    assert np.all(np.abs(z) < 4.0)
    k_s = fit.hemispherical(8.0).k_s
    assert np.sum((k_s.lower < 0.04) & (k_s.upper > 0.04)) >= 6


def test_wide_lobe_bounds_alpha_from_above(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = exact_readings(0.6, 1.0, 0.15, 1.6)
    fit = run(positions, noisy(r, 4, m=4) * 1.0, aperture)
    inside = (fit.lower[:, 2] <= 0.15) & (fit.upper[:, 2] >= 0.15)
    assert np.sum(inside) >= 3
    open_end = fit.lower[:, 2] == 0.0
    assert all(
        ("looks diffuse" in note) == bool(is_open) for note, is_open in zip(fit.notes, open_end, strict=True)
    )


def test_index_near_one_leaves_rho_s_without_an_upper_bound(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = exact_readings(0.3, 120.0, 90.0, 1.02)  # the product rho_s R is 1 %
    fit = run(positions, noisy(r, 5) + 2e-3 * np.random.default_rng(1).standard_normal((292, 8)), aperture)
    assert np.all(fit.lower[:, 3] <= 1.02)
    assert np.all(fit.upper[:, 3] >= 1.02)
    is_open = fit.lower[:, 3] == 1.0
    assert np.any(is_open)
    assert np.all(np.isposinf(fit.upper[is_open, 1]))
    assert all("no upper bound" in fit.notes[k] for k in np.flatnonzero(is_open))
    k_s = fit.hemispherical(8.0).k_s
    true_k_s = 120.0 * (0.02 / 2.02) ** 2
    assert np.mean((k_s.lower < true_k_s) & (true_k_s < k_s.upper)) > 0.7
    assert np.all(k_s.se < 0.2 * true_k_s)


def test_one_incidence_and_polarization_tell_the_product_only(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = exact_readings(*TRUTH)
    rows = (positions.theta_i_deg == 45.0) & (positions.polarization == "s")
    fit = run(positions[rows], noisy(r, 6)[rows], aperture)
    assert np.all(np.isnan(fit.value[:, [1, 3]]))
    assert np.all(np.isnan(fit.se[:, [1, 3]]))
    assert all("rho_s and n2 are undetermined" in note for note in fit.notes)
    assert np.all((fit.lower[:, [0, 2]] < [0.72, 90.0]) | (fit.upper[:, [0, 2]] > [0.72, 90.0]))
    assert np.all(np.isnan(fit.hemispherical(8.0).k_g.value))
    assert np.all(np.isfinite(fit.hemispherical(8.0).k_d.se))
    np.testing.assert_allclose(fit.predict(45.0, 45.0, "s")[0], r[rows][np.argmax(r[rows])], rtol=0.01)
    # the same incidence in both polarizations separates them, if loosely
    both = positions.theta_i_deg == 45.0
    fit = run(positions[both], noisy(r, 6)[both], aperture)
    assert np.all((fit.lower < TRUTH) & (fit.upper > TRUTH), axis=1).sum() >= 5


def test_brewster_inside_the_scan(positions: Positions, exact_readings: Readings, aperture: Aperture) -> None:
    truth = (0.5, 1.0, 90.0, float(np.tan(np.deg2rad(50.0))))  # P vanishes between 45 and 55 degrees
    r = exact_readings(*truth)
    fit = run(positions, noisy(r, 7, m=40), aperture, polarization="p")
    covered = np.mean((fit.lower < truth) & (fit.upper > truth), axis=0)
    assert np.all(covered >= 0.8)
    assert np.all(np.abs(fit.value[:, 3] / truth[3] - 1.0) < 0.2)


def test_missing_and_infinite_readings_are_left_out(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = exact_readings(*TRUTH)
    y = noisy(r, 8, m=4)
    y[::7, 0] = np.nan
    y[5, 1] = np.inf
    y[:-5, 2] = np.nan  # five readings left
    y[:, 3] = np.nan
    fit = run(positions, y, aperture, wavelength_nm=[400.0, 410.0, 420.0, 430.0])
    assert np.all((fit.lower[:2] < TRUTH) & (fit.upper[:2] > TRUTH), axis=1).sum() >= 1
    assert fit.dof.tolist() == [292 - 42 - 4, 291 - 4, 0, 0]
    assert np.all(np.isnan(fit.value[2:]))
    assert fit.notes[2] == "only 5 usable readings, too few to fit"
    assert np.all(np.isnan(fit.residual[::7, 0]))
    assert "only 5 usable readings" in fit.table()
    alone = run(positions, y[:, :2], aperture, wavelength_nm=[400.0, 410.0])
    np.testing.assert_allclose(alone.value, fit.value[:2], rtol=1e-9)


def test_outliers_are_reported_with_their_position(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    y = noisy(exact_readings(*TRUTH), 9, m=15)
    y[100, 7] *= 1.2
    fit = run(positions, y, aperture)
    assert "outlier" in fit.notes[7]
    assert "position 100" in fit.notes[7]
    assert sum("outlier" in note for note in fit.notes) == 1
    # its neighbours' weights do not suffer
    clean = run(positions, np.delete(y, 7, axis=1), aperture)
    np.testing.assert_allclose(np.delete(fit.se, 7, axis=0), clean.se, rtol=0.2)


def test_unphysical_results_say_so(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    high = run(positions, noisy(exact_readings(0.72, 3.5, 90.0, 1.24), 10), aperture)
    assert all("above 1, unphysical" in note for note in high.notes)
    negative = run(positions, noisy(exact_readings(0.72, 1.0, 90.0, 1.5), 11) - 0.05, aperture)
    assert all("negative, unphysical" in note for note in negative.notes)


def test_weights_never_cross_the_detector_change(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = exact_readings(*TRUTH)
    rng = np.random.default_rng(12)
    level = np.where(np.arange(12) < 6, 1.0, 12.0)
    y = r[:, None] + instrument_noise(r)[:, None] * level * rng.standard_normal((292, 12))
    known = run(positions, y, aperture, detector_index=level > 1.0)
    expected = instrument_noise(r)[:, None] * level
    np.testing.assert_allclose(known.sigma / expected, 1.0, atol=0.25)
    blurred = run(positions, y, aperture)
    assert np.median(blurred.sigma[:, 5] / expected[:, 5]) > 2.0


def test_given_standard_deviations_are_used_as_they_are(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = exact_readings(*TRUTH)
    sd = np.repeat(instrument_noise(r)[:, None], 8, axis=1)
    fit = run(positions, noisy(r, 13), aperture, weights="r_sd", r_sd=sd)
    np.testing.assert_allclose(fit.sigma, sd, rtol=1e-12)
    np.testing.assert_allclose(fit.chi2 / fit.dof, 1.0, atol=5.0 * np.sqrt(2.0 / 288.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"polarization": "p"}, "polarization 'p' was not measured; the scan has: s"),
        ({"polarization": "x"}, "polarization = 'x' is not known"),
        ({"aperture": "round"}, "aperture = 'round' is not known"),
        ({"weights": "some"}, "weights = 'some' is not known"),
        ({"weights": "r_sd"}, "no wavelength has 8 readings with a standard deviation"),
        ({"intervals": "bayes"}, "intervals = 'bayes' is not known"),
        ({"wavelength_nm": [400.0, 500.0]}, "the readings have 1 wavelengths"),
    ],
)
def test_refusals(
    positions: Positions, exact_readings: Readings, aperture: Aperture, change: dict[str, object], words: str
) -> None:
    s = positions.polarization == "s"
    r = exact_readings(*TRUTH)[s]
    with pytest.raises(FitError, match=words):
        run(positions[s], r, aperture, **change)


def test_nothing_to_fit(positions: Positions, aperture: Aperture) -> None:
    with pytest.raises(FitError, match="no wavelength has 8 usable readings"):
        run(positions, np.full((292, 3), np.nan), aperture)
    with pytest.raises(FitError, match="give one of each per position"):
        run(positions, np.zeros((10, 3)), aperture)

"""What wavelengths, polarizations and detectors share: found in simulated scans, with honest intervals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import optimize
from simulated_readings import FloatArray, Positions, fresnel_textbook, instrument_noise

from gonio.aperture import Aperture
from gonio.errors import FitError
from gonio.fitting import FitResult, fit_readings

Readings = Callable[..., FloatArray]
NM = np.linspace(400.0, 1000.0, 13)
UM = NM / 1000.0
INDEX = {
    "constant": (np.full(13, 1.48), [1.48]),
    "cauchy": (1.45 + 0.01 / UM**2, [1.45, 0.01]),
    "sellmeier": (np.sqrt(1.0 + 1.1 * UM**2 / (UM**2 - 0.012)), [1.1, 0.012]),
}


def run(at: Positions, y: FloatArray, aperture: Aperture, **options: object) -> FitResult:
    return fit_readings(
        at.theta_i_deg, at.theta_o_deg, at.polarization, y,
        instrument=aperture, **({"wavelength_nm": NM[: y.shape[1]]} | options),  # type: ignore[arg-type]
    )  # fmt: skip


def readings_of(at: Positions, exact_readings: Readings, n2: FloatArray, rho_s: float = 1.0) -> FloatArray:
    """R enters the readings as a factor on the lobe: two quadratures make those of any index."""
    diffuse, whole = exact_readings(0.72, 0.0, 90.0, 1.5), exact_readings(0.72, rho_s, 90.0, 1.5)
    at_15 = fresnel_textbook(1.5, at.theta_i_deg, at.polarization)
    lobe = (whole - diffuse) / at_15
    r = np.stack([fresnel_textbook(n, at.theta_i_deg, at.polarization) for n in n2], axis=1)
    return diffuse[:, None] + lobe[:, None] * r


def noisy(r: FloatArray, seed: int) -> FloatArray:
    return r + instrument_noise(r) * np.random.default_rng(seed).standard_normal(r.shape)


@pytest.mark.parametrize("form", list(INDEX))
def test_a_shared_index_is_found_with_an_honest_uncertainty(
    positions: Positions, exact_readings: Readings, aperture: Aperture, form: str
) -> None:
    n2, coefficients = INDEX[form]
    r = readings_of(positions, exact_readings, n2)
    truth = np.stack([np.full(13, 0.72), np.full(13, 1.0), np.full(13, 90.0), n2], axis=1)
    exact = run(positions, r, aperture, n2=form)
    np.testing.assert_allclose(exact.value, truth, rtol=2e-8)
    np.testing.assert_allclose(exact.shared_value, coefficients, rtol=1e-5)
    z, own, covered = [], [], []
    for seed in range(12):
        fit = run(positions, noisy(r, seed), aperture, n2=form)
        z.append((fit.shared_value - coefficients) / np.sqrt(np.diag(fit.shared_covariance)))
        own.append((fit.value - truth) / fit.se)
        covered.append((fit.lower <= truth) & (truth <= fit.upper))
        assert not any("does not follow" in remark for remark in fit.remarks)
    assert 0.6 < float(np.sqrt(np.mean(np.square(z)))) < 1.5
    assert np.all(np.abs(np.sqrt(np.mean(np.square(own), axis=(0, 1))) - 1.0) < 0.35)
    assert float(np.mean(covered)) > 0.9
    # what is shared is common to the wavelengths, and n2 has no other uncertainty
    alone = run(positions, noisy(r, 0), aperture)
    assert np.all(fit.se[:, 3] < 0.8 * np.median(alone.se[:, 3]))
    np.testing.assert_allclose(np.sqrt(np.sum(fit.modes[:, :, 3] ** 2, axis=0)), fit.se[:, 3], rtol=1e-6)


def test_a_shared_index_is_the_optimum_of_all_readings_at_once(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """Against scipy over all parameters of three wavelengths, on the same weights."""
    y = noisy(readings_of(positions, exact_readings, INDEX["cauchy"][0][[0, 6, 12]]), 3)
    at_nm = NM[[0, 6, 12]]
    fit = run(positions, y, aperture, n2="cauchy", weights="none", wavelength_nm=at_nm)
    delta = positions.theta_i_deg - positions.theta_o_deg
    diffuse = aperture.diffuse_integral(positions.theta_o_deg)
    # each wavelength counts by the scatter that the fit found there
    weight = 1.0 / np.sqrt(fit.chi2 / (fit.dof))

    def residual(p: FloatArray) -> FloatArray:
        parts = []
        for k in range(3):
            rho_d, rho_s, log_alpha = p[2 + 3 * k : 5 + 3 * k]
            n2 = p[0] + p[1] / (at_nm[k] / 1000.0) ** 2
            lobe = aperture.lobe_integral(np.exp(log_alpha), delta, positions.theta_o_deg)
            r = fresnel_textbook(n2, positions.theta_i_deg, positions.polarization)
            parts.append((rho_d * diffuse + rho_s * r * lobe - y[:, k]) * weight[k])
        return np.concatenate(parts)

    begin = np.concatenate([[1.45, 0.01], *([0.7, 1.1, 4.4] for _ in range(3))])
    found = optimize.least_squares(residual, begin, x_scale=np.abs(begin), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(fit.shared_value, found.x[:2], rtol=2e-5)
    np.testing.assert_allclose(fit.value[:, 1], found.x[3::3], rtol=2e-5)
    se = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    np.testing.assert_allclose(np.sqrt(np.diag(fit.shared_covariance)), se[:2], rtol=1e-2)
    np.testing.assert_allclose(fit.se[:, 1], se[3::3], rtol=1e-2)


def test_a_form_that_the_wavelengths_do_not_follow_is_said(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    y = noisy(readings_of(positions, exact_readings, INDEX["cauchy"][0]), 4)
    assert any("does not follow" in x for x in run(positions, y, aperture, n2="constant").remarks)
    assert not any("does not follow" in x for x in run(positions, y, aperture, n2="cauchy").remarks)


def test_a_given_index_is_held_and_frees_rho_s(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    n2, _ = INDEX["cauchy"]
    y = noisy(readings_of(positions, exact_readings, n2), 5)
    fit = run(positions, y, aperture, n2=n2)
    np.testing.assert_array_equal(fit.value[:, 3], n2)
    np.testing.assert_array_equal(fit.se[:, 3], 0.0)
    assert np.all(fit.se[:, 1] < 0.5 * run(positions, y, aperture).se[:, 1])
    assert np.all(np.abs(fit.value[:, 1] - 1.0) < 4.0 * fit.se[:, 1])
    # one incidence and polarization are then enough
    s = (positions.polarization == "s") & (positions.theta_i_deg == 45.0)
    one = run(positions[s], y[s], aperture, n2=n2)
    assert np.all(np.abs(one.value[:, 1] - 1.0) < 4.0 * one.se[:, 1])
    assert not any("undetermined" in note for note in one.notes)


def test_s_and_p_with_surfaces_of_their_own_share_the_index(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    first = readings_of(positions, exact_readings, np.full(13, 1.5))
    second = readings_of(positions, exact_readings, np.full(13, 1.5), rho_s=0.6)
    is_s = positions.polarization == "s"
    r = np.where(is_s[:, None], first, second)
    fit = run(positions, r, aperture, polarization="shared_n2")
    assert fit.parameters == ("rho_d[s]", "rho_s[s]", "alpha[s]", "rho_d[p]", "rho_s[p]", "alpha[p]", "n2")
    truth = np.array([0.72, 1.0, 90.0, 0.72, 0.6, 90.0, 1.5])
    np.testing.assert_allclose(fit.value, np.broadcast_to(truth, fit.value.shape), rtol=1e-7)
    y = noisy(r, 6)
    fit = run(positions, y, aperture, polarization="shared_n2")
    assert float(np.mean(np.abs(fit.value - truth) < 2.0 * fit.se)) > 0.85
    k = fit.hemispherical(8.0)
    # normal incidence nearly: R is 4 % for both polarizations
    np.testing.assert_allclose(k.k_s.value, 0.04 * 0.8, rtol=0.03)
    expected = 0.5 * (r[is_s] + r[~is_s])[5]
    at = positions[is_s]
    predicted = fit.predict(at.theta_i_deg[5], at.theta_o_deg[5], "unpolarized")[0]
    np.testing.assert_allclose(predicted, expected, rtol=0.01)
    # between S alone and all in common
    alone = run(positions, y, aperture, polarization="s")
    assert np.all(fit.se[:, 6] < alone.se[:, 3])


def test_offsets_of_detectors_are_found_and_gains_stay_at_their_prior(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = readings_of(positions, exact_readings, INDEX["cauchy"][0])
    detector = (np.arange(13) >= 7).astype(np.uint8)
    offset = np.where(
        detector == 0, -1e-4, 5e-5
    )  # 0.9 % of rho_d, as the PMT of a spectrophotometer may have
    fit = run(
        positions, noisy(r, 7) + offset, aperture, detector_index=detector,
        detector_offset_u=1e-3, detector_gain_u=0.01,
    )  # fmt: skip
    assert fit.shared_names == ("gain[0]", "gain[1]", "offset[0]", "offset[1]")
    u = np.sqrt(np.diag(fit.shared_covariance))
    np.testing.assert_allclose(u[:2], 0.01, rtol=1e-3)
    np.testing.assert_allclose(fit.shared_value[:2], 0.0, atol=1e-9)
    assert np.all(u[2:] < 1e-5)
    assert np.all(np.abs(fit.shared_value[2:] - [-1e-4, 5e-5]) < 4.0 * u[2:])
    np.testing.assert_allclose(fit.value[:, 0], 0.72, atol=0.002)
    assert np.all(fit.se[:, 0] > 0.007)
    assert sum("do not tell it" in remark for remark in fit.remarks) == 2
    plain = run(positions, noisy(r, 7) + offset, aperture, detector_index=detector)
    assert np.all(np.abs(plain.value[:7, 0] - 0.72) > 0.003)  # what the offset does when nobody asks


def test_an_overlap_tells_one_detectors_gain_from_the_others(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    nm = np.concatenate([NM[:8], NM[5:]])
    index = np.concatenate([INDEX["cauchy"][0][:8], INDEX["cauchy"][0][5:]])
    detector = (np.arange(nm.size) >= 8).astype(np.uint8)
    r = readings_of(positions, exact_readings, index) * np.where(detector == 0, 0.9, 1.0)
    fit = run(
        positions, noisy(r, 8), aperture, wavelength_nm=nm, detector_index=detector,
        detector_gain_u=[0.2, 0.005],
    )  # fmt: skip
    u = np.sqrt(np.diag(fit.shared_covariance))
    assert abs(fit.shared_value[0] + 0.1) < 3.0 * u[0]
    np.testing.assert_allclose(u, 0.005, rtol=0.15)  # as good as the better one's
    np.testing.assert_allclose(fit.value[:, 0], 0.72, atol=0.02)
    np.testing.assert_allclose(fit.value[5:8], fit.value[8:11], rtol=1e-9)  # measured twice, one surface


def test_wavelengths_without_a_lobe_take_no_part_in_the_index(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    r = readings_of(positions, exact_readings, INDEX["constant"][0])
    r[:, 4:7] = exact_readings(0.72, 0.0, 90.0, 1.5)[:, None]
    fit = run(positions, noisy(r, 10), aperture, n2="constant", detector_offset_u=1e-4)
    assert abs(fit.shared_value[0] - 1.48) < 4.0 * np.sqrt(fit.shared_covariance[0, 0])
    np.testing.assert_array_equal(fit.value[4:7, 1], 0.0)
    assert np.all(np.isnan(fit.value[4:7, 2:]))
    assert all("no lobe is seen" in note for note in fit.notes[4:7])
    assert np.all(np.abs(fit.value[:, 0] - 0.72) < 4.0 * fit.se[:, 0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"n2": "conrady"}, "n2 = 'conrady' is not known"),
        ({"n2": 0.9}, "n2 = 0.9 at wavelength 400 nm is outside"),
        ({"n2": [1.5, 1.5]}, "give one number, or 13 of them"),
        ({"n2": "cauchy", "wavelength_nm": np.full(13, 500.0)}, "1 different wavelengths"),
        ({"n2": "cauchy", "wavelength_nm": None}, "needs the wavelengths"),
        ({"n2": "cauchy", "intervals": "nlparci"}, "'nlparci' are MATLAB's"),
        ({"polarization": "shared_n2", "at": "s"}, "need readings of both polarizations"),
        ({"detector_gain_u": -0.1}, "must be standard uncertainties of at least 0"),
        ({"detector_offset_u": [0.1, 0.1, 0.1]}, "one for each of 1 detectors"),
        ({"n2": "constant", "lobe": False}, "no lobe is seen at any wavelength"),
        ({"loss": "cauchy"}, "loss = 'cauchy' is not known"),
        ({"model": "oren"}, "model = 'oren' is not known"),
    ],
)
def test_refusals(
    positions: Positions, exact_readings: Readings, aperture: Aperture, change: dict[str, object], words: str
) -> None:
    y = noisy(readings_of(positions, exact_readings, INDEX["constant"][0]), 9)
    if not change.pop("lobe", True):
        y = noisy(np.repeat(exact_readings(0.72, 0.0, 90.0, 1.5)[:, None], 13, axis=1), 9)
    rows = positions.polarization == "s" if change.pop("at", "") == "s" else np.ones(292, bool)
    with pytest.raises(FitError, match=words):
        run(positions[rows], y[rows], aperture, **change)

"""Are the four aperture models compared fairly, and is what is said about them true?"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from simulated_readings import FloatArray, Positions, fresnel_textbook

from gonio.aperture import Aperture
from gonio.brdf import PublishedLobe
from gonio.fitting.compare import COMPARED, compare_apertures
from gonio.fitting.selection import akaike, runs_probability
from gonio.store import Scan

Readings = Callable[..., FloatArray]
TRUTH = (0.72, 1.0, 100.0, 1.5)
WAVELENGTHS = 9


def scan_of(at: Positions, aperture: Aperture, r: FloatArray, r_sd: FloatArray | float = np.nan) -> Scan:
    n, m = r.shape
    none = np.full((n, m), np.nan)
    return Scan(
        path=Path("simulated.h5"), title="", sample_name="", wavelength_nm=np.linspace(400.0, 800.0, m),
        detector_index=np.zeros(m, np.uint8), detector_names=("pmt",), theta_i_deg=at.theta_i_deg,
        theta_mes_deg=at.theta_i_deg + at.theta_o_deg, theta_o_deg=at.theta_o_deg,
        polarization=at.polarization, r=r, r_sd=np.broadcast_to(r_sd, (n, m)).copy(), raw_signal_v=none,
        dark_v=none, baseline_v=none, gain_u=np.zeros((n, m)), offset_u=np.zeros((n, m)),
        quality=np.zeros((n, m), np.uint16), time_s=np.arange(n, dtype=np.float64), aperture=aperture,
        position=np.arange(n), n_planned=n, finished=True,
    )  # fmt: skip


def truth_columns(truth: tuple[float, float, float, float]) -> dict[str, FloatArray]:
    at = np.array([300.0, 1500.0])
    lobe = PublishedLobe(*truth)
    known = dict(zip(lobe.parameter_names, truth, strict=True))
    known["k_d"], known["k_s"] = truth[0], float(lobe.specular_albedo(8.0, "unpolarized"))
    known["k_g"] = known["k_d"] + known["k_s"]
    return {"wavelength_nm": at} | {name: np.full(2, value) for name, value in known.items()}


@pytest.fixture(scope="module")
def noisy(positions: Positions, exact_readings: Readings) -> FloatArray:
    """0.5 % of each reading, (292, 9)."""
    rng = np.random.default_rng(11)
    r = exact_readings(*TRUTH)[:, None]
    return r * (1.0 + 0.005 * rng.standard_normal((r.size, WAVELENGTHS)))


def test_biases_are_those_of_physics_md(positions: Positions, noisy: FloatArray, aperture: Aperture) -> None:
    """alpha 100, unweighted: k_s 0.0453, 0.0344, 0.0301, 0.0401 for 0.0400, with 0.0516 sr where assumed."""
    found = compare_apertures(scan_of(positions, aperture, noisy), truth=truth_columns(TRUTH), weights="none")
    assert found.reference_is_truth
    for name, expected in zip(COMPARED, (0.0453, 0.0344, 0.0301, 0.0401), strict=True):
        scale = aperture.solid_angle_sr / 0.0516 if name in ("point", "eq22") else 1.0
        k_s = found.reference["k_s"] * (1.0 + found.bias(name, "k_s")) * scale
        assert float(np.median(k_s)) == pytest.approx(expected, abs=0.0004)
    text = found.table()
    assert "truth stored in this file" in text
    assert "Eq 22 with the true half-width reads k_s 13 % low" in " ".join(text.split())


def test_published_pair_s_scale_is_told_from_its_shape(
    positions: Positions, noisy: FloatArray, aperture: Aperture
) -> None:
    found = compare_apertures(scan_of(positions, aperture, noisy), truth=truth_columns(TRUTH))
    w, h, far = 26.0, 18.0, 95.2353
    own = 4.0 * np.arctan(w * h / (4.0 * far * np.sqrt(far**2 + (w**2 + h**2) / 4.0)))
    assert found.scale_bias("published") == pytest.approx(own / 0.0516 - 1.0, rel=1e-12)
    assert [found.scale_bias(name) for name in ("point", "eq22", "exact")] == [0.0, 0.0, 0.0]
    assert "0.05160 sr where this aperture has 0.05090 sr" in " ".join(found.table().split())


def test_weighted_fit_of_a_wrong_aperture_is_that_of_an_independent_minimiser(
    positions: Positions, noisy: FloatArray, aperture: Aperture
) -> None:
    """Eq 22 by a plain sum over 4001 angles, minimised by scipy with the weights that were asked for."""
    sd = 0.005 * noisy[:, :1] + 2e-5
    scan = scan_of(positions, aperture, noisy[:, :1], sd)
    found = compare_apertures(scan, weights="r_sd")
    np.testing.assert_allclose(found["eq22"].fit.sigma, sd, rtol=1e-12)
    half = np.arctan(13.0 / 95.2353)
    t = np.linspace(-half, half, 4001)
    weight = np.full(t.size, 1.0 / (t.size - 1))
    weight[[0, -1]] /= 2.0
    out = np.deg2rad(positions.theta_o_deg)[:, None] + t
    above = np.abs(out) < np.pi / 2.0
    to_mirror = np.cos(out - np.deg2rad(positions.theta_i_deg)[:, None])
    log_cos = np.log(np.clip(to_mirror, 1e-300, 1.0))

    def residual(p: FloatArray) -> FloatArray:
        reflectance = fresnel_textbook(p[3], positions.theta_i_deg, positions.polarization)
        lobe = (p[2] + 1.0) / (2.0 * np.pi) * np.exp(p[2] * log_cos) * (above & (to_mirror > 0.0)) @ weight
        diffuse = (np.where(above, np.cos(out), 0.0) / np.pi) @ weight
        r = aperture.solid_angle_sr * (p[0] * diffuse + p[1] * reflectance * lobe)
        return (r - noisy[:, 0]) / sd[:, 0]

    best = least_squares(residual, TRUTH, x_scale=np.abs(TRUTH), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(found["eq22"].fit.value[0], best.x, rtol=2e-5)
    assert float(found["eq22"].fit.chi2[0]) == pytest.approx(2.0 * best.cost, rel=1e-6)


def test_all_variants_have_the_same_weights_and_are_judged_alike(
    positions: Positions, noisy: FloatArray, aperture: Aperture
) -> None:
    noisy = noisy.copy()
    noisy[5, 2] = np.nan
    found = compare_apertures(scan_of(positions, aperture, noisy))
    assert [v.aperture for v in found.variants] == list(COMPARED)
    for variant in found.variants:
        np.testing.assert_array_equal(variant.fit.sigma, found.exact.fit.sigma)
        n = np.sum(np.isfinite(variant.fit.residual), axis=0)
        assert n.tolist() == [292, 292, 291] + [292] * 6
        k = 5.0  # rho_d, rho_s, alpha, n2 and the scale of the variance
        expected = n * np.log(variant.fit.chi2 / n) + 2.0 * k + 2.0 * k * (k + 1.0) / (n - k - 1.0)
        np.testing.assert_allclose(akaike(variant.fit), expected, rtol=1e-12)
    # the wrong shapes are seen in the residuals, the true one is not
    assert np.all(found["published"].runs_p < 1e-6)
    assert np.median(found.exact.runs_p) > 0.02
    assert np.all(found["published"].aicc > found.exact.aicc + 100.0)
    assert float(np.median(found.exact.fit.chi2 / found.exact.fit.dof)) == pytest.approx(1.0, abs=0.05)


def test_without_a_truth_the_exact_fit_is_the_reference(
    positions: Positions, noisy: FloatArray, aperture: Aperture
) -> None:
    for polarization in ("joint", "s", "p"):
        found = compare_apertures(scan_of(positions, aperture, noisy), polarization=polarization)  # type: ignore[arg-type]
        assert not found.reference_is_truth
        assert np.all(found.bias("exact", "k_s") == 0.0)
        assert float(np.median(found.bias("eq22", "k_s"))) < -0.1
        assert "against the exact fit" in found.table()


def test_a_truth_elsewhere_is_no_truth(positions: Positions, noisy: FloatArray, aperture: Aperture) -> None:
    columns = truth_columns(TRUTH)
    columns["wavelength_nm"] = np.array([2000.0, 2500.0])
    assert not compare_apertures(scan_of(positions, aperture, noisy), truth=columns).reference_is_truth


def test_a_surface_without_a_lobe_compares_what_there_is(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    rng = np.random.default_rng(5)
    r = exact_readings(0.72, 0.0, 100.0, 1.5)[:, None]
    y = r * (1.0 + 0.005 * rng.standard_normal((r.size, 3)))
    found = compare_apertures(scan_of(positions, aperture, y))
    assert np.all(np.isnan(found.bias("point", "k_s")))
    # the height of the aperture costs 0.15 % of the diffuse reading, and Eq 22 knows none
    assert abs(float(np.median(found.bias("eq22", "k_d")))) < 0.005
    assert "-" in found.table()


def brute_force_p(signs: list[int]) -> float:
    """Chance of as few runs among all orders of these signs."""

    def runs(order: tuple[int, ...]) -> int:
        return 1 + sum(a != b for a, b in itertools.pairwise(order))

    orders = {tuple(order) for order in itertools.permutations(signs)}
    return float(np.mean([runs(order) <= runs(tuple(signs)) for order in orders]))


def test_runs_probability_is_near_the_exact_one() -> None:
    """One sweep of 8; the normal approximation with so few is good to a few hundredths."""
    signs = [1, 1, 1, -1, 1, -1, -1, -1]
    at = np.linspace(-40.0, 60.0, 8)
    order = np.array([3, 0, 7, 1, 6, 2, 5, 4])  # measured in any order
    residual = np.array(signs, float)[order, None] * np.linspace(1.0, 2.0, 8)[:, None]
    p = runs_probability(residual, np.full(8, 30.0), at[order], np.ones(8, bool))
    assert float(p[0]) == pytest.approx(brute_force_p(signs), abs=0.03)
    # runs 4, n+ = n- = 4: expectation 5, variance 32 * 24 / (64 * 7)
    from scipy.stats import norm

    assert float(p[0]) == pytest.approx(norm.cdf(-0.5 / np.sqrt(32.0 * 24.0 / (64.0 * 7.0))), rel=1e-12)
    gaps = np.insert(residual, [0, 3, 8], np.nan, axis=0)
    where = np.insert(at[order], [0, 3, 8], [-60.0, 0.0, 70.0])
    again = runs_probability(gaps, np.full(11, 30.0), where, np.ones(11, bool))
    assert float(again[0]) == pytest.approx(float(p[0]), rel=1e-12)


def test_runs_probability_is_uniform_where_nothing_is_wrong(positions: Positions) -> None:
    rng = np.random.default_rng(7)
    noise = rng.standard_normal((292, 4000))
    p = runs_probability(noise, positions.theta_i_deg, positions.theta_o_deg, positions.polarization == "s")
    for level in (0.01, 0.05, 0.5):
        assert float(np.mean(p < level)) == pytest.approx(
            level, abs=4.0 * np.sqrt(level / 4000.0) + 0.05 * level
        )
    constant = runs_probability(
        np.ones((292, 1)), positions.theta_i_deg, positions.theta_o_deg, positions.polarization == "s"
    )
    assert np.isnan(constant[0])  # one sign only: nothing to count

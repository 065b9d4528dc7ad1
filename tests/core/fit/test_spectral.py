"""Band averages: against adaptive quadrature of the same integrals, and against simulated scans."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate
from simulated_readings import FloatArray, Positions, instrument_noise

from gonio.aperture import Aperture
from gonio.brdf import PublishedLobe
from gonio.errors import GonioError
from gonio.fitting import fit_readings
from gonio.fitting.bands import band_average
from gonio.spectral import am15g, band_weights, photopic

Readings = Callable[..., FloatArray]


def at(positions: Positions) -> tuple[FloatArray, FloatArray, NDArray[np.str_]]:
    return positions.theta_i_deg, positions.theta_o_deg, positions.polarization


def test_photopic_table_is_the_cie_s() -> None:
    """CIE 1924 as an independent package (colour-science 0.4) has it every 1 nm, and its integral.

    Between our entries, 5 nm apart, a straight line is 1 % off at most.
    """
    at = [400.0, 450.0, 507.0, 532.0, 555.0, 589.0, 633.0, 700.0, 771.0]
    known = [3.96e-4, 0.038, 0.4443096, 0.8849624, 1.0, 0.7691547, 0.2353344, 4.102e-3, 2.799e-5]
    np.testing.assert_allclose(photopic(at), known, rtol=1e-2)
    np.testing.assert_allclose(photopic(at[:2]), known[:2], rtol=1e-12)
    whole = np.trapezoid(photopic(np.arange(380.0, 780.1, 5.0)), dx=5.0)
    assert whole == pytest.approx(106.85643, rel=1e-5)
    np.testing.assert_array_equal(photopic([379.9, 780.1]), 0.0)


def test_am15g_is_astm_g173() -> None:
    """As ASTM prints it: 1.1141, 1.5451, 0.73532, 0.25061 W/m2/nm, and 1000.37 W/m2 from 280 to 4000 nm."""
    np.testing.assert_allclose(am15g([400.0, 500.0, 1000.0, 1500.0]), [1.1141, 1.5451, 0.73532, 0.25061])
    nm = np.arange(280.0, 4000.1, 0.5)
    assert np.trapezoid(am15g(nm), nm) == pytest.approx(1000.37, rel=1e-5)
    np.testing.assert_array_equal(am15g([279.0, 4001.0]), 0.0)


@pytest.mark.parametrize("weight", ["am15g", "photopic", "flat", "given"])
def test_shares_are_the_integral_of_the_straight_lines(weight: str) -> None:
    """∫ w k / ∫ w by adaptive quadrature with k linear between wavelengths of uneven steps."""
    rng = np.random.default_rng(4)
    nm = 350.0 + 12.7 * np.arange(60) + rng.uniform(-4.0, 4.0, 60)
    k = rng.uniform(0.1, 0.9, 60)
    low, high = 431.7, 903.1
    given = (lambda x: 2.0 + np.sin(x / 50.0)) if weight == "given" else weight
    found = band_weights(nm, low, high, given)  # type: ignore[arg-type]
    assert found.share.sum() == pytest.approx(1.0, abs=1e-14)
    function = {"am15g": am15g, "photopic": photopic, "flat": np.ones_like, "given": given}[weight]
    x = np.linspace(low, high, 400001)
    w = np.asarray(function(x))
    expected = integrate.simpson(w * np.interp(x, nm, k), x=x) / integrate.simpson(w, x=x)
    assert found.share @ k == pytest.approx(expected, rel=1e-6)
    assert found.covered == pytest.approx(1.0)
    assert np.isnan(found.of_whole) == (weight in ("flat", "given"))


def test_flat_weight_is_the_trapezoidal_rule() -> None:
    nm = np.array([300.0, 310.0, 330.0, 350.0])
    share = band_weights(nm[::-1], 300.0, 350.0, "flat").share
    np.testing.assert_allclose(share[::-1], [0.1, 0.3, 0.4, 0.2])


def test_gaps_and_uncovered_parts_are_stated_or_refused() -> None:
    nm = np.arange(400.0, 801.0, 10.0)
    use = np.ones(nm.size, bool)
    use[20] = False  # 600 nm: nothing is known between 590 and 610
    whole = band_weights(nm, 400.0, 800.0, "flat", use=use, least_coverage=0.9)
    assert whole.covered == pytest.approx(0.95)
    assert whole.share[20] == 0.0
    assert "95.0 % of the band's weight" in whole.text(400.0, 800.0, "flat")
    with pytest.raises(
        GonioError, match=r"400...800 nm with gaps\) cover 95.0 %.*less than the 96 % required"
    ):
        band_weights(nm, 400.0, 800.0, "flat", use=use, least_coverage=0.96)
    with pytest.raises(GonioError, match=r"cover 80.0 % of the weight 'flat'"):
        band_weights(nm, 400.0, 900.0, "flat")
    far = np.concatenate([nm, [1500.0]])  # a jump of 700 nm is no step of this plan
    with pytest.raises(GonioError, match="cover"):
        band_weights(far, 400.0, 1500.0, "flat")
    assert band_weights([400.0, 1500.0], 400.0, 1500.0, "flat").longest_step_nm == 1100.0
    with pytest.raises(GonioError, match="zero there"):
        band_weights(nm, 790.0, 800.0, "photopic")
    with pytest.raises(GonioError, match="550 nm is there twice"):
        band_weights(np.append(nm, 550.0), 400.0, 800.0)
    for bad in ((800.0, 400.0), (float("nan"), 800.0)):
        with pytest.raises(GonioError, match="ascending order"):
            band_weights(nm, *bad)
    with pytest.raises(GonioError, match="not known"):
        band_weights(nm, 400.0, 800.0, "d65")  # type: ignore[arg-type]
    with pytest.raises(GonioError, match="must be a number of at least 0"):
        band_weights(nm, 400.0, 800.0, lambda x: x - 500.0)
    with pytest.raises(GonioError, match="needs the wavelengths"):
        band_weights(np.full(3, np.nan), 400.0, 800.0)


def test_uncertainty_of_a_band_average_is_the_scatter_over_scans(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """300 scans of 9 wavelengths with noise of their own: the claimed u of <k_s>, and its coverage."""
    scans, nm = 300, np.arange(400.0, 801.0, 50.0)
    r = exact_readings(0.72, 1.0, 90.0, 1.5)
    rng = np.random.default_rng(8)
    y = r[:, None] + 20.0 * instrument_noise(r)[:, None] * rng.standard_normal((r.size, scans * nm.size))
    fit = fit_readings(*at(positions), y, instrument=aperture)
    scan = np.repeat(np.arange(scans), nm.size)
    fit = replace(fit, wavelength_nm=np.tile(nm, scans))
    true = float(PublishedLobe(0.72, 1.0, 90.0, 1.5).specular_albedo(8.0, "unpolarized"))
    found = [band_average(fit.only(scan == k), 400.0, 800.0, weight="flat").k_s for k in range(scans)]
    z = np.array([(k_s.value - true) / k_s.u for k_s in found])
    assert abs(np.mean(z)) < 3.5 / np.sqrt(scans)
    assert abs(np.std(z) - 1.0) < 3.5 / np.sqrt(2.0 * scans)
    covered = np.mean([k_s.lower <= true <= k_s.upper for k_s in found])
    assert covered > 0.91
    assert all(k_s.u_common == 0.0 for k_s in found)


def test_one_index_for_all_wavelengths_is_a_common_error(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """Scatter of k_s at 75 deg over 30 scans, where n2 matters: u has a common part, and is right."""
    few = np.arange(0, 292, 3)
    r, nm = exact_readings(0.72, 1.0, 90.0, 1.5)[few], np.arange(400.0, 801.0, 100.0)
    rng = np.random.default_rng(9)
    true = float(PublishedLobe(0.72, 1.0, 90.0, 1.5).specular_albedo(75.0, "unpolarized"))
    z = []
    for _ in range(30):
        y = r[:, None] + 5.0 * instrument_noise(r)[:, None] * rng.standard_normal((r.size, nm.size))
        fit = fit_readings(*at(positions[few]), y, instrument=aperture, wavelength_nm=nm, n2="constant")
        k_s = band_average(fit, 400.0, 800.0, weight="flat", theta_i_deg=75.0).k_s
        assert k_s.u_common > 0.5 * k_s.u_random
        z.append((k_s.value - true) / k_s.u)
    assert abs(np.mean(z)) < 3.5 / np.sqrt(30)
    assert abs(np.std(z) - 1.0) < 3.5 / np.sqrt(60)


def test_common_modes_do_not_average_out_over_a_band(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """A detector gain known to 1 % is 1 % of every band's k_d; two detectors share no gain."""
    nm = np.arange(400.0, 801.0, 50.0)
    y = np.repeat(exact_readings(0.72, 1.0, 90.0, 1.5)[:, None], nm.size, axis=1)
    y = y * (1.0 + 1e-4 * np.random.default_rng(0).standard_normal(y.shape))
    fit = fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization, y,
        instrument=aperture, wavelength_nm=nm, detector_index=nm > 599.0, detector_gain_u=0.01,
    )  # fmt: skip
    one = band_average(fit, 400.0, 550.0, weight="flat").k_d
    assert one.u_common == pytest.approx(0.0072, rel=1e-2)
    assert one.u_random < 1e-3
    both = band_average(fit, 400.0, 800.0, weight="flat").k_d
    share = band_weights(nm, 400.0, 800.0).share
    weights = [share[:4].sum(), share[4:].sum()]
    assert both.u_common == pytest.approx(0.0072 * np.hypot(*weights), rel=1e-2)
    assert both.upper - both.value == pytest.approx(1.96 * both.u, rel=1e-3)

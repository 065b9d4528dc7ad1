"""Are the intervals what they claim?  nlparci by its own formula, and coverage over simulated scans."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats
from simulated_readings import FloatArray, Positions, fresnel_textbook, instrument_noise

from gonio.aperture import Aperture
from gonio.brdf import PublishedLobe
from gonio.fitting import fit_readings

Readings = Callable[..., FloatArray]


def test_nlparci_intervals_are_matlabs(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """v = n - p, s^2 = |res|^2 / v, J = QR, se = s sqrt(diag(R^-1 R^-T)), value ± t(0.975, v) se."""
    rng = np.random.default_rng(6)
    y = exact_readings(0.72, 1.0, 90.0, 1.5) * (1.0 + 0.01 * rng.standard_normal(292))
    y[[3, 70, 200]] = np.nan
    fit = fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization, y[:, None],
        instrument=aperture, intervals="nlparci",
    )  # fmt: skip
    keep = np.isfinite(y)
    delta = positions.theta_i_deg - positions.theta_o_deg
    diffuse = aperture.diffuse_integral(positions.theta_o_deg)

    def model(p: FloatArray) -> FloatArray:
        lobe = aperture.lobe_integral(p[2], delta, positions.theta_o_deg)
        r = fresnel_textbook(p[3], positions.theta_i_deg, positions.polarization)
        return (p[0] * diffuse + p[1] * r * lobe)[keep]

    p = fit.value[0]
    jacobian = np.empty((int(keep.sum()), 4))
    for c in range(4):
        step = np.zeros(4)
        step[c] = 1e-5 * p[c]
        jacobian[:, c] = (
            8.0 * (model(p + step) - model(p - step)) - (model(p + 2.0 * step) - model(p - 2.0 * step))
        ) / (12.0 * step[c])
    v = int(keep.sum()) - 4
    s = np.sqrt(np.sum((y[keep] - model(p)) ** 2) / v)
    inverse = np.linalg.inv(np.linalg.qr(jacobian)[1])
    half = stats.t.ppf(0.975, v) * s * np.sqrt(np.sum(inverse**2, axis=1))
    np.testing.assert_allclose(fit.upper[0] - p, half, rtol=1e-7)
    np.testing.assert_allclose(p - fit.lower[0], half, rtol=1e-7)
    assert int(fit.dof[0]) == v
    assert float(fit.rms[0]) == pytest.approx(s * np.sqrt(v / keep.sum()), rel=1e-9)


def coverage_bounds(n: int) -> tuple[float, float]:
    """Range that a true coverage of 95 % leaves once in a thousand."""
    low, high = stats.binom.ppf([0.0005, 0.9995], n, 0.95) / n
    return float(low), float(high)


@pytest.mark.parametrize(
    ("truth", "polarization", "gain", "offset"),
    [
        ((0.72, 1.0, 90.0, 1.5), "joint", 0.0, 0.0),
        ((0.72, 1.0, 90.0, 1.5), "joint", 0.004, 4e-5),
        ((0.30, 0.5, 20.0, 1.3), "joint", 0.004, 4e-5),
        ((0.35, 1.0, 1000.0, 1.4), "joint", 0.004, 4e-5),
        ((0.72, 1.0, 90.0, 1.5), "s", 0.004, 4e-5),
    ],
)
def test_coverage_of_the_95_percent_intervals(
    positions: Positions,
    exact_readings: Readings,
    aperture: Aperture,
    truth: tuple[float, float, float, float],
    polarization: str,
    gain: float,
    offset: float,
) -> None:
    """600 simulated scans; a baseline error per polarization and a dark error are drawn for each."""
    m = 600
    rng = np.random.default_rng(20)
    r = exact_readings(*truth)
    y = r[:, None] + instrument_noise(r)[:, None] * rng.standard_normal((r.size, m))
    for which in ("s", "p"):
        y[positions.polarization == which] *= 1.0 + gain * rng.standard_normal(m)
    y += offset * rng.standard_normal(m)  # one dark for both
    fit = fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization, y,
        instrument=aperture, polarization=polarization, # type: ignore[arg-type]
        gain_u=gain, offset_u=offset,
        wavelength_nm=np.linspace(300.0, 1500.0, m), detector_index=np.arange(m) >= m // 2,
    )  # fmt: skip
    low, high = coverage_bounds(m)
    covered = np.mean((fit.lower <= truth) & (truth <= fit.upper), axis=0)
    assert np.all((covered >= low) & (covered <= high)), covered
    k_g = fit.hemispherical(8.0).k_g
    true_k_g = float(PublishedLobe(*truth).directional_albedo(8.0, "unpolarized"))
    assert low <= float(np.mean((k_g.lower <= true_k_g) & (true_k_g <= k_g.upper))) <= high
    # and the estimates themselves: unbiased, with the scatter that is claimed
    z = (fit.value - truth) / fit.se
    assert np.all(np.abs(np.mean(z, axis=0)) < 0.2)
    assert np.all(np.abs(np.std(z, axis=0) - 1.0) < 0.12)


def test_common_mode_does_not_average_out(
    positions: Positions, exact_readings: Readings, aperture: Aperture
) -> None:
    """A 1 % baseline error is 1 % of rho_d however many positions there are; shared by S and P or not."""
    rng = np.random.default_rng(1)
    r = exact_readings(0.72, 1.0, 90.0, 1.5)
    y = r[:, None] * (1.0 + 1e-5 * rng.standard_normal((r.size, 5)))
    options = {"instrument": aperture, "gain_u": 0.01}
    s = fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization, y, polarization="s", **options
    )  # type: ignore[arg-type]
    np.testing.assert_allclose(s.se[:, 0], 0.0072, rtol=1e-2)
    np.testing.assert_allclose(s.se[:, 1], 0.01, rtol=0.2)
    at = (positions.theta_i_deg, positions.theta_o_deg, positions.polarization)
    joint = fit_readings(*at, y, **options)  # type: ignore[arg-type]
    np.testing.assert_allclose(joint.se[:, 0], 0.0072 / np.sqrt(2.0), rtol=5e-2)


@pytest.mark.parametrize("polarization", ["joint", "s"])
def test_claimed_correlation_is_that_of_the_estimates(
    positions: Positions, exact_readings: Readings, aperture: Aperture, polarization: str
) -> None:
    """rho_s and n2 are hard to tell apart: for relative noise S alone -0.99 or so, both together less."""
    rng = np.random.default_rng(2)
    y = exact_readings(0.72, 1.0, 90.0, 1.5)[:, None] * (1.0 + 0.005 * rng.standard_normal((292, 400)))
    fit = fit_readings(
        positions.theta_i_deg, positions.theta_o_deg, positions.polarization, y,
        instrument=aperture, polarization=polarization,  # type: ignore[arg-type]
    )  # fmt: skip
    claimed = np.median(fit.correlation, axis=0)
    found = np.corrcoef(fit.value.T)
    # Fisher's z of 400 pairs has a standard deviation of 0.05
    off = ~np.eye(4, dtype=bool)
    np.testing.assert_allclose(np.arctanh(claimed[off]), np.arctanh(found[off]), atol=0.2)
    low, high = (-0.995, -0.975) if polarization == "s" else (-0.97, -0.94)
    assert low < claimed[1, 3] < high
    assert all(
        ("hardly separable" in note) == (abs(c) > 0.95)
        for note, c in zip(fit.notes, fit.correlation[:, 1, 3], strict=True)
    )


@pytest.mark.parametrize(
    ("truth", "level"), [((0.72, 0.2, 15.0, 1.2), 10.0), ((0.72, 0.2, 100.0, 1.2), 10.0)]
)
def test_a_lobe_below_the_noise_is_allowed_for_in_rho_d(
    positions: Positions,
    exact_readings: Readings,
    aperture: Aperture,
    truth: tuple[float, float, float, float],
    level: float,
) -> None:
    """P light, 5 % noise: no lobe is seen, but there is one; Lambert's own interval would miss rho_d."""
    p = positions.polarization == "p"
    r = exact_readings(*truth)[p]
    noise = level * instrument_noise(r)[:, None]
    y = r[:, None] + noise * np.random.default_rng(8).standard_normal((r.size, 150))
    at = positions[p]
    fit = fit_readings(
        at.theta_i_deg, at.theta_o_deg, at.polarization, y, instrument=aperture, polarization="p"
    )
    unseen = np.array(["no lobe is seen" in note for note in fit.notes])
    assert np.mean(unseen) > 0.5
    covered = (fit.lower[:, 0] <= truth[0]) & (truth[0] <= fit.upper[:, 0])
    assert np.mean(covered[unseen]) > 0.93
    plain = (
        np.sqrt(np.nansum((fit.sigma**-2) * aperture.diffuse_integral(at.theta_o_deg)[:, None] ** 2, axis=0))
        ** -1
    )
    assert np.median(fit.se[unseen, 0] / plain[unseen]) < 2.5

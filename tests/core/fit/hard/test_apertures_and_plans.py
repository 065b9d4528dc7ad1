"""Other apertures and plans than the paper's, with known truths: covered, or said to be undetermined."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from simulated_readings import FloatArray, Positions, instrument_noise, paper_positions, plane_quadrature

from gonio.aperture import Aperture
from gonio.fitting import FitResult, fit_readings

TRUTH = (0.72, 1.0, 90.0, 1.5)
COUNT = 40


def plan(*sweeps: tuple[float, FloatArray], polarizations: str = "sp") -> Positions:
    """Sweeps of (theta_i, theta_o), each in every polarization."""
    theta_i = np.concatenate([np.full(len(out), angle) for angle, out in sweeps])
    theta_o = np.concatenate([out for _, out in sweeps])
    times = len(polarizations)
    return Positions(
        np.tile(theta_i, times), np.tile(theta_o, times), np.repeat(list(polarizations), theta_i.size)
    )


def noisy_fit(
    at: Positions, truth: tuple[float, ...], instrument: Aperture, *, panels: int = 6, seed: int = 0
) -> FitResult:
    r = plane_quadrature(at, *truth, instrument, panels=panels)
    noise = instrument_noise(r)[:, None] * np.random.default_rng(seed).standard_normal((r.size, COUNT))
    return fit_readings(
        at.theta_i_deg, at.theta_o_deg, at.polarization, r[:, None] + noise, instrument=instrument
    )


def misses(fit: FitResult, truth: tuple[float, ...]) -> list[int]:
    """Intervals that do not hold the truth, of each parameter."""
    return np.sum((fit.lower > truth) | (fit.upper < truth), axis=0).tolist()


# as many misses of 40 intervals of 95 % have a chance of 2e-5 with four parameters
MOST = int(stats.binom.isf(5e-6, COUNT, 0.05))


@pytest.mark.parametrize("alpha", [20.0, 1500.0])
@pytest.mark.parametrize("size", [(5.0, 40.0, 60.0), (40.0, 4.0, 200.0), (2.0, 2.0, 95.0)])
def test_other_apertures(size: tuple[float, float, float], alpha: float) -> None:
    truth = (0.72, 1.0, alpha, 1.5)
    fit = noisy_fit(paper_positions(6.0), truth, Aperture(*size), panels=8 if alpha > 100.0 else 4)
    assert max(misses(fit, truth)) <= MOST
    z = (np.mean(fit.value, axis=0) - truth) / np.mean(fit.se, axis=0) * np.sqrt(COUNT)
    assert np.all(np.abs(z) < 5.0)


FULL = np.arange(-75.0, 86.0, 3.0)
FORWARD = np.arange(-30.0, 86.0, 3.0)
PLANS = {
    "one incidence in S and P": plan((45.0, FORWARD)),
    "two incidences close together": plan((45.0, FORWARD), (46.0, FORWARD)),
    "twelve positions": plan((20.0, np.array([14.0, 20.0, 60.0])), (55.0, np.array([0.0, 50.0, 55.0]))),
    "specular side only": plan(*[(t, np.arange(0.0, 86.0, 3.0)) for t in (20.0, 55.0)]),
    "beyond the mirror direction only": plan(*[(t, np.arange(t + 6.0, 86.0, 2.0)) for t in (20.0, 40.0)]),
    "normal and grazing incidence": plan((0.0, FULL), (85.0, FULL)),
    "past the sample's plane": plan((30.0, FORWARD), (80.0, np.arange(60.0, 97.0, 2.0))),
    "half a degree apart": plan((55.0, np.arange(20.0, 86.0, 0.5))),
}


@pytest.mark.parametrize("name", PLANS)
def test_other_plans(name: str, aperture: Aperture) -> None:
    fit = noisy_fit(PLANS[name], TRUTH, aperture)
    assert max(misses(fit, TRUTH)) <= MOST


def test_random_positions_and_positions_twice(aperture: Aperture) -> None:
    rng = np.random.default_rng(3)
    at = Positions(rng.uniform(0.0, 80.0, 120), rng.uniform(-85.0, 85.0, 120), rng.choice(["s", "p"], 120))
    assert max(misses(noisy_fit(at, TRUTH, aperture), TRUTH)) <= MOST
    twice = at[np.concatenate([np.arange(120), np.arange(120)])]
    fit = noisy_fit(twice, TRUTH, aperture)
    assert max(misses(fit, TRUTH)) <= MOST
    assert np.all(fit.dof == 240 - 4)


def test_normal_incidence_tells_the_product_only(aperture: Aperture) -> None:
    """At theta_i = 0, S and P reflect alike, whatever n2 is."""
    fit = noisy_fit(plan((0.0, FULL)), TRUTH, aperture)
    assert all("only their product rho_s R" in note for note in fit.notes)
    assert np.all(fit.lower[:, 3] <= 1.5)
    assert np.all(fit.upper[:, 3] >= 1.5)
    k_s = fit.hemispherical(0.0).k_s
    assert np.sum((k_s.lower > 0.04) | (k_s.upper < 0.04)) <= MOST


def test_two_incidences_of_one_polarization_a_degree_apart(aperture: Aperture) -> None:
    """R changes by little over a degree: what is left of rho_s is wide, and said to be."""
    fit = noisy_fit(plan((45.0, FORWARD), (46.0, FORWARD), polarizations="s"), TRUTH, aperture)
    assert max(misses(fit, TRUTH)) <= MOST
    assert all("hardly separable" in note or "no upper bound" in note for note in fit.notes)


def test_retro_side_sees_no_lobe(aperture: Aperture) -> None:
    fit = noisy_fit(
        plan(*[(t, np.arange(-85.0, -t - 15.0, 3.0)) for t in (20.0, 30.0, 45.0)]), TRUTH, aperture
    )
    assert all(note.startswith("no lobe is seen above the noise") for note in fit.notes)
    assert misses(fit, TRUTH)[0] <= MOST
    assert np.all(np.isnan(fit.value[:, 2:]))


def test_narrow_lobe_whose_peak_was_not_measured(aperture: Aperture) -> None:
    at = paper_positions(6.0)
    away = at[np.abs(at.theta_o_deg - at.theta_i_deg) >= 12.0]
    fit = noisy_fit(away, (0.72, 1.0, 2000.0, 1.5), aperture, panels=8)
    # at 12 degrees it has fallen to 1e-18 of its peak
    assert sum(note.startswith("no lobe is seen above the noise") for note in fit.notes) >= COUNT - 1
    assert misses(fit, TRUTH)[0] <= MOST
    # of a wide one, the flanks are enough
    assert max(misses(noisy_fit(away, TRUTH, aperture), TRUTH)) <= MOST

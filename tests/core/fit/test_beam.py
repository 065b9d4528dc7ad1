"""A beam with width and divergence: the fit finds the truth; without it a narrow lobe reads too wide."""

from __future__ import annotations

import numpy as np
import pytest
from bench_readings import bench_quadrature
from simulated_readings import Positions, instrument_noise

from gonio.aperture import Aperture, IncidentBeam
from gonio.fitting import FitResult, fit_readings


def run(at: Positions, r: np.ndarray, aperture: Aperture, beam: IncidentBeam | None) -> FitResult:
    return fit_readings(
        at.theta_i_deg, at.theta_o_deg, at.polarization, r if r.ndim == 2 else r[:, None],
        instrument=aperture, beam=beam,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("beam", "alpha", "rtol"),
    [
        (IncidentBeam(1.0, 1.0), 30.0, 1e-8),
        (IncidentBeam(1.0, 1.0), 1000.0, 1e-8),
        (IncidentBeam(3.0, 5.0), 300.0, 1e-8),
        (IncidentBeam(1.0, 1.0), 1e5, 1e-8),
        (IncidentBeam(1.0, 1.0, 0.5), 100.0, 1e-7),
        (IncidentBeam(2.0, 2.0, 1.5), 40.0, 3e-6),  # P near Brewster's angle has terms of the fourth order
    ],
)
def test_parameters_come_back(
    positions: Positions, aperture: Aperture, beam: IncidentBeam, alpha: float, rtol: float
) -> None:
    truth = (0.72, 1.0, alpha, 1.5)
    r = bench_quadrature(positions, *truth, aperture, beam)
    fit = run(positions, r, aperture, beam)
    np.testing.assert_allclose(fit.value[0], truth, rtol=rtol)
    np.testing.assert_allclose(
        fit.predict(positions.theta_i_deg, positions.theta_o_deg, positions.polarization)[:, 0],
        r,
        rtol=1e-6 if beam.divergence_deg == 0.0 else 1e-3,
        atol=1e-6 * r.max(),
    )


def test_what_leaving_the_beam_out_does(positions: Positions, aperture: Aperture) -> None:
    """3 mm of beam smear the edge of the aperture as a wider lobe would."""
    beam, truth = IncidentBeam(3.0, 3.0), (0.72, 1.0, 1e4, 1.5)
    r = bench_quadrature(positions, *truth, aperture, beam)
    y = r[:, None] + instrument_noise(r)[:, None] * np.random.default_rng(1).standard_normal((r.size, 12))
    line, right = run(positions, y, aperture, None), run(positions, y, aperture, beam)
    assert np.all(line.upper[:, 2] < 0.7 * truth[2])  # wrong, and sure of it
    covered = (right.lower <= truth) & (truth <= right.upper)
    assert np.all(np.mean(covered, axis=0) > 0.7)


def test_a_mirror_under_a_beam_leaves_alpha_open(positions: Positions, aperture: Aperture) -> None:
    beam, truth = IncidentBeam(1.0, 1.0), (0.72, 1.0, 1e7, 1.5)
    r = bench_quadrature(positions, *truth, aperture, beam)
    y = r[:, None] + instrument_noise(r)[:, None] * np.random.default_rng(2).standard_normal((r.size, 12))
    fit = run(positions, y, aperture, beam)
    assert np.all(np.isposinf(fit.upper[:, 2]))
    assert np.all(fit.lower[:, 2] < truth[2])
    z = (fit.value - truth)[:, [0, 1, 3]] / fit.se[:, [0, 1, 3]]
    assert np.all(np.abs(np.mean(z, axis=0)) < 1.2)
    assert all("alpha >= " in note for note in fit.notes)

"""P readings on both sides of Brewster's angle: two indices give the same readings, and the fit says so."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize
from simulated_readings import FloatArray, Positions, fresnel_textbook, instrument_noise, plane_quadrature

from gonio.aperture import Aperture
from gonio.fitting import FitResult, fit_readings

FORWARD = np.arange(-30.0, 86.0, 3.0)


def sweeps(incidences: list[float], polarization: str) -> Positions:
    n = len(incidences) * FORWARD.size
    return Positions(
        np.repeat(incidences, FORWARD.size), np.tile(FORWARD, len(incidences)), np.full(n, polarization)
    )


def fit_of(at: Positions, rho_s: float, instrument: Aperture, m: int = 20) -> FitResult:
    r = plane_quadrature(at, 0.72, rho_s, 90.0, 1.5, instrument, panels=4)
    y = r[:, None] + instrument_noise(r)[:, None] * np.random.default_rng(0).standard_normal((r.size, m))
    return fit_readings(at.theta_i_deg, at.theta_o_deg, at.polarization, y, instrument=instrument)


def ratio(n2: float, incidences: list[float]) -> float:
    r: FloatArray = fresnel_textbook(n2, np.array(incidences), np.array(["p", "p"]))
    return float(r[0] / r[1])


@pytest.mark.parametrize(("incidences", "rho_s"), [([55.0, 57.0], 20.0), ([50.0, 60.0], 1.0)])
def test_the_other_index_is_named(incidences: list[float], rho_s: float, aperture: Aperture) -> None:
    fit = fit_of(sweeps(incidences, "p"), rho_s, aperture)
    # where R(theta_1) / R(theta_2) comes back to what it is at 1.5; beyond Brewster's angle of theta_2
    beyond = np.tan(np.deg2rad(incidences[1])) + 1e-6
    twin = optimize.brentq(lambda n: ratio(n, incidences) - ratio(1.5, incidences), beyond, 9.0)
    for k, note in enumerate(fit.notes):
        assert "fits as well, on the other side of Brewster's angle" in note
        named = float(note.split("n2 = ")[1].split(" ")[0])
        found = sorted([named, float(fit.value[k, 3])])
        np.testing.assert_allclose(found, [1.5, twin], rtol=0.15)


def test_a_third_incidence_or_s_readings_decide(aperture: Aperture) -> None:
    p = sweeps([50.0, 60.0], "p")
    s = sweeps([50.0, 60.0], "s")
    both = Positions(*(np.concatenate([getattr(x, name) for x in (p, s)]) for name in p.__dataclass_fields__))
    for at in (sweeps([50.0, 56.0, 62.0], "p"), both, s):
        fit = fit_of(at, 1.0, aperture)
        assert not any("Brewster" in note for note in fit.notes)
        truth = [0.72, 1.0, 90.0, 1.5]
        assert np.all(np.sum((fit.lower > truth) | (fit.upper < truth), axis=0) <= 5)

"""What `gonio fit` says beside its table: the parts of the instrument function, and what is hard to tell."""

from __future__ import annotations

import re

import numpy as np
import pytest

from gonio.aperture import Aperture, IncidentBeam, InstrumentFunction
from gonio.cli.side_by_side import identifiability_text, instrument_text
from gonio.fitting import FitResult, fit_readings
from gonio.fitting.columns import readings
from gonio.fitting.problem import Problem

ARTA, BEAM = Aperture(26.0, 18.0, 95.2353), IncidentBeam(3.0, 3.0)
TRUTH = ((0.7, 0.04, 30.0, 1.5), (0.3, 0.06, 900.0, 1.6))  # rho_d, k_n, alpha, n2 at two wavelengths


def plan() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    theta_i = np.repeat([20.0, 45.0, 55.0, 20.0, 45.0, 55.0], 30)
    theta_o = np.tile(np.linspace(-25.0, 80.0, 30), 6)
    return theta_i, theta_o, np.repeat(["s", "p"], 90)


def fitted(beam: IncidentBeam | None, aperture: str = "exact") -> FitResult:
    theta_i, theta_o, which = plan()
    basic = np.array([[rho_d, k_n, np.log(alpha), n2] for rho_d, k_n, alpha, n2 in TRUTH])
    receiver = ARTA if beam is None else InstrumentFunction(ARTA, beam)
    r = readings(Problem.of(receiver, theta_i, theta_o, which == "s"), basic)
    r = r + 1e-5 * np.random.default_rng(1).standard_normal(r.shape)
    return fit_readings(
        theta_i,
        theta_o,
        which,
        r,
        instrument=ARTA,
        beam=beam,
        aperture=aperture,
        wavelength_nm=[500.0, 600.0],
    )  # type: ignore[arg-type]


def test_no_reading_changes_by_more_than_is_said() -> None:
    fit = fitted(BEAM)
    text = instrument_text(fit)
    assert re.search(r"alpha 30\.?\d*\.\.\.90\d", text)
    said = {line.split("  ")[1]: line for line in text.splitlines()[1:]}
    assert list(said) == [
        "height of the aperture", "length of the spot", "height of the spot", "the beam as a whole",
    ]  # fmt: skip
    theta_i, theta_o, which = plan()
    whole = fit.predict(theta_i, theta_o, which)
    without = Problem.of(ARTA, theta_i, theta_o, which == "s")
    change = float(np.max(np.abs(readings(without, fit.basic) - whole)))
    in_r = re.search(r"([\d.e+-]+) in r$", said["the beam as a whole"])
    assert in_r is not None
    # twice, since all of the lobe might be in one polarization, and not far beyond
    assert change <= float(in_r[1]) * 1.05
    assert float(in_r[1]) < 6.0 * change


def test_an_unknown_beam_is_said_and_an_approximate_aperture_has_no_parts() -> None:
    assert "state [beam] in the rig file" in instrument_text(fitted(None))
    assert instrument_text(fitted(None, "eq22")) == ""


def test_what_is_told_least_is_named_at_its_wavelength() -> None:
    text = identifiability_text(fitted(None))
    assert text.startswith("identifiability, worst at ")
    assert "rho_s" in text
    assert "n2" in text
    assert text.count(" nm: ") == 1


@pytest.mark.parametrize("beam", [None, BEAM])
def test_the_fit_of_these_readings_is_right(beam: IncidentBeam | None) -> None:
    """What is said above is said of the truth."""
    fit = fitted(beam)
    np.testing.assert_allclose(fit.value[:, 2], [alpha for _, _, alpha, _ in TRUTH], rtol=0.02)

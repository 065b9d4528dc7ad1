"""Fixtures of the fit tests; `simulated_readings.py` beside this file makes the readings."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from gonio.aperture import Aperture

sys.path.insert(0, str(Path(__file__).parent))  # tests are no package; the helper module is found beside them

from simulated_readings import FloatArray, Positions, paper_positions, plane_quadrature


@pytest.fixture(scope="session")
def aperture() -> Aperture:
    return Aperture(26.0, 18.0, 95.2353)


@pytest.fixture(scope="session")
def positions() -> Positions:
    return paper_positions()


@pytest.fixture(scope="session")
def exact_readings(positions: Positions, aperture: Aperture) -> Callable[..., FloatArray]:
    """r (292,) of four parameters, each combination integrated once a session."""
    known: dict[tuple[float, ...], FloatArray] = {}

    def readings(rho_d: float, rho_s: float, alpha: float, n2: float) -> FloatArray:
        key = (rho_d, rho_s, alpha, n2)
        if key not in known:
            known[key] = plane_quadrature(positions, *key, aperture, panels=6 if alpha < 300 else 10)
        return known[key]

    return readings

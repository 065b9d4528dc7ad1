"""Fits of readings made by hand: the published lobe in the exact aperture, with noise and gains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture
from gonio.fitting import FitResult, fit_readings
from gonio.fitting.problem import Problem

TRUTH = (0.72, 1.0, 90.0, 1.5)
INSTRUMENT = Aperture(26.0, 18.0, 95.2353)


def fitted(
    wavelength_nm: NDArray[np.float64], detector_index: Sequence[int], gain: Sequence[float] | None = None
) -> FitResult:
    """Return the fit of four sweeps in S and P with 0.5 % noise; `gain` multiplies the readings, (m,)."""
    theta_i = np.repeat([20.0, 30.0, 45.0, 55.0], 31)
    theta_o = np.tile(np.linspace(-4.0, 80.0, 31), 4)
    keep = np.abs(theta_o + theta_i) >= 15.0
    theta_i, theta_o = np.tile(theta_i[keep], 2), np.tile(theta_o[keep], 2)
    is_s = np.arange(theta_i.size) < theta_i.size // 2
    m = len(wavelength_nm)
    rho_d, rho_s, alpha, n2 = TRUTH
    basic = np.tile([rho_d, rho_s * ((n2 - 1.0) / (n2 + 1.0)) ** 2, np.log(alpha), n2], (m, 1))
    r = _readings(Problem.of(INSTRUMENT, theta_i, theta_o, is_s), basic)
    rng = np.random.default_rng(7)
    y = r * (1.0 if gain is None else np.asarray(gain)) * (1.0 + 0.005 * rng.standard_normal(r.shape))
    return fit_readings(
        theta_i, theta_o, np.where(is_s, "s", "p"), y, instrument=INSTRUMENT, wavelength_nm=wavelength_nm,
        detector_index=list(detector_index),
    )  # fmt: skip


def _readings(problem: Problem, basic: NDArray[np.float64]) -> NDArray[np.float64]:
    from gonio.fitting.columns import readings

    return readings(problem, basic)

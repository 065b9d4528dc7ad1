"""The optimum is the global one: against a dense grid whose best points scipy polishes, from many truths."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize
from simulated_readings import FloatArray, paper_positions

from gonio.aperture import Aperture
from gonio.fitting.columns import readings
from gonio.fitting.problem import Problem
from gonio.fitting.solve import refine

APERTURE = Aperture(26.0, 18.0, 95.2353)
CASES = 50


def by_brute_force(model: Problem, y: FloatArray) -> float:
    """Return the least chi2 of one wavelength that a grid of 60 x 40 and Nelder and Mead's simplex find."""
    a, n = np.meshgrid(
        np.linspace(model.low[0], model.high[0], 60), 1.0 + np.geomspace(1e-3, 9.0, 40), indexing="ij"
    )
    diffuse, lobe = model.columns(np.stack([a.ravel(), n.ravel()], axis=1)).value
    d = diffuse[:, 0]
    rest = y - d * (d @ y) / (d @ d)
    across = lobe - d[:, None] * (d @ lobe) / (d @ d)
    size = np.sum(across**2, axis=0)
    chi2 = rest @ rest - np.where(size > 0.0, (across.T @ rest) ** 2 / np.where(size > 0.0, size, 1.0), 0.0)
    grid = chi2.reshape(a.shape)
    padded = np.pad(grid, 1, constant_values=np.inf)
    lowest = np.ones(grid.shape, bool)
    for i in range(3):
        for j in range(3):
            lowest &= grid <= padded[i : i + grid.shape[0], j : j + grid.shape[1]]
    valleys = np.flatnonzero(lowest.ravel())

    def residual_square(x: FloatArray) -> float:
        column = model.columns(x[None]).value[1][:, 0]
        basis = np.stack([d, column], axis=1)
        left = y - basis @ np.linalg.lstsq(basis, y, rcond=1e-14)[0]
        return float(left @ left)

    best = np.inf
    for at in valleys[np.argsort(chi2[valleys])][:2]:
        x = np.array([a.ravel()[at], n.ravel()[at]])
        step = np.diag([0.05, 0.03 * (x[1] - 1.0)]) * np.where(x < 0.5 * (model.low + model.high), 1.0, -1.0)
        simplex = np.concatenate([x[None], x + step])
        found = optimize.minimize(
            residual_square,
            x,
            method="Nelder-Mead",
            bounds=list(zip(model.low, model.high, strict=True)),
            options={"xatol": 1e-8, "fatol": 1e-13 * chi2[at], "initial_simplex": simplex, "maxiter": 300},
        )
        best = min(best, float(found.fun))
    return best


@pytest.mark.parametrize("plan", ["all", "s", "one incidence", "two incidences"])
def test_no_start_is_needed(plan: str) -> None:
    """200 truths: wide and narrow lobes, 0.1 ... 5 % noise, indices 1.01 ... 4."""
    at = paper_positions(6.0)
    at = {
        "all": at,
        "s": at[at.polarization == "s"],
        "one incidence": at[at.theta_i_deg == 30.0],
        "two incidences": at[np.isin(at.theta_i_deg, [45.0, 55.0])],
    }[plan]
    rng = np.random.default_rng(["all", "s", "one incidence", "two incidences"].index(plan))
    basic = np.stack(
        [
            rng.uniform(0.05, 0.9, CASES),
            np.exp(rng.uniform(np.log(1e-3), np.log(0.3), CASES)),
            np.log(rng.choice([0.5, 3.0, 10.0, 30.0, 100.0, 500.0, 2000.0, 1e4], CASES)),
            1.0 + np.exp(rng.uniform(np.log(0.01), np.log(3.0), CASES)),
        ],
        axis=1,
    )
    model = Problem.of(APERTURE, at.theta_i_deg, at.theta_o_deg, at.polarization == "s")
    clean = readings(model, basic)
    level = np.exp(rng.uniform(np.log(1e-3), np.log(0.05), CASES))
    y = clean * (1.0 + level * rng.standard_normal(clean.shape)) + 1e-5 * rng.standard_normal(clean.shape)
    found = refine(model, y, np.ones_like(y), model.start(y, np.ones_like(y)))
    least = np.array([by_brute_force(model, y[:, k]) for k in range(CASES)])
    assert np.all(found.chi2 <= least * (1.0 + 1e-9))

"""Is the noise of the readings told right from residuals, whichever of its three parts are there?"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import nnls
from simulated_readings import FloatArray

from gonio.fitting.noise import NEIGHBOURS, variance_function

Readings = Callable[..., FloatArray]

NOISE = {
    "floor": (2e-5, 0.0, 0.0),
    "shot": (0.0, 4e-4, 0.0),
    "proportional": (0.0, 0.0, 5e-3),
    "floor and proportional": (2e-5, 0.0, 2e-3),
    "all three": (2e-5, 4e-4, 2e-3),
}


@pytest.mark.parametrize("kind", NOISE)
@pytest.mark.parametrize("m", [1, 15])
def test_variance_is_found_over_the_whole_range_of_readings(
    exact_readings: Readings, kind: str, m: int
) -> None:
    """Readings span 0.0009 to 0.07: weights must be right at both ends."""
    floor, shot, proportional = NOISE[kind]
    r = exact_readings(0.72, 1.0, 100.0, 1.5)
    true = floor**2 + shot**2 * r + (proportional * r) ** 2
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(20):
        squared = true[:, None] * rng.standard_normal((r.size, m)) ** 2
        model = np.repeat(r[:, None], m, axis=1)
        found = variance_function(squared, model, np.ones((r.size, m), bool), np.zeros(m, np.uint8))
        ratios.append(found[:, m // 2] / true)
    # sd of a variance from as many residuals; a part that is not there is found a little positive
    pooled = r.size * min(m, 2 * NEIGHBOURS + 1)
    spread = 8.0 * np.sqrt(2.0 / pooled)
    middle = np.median(ratios, axis=0)
    assert np.all((middle > 1.0 - spread) & (middle < 1.0 + 2.0 * spread)), (middle.min(), middle.max())


def test_coefficients_are_those_of_an_independent_non_negative_least_squares() -> None:
    """Proportional noise: the iteration's fixed point by scipy's nnls on the same weights."""
    rng = np.random.default_rng(5)
    r = np.geomspace(1e-3, 0.3, 300)
    squared = (5e-3 * r * rng.standard_normal(r.size)) ** 2
    found = variance_function(squared[:, None], r[:, None], np.ones((300, 1), bool), np.zeros(1, np.uint8))
    columns = np.stack([np.ones_like(r), r, r**2], axis=1)
    variance, mean = np.full(r.size, np.mean(squared)), float(np.mean(squared))
    for _ in range(3):
        weight = np.where(squared < 36.0 * variance, 1.0 / variance, 0.0)
        unit = np.linalg.norm(columns * weight[:, None], axis=0)
        c, _ = nnls(columns * weight[:, None] / unit, squared * weight)
        variance = np.maximum(columns @ (c / unit), 1e-6 * mean)
    np.testing.assert_allclose(found[:, 0], variance, rtol=1e-5)

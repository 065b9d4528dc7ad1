from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import qmc

from gonio import fresnel
from gonio.facade import sampling
from gonio.facade.sobol import DIMENSIONS, sobol_directions
from gonio.facade.tracing import fresnel_mean

KEY = np.uint64(0x1234_5678_9ABC_DEF0)


def key_of(seed: int, replica: int) -> np.uint64:
    return np.uint64(sampling.key_of(np.uint64(seed), np.uint64(3), np.uint64(replica)))


def test_direction_numbers_are_those_of_scipy() -> None:
    # scipy counts in Gray code: the same points in another order within every power of two.
    ours = np.zeros((64, DIMENSIONS), dtype=np.uint64)
    table = sobol_directions()
    for index in range(64):
        for bit in range(6):
            if index >> bit & 1:
                ours[index] ^= table[:, bit]
    theirs = qmc.Sobol(DIMENSIONS, scramble=False, bits=32).random_base2(6)
    a, b = ours / 2.0**32, np.asarray(theirs)
    assert np.array_equal(a[np.lexsort(a.T)], b[np.lexsort(b.T)])


def test_scrambling_keeps_one_point_in_every_stratum_of_all_pairs_used_together() -> None:
    table = sobol_directions()
    for replica in range(4):
        key = key_of(7, replica)
        points = np.array([[sampling.sobol(table, i, d, key) for d in range(DIMENSIONS)] for i in range(256)])
        assert np.all((points > 0.0) & (points < 1.0))
        for d in range(DIMENSIONS):
            assert np.array_equal(np.sort((points[:, d] * 256).astype(int)), np.arange(256))
        for rows, columns in ((16, 16), (4, 64)):  # the first two dimensions are a (0, 2)-sequence
            cells = (points[:, 0] * rows).astype(int) * columns + (points[:, 1] * columns).astype(int)
            assert np.array_equal(np.sort(cells), np.arange(256))


def test_replicas_are_different_and_uncorrelated() -> None:
    table = sobol_directions()
    keys = [key_of(1, r) for r in range(200)]
    first = np.array([[sampling.sobol(table, i, d, k) for i in (0, 1) for d in (0, 3)] for k in keys])
    assert len(np.unique(first)) == first.size
    assert abs(first.mean() - 0.5) < 4 * math.sqrt(1 / 12 / first.size)
    correlation = np.corrcoef(first.T)[[0, 0], [1, 3]]  # different dimensions: independent
    assert np.all(np.abs(correlation) < 0.3)


def test_hashed_numbers_are_uniform() -> None:
    draws = np.array([sampling.uniform(KEY, n) for n in range(20_000)])
    counts = np.histogram(draws, bins=50, range=(0.0, 1.0))[0]
    chi_square = float(np.sum((counts - 400.0) ** 2 / 400.0))
    assert 20.0 < chi_square < 95.0  # 49 degrees of freedom
    assert abs(np.corrcoef(draws[:-1], draws[1:])[0, 1]) < 0.03


@settings(max_examples=60, deadline=None)
@given(
    theta=st.floats(0.0, math.pi),
    phi=st.floats(-math.pi, math.pi),
    polar=st.floats(0.0, math.pi / 2),
    u=st.floats(0.0, 1.0),
)
def test_directions_are_unit_vectors_at_the_angle_asked(
    theta: float, phi: float, polar: float, u: float
) -> None:
    axis = (math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))
    d = sampling.around(*axis, math.cos(polar), math.sin(polar), u)
    assert math.hypot(*d) == pytest.approx(1.0, abs=1e-14)
    assert math.hypot(*np.cross(d, axis)) == pytest.approx(math.sin(polar), abs=1e-14)


@pytest.mark.parametrize("alpha", [0.0, 1.0, 50.0, 1e4, 1e6, 1e8])
def test_lobe_has_the_moments_of_cos_to_the_alpha(alpha: float) -> None:
    # Stratified in u, so the moments are an integral by the midpoint rule, not a statistic.
    us = (np.arange(4000) + 0.5) / 4000
    sine2 = [np.sum(np.square(sampling.lobe_direction(0.0, 0.0, 1.0, alpha, u, 0.3)[:2])) for u in us]
    assert np.mean(sine2) == pytest.approx(2.0 / (alpha + 3.0), rel=2e-3)
    assert np.unique(sine2).size == us.size  # no digits lost at alpha 1e8
    # quantile: P(sin^2 > x) = (1 - x)^((alpha+1)/2)
    middle = float(np.sum(np.square(sampling.lobe_direction(0.0, 0.0, 1.0, alpha, 0.5, 0.0)[:2])))
    assert middle == pytest.approx(-math.expm1(2.0 * math.log(0.5) / (alpha + 1.0)), rel=1e-14)


@pytest.mark.parametrize("n2", [1.0, 1.0001, 1.24, 1.5, 2.5])
def test_scalar_fresnel_is_that_of_the_fit(n2: float) -> None:
    for theta_deg in (0.0, 8.0, 45.0, 56.3, 75.0, 89.0, 89.99, 90.0):
        cosine = 0.0 if theta_deg == 90.0 else math.cos(math.radians(theta_deg))
        expected = float(fresnel.reflectance(n2, theta_deg, "unpolarized"))
        assert fresnel_mean(cosine, n2) == pytest.approx(expected, rel=1e-11, abs=1e-16)

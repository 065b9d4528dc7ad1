"""The least-squares core against the certified values of NIST's 27 nonlinear problems, from both starts."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests are no package; `nist` is found beside the others

from nist.problems import Problem, problems
from nist.table import Agreement, digits, ordinary, separable

from gonio.fitting import least_squares, nlparci

ALL = list(problems().values())
SEPARABLE = [p for p in ALL if p.linear]


def check(p: Problem, a: Agreement) -> None:
    assert a.converged
    assert a.value >= 8.0
    if p.name == "Lanczos1":
        # The data carry 14 digits and the model fits them all: residuals of 8e-14 beside readings of 2.5 are
        # rounded to 0.5 % of themselves in double precision, and the standard errors are in proportion to
        # them.  What does not depend on that is certified all the same.
        assert a.rss >= 1.5
        assert a.se >= 1.5
        assert a.relative_se >= 7.0
    else:
        assert a.se >= 6.0
        assert a.rss >= 8.0


@pytest.mark.parametrize("start", [0, 1])
@pytest.mark.parametrize("p", ALL, ids=lambda p: p.name)
def test_as_an_ordinary_problem(p: Problem, start: int) -> None:
    check(p, ordinary(p, start))


@pytest.mark.parametrize("start", [0, 1])
@pytest.mark.parametrize("p", SEPARABLE, ids=lambda p: p.name)
def test_with_the_linear_parameters_eliminated(p: Problem, start: int) -> None:
    check(p, separable(p, start))


@pytest.mark.parametrize("name", ["Hahn1", "MGH09", "Misra1a", "Thurber", "Eckerle4", "ENSO"])
def test_without_any_derivatives(name: str) -> None:
    """A function that refuses complex parameters leaves differences."""
    p = problems()[name]

    def real(b: object) -> np.ndarray:
        return np.asarray(p.predicted([float(v) for v in b]))  # type: ignore[attr-defined]

    found = least_squares(real, p.starts[0], y=p.y)
    assert found.converged
    assert digits(found.value, p.value) >= 8.0
    assert digits(found.se, p.se) >= 6.0


@pytest.mark.parametrize("p", ALL, ids=lambda p: p.name)
def test_nlparci_at_the_certified_optimum(p: Problem) -> None:
    """Half width over Student's t is the certified standard error, where rounding of the residuals allows."""
    residual = p.y - p.predicted(p.value)
    residual *= np.sqrt(
        p.rss / np.sum(residual**2)
    )  # 11 printed digits of the parameters leave more than rss
    low, high = nlparci(p.value, residual, p.jacobian(p.value)).T
    from scipy import stats

    t = stats.t.ppf(0.975, p.y.size - p.value.size)
    assert digits(0.5 * (high - low) / t, p.se) >= 6.0
    np.testing.assert_allclose(0.5 * (high + low), p.value, rtol=1e-13)
    # a missing reading is dropped with its row
    gaps = np.concatenate([[np.nan], residual])
    padded = np.concatenate([np.full((1, p.value.size), 7.0), p.jacobian(p.value)])
    np.testing.assert_array_equal(nlparci(p.value, gaps, padded), np.stack([low, high], axis=1))


def test_all_problems_are_here() -> None:
    assert len(ALL) == 27
    assert sum(p.y.size for p in ALL) == 2176
    assert [sum(p.difficulty == d for p in ALL) for d in ("lower", "average", "higher")] == [8, 11, 8]

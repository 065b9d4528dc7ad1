"""One ordinary problem through the public door: derivatives, refusals, and MATLAB's nlparci."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from scipy import optimize, stats

from gonio.errors import FitError
from gonio.fitting import least_squares, nlparci
from gonio.fitting.columns import jacobian
from gonio.fitting.covariance_of import inverse_gram
from gonio.fitting.derivatives import derivatives_of

T = np.linspace(0.0, 4.0, 30)
RNG = np.random.default_rng(1)
Y = 2.0 * np.exp(-0.7 * T) + 0.3 + 0.02 * RNG.standard_normal(30)


def decay(b: np.ndarray) -> np.ndarray:
    return np.asarray(b[0] * np.exp(-b[1] * T) + b[2])


def decay_jacobian(b: np.ndarray) -> np.ndarray:
    e = np.exp(-b[1] * T)
    return np.stack([e, -b[0] * T * e, np.ones(30)], axis=1)


def test_scipy_finds_the_same() -> None:
    """Value, covariance and residual sum of squares; as a model with readings, and as residuals."""
    peer = optimize.least_squares(
        lambda b: decay(b) - Y, [1.0, 1.0, 0.0], jac=decay_jacobian, xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    covariance = 2.0 * peer.cost / 27 * np.linalg.inv(peer.jac.T @ peer.jac)
    for found in (
        least_squares(decay, [50.0, 9.0, -3.0], decay_jacobian, y=Y),
        least_squares(lambda b: decay(b) - Y, [1.0, 1.0, 0.0]),
    ):
        assert found.converged
        np.testing.assert_allclose(found.value, peer.x, rtol=1e-8)
        np.testing.assert_allclose(found.covariance, covariance, rtol=1e-7)
        np.testing.assert_allclose(found.se**2, np.diag(found.covariance))
        assert found.rss == pytest.approx(2.0 * peer.cost, rel=1e-12)
        assert found.dof == 27
        t = stats.t.ppf([0.025, 0.975], 27)
        np.testing.assert_allclose(
            found.intervals(), found.value[:, None] + found.se[:, None] * t, rtol=1e-12
        )
        t = stats.t.ppf([0.16, 0.84], 27)
        np.testing.assert_allclose(
            found.intervals(0.32), found.value[:, None] + found.se[:, None] * t, rtol=1e-12
        )


def test_missing_readings_and_weights() -> None:
    """A reading of weight 2 is one that was taken twice; NaN and weight 0 are none."""
    weights = np.where(np.arange(30) < 10, 2.0, 1.0)
    weights[20] = 0.0
    y = Y.copy()
    y[25] = np.nan
    found = least_squares(decay, [1.0, 1.0, 0.0], y=y, weights=weights)
    rows = np.concatenate([np.arange(10), [k for k in range(30) if k not in (20, 25)]])
    twice = least_squares(lambda b: decay(b)[rows] - Y[rows], [1.0, 1.0, 0.0])
    np.testing.assert_allclose(found.value, twice.value, rtol=1e-8)
    assert found.rss == pytest.approx(twice.rss, rel=1e-12)
    assert found.dof == 25
    np.testing.assert_allclose(found.covariance * 25.0, twice.covariance * 35.0, rtol=1e-7)
    scaled = least_squares(decay, [1.0, 1.0, 0.0], y=y, weights=1e12 * weights)
    np.testing.assert_allclose(scaled.covariance, found.covariance, rtol=1e-7)


@pytest.mark.parametrize("power", [-200, 200])
def test_residuals_of_any_size(power: int) -> None:
    found = least_squares(lambda b: 10.0**power * (decay(b) - Y), [1.0, 1.0, 0.0])
    plain = least_squares(decay, [1.0, 1.0, 0.0], y=Y)
    assert found.converged
    np.testing.assert_allclose(found.value, plain.value, rtol=1e-8)
    np.testing.assert_allclose(found.intervals(), plain.intervals(), rtol=1e-7)


def test_bounds() -> None:
    found = least_squares(decay, [1.0, 0.5, 0.1], y=Y, low=[0.0, 0.0, 0.0], high=[np.inf, 0.6, np.inf])
    assert found.converged
    assert found.value[1] == 0.6
    held = least_squares(lambda b: decay([b[0], 0.6, b[1]]) - Y, [1.0, 0.1])
    np.testing.assert_allclose(found.value[[0, 2]], held.value, rtol=1e-8)


def test_derivatives_of_a_function_that_is_not_analytic() -> None:
    """A complex step through a modulus or a float() is wrong or refused; differences are taken instead."""

    def modulus(b: np.ndarray) -> np.ndarray:
        return np.abs(b[0]) * np.exp(-np.real(b[1]) * T)

    def scalar(b: np.ndarray) -> np.ndarray:
        return np.array([b[0] * math.exp(-b[1] * t) for t in T])

    def dropped(b: np.ndarray) -> np.ndarray:
        out = np.empty(30)
        out[:] = b[0] * np.exp(-b[1] * T)
        return out

    at = np.array([2.0, 0.7])
    exact = decay_jacobian(np.array([2.0, 0.7, 0.0]))[:, :2]
    for function in (modulus, scalar, dropped):
        by = derivatives_of(function, at)
        np.testing.assert_allclose(by.rough(at), exact, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(by.fine(at), exact, rtol=0.0, atol=2e-12)
    analytic = derivatives_of(lambda b: b[0] * np.exp(-b[1] * T), at)
    np.testing.assert_allclose(analytic.rough(at), exact, rtol=1e-14, atol=1e-300)


def test_what_readings_do_not_determine_has_no_standard_error() -> None:
    found = least_squares(lambda b: (b[0] + b[1]) * T - Y, [1.0, 1.0])
    assert np.all(np.isnan(found.se))
    with pytest.raises(FitError, match="rank below 2: parameters 1, 2 have the same effect together"):
        found.intervals()


def test_refusals_name_the_cause() -> None:
    with pytest.raises(FitError, match=r"start\[1\] = 5 is outside its bounds 0\.\.\.1; start within them"):
        least_squares(decay, [1.0, 5.0, 0.0], y=Y, low=[-9.0, 0.0, -9.0], high=[9.0, 1.0, 9.0])
    with pytest.raises(FitError, match="3 used readings do not determine 3 parameters"):
        least_squares(decay, [1.0, 1.0, 0.0], y=np.where(np.arange(30) < 3, Y, np.nan))
    with pytest.raises(FitError, match="infinite at start"):
        least_squares(decay, [1.0, -1e4, 0.0], y=Y)
    with pytest.raises(FitError, match="not a list of finite numbers"):
        least_squares(decay, [1.0, np.nan, 0.0], y=Y)
    with pytest.raises(FitError, match="none negative"):
        least_squares(decay, [1.0, 1.0, 0.0], y=Y, weights=-np.ones(30))
    with pytest.raises(FitError, match=r"jacobian returns an array of shape \(30, 2\)"):
        least_squares(decay, [1.0, 1.0, 0.0], lambda b: decay_jacobian(b)[:, :2], y=Y)


def test_nlparci_refuses_what_has_no_interval() -> None:
    j = decay_jacobian(np.array([2.0, 0.7, 0.3]))
    r = RNG.standard_normal(30)
    with pytest.raises(FitError, match="rank below 3: no residual depends on parameter 2"):
        nlparci([1.0, 2.0, 3.0], r, j * [1.0, 0.0, 1.0])
    with pytest.raises(FitError, match="rank below 3: parameters 1, 3"):
        nlparci([1.0, 2.0, 3.0], r, np.stack([j[:, 0], j[:, 1], -2.0 * j[:, 0]], axis=1))
    with pytest.raises(FitError, match="leave no degree of freedom beside 3 parameters"):
        nlparci([1.0, 2.0, 3.0], np.where(np.arange(30) < 3, r, np.nan), j)
    with pytest.raises(FitError, match=r"need a Jacobian of shape \(30, 3\), not \(29, 3\)"):
        nlparci([1.0, 2.0, 3.0], r, j[1:])
    with pytest.raises(FitError, match="not finite in a row that is used"):
        nlparci([1.0, 2.0, 3.0], r, np.where(np.arange(30)[:, None] == 4, np.nan, j))
    with pytest.raises(FitError, match="alpha = 5"):
        nlparci([1.0, 2.0, 3.0], r, j, 5.0)


def test_nlparci_drops_a_missing_row_even_if_its_jacobian_is_missing_too() -> None:
    j = decay_jacobian(np.array([2.0, 0.7, 0.3]))
    r = RNG.standard_normal(30)
    gaps = np.where(np.arange(30) == 4, np.nan, r)
    whole = nlparci([1.0, 2.0, 3.0], np.delete(r, 4), np.delete(j, 4, axis=0))
    np.testing.assert_array_equal(
        nlparci([1.0, 2.0, 3.0], gaps, np.where(np.isnan(gaps)[:, None], np.nan, j)), whole
    )


def test_covariance_keeps_the_digits_that_the_jacobian_has() -> None:
    """Polynomials up to degree 8 on 0...1, badly scaled: the condition of J is 1e9 and that of J'J 1e18."""
    t = np.linspace(0.0, 1.0, 40)
    scale = 10.0 ** np.linspace(-120.0, 120.0, 9)
    j = t[:, None] ** np.arange(9) * scale
    with mpmath.workdps(600):
        a = mpmath.matrix(j.tolist())
        exact = mpmath.inverse(a.T * a)
        expected = [float(mpmath.sqrt(exact[k, k])) for k in range(9)]
    found = inverse_gram(np.stack([j, j * 0.0, np.where(t[:, None] > 0.5, np.nan, j)]))
    np.testing.assert_allclose(np.sqrt(np.diag(found[0])), expected, rtol=1e-9)
    assert np.all(np.isnan(found[1:]))


def test_jacobian_of_a_column_without_a_coefficient() -> None:
    from decays import Decays

    model = Decays(T, 1, drift=True)
    basic = np.array([[0.3, 2.0, 1.1, 0.4], [0.1, 1.0, 0.8, 0.7]])
    h = 1e-5
    for j in range(4):
        step = h * np.eye(4)[j]
        slope = (model.predicted(basic + step) - model.predicted(basic - step)) / (2.0 * h)
        np.testing.assert_allclose(jacobian(model, basic)[:, :, j], slope.T, atol=1e-8)

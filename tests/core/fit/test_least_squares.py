"""The least-squares core where numerics are hard: against mpmath, LAPACK, scipy, and closed forms."""

from __future__ import annotations

import tracemalloc

import mpmath
import numpy as np
import pytest
from decays import Decays, FloatArray, Lines, Square, chi2_of

from gonio.fitting.separable import Rows, project
from gonio.fitting.solve import grid_start, refine

T = np.linspace(0.0, 4.0, 40)
TRUTH = np.array([[0.3, 2.0, 1.1]])


def noisy(model: Decays, basic: FloatArray, m: int, sd: float = 0.01, seed: int = 1) -> FloatArray:
    noise = sd * np.random.default_rng(seed).standard_normal((model.t.size, m))
    return model.predicted(np.broadcast_to(basic, (m, basic.shape[1]))) + noise


def exact_lines(design: FloatArray, y: FloatArray, w: FloatArray) -> FloatArray:
    """Weighted linear least squares with 60 digits."""
    with mpmath.workdps(60):
        a, b = mpmath.matrix(design.tolist()), mpmath.matrix(y.tolist())
        d = mpmath.diag([mpmath.mpf(float(v)) for v in w])
        return np.array([float(v) for v in mpmath.lu_solve(a.T * d * a, a.T * d * b)])


@pytest.mark.parametrize("drift", [False, True])
def test_gradient_and_hessian_of_the_projected_problem(drift: bool) -> None:
    """Differences of chi2 with the coefficients from LAPACK; residuals as large as the readings."""
    model = Decays(T, 2, drift)
    rng = np.random.default_rng(3)
    y, w = rng.standard_normal(40), rng.uniform(0.1, 3.0, 40)
    x = np.array([0.4, 1.7, 0.9])[: 2 + drift]
    rows = Rows.of(y[:, None], w[:, None])
    state = project(model, rows, x[None])
    unit = float((rows.size * rows.heaviest)[0]) ** 2

    def f(at: FloatArray) -> float:
        return chi2_of(model, y, w, at)

    assert unit * state.chi2[0] == pytest.approx(f(x), rel=1e-13)
    h, k = 1e-3, x.size
    e = h * np.eye(k)
    slope = [(8.0 * (f(x + v) - f(x - v)) - f(x + 2.0 * v) + f(x - 2.0 * v)) / (12.0 * h) for v in e]
    np.testing.assert_allclose(2.0 * unit * state.gradient[0], slope, rtol=1e-7, atol=1e-8)

    def mixed(a: FloatArray, b: FloatArray) -> float:
        return (f(x + a + b) - f(x + a - b) - f(x - a + b) + f(x - a - b)) / (4.0 * h * h)

    curve = [[(4.0 * mixed(a, b) - mixed(2.0 * a, 2.0 * b) / 4.0) / 3.0 for b in e] for a in e]
    np.testing.assert_allclose(2.0 * unit * state.hessian[0], curve, rtol=1e-5, atol=1e-5)


def test_newton_steps_double_the_digits_although_residuals_are_large() -> None:
    model = Decays(T)
    y = noisy(model, TRUTH, 1, sd=1.0)
    w = np.ones_like(y)
    best = refine(model, y, w, np.array([[1.0]])).basic[0, 2]
    near = best * 1.03
    errors = [
        abs(refine(model, y, w, np.array([[near]]), iterations=count).basic[0, 2] - best)
        for count in (1, 2, 3)
    ]
    assert errors[0] < 1e-2
    assert errors[1] < 10.0 * errors[0] ** 2 + 1e-12
    assert errors[2] < 10.0 * errors[1] ** 2 + 1e-12


@pytest.mark.parametrize("gap", [1e-4, 1e-7])
def test_nearly_collinear_columns(gap: float) -> None:
    """The columns' condition is 1/gap; a normal matrix has its square, and no digit left at 1e-8."""
    rng = np.random.default_rng(1)
    design = np.stack([np.ones(30), 1.0 + gap * rng.standard_normal(30), rng.standard_normal(30)], axis=1)
    y = design @ [1.0, 2.0, -0.5] + 1e-9 * rng.standard_normal(30)
    found = refine(Lines(design), y[:, None], np.ones((30, 1)), np.zeros((1, 0)))
    np.testing.assert_allclose(found.basic[0], exact_lines(design, y, np.ones(30)), rtol=1e-14 / gap)
    assert found.converged[0]


@pytest.mark.parametrize("same", [0.0, 2.0])
def test_a_column_that_says_nothing_of_its_own_gets_no_coefficient(same: float) -> None:
    rng = np.random.default_rng(2)
    design = rng.standard_normal((30, 2))
    y, w = rng.standard_normal((30, 3)), rng.uniform(0.5, 2.0, (30, 3))
    three = refine(Lines(np.column_stack([design, same * design[:, 0]])), y, w, np.zeros((3, 0)))
    two = refine(Lines(design), y, w, np.zeros((3, 0)))
    np.testing.assert_array_equal(three.basic[:, 2], 0.0)
    np.testing.assert_allclose(three.basic[:, :2], two.basic, rtol=1e-12)
    np.testing.assert_allclose(three.chi2, two.chi2, rtol=1e-12)


def test_weights_over_twelve_decades() -> None:
    rng = np.random.default_rng(4)
    design = np.stack([np.ones(40), T, np.exp(-T)], axis=1)
    w = 10.0 ** rng.uniform(-6.0, 6.0, 40)
    y = design @ [1.0, -2.0, 0.7] + rng.standard_normal(40) / np.sqrt(w)
    found = refine(Lines(design), y[:, None], w[:, None], np.zeros((1, 0)))
    np.testing.assert_allclose(found.basic[0], exact_lines(design, y, w), rtol=1e-10)


def test_weights_over_twelve_decades_with_a_shape() -> None:
    """The gradient vanishes in 50 digits: what is left moves no parameter by 1e-10 of itself."""
    rng = np.random.default_rng(5)
    model = Decays(T)
    w = 10.0 ** rng.uniform(-6.0, 6.0, 40)
    y = model.predicted(TRUTH)[:, 0] + rng.standard_normal(40) / np.sqrt(w)
    found = refine(model, y[:, None], w[:, None], np.array([[0.7]]))
    assert found.converged[0]
    with mpmath.workdps(50):
        t, v, u = ([mpmath.mpf(float(a)) for a in values] for values in (T, y, w))

        def equations(a: object, b: object, c: object) -> list[object]:
            e = [mpmath.exp(-c * s) for s in t]
            r = [p * (q - a - b * d) for p, q, d in zip(u, v, e, strict=True)]
            return [
                sum(r),
                sum(p * q for p, q in zip(r, e, strict=True)),
                sum(p * q * s for p, q, s in zip(r, e, t, strict=True)),
            ]

        root = mpmath.findroot(equations, [mpmath.mpf(float(b)) for b in found.basic[0]])
        np.testing.assert_allclose(found.basic[0], [float(b) for b in root], rtol=1e-10)


@pytest.mark.parametrize("power", [-300, -170, 170, 300])
def test_readings_of_any_size(power: int) -> None:
    """Coefficients scale with the readings; their squares may be too large or too small for a double."""
    model = Decays(T)
    y = noisy(model, TRUTH, 3)
    w = np.ones_like(y)
    plain = refine(model, y, w, np.full((3, 1), 0.5))
    scaled = refine(model, y * 10.0**power, w, np.full((3, 1), 0.5))
    assert np.all(scaled.converged)
    np.testing.assert_allclose(scaled.basic[:, 2], plain.basic[:, 2], rtol=1e-9)
    np.testing.assert_allclose(scaled.basic[:, :2] * 10.0**-power, plain.basic[:, :2], rtol=1e-9)
    np.testing.assert_array_equal(scaled.chi2, 0.0 if power < 0 else np.inf)


def test_a_bound_that_is_active_at_the_optimum() -> None:
    """The parameter rests exactly there, the others are as with it held, and chi2 falls beyond."""
    low, high = np.array([0.05, 1.8]), np.array([0.9, 5.0])
    model = Decays(T, 2, low=low, high=high)
    y = noisy(
        Decays(T, 2), np.array([[0.2, 1.5, 1.0, 0.6, 1.2]]), 6, sd=1e-4
    )  # the second is below its bound
    w = np.ones_like(y)
    found = refine(model, y, w, np.tile([0.3, 3.0], (6, 1)))
    assert np.all(found.converged)
    np.testing.assert_array_equal(found.basic[:, 4], 1.8)
    assert np.all((found.basic[:, 3] > 0.05) & (found.basic[:, 3] < 0.9))
    held = refine(model, y, w, np.tile([0.5, 1.8], (6, 1)), free=(True, False))
    np.testing.assert_allclose(found.basic, held.basic, rtol=1e-8)
    for j in range(6):
        x = found.basic[j, 3:]
        assert chi2_of(model, y[:, j], w[:, j], x - [0.0, 1e-3]) < found.chi2[j]


def test_one_wavelength_is_one_of_ten_thousand() -> None:
    model = Decays(T)
    rng = np.random.default_rng(6)
    m = 10_000
    basic = np.stack([rng.uniform(0.0, 1.0, m), rng.uniform(1.0, 3.0, m), rng.uniform(0.5, 2.0, m)], axis=1)
    y = model.predicted(basic) + 0.01 * rng.standard_normal((40, m))
    w = rng.uniform(0.5, 2.0, (40, m))
    many = refine(model, y, w, np.ones((m, 1)))
    assert np.all(many.converged)
    for j in (0, 1500, 9999):
        one = refine(model, y[:, [j]], w[:, [j]], np.ones((1, 1)))
        np.testing.assert_allclose(one.basic[0], many.basic[j], rtol=1e-9)
        np.testing.assert_allclose(one.chi2[0], many.chi2[j], rtol=1e-12)


def test_memory_does_not_grow_with_the_wavelengths() -> None:
    """Beyond what is returned."""
    model = Decays(T[::4])

    def peak(m: int) -> int:
        y = noisy(model, TRUTH, m)
        w, begin = np.ones_like(y), np.ones((m, 1))
        grid = np.linspace(0.1, 3.0, 50)[:, None]
        tracemalloc.start()
        refine(model, y, w, grid_start(model, y, w, grid))
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size - begin.nbytes

    few, many = peak(15_000), peak(60_000)
    assert many < few + 45_000 * 8 * 6  # start, basic, chi2, converged: not the readings of each


def test_what_is_no_number_stays_where_it_is() -> None:
    model = Decays(T)
    y = noisy(model, TRUTH, 8)
    w, begin = np.ones_like(y), np.full((8, 1), 0.5)
    good = refine(model, y, w, begin)
    bad_y, bad_w, bad_begin = y.copy(), w.copy(), begin.copy()
    bad_y[3, 1], bad_y[3, 2], bad_w[5, 3], bad_w[5, 4] = np.nan, np.inf, np.nan, -1.0
    bad_begin[5] = np.nan
    bad_begin[6] = -1e6  # exp(1e6 t) is no number either
    found = refine(model, bad_y, bad_w, bad_begin)
    np.testing.assert_array_equal(np.isnan(found.basic).all(axis=1), [0, 1, 1, 1, 1, 1, 1, 0])
    np.testing.assert_array_equal(found.converged, [1, 0, 0, 0, 0, 0, 0, 1])
    np.testing.assert_allclose(found.basic[[0, 7]], good.basic[[0, 7]], rtol=1e-9)
    # a reading that is not used may be anything
    bad_w = w.copy()
    bad_y = y.copy()
    bad_y[:5, 2], bad_w[:5, 2] = np.nan, 0.0
    found = refine(model, bad_y, bad_w, begin)
    short = refine(Decays(T[5:]), y[5:, [2]], w[5:, [2]], begin[[2]])
    np.testing.assert_allclose(found.basic[2], short.basic[0], rtol=1e-8)
    # and a wavelength without any is not converged
    bad_w[:, 4] = 0.0
    assert not refine(model, bad_y, bad_w, begin).converged[4]


def test_each_wavelength_holds_its_own() -> None:
    model = Decays(T, 2)
    y = noisy(model, np.array([[0.2, 1.5, 1.0, 0.6, 2.2]]), 4, sd=1e-3)
    w = np.ones_like(y)
    begin = np.tile([0.5, 2.5], (4, 1))
    free = np.array([[True, True], [False, True], [True, False], [False, False]])
    found = refine(model, y, w, begin, free=free)
    assert np.all(found.converged)
    np.testing.assert_array_equal(found.basic[:, 3:][~free], begin[~free])
    for j in range(4):
        one = refine(model, y[:, [j]], w[:, [j]], begin[[j]], free=tuple(free[j]))
        np.testing.assert_allclose(found.basic[j], one.basic[0], rtol=1e-8)
    assert found.chi2[0] < min(found.chi2[1:])


def test_a_saddle_is_left() -> None:
    """At x = 0 the gradient of (1 - x^2)^2 vanishes; it is a maximum."""
    y = np.ones((5, 2))
    found = refine(Square(5), y, np.ones_like(y), np.array([[0.0], [0.3]]))
    assert np.all(found.converged)
    np.testing.assert_allclose(np.abs(found.basic[:, 0]), 1.0, rtol=1e-9)


@pytest.mark.parametrize("drift", [False, True])
def test_a_start_is_the_best_of_its_grid(drift: bool) -> None:
    model = Decays(T, 1, drift)
    rng = np.random.default_rng(7)
    y, w = rng.standard_normal((40, 25)), rng.uniform(0.1, 2.0, (40, 25))
    y[3, 4], w[3, 4] = np.nan, 0.0
    axes = np.meshgrid(np.linspace(0.1, 3.0, 11), np.linspace(0.2, 2.0, 7 if drift else 1), indexing="ij")
    grid = np.stack([a.ravel() for a in axes], axis=1)[:, : 1 + drift]
    found = grid_start(model, y, w, grid)
    for j in range(25):
        use = w[:, j] > 0.0
        part = Decays(T[use], 1, drift)
        chi2 = [chi2_of(part, y[use, j], w[use, j], x) for x in grid]
        np.testing.assert_array_equal(found[j], grid[int(np.argmin(chi2))])


def test_without_second_derivatives_the_optimum_is_the_same() -> None:
    y = noisy(Decays(T, 2), np.array([[0.2, 1.5, 1.0, 0.6, 2.2]]), 5, sd=0.02)
    w = np.ones_like(y)
    begin = np.tile([0.1, 6.0], (5, 1))
    exact = refine(Decays(T, 2), y, w, begin)
    gauss = refine(Decays(T, 2, curved=False), y, w, begin)
    assert np.all(exact.converged & gauss.converged)
    np.testing.assert_allclose(gauss.basic, exact.basic, rtol=1e-7)


def test_too_few_steps_are_no_convergence() -> None:
    y = noisy(Decays(T), TRUTH, 3)
    assert not np.any(refine(Decays(T), y, np.ones_like(y), np.full((3, 1), 8.0), iterations=2).converged)

"""One ordinary nonlinear least-squares problem, and MATLAB's intervals for it.

`least_squares` is the door to the core for a single problem that is no scattering model; `nlparci` gives the
intervals of MATLAB's function of that name from any residuals and Jacobian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from gonio.errors import FitError
from gonio.fitting.columns import Columns
from gonio.fitting.covariance_of import inverse_gram
from gonio.fitting.derivatives import Derivative, Derivatives, derivatives_of
from gonio.fitting.solve import refine, refine_boldly

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Function = Callable[[FloatArray], ArrayLike]


@dataclass(frozen=True, slots=True)
class LeastSquares:
    """Optimum of one problem with n used readings and p parameters.

    Attributes
    ----------
    value, se
        (p,); `se` is NaN where the readings do not determine a parameter beside the others.
    covariance
        ``rss/dof (J'J)^-1``, (p, p).
    rss
        Weighted sum of squared residuals.
    dof
        ``n - p``.
    converged
        Whether nothing is left to win that can be seen.
    residual, jacobian
        Weighted, (n,) and (n, p), of the used readings; as `nlparci` takes them.
    """

    value: FloatArray
    se: FloatArray
    covariance: FloatArray
    rss: float
    dof: int
    converged: bool
    residual: FloatArray
    jacobian: FloatArray

    def intervals(self, alpha: float = 0.05) -> FloatArray:
        """Return `nlparci` of this optimum, (p, 2)."""
        return nlparci(self.value, self.residual, self.jacobian, alpha)


def least_squares(
    function: Function,
    start: ArrayLike,
    jacobian: Function | None = None,
    *,
    y: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    low: ArrayLike | None = None,
    high: ArrayLike | None = None,
) -> LeastSquares:
    """Return the least-squares optimum that is reached from `start`.

    Parameters
    ----------
    function
        Residuals (n,) at parameters (p,); or, with `y`, what the model predicts for y.
    start
        Parameters to begin with, (p,); may be far away.
    jacobian
        Derivatives of `function`, (n, p).  Without it they come from the complex step, exact to rounding,
        where the function takes complex parameters and that agrees with differences; else from differences
        of fourth order.
    y
        Readings (n,); NaN for none, as is a NaN residual at the start.
    weights
        ``1/variance`` of the readings, (n,), up to a common factor; 1 each without it.
    low, high
        Bounds, (p,).

    Raises
    ------
    FitError
        Shapes that do not fit, a start outside the bounds or where the function is no number, no more
        readings than parameters.
    """
    begin = np.atleast_1d(np.asarray(start, np.float64))
    p = begin.size
    bottom, top = _bound(low, -np.inf, p, "low"), _bound(high, np.inf, p, "high")
    if begin.shape != (p,) or not np.all(np.isfinite(begin)):
        raise FitError(f"start = {begin} is not a list of finite numbers; give one for every parameter")
    outside = np.flatnonzero((begin < bottom) | (begin > top))
    if outside.size:
        a = int(outside[0])
        raise FitError(
            f"start[{a}] = {begin[a]:g} is outside its bounds {bottom[a]:g}...{top[a]:g}; start within them"
        )
    target = 0.0 if y is None else np.asarray(y, np.float64)
    with np.errstate(all="ignore"):
        first = np.asarray(function(begin), np.float64) - target
    if first.ndim != 1:
        raise FitError(f"the function returns an array of shape {first.shape}; it must be (n,)")
    w = np.ones(first.size) if weights is None else np.asarray(weights, np.float64)
    if w.shape != first.shape or not np.all(np.isfinite(w) & (w >= 0.0)):
        raise FitError(f"weights must be {first.size} finite numbers, none negative, one for every reading")
    used = ~np.isnan(first) & (w > 0.0)
    n = int(np.sum(used))
    if n <= p:
        raise FitError(
            f"{n} used readings do not determine {p} parameters and their noise; give at least {p + 1}"
        )
    if not np.all(np.isfinite(first[used])):
        raise FitError(f"the function is infinite at start = {begin}; start where it is a number")
    size = float(np.max(np.abs(first[used]))) or 1.0
    root = np.sqrt(w[used])

    def weighted(x: NDArray[np.complex128] | FloatArray) -> NDArray[np.complex128] | FloatArray:
        value = np.asarray(function(x.copy())) - target  # type: ignore[arg-type]
        return np.asarray(root * (value[used] / size))

    def given(x: FloatArray) -> FloatArray:
        assert jacobian is not None
        j = np.asarray(jacobian(x), np.float64)
        if j.shape != (first.size, p):
            raise FitError(
                f"jacobian returns an array of shape {j.shape}; {first.size} readings and {p} parameters "
                f"need {(first.size, p)}"
            )
        return np.asarray(root[:, None] * (j[used] / size))

    none, ones = np.zeros((n, 1)), np.ones((n, 1))
    with np.errstate(all="ignore"):
        by = derivatives_of(weighted, begin) if jacobian is None else Derivatives(given, given)
        model = _Ordinary(weighted, by.rough, bottom, top)
        found = refine_boldly(model, none, ones, begin[None])
        if by.fine is not by.rough and np.all(np.isfinite(found.basic)):
            model = _Ordinary(weighted, by.fine, bottom, top)
            found = refine(model, none, ones, found.basic)
        value = found.basic[0]
        residual, j = np.real(weighted(value)), by.fine(value)
        rss = float(residual @ residual)
        covariance = rss / (n - p) * inverse_gram(j)
        return LeastSquares(
            value,
            np.sqrt(np.diag(covariance)),
            covariance,
            rss * size * size,
            n - p,
            bool(found.converged[0]),
            size * residual,
            size * j,
        )


def nlparci(value: ArrayLike, residual: ArrayLike, jacobian: ArrayLike, alpha: float = 0.05) -> FloatArray:
    """Return the ``1 - alpha`` intervals of MATLAB's nlparci, (p, 2).

    With v = n - p, s^2 = |residual|^2 / v and J = Q R: ``value ± t(1 - alpha/2, v) s sqrt(diag(R^-1 R^-T))``.
    Readings with a NaN residual are dropped with their row of the Jacobian; bounds play no part.

    Parameters
    ----------
    value
        Parameters, (p,).
    residual
        (n,)
    jacobian
        (n, p)

    Raises
    ------
    FitError
        Shapes that do not fit, no more readings than parameters, or a Jacobian whose columns are one
        another's combination to working precision: the intervals would be infinite.
    """
    beta, r = (
        np.atleast_1d(np.asarray(value, np.float64)),
        np.atleast_1d(np.asarray(residual, np.float64)).ravel(),
    )
    j = np.asarray(jacobian, np.float64)
    p = beta.size
    if beta.ndim != 1 or j.shape != (r.size, p):
        raise FitError(
            f"{r.size} residuals and {p} parameters need a Jacobian of shape {(r.size, p)}, not {j.shape}"
        )
    if not 0.0 < alpha < 1.0:
        raise FitError(f"alpha = {alpha:g} is not between 0 and 1; 0.05 gives intervals of 95 %")
    keep = ~np.isnan(r)
    r, j = r[keep], j[keep]
    v = r.size - p
    if v <= 0:
        raise FitError(
            f"{r.size} residuals that are numbers leave no degree of freedom beside {p} parameters"
        )
    if not (np.all(np.isfinite(j)) and np.all(np.isfinite(r))):
        raise FitError(
            "the Jacobian or a residual is not finite in a row that is used; drop it by a NaN residual"
        )
    unit = float(np.max(np.abs(j))) or 1.0
    inverse = inverse_gram(j / unit)
    if not np.all(np.isfinite(inverse)):
        flat = np.flatnonzero(~np.any(j != 0.0, axis=0))
        why = f"no residual depends on parameter {int(flat[0]) + 1}" if flat.size else _dependence(j)
        raise FitError(f"the Jacobian has a rank below {p}: {why}; fix or leave out a parameter")
    largest = float(np.max(np.abs(r))) or 1.0
    s = largest / unit * np.sqrt(np.sum((r / largest) ** 2) / v)
    half = float(special.stdtrit(v, 1.0 - 0.5 * alpha)) * s * np.sqrt(np.diag(inverse))
    return np.stack([beta - half, beta + half], axis=1)


def _dependence(j: FloatArray) -> str:
    """Name the parameters whose columns cancel in a rank-deficient Jacobian."""
    unit = j / np.max(np.abs(j), axis=0)
    direction = np.abs(np.linalg.svd(unit)[2][-1])
    names = ", ".join(str(int(a) + 1) for a in np.flatnonzero(direction > 0.1 * direction.max()))
    return f"parameters {names} have the same effect together"


def _bound(values: ArrayLike | None, default: float, p: int, name: str) -> FloatArray:
    if values is None:
        return np.full(p, default)
    bound = np.atleast_1d(np.asarray(values, np.float64))
    if bound.shape != (p,) or np.any(np.isnan(bound)):
        raise FitError(
            f"{name} = {bound} does not bound {p} parameters; give one number each, infinite for none"
        )
    return bound


@dataclass(frozen=True, slots=True)
class _Ordinary:
    """`gonio.fitting.separable.Separable` without linear coefficients: one column, the residuals."""

    function: Callable[[FloatArray], NDArray[np.complex128] | FloatArray]
    derivative: Derivative
    low: FloatArray
    high: FloatArray
    linear: tuple[str, ...] = ()

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        value = np.stack([np.real(self.function(row)) for row in x], axis=1)
        if order == 0:
            return Columns((value,))
        j = np.stack([self.derivative(row) for row in x], axis=1)
        return Columns((value,), (tuple(j[:, :, a] for a in range(x.shape[1])),))

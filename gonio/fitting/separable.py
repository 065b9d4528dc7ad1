"""What is chi2 with the linear coefficients eliminated?  Value, gradient and Hessian in the nonlinear ones.

    chi2(x) = min over c of  sum_i w_i (y_i - g_i(x) - sum_l c_l Phi_l,i(x))^2

**Variable projection** (Golub & Pereyra, Inverse Problems 19 (2003) R1).  With weights taken into the rows,
Phi = Q R by Gram-Schmidt, twice where digits are lost, which is as good as Householder's (Giraud et al.,
Numer. Math. 101 (2005) 87); r the residual, J_a = dg/dx_a + sum_l c_l dPhi_l/dx_a, and

    u_a = Q'J_a,   z_a = J_a - Q u_a,   v_a = R^-T (dPhi_l/dx_a ' r)_l,   k_ab = r'(d2g + sum_l c_l d2Phi_l),

the derivative of the projected residual is -(z_a + Q v_a), so that half of chi2 has

    gradient  -z_a'r,      Hessian  z_a'z_b + u_a'v_b + v_a'u_b - v_a'v_b - k_ab  (exact),

and z_a'z_b + v_a'v_b is the Hessian of Gauss and Newton, used where second derivatives are not given.  No
normal matrix is formed of anything that may be ill-conditioned: z = Q_z R_z, and steps are solved with R_z.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.columns import Columns

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

_LOST = 1e-12  # a column that keeps less than this of its norm beside the others is one of them, and rounding
_BEND = 1e-12  # of the second derivative: a squared slope below this is zero beside it
_TWICE = 1e-2  # of its square: a column that loses more to the others is orthogonalised again
_EPS = float(np.finfo(float).eps)


class Separable(Protocol):
    """What the least-squares core asks of a model; every `gonio.fitting.columns.FitModel` gives it."""

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the L linear coefficients, may be empty."""
        ...

    @property
    def low(self) -> FloatArray:
        """Lower bounds of the k nonlinear parameters, (k,), -inf for none."""
        ...

    @property
    def high(self) -> FloatArray:
        """Upper bounds, (k,), +inf for none."""
        ...

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        """Return the columns at x (m, k); second derivatives may be left out at any order.

        One column more than there are names enters as it is, with the coefficient 1.
        """
        ...


@dataclass(frozen=True, slots=True)
class Rows:
    """Readings of m problems in units of their size, so that squares neither overflow nor vanish.

    Attributes
    ----------
    root
        Square roots of the weights over their largest, (n, m).
    target
        ``root * y / size``, (n, m).
    size
        Largest weighted reading of each problem, in units of y, (m,).
    heaviest
        Largest square root of a weight, (m,).
    known
        Where every used reading and every weight is a number, (m,).
    """

    root: FloatArray
    target: FloatArray
    size: FloatArray
    heaviest: FloatArray
    known: NDArray[np.bool_]

    @classmethod
    def of(cls, y: FloatArray, w: FloatArray) -> Rows:
        """Return readings and weights, (n, m) each, as the solver wants them; y is free where w is 0."""
        used = w != 0.0
        known = np.all(np.isfinite(w) & (w >= 0.0) & (np.isfinite(y) | ~used), axis=0)
        used &= known
        root = np.sqrt(np.where(used, w, 0.0))
        heaviest = np.max(root, axis=0, initial=0.0)
        heaviest = np.where(heaviest > 0.0, heaviest, 1.0)
        root /= heaviest
        target = root * np.where(used, y, 0.0)
        size = np.max(np.abs(target), axis=0, initial=0.0)
        size = np.where(size > 0.0, size, 1.0)
        return cls(root, target / size, size, heaviest, known)

    def of_problems(self, pick: IndexArray) -> Rows:
        """Return the part of some problems."""
        return Rows(
            self.root[:, pick], self.target[:, pick], self.size[pick], self.heaviest[pick], self.known[pick]
        )


@dataclass(slots=True)
class Projected:
    """Half of chi2 at one x of each of m problems, in the units of `Rows`; `exact` says if `hessian` is.

    Attributes
    ----------
    coefficients
        The linear coefficients that belong to x, (m, L), in units of `Rows.size`; 0 for a column that is the
        others' combination.
    chi2
        (m,); inf where the model gave no number.
    factor, right
        (m, k + L, k) and (m, k + L): the step of Gauss and Newton minimises ``|factor s - right|``.
    gradient, hessian
        (m, k), (m, k, k) of half of chi2.
    scale
        (m, k): norm of the change of the readings and of their fit by one unit of each x, the unit of steps.
    floor
        (m,): what chi2 would be if only rounding of the readings, of the model and of x were left.
    exact
        Whether `hessian` holds second derivatives.
    """

    coefficients: FloatArray
    chi2: FloatArray
    factor: FloatArray
    right: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    scale: FloatArray
    floor: FloatArray
    exact: bool

    def of(self, pick: IndexArray) -> Projected:
        """Return the part of some problems."""
        arrays = {name: getattr(self, name)[pick] for name in _ARRAYS}
        return replace(self, **arrays)

    def put(self, pick: IndexArray, other: Projected, rows: IndexArray) -> None:
        """Replace problems `pick` by problems `rows` of another."""
        for name in _ARRAYS:
            getattr(self, name)[pick] = getattr(other, name)[rows]


_ARRAYS = ("coefficients", "chi2", "factor", "right", "gradient", "hessian", "scale", "floor")


def settle(model: Separable, rows: Rows, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the linear coefficients (m, L) and half of chi2 (m,) at x, inf where there is no number."""
    best = _eliminate(model.columns(x), rows, len(model.linear))
    chi2 = _inner(best.residual, best.residual)
    lost = ~(np.isfinite(chi2) & np.all(np.isfinite(best.c), axis=1))
    best.c[lost], chi2[lost] = 0.0, np.inf
    return best.c, chi2


@dataclass(frozen=True, slots=True)
class _Eliminated:
    q: list[FloatArray]
    r: FloatArray
    residual: FloatArray
    c: FloatArray
    size2: FloatArray  # of the readings, and of what the column without a coefficient leaves of them


def _eliminate(at: Columns, rows: Rows, count: int) -> _Eliminated:
    root, target = rows.root, rows.target
    q, r = _extend([], [root * column for column in at.value[:count]], target.shape[1])
    size2 = _inner(target, target)
    rest = target.copy()
    if len(at.value) > count:
        rest -= root * at.value[count] / rows.size
        size2 += _inner(rest, rest)
    residual, z = _project_out(q, rest)
    return _Eliminated(q, r, residual, _solve_upper(r, z), size2)


def project(model: Separable, rows: Rows, x: FloatArray) -> Projected:
    """Return half of chi2 with its derivatives at x, (m, k)."""
    count, (m, k) = len(model.linear), x.shape
    at = model.columns(x, 2)
    exact = bool(at.second) or k == 0
    best = _eliminate(at, rows, count)
    root, residual, c = rows.root, best.residual, best.c
    per = [c[:, j] for j in range(count)] + [1.0 / rows.size] * (len(at.value) - count)
    weighted = root * residual
    # what moves with each x: J_a, and the derivatives of the columns along the residual
    moved: list[FloatArray] = []
    along = np.zeros((m, count, k))
    for a in range(k):
        change: FloatArray | float = 0.0
        for j, slopes in enumerate(at.first):
            slope = slopes[a]
            if slope is not None:
                change = change + per[j] * slope
                if j < count:
                    along[:, j, a] = _inner(weighted, slope)
        moved.append(root * change)
    v = _solve_lower(best.r, along)
    every, upper = _extend(best.q, moved, m)
    u, rz = upper[:, :count], upper[:, count:]
    scale = np.sqrt(np.sum(upper**2, axis=1) + np.sum(v**2, axis=1))
    b = np.zeros((m, k))
    for a, axis in enumerate(every[count:]):
        b[:, a] = _inner(axis, residual)
    factor = np.concatenate([rz, v], axis=1)
    hessian = np.swapaxes(factor, 1, 2) @ factor
    if exact:
        mixed = np.swapaxes(u - v, 1, 2) @ v
        curvature = _curvature(at, per, weighted, k)
        hessian += mixed + np.swapaxes(mixed, 1, 2) - curvature
        # at a saddle the readings may depend on x in second order alone
        bend = np.abs(np.diagonal(curvature, axis1=1, axis2=2))
        scale = np.where(scale**2 > _BEND * bend, scale, np.sqrt(bend))
    state = Projected(
        c,
        _inner(residual, residual),
        factor,
        np.concatenate([b, np.zeros((m, count))], axis=1),
        -(np.swapaxes(rz, 1, 2) @ b[:, :, None])[:, :, 0],
        hessian,
        scale,
        (10.0 * _EPS) ** 2 * np.maximum(best.size2, np.max((scale * x) ** 2, axis=1, initial=0.0)),
        exact,
    )
    _fence(state)
    return state


def _curvature(at: Columns, per: list[FloatArray], weighted: FloatArray, k: int) -> FloatArray:
    """Return k_ab, (m, k, k), from the weighted residual (n, m)."""
    result = np.zeros((weighted.shape[1], k, k))
    for a in range(k):
        for b in range(a + 1):
            for c, columns in zip(per, at.second, strict=True):
                column = columns[a][b]
                if column is not None:
                    result[:, a, b] += c * _inner(weighted, column)
            result[:, b, a] = result[:, a, b]
    return result


def _fence(state: Projected) -> None:
    """Give problems without a number chi2 = inf and nothing to move, so that no other one notices."""
    finite = np.isfinite(state.chi2)
    for name in _ARRAYS:
        array = getattr(state, name)
        finite &= np.all(np.isfinite(array.reshape(len(array), -1)), axis=1)
    if np.all(finite):
        return
    for name in _ARRAYS:
        getattr(state, name)[~finite] = 0.0
    state.chi2[~finite] = np.inf


def _inner(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the inner product over the positions, (m,), of (n, m) with (n, m) or (n, 1)."""
    if b.shape[1] != a.shape[1]:
        return np.asarray(b[:, 0] @ a)
    return np.asarray(np.einsum("nm,nm->m", a, b))


def _project_out(q: list[FloatArray], column: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Take the part along orthonormal q out of a column (n, m), in place; return both, (m, len(q)) the part.

    A second pass where the first took away nearly all restores the digits that it lost.
    """
    part = np.zeros((column.shape[1], len(q)))
    if not q:
        return column, part
    scratch = np.empty_like(column)
    for again in (False, True):
        for j, axis in enumerate(q):
            along = _inner(column, axis)
            np.multiply(axis, along, out=scratch)
            np.subtract(column, scratch, out=column)
            part[:, j] += along
        if not again and not np.any(_inner(column, column) < _TWICE * np.sum(part**2, axis=1)):
            break
    return column, part


def _extend(q: list[FloatArray], columns: list[FloatArray], m: int) -> tuple[list[FloatArray], FloatArray]:
    """Return orthonormal columns that begin with q, and R (m, len(q) + len(columns), len(columns)).

    A column that depends on those before it becomes 0.  The columns are overwritten.
    """
    every = list(q)
    r = np.zeros((m, len(q) + len(columns), len(columns)))
    for j, column in enumerate(columns):
        at = len(every)
        rest, r[:, :at, j] = _project_out(every, column)
        norm = _inner(rest, rest)
        norm = np.where(norm > _LOST**2 * (norm + np.sum(r[:, :at, j] ** 2, axis=1)), np.sqrt(norm), 0.0)
        r[:, at, j] = norm
        rest *= np.where(norm > 0.0, 1.0 / np.where(norm > 0.0, norm, 1.0), 0.0)
        every.append(rest)
    return every, r


def _solve_upper(r: FloatArray, z: FloatArray) -> FloatArray:
    """Return c with R c = z, (m, L); 0 for a column without a pivot."""
    c = np.zeros_like(z)
    for j in range(z.shape[1] - 1, -1, -1):
        pivot = r[:, j, j]
        rest = z[:, j] - np.sum(r[:, j, j + 1 :] * c[:, j + 1 :], axis=1)
        c[:, j] = np.where(pivot > 0.0, rest / np.where(pivot > 0.0, pivot, 1.0), 0.0)
    return c


def _solve_lower(r: FloatArray, right: FloatArray) -> FloatArray:
    """Return v with R'v = right, (m, L, k); 0 for a column without a pivot."""
    v = np.zeros_like(right)
    for j in range(right.shape[1]):
        pivot = r[:, j, j, None]
        rest = right[:, j] - np.sum(r[:, :j, j, None] * v[:, :j], axis=1)
        v[:, j] = np.where(pivot > 0.0, rest / np.where(pivot > 0.0, pivot, 1.0), 0.0)
    return v

"""What can be asked of a fitted surface, as a function of the fit's basic parameters ``(*c, *x)``?

Every quantity of interest is of one of two kinds.  A **strength** is linear in the coefficients c, with
factors that depend on the shape x: rho_s = k_n / R(0, n2), k_g = rho_d + k_n q(n2) F(alpha).  A **shape** is
a monotonic function of one shape parameter: alpha = exp(log_alpha), n2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.errors import FitError
from gonio.fitting.columns import FitModel
from gonio.fitting.kinds import coefficients

FloatArray = NDArray[np.float64]

_STEP = 1e-4  # of derivatives by a shape parameter; leaves 1e-8 of the first and of the second
_PARTS: dict[str, tuple[int, ...]] = {
    "k_d": (0,), "k_s": (1,), "k_g": (0, 1), "k_s_published": (2,), "k_g_published": (0, 2),
}  # fmt: skip
COEFFICIENTS = tuple(_PARTS)


@dataclass(frozen=True, slots=True)
class Quantity:
    """A strength (`shape` is None) or a function of the shape parameter number `shape`."""

    name: str
    kind: type[FitModel]
    of: Callable[[FloatArray], FloatArray]
    """``basic (m, p) -> (m,)``, of finite parameters."""
    shape: int | None

    def slopes(self, basic: FloatArray) -> FloatArray:
        """Return the derivatives by the basic parameters, (m, p)."""
        count = len(self.kind.linear)
        result = np.empty(basic.shape)
        if self.shape is not None:
            result[:] = 0.0
        else:
            result[:, :count] = self.factors(basic[:, count:])
        step = self._steps(basic[:, count:])
        for a in range(len(self.kind.shape)):
            up, down = basic.copy(), basic.copy()
            up[:, count + a] += step[:, a]
            down[:, count + a] -= step[:, a]
            result[:, count + a] = (self.of(up) - self.of(down)) / (2.0 * step[:, a])
        return result

    def factors(self, x: FloatArray) -> FloatArray:
        """Return the factors a of a strength ``a(x)'c``, (m, L), at x (m, k)."""
        count, m = len(self.kind.linear), len(x)
        units = np.zeros((count, m, count))
        units[np.arange(count), :, np.arange(count)] = 1.0
        basic = np.concatenate([units, np.broadcast_to(x, (count, *x.shape))], axis=2)
        return self.of(basic.reshape(count * m, -1)).reshape(count, m).T

    def factor_slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return `factors` (m, L) with first and second derivatives, (m, L, k) and (m, L, k, k)."""
        m, k = x.shape
        step = self._steps(x)
        moves = [np.zeros(k)]
        for a in range(k):
            moves += [sign * np.eye(k)[a] for sign in (1.0, -1.0)]
        for a in range(k):
            for b in range(a):
                moves += [s * np.eye(k)[a] + t * np.eye(k)[b] for s in (1.0, -1.0) for t in (1.0, -1.0)]
        points = x + np.stack(moves)[:, None, :] * step
        at = self.factors(points.reshape(len(moves) * m, k)).reshape(len(moves), m, -1)
        first, second = np.zeros((*at.shape[1:], k)), np.zeros((*at.shape[1:], k, k))
        for a in range(k):
            up, down = at[1 + 2 * a], at[2 + 2 * a]
            first[:, :, a] = (up - down) / (2.0 * step[:, a, None])
            second[:, :, a, a] = (up - 2.0 * at[0] + down) / step[:, a, None] ** 2
        corner = 1 + 2 * k
        for a in range(k):
            for b in range(a):
                pp, pm, mp, mm = at[corner : corner + 4]
                mixed = (pp - pm - mp + mm) / (4.0 * step[:, a] * step[:, b])[:, None]
                second[:, :, a, b] = second[:, :, b, a] = mixed
                corner += 4
        return at[0], first, second

    def _steps(self, x: FloatArray) -> FloatArray:
        """Return the steps of derivatives, (m, k): an index is never stepped below 1."""
        step = np.full(x.shape, _STEP)
        for a, name in enumerate(self.kind.shape):
            if name == "n2":
                step[:, a] = _STEP * (x[:, a] - 1.0)
        return step


def quantity_named(kind: type[FitModel], name: str, theta_i_deg: float = 8.0) -> Quantity:
    """Return a quantity by name.

    Parameters
    ----------
    name
        A parameter of the model, known (rho_s, alpha) or basic (k_n, log_alpha), or a hemispherical
        coefficient: k_d, k_s, k_g, k_s_published, k_g_published.
    theta_i_deg
        Incidence of a coefficient.

    Raises
    ------
    FitError
        An unknown name, or a parameter that is neither a strength nor a shape.
    """
    basic_names = (*kind.linear, *kind.shape)
    if name in _PARTS:
        parts = list(_PARTS[name])
        return Quantity(
            name, kind, lambda basic: np.sum(coefficients(kind, basic, theta_i_deg)[parts], axis=0), None
        )
    if name in kind.parameters:
        column = kind.parameters.index(name)
        return _classified(name, kind, lambda basic: kind.published(basic)[:, column])
    if name in basic_names:
        at = basic_names.index(name)
        return Quantity(
            name, kind, lambda basic: basic[:, at], None if at < len(kind.linear) else at - len(kind.linear)
        )
    known = ", ".join(dict.fromkeys((*kind.parameters, *basic_names, *_PARTS)))
    raise FitError(f"{name!r} is no quantity of model '{kind.name}'; use one of {known}")


def _classified(name: str, kind: type[FitModel], of: Callable[[FloatArray], FloatArray]) -> Quantity:
    """Tell a strength from a shape by what it depends on."""
    count, k = len(kind.linear), len(kind.shape)
    middle = np.concatenate([np.full(count, 0.3), 0.6 * np.asarray(kind.low) + 0.4 * np.asarray(kind.high)])
    doubled = middle.copy()
    doubled[:count] *= 2.0
    one, two = of(np.stack([middle, doubled]))
    if np.isclose(two, 2.0 * one, rtol=1e-9):
        return Quantity(name, kind, of, None)
    moved = np.repeat(middle[None], k, axis=0)
    for a in range(k):
        moved[a, count + a] = 0.5 * (kind.low[a] + kind.high[a])
    depends = np.flatnonzero(of(moved) != one) if k else np.zeros(0, np.intp)
    if two == one and depends.size == 1:
        return Quantity(name, kind, of, int(depends[0]))
    raise FitError(
        f"{name} of model '{kind.name}' depends on strengths and shapes in a way that has no profile; "
        f"ask for one of {', '.join((*kind.linear, *kind.shape))}"
    )

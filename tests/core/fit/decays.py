"""Small separable models whose every derivative is plain to see, for the tests of the least-squares core."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.columns import Columns

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Decays:
    """``c_0 + c_1 exp(-x_0 t) + ...``, and with `drift` a column ``sin(x_last t)`` without a coefficient."""

    t: FloatArray
    count: int = 1
    drift: bool = False
    curved: bool = True
    low: FloatArray = field(default_factory=lambda: np.array([]))
    high: FloatArray = field(default_factory=lambda: np.array([]))

    def __post_init__(self) -> None:
        k = self.count + self.drift
        if not self.low.size:
            object.__setattr__(self, "low", np.full(k, -np.inf))
            object.__setattr__(self, "high", np.full(k, np.inf))

    @property
    def linear(self) -> tuple[str, ...]:
        return tuple(f"c{j}" for j in range(self.count + 1))

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        t, k = self.t[:, None], x.shape[1]
        e = [np.exp(-x[:, a] * t) for a in range(self.count)]
        value = [np.ones_like(t), *e]
        none: list[FloatArray | None] = [None] * k
        first, second = [list(none)], [[list(none) for _ in range(k)]]
        for a in range(self.count):
            first.append([-t * e[a] if b == a else None for b in range(k)])
            second.append([[t**2 * e[a] if b == c == a else None for c in range(k)] for b in range(k)])
        if self.drift:
            s = x[:, -1] * t
            value.append(np.sin(s))
            first.append([*none[:-1], t * np.cos(s)])
            last = [list(none) for _ in range(k)]
            last[-1][-1] = -(t**2) * np.sin(s)
            second.append(last)
        return Columns(
            tuple(value),
            tuple(tuple(column) for column in first) if order > 0 else (),
            tuple(tuple(tuple(row) for row in column) for column in second)
            if order > 1 and self.curved
            else (),
        )

    def predicted(self, basic: FloatArray) -> FloatArray:
        """Return (n, m) at basic parameters (m, p)."""
        value = self.columns(basic[:, self.count + 1 :]).value
        c = [basic[:, j] for j in range(self.count + 1)] + [np.ones(len(basic))] * self.drift
        return np.asarray(sum(a * b for a, b in zip(c, value, strict=True)))


def chi2_of(model: Decays, y: FloatArray, w: FloatArray, x: FloatArray) -> float:
    """Return chi2 at x (k,) of one problem (n,), linear coefficients by LAPACK."""
    columns = [c[:, 0] * np.ones_like(y) for c in model.columns(x[None]).value]
    root = np.sqrt(w)
    rest = root * (y - (columns.pop() if model.drift else 0.0))
    a = np.stack(columns, axis=1) * root[:, None]
    return float(np.sum((rest - a @ np.linalg.lstsq(a, rest, rcond=None)[0]) ** 2))


@dataclass(frozen=True)
class Lines:
    """Given columns (n, L) and nothing to search for."""

    design: FloatArray
    low: FloatArray = field(default_factory=lambda: np.zeros(0))
    high: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def linear(self) -> tuple[str, ...]:
        return tuple(f"c{j}" for j in range(self.design.shape[1]))

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        value = tuple(c[:, None] for c in self.design.T)
        none: tuple[tuple[None, ...], ...] = ((),) * len(value)
        return Columns(value, none if order > 0 else (), none if order > 1 else ())


@dataclass(frozen=True)
class Square:
    """``x^2`` at every one of n positions: at x = 0 the readings depend on x in second order alone."""

    n: int
    linear: tuple[str, ...] = ()
    low: FloatArray = field(default_factory=lambda: np.full(1, -np.inf))
    high: FloatArray = field(default_factory=lambda: np.full(1, np.inf))

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        one = np.ones((self.n, 1))
        return Columns(
            (one * x[:, 0] ** 2,),
            ((one * 2.0 * x[:, 0],),) if order > 0 else (),
            (((one * 2.0 * np.ones(len(x)),),),) if order > 1 else (),
        )

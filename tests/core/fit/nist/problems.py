"""The 27 nonlinear problems of NIST's Statistical Reference Datasets, for the least-squares core.

`strd.toml` holds readings, starts and certified values; here are the models, each once as it is printed.  A
problem that is linear in some parameters becomes a separable one by its own formula: the column of such a
parameter is what the model changes by when it goes from 0 to 1.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.columns import Columns

FloatArray = NDArray[np.float64]
Formula = Callable[[Any, Any], Any]

_STEP = 1e-30  # of the imaginary direction: the derivative is exact
_CURVE = 1e-5  # relative step of second derivatives, which only lead the way


def _gauss(b: Any, x: Any) -> Any:
    return (
        b[0] * np.exp(-b[1] * x)
        + b[2] * np.exp(-(((x - b[3]) / b[4]) ** 2))
        + b[5] * np.exp(-(((x - b[6]) / b[7]) ** 2))
    )


def _lanczos(b: Any, x: Any) -> Any:
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x)


def _rational(b: Any, x: Any) -> Any:
    above = b[0] + x * (b[1] + x * (b[2] + x * b[3]))
    return above / (1.0 + x * (b[4] + x * (b[5] + x * b[6])))


def _enso(b: Any, x: Any) -> Any:
    year, second, third = 2.0 * np.pi * x / 12.0, 2.0 * np.pi * x / b[3], 2.0 * np.pi * x / b[6]
    result = b[0] + b[1] * np.cos(year) + b[2] * np.sin(year)
    result = result + b[4] * np.cos(second) + b[5] * np.sin(second)
    return result + b[7] * np.cos(third) + b[8] * np.sin(third)


_MODELS: dict[str, tuple[Formula, tuple[int, ...]]] = {
    "Bennett5": (lambda b, x: b[0] * (b[1] + x) ** (-1.0 / b[2]), (0,)),
    "BoxBOD": (lambda b, x: b[0] * (1.0 - np.exp(-b[1] * x)), (0,)),
    "Chwirut1": (lambda b, x: np.exp(-b[0] * x) / (b[1] + b[2] * x), ()),
    "Chwirut2": (lambda b, x: np.exp(-b[0] * x) / (b[1] + b[2] * x), ()),
    "DanWood": (lambda b, x: b[0] * x ** b[1], (0,)),
    "ENSO": (_enso, (0, 1, 2, 4, 5, 7, 8)),
    "Eckerle4": (lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2), (0,)),
    "Gauss1": (_gauss, (0, 2, 5)),
    "Gauss2": (_gauss, (0, 2, 5)),
    "Gauss3": (_gauss, (0, 2, 5)),
    "Hahn1": (_rational, (0, 1, 2, 3)),
    "Kirby2": (
        lambda b, x: (b[0] + x * (b[1] + x * b[2])) / (1.0 + x * (b[3] + x * b[4])),
        (0, 1, 2),
    ),
    "Lanczos1": (_lanczos, (0, 2, 4)),
    "Lanczos2": (_lanczos, (0, 2, 4)),
    "Lanczos3": (_lanczos, (0, 2, 4)),
    "MGH09": (lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]), (0,)),
    "MGH10": (lambda b, x: b[0] * np.exp(b[1] / (x + b[2])), (0,)),
    "MGH17": (lambda b, x: b[0] + b[1] * np.exp(-x * b[3]) + b[2] * np.exp(-x * b[4]), (0, 1, 2)),
    "Misra1a": (lambda b, x: b[0] * (1.0 - np.exp(-b[1] * x)), (0,)),
    "Misra1b": (lambda b, x: b[0] * (1.0 - (1.0 + b[1] * x / 2.0) ** -2.0), (0,)),
    "Misra1c": (lambda b, x: b[0] * (1.0 - (1.0 + 2.0 * b[1] * x) ** -0.5), (0,)),
    "Misra1d": (lambda b, x: b[0] * b[1] * x / (1.0 + b[1] * x), (0,)),
    "Nelson": (lambda b, x: b[0] - b[1] * x[0] * np.exp(-b[2] * x[1]), (0, 1)),  # of log(y)
    "Rat42": (lambda b, x: b[0] / (1.0 + np.exp(b[1] - b[2] * x)), (0,)),
    "Rat43": (lambda b, x: b[0] / (1.0 + np.exp(b[1] - b[2] * x)) ** (1.0 / b[3]), (0,)),
    "Roszman1": (lambda b, x: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi, (0, 1)),
    "Thurber": (_rational, (0, 1, 2, 3)),
}


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem: ``y = formula(b, x) + error``; `linear` are the parameters that enter linearly."""

    name: str
    difficulty: str
    formula: Formula
    linear: tuple[int, ...]
    x: FloatArray
    y: FloatArray
    starts: tuple[FloatArray, FloatArray]
    value: FloatArray
    se: FloatArray
    rss: float

    def predicted(self, b: Sequence[Any]) -> Any:
        return self.formula(b, self.x)

    def jacobian(self, b: FloatArray) -> FloatArray:
        """Return (n, p), by complex step."""
        steps = np.asarray(b) + 1j * _STEP * np.eye(len(b))
        return np.stack([self.predicted(s).imag / _STEP for s in steps], axis=1)


@cache
def problems() -> dict[str, Problem]:
    with (Path(__file__).parent / "strd.toml").open("rb") as file:
        data = tomllib.load(file)
    result = {}
    for name, d in data.items():
        formula, linear = _MODELS[name]
        y = np.array(d["y"])
        result[name] = Problem(
            name,
            d["difficulty"],
            formula,
            linear,
            np.array(d["x"]),
            np.log(y) if name == "Nelson" else y,
            (np.array(d["start_1"]), np.array(d["start_2"])),
            np.array(d["value"]),
            np.array(d["se"]),
            d["rss"],
        )
    return result


@dataclass(frozen=True, slots=True)
class Separated:
    """A problem as `gonio.fitting.separable.Separable`: some parameters eliminated, or none."""

    problem: Problem
    eliminated: tuple[int, ...]
    curved: bool = True  # second derivatives too

    @property
    def low(self) -> FloatArray:
        return -self.high

    @property
    def high(self) -> FloatArray:
        return np.full(len(self.nonlinear), np.inf)

    @property
    def linear(self) -> tuple[str, ...]:
        return tuple(f"b{j + 1}" for j in self.eliminated)

    @property
    def nonlinear(self) -> tuple[int, ...]:
        return tuple(j for j in range(len(self.problem.value)) if j not in self.eliminated)

    @property
    def order(self) -> tuple[int, ...]:
        """Where each of the core's basic parameters stands among b1, b2, ..."""
        return (*self.eliminated, *self.nonlinear)

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        k = x.shape[1]
        value = self._parts(list(x.T))
        if order == 0:
            return Columns(value)
        first = [self._slopes(x, a) for a in range(k)]
        by_column = tuple(tuple(first[a][j] for a in range(k)) for j in range(len(value)))
        if order == 1 or not self.curved:
            return Columns(value, by_column)
        second: list[list[Any]] = [[None] * k for _ in range(k)]
        for b in range(k):
            h = np.zeros_like(x)
            h[:, b] = _CURVE * np.maximum(np.abs(x[:, b]), 1e-6)
            for a in range(k):
                up, down = self._slopes(x + h, a), self._slopes(x - h, a)
                second[a][b] = [(u - v) / (2.0 * h[:, b]) for u, v in zip(up, down, strict=True)]
        curves = tuple(
            tuple(tuple(0.5 * (second[a][b][j] + second[b][a][j]) for b in range(k)) for a in range(k))
            for j in range(len(value))
        )
        return Columns(value, by_column, curves)

    def _slopes(self, x: FloatArray, a: int) -> list[FloatArray]:
        stepped = [*x.T.astype(np.complex128)]
        stepped[a] = stepped[a] + 1j * _STEP
        return [part.imag / _STEP for part in self._parts(stepped)]

    def _parts(self, theta: list[Any]) -> tuple[Any, ...]:
        """Return a column (n, m) for every eliminated parameter, and what is left without them."""
        m = theta[0].shape[0]
        at = self.problem.x[..., None]
        b: list[Any] = [0.0] * len(self.problem.value)
        for j, t in zip(self.nonlinear, theta, strict=True):
            b[j] = t
        shape = (self.problem.y.size, m)
        rest = np.broadcast_to(self.problem.formula(b, at), shape)
        parts = []
        for j in self.eliminated:
            b[j] = 1.0
            parts.append(np.broadcast_to(self.problem.formula(b, at), shape) - rest)
            b[j] = 0.0
        return (*parts, rest)

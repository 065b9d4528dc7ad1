"""What are the derivatives of a function that comes without them?

The complex step where it can be proven, which is exact to rounding; else differences: of fourth order on the
way, and Ridders' extrapolation where the last digits count (C. J. F. Ridders, Adv. Eng. Softw. 4 (1982) 75).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Derivative = Callable[[FloatArray], FloatArray]
"""Jacobian (n, p) at x (p,)."""
Vector = Callable[[FloatArray | ComplexArray], FloatArray | ComplexArray]
"""Values (n,) at x (p,)."""

_TINY = 1e-30  # of x: no difference is formed, so nothing is lost
_WIDE = 7e-4  # of x: the fifth root of the rounding, where the errors of fourth-order differences are least
_WIDEST = 0.02  # of x: the first of the steps that are extrapolated
_LEVELS = 9  # of them, each half the one before
_LEAST = 1e-3  # of the start: x may pass through zero
_ALIKE = 1e-5  # of a column's norm


@dataclass(frozen=True, slots=True)
class Derivatives:
    """Jacobian (n, p) at x (p,): one that is good enough to descend with, and one with all digits."""

    rough: Derivative
    fine: Derivative


def derivatives_of(function: Vector, start: FloatArray) -> Derivatives:
    """Return the Jacobian of a function, by the complex step if that agrees with differences at the start.

    A function that takes the modulus or the real part of its parameters is not analytic, and one that insists
    on floats refuses complex ones: both are found out here.
    """
    differences = _Differences(function, np.where(start != 0.0, np.abs(start), 1.0))

    def complex_step(x: FloatArray) -> FloatArray:
        columns = []
        for a in range(x.size):
            h = _TINY * float(differences.typical[a])
            z = x.astype(np.complex128)
            z[a] += 1j * h
            columns.append(np.imag(function(z)) / h)
        return np.stack(columns, axis=1)

    without = Derivatives(differences.rough, differences.fine)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)  # the imaginary part was dropped
            exact = complex_step(start)
    except Exception:  # whatever a function does with parameters it was not made for
        return without
    close = differences.fine(start)
    size = np.sqrt(np.sum(close**2, axis=0))
    off = np.sqrt(np.sum((exact - close) ** 2, axis=0))
    # differences may leave the range of the function where the complex step does not
    agree = (off <= _ALIKE * size) | ~np.isfinite(size)
    return (
        Derivatives(complex_step, complex_step) if np.all(agree) and np.all(np.isfinite(exact)) else without
    )


@dataclass(frozen=True, slots=True)
class _Differences:
    function: Vector
    typical: FloatArray  # (p,)

    def rough(self, x: FloatArray) -> FloatArray:
        """Return central differences of fourth order."""
        columns = []
        for a in range(x.size):
            h = _WIDE * self._unit(x, a)
            columns.append((4.0 * self._central(x, a, h) - self._central(x, a, 2.0 * h)) / 3.0)
        return np.stack(columns, axis=1)

    def fine(self, x: FloatArray) -> FloatArray:
        """Return central differences extrapolated to a step of zero, of the order that changed least."""
        columns = []
        for a in range(x.size):
            h = _WIDEST * self._unit(x, a)
            before: list[FloatArray] = []
            best, least = np.full(1, np.nan), np.inf
            for level in range(_LEVELS):
                row = [self._central(x, a, h / 2.0**level)]
                for order, coarse in enumerate(before):
                    row.append(row[-1] + (row[-1] - coarse) / (4.0 ** (order + 1) - 1.0))
                    change = max(_norm(row[-1] - row[-2]), _norm(row[-1] - coarse))
                    if not change >= least:
                        best, least = row[-1], change
                before = row
                if level == 0 or not np.all(np.isfinite(best)):
                    best, least = row[0], np.inf
            columns.append(best)
        return np.stack(columns, axis=1)

    def _unit(self, x: FloatArray, a: int) -> float:
        return max(abs(float(x[a])), _LEAST * float(self.typical[a]))

    def _central(self, x: FloatArray, a: int, h: float) -> FloatArray:
        up, down = x.copy(), x.copy()
        up[a] += h
        down[a] -= h
        return np.asarray((np.real(self.function(up)) - np.real(self.function(down))) / (up[a] - down[a]))


def _norm(values: FloatArray) -> float:
    norm = float(np.sqrt(np.sum(values**2)))
    return norm if np.isfinite(norm) else np.inf

"""What is known of a parameter beforehand, as one more reading: ``value = parameter ± sd``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.errors import FitError
from gonio.fitting.columns import Columns
from gonio.fitting.separable import Separable

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


def with_prior(
    model: Separable, y: FloatArray, w: FloatArray, value: ArrayLike, sd: ArrayLike
) -> tuple[Separable, FloatArray, FloatArray]:
    """Return a model, readings and weights whose chi2 holds ``sum_j (basic_j - value_j)^2 / sd_j^2`` too.

    They go to `gonio.fitting.solve.refine` in place of the ones given; the weights there must be 1/variance,
    or the prior is out of proportion.

    Parameters
    ----------
    y, w
        Readings and weights, (n, m).
    value, sd
        Of the basic parameters in their order, linear ones first; broadcast to (m, L + k).  An sd of inf is
        no prior, and its value plays no part.

    Raises
    ------
    FitError
        An sd that is not positive (to hold a nonlinear parameter use ``free``), or a value that is no number.
    """
    count, k = len(model.linear), model.low.size
    shape = (y.shape[1], count + k)
    centre, width = (np.broadcast_to(np.asarray(a, np.float64), shape) for a in (value, sd))
    wrong = np.argwhere(~(width > 0.0))
    if wrong.size:
        m, j = wrong[0]
        raise FitError(
            f"the prior's sd of basic parameter {j} is {width[m, j]:g} at wavelength {m}; give a positive "
            "one, inf for none; to hold a nonlinear parameter use free"
        )
    told = np.isfinite(width)
    wrong = np.argwhere(told & ~np.isfinite(centre))
    if wrong.size:
        m, j = wrong[0]
        raise FitError(
            f"the prior's value of basic parameter {j} at wavelength {m} is {centre[m, j]}; give a number"
        )
    pick = np.flatnonzero(np.any(told, axis=0))
    if not pick.size:
        return model, y, w
    rows = np.where(told, centre, 0.0).T[pick]
    weights = np.where(told, 1.0 / width**2, 0.0).T[pick]
    return _WithPrior(model, pick), np.concatenate([y, rows]), np.concatenate([w, weights])


@dataclass(frozen=True, slots=True)
class _WithPrior:
    """A model with the basic parameters `pick` as its last readings."""

    model: Separable
    pick: IndexArray

    @property
    def linear(self) -> tuple[str, ...]:
        return self.model.linear

    @property
    def low(self) -> FloatArray:
        return self.model.low

    @property
    def high(self) -> FloatArray:
        return self.model.high

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        at, count, k = self.model.columns(x, order), len(self.linear), x.shape[1]
        value = [self._below(c, _rows(self.pick == j)) for j, c in enumerate(at.value[:count])]
        # a nonlinear parameter enters its row as itself: the column without a coefficient
        bare = np.where(self.pick[:, None] >= count, x.T[np.maximum(self.pick - count, 0)], 0.0)
        rest = at.value[count] if len(at.value) > count else np.zeros((at.value[0].shape[0], 1))
        value.append(self._below(rest, bare))
        if order == 0:
            return Columns(tuple(value))
        none: tuple[None, ...] = (None,) * k
        first = [*at.first, *([none] if len(at.first) == count else [])]
        slopes = [
            tuple(None if s is None else self._below(s, _rows(self.pick < 0)) for s in column)
            for column in first[:count]
        ]
        slopes.append(
            tuple(
                self._below(np.zeros_like(rest[:, :1]) if s is None else s, _rows(self.pick == count + a))
                for a, s in enumerate(first[count])
            )
        )
        if order == 1 or (k and not at.second):
            return Columns(tuple(value), tuple(slopes))
        second = [*at.second, *([(none,) * k] if len(at.second) == count else [])]
        curves = tuple(
            tuple(
                tuple(None if c is None else self._below(c, _rows(self.pick < 0)) for c in row)
                for row in column
            )
            for column in second
        )
        return Columns(tuple(value), tuple(slopes), curves)

    @staticmethod
    def _below(column: FloatArray, rows: FloatArray) -> FloatArray:
        width = max(column.shape[1], rows.shape[1])
        parts = [np.broadcast_to(part, (part.shape[0], width)) for part in (column, rows)]
        return np.concatenate(parts)


def _rows(mask: NDArray[np.bool_]) -> FloatArray:
    """Return a mask (q,) as rows of a column, (q, 1)."""
    return mask.astype(np.float64)[:, None]

"""How is a quantity of a fit pulled to a value, with all else free to follow?

A shape parameter is held.  For a strength ``g = a(x)'c`` one reading is added, ``g`` with the value v' and a
weight of its own: the optimum of this fit is that of chi2 with g held at what is reached, whatever the weight
(a penalty's minimum is the minimum of chi2 among all points of equal penalty).  So every point is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.columns import BoolArray, Columns, FitModel, FloatArray
from gonio.fitting.covariance import random_and_common
from gonio.fitting.quantity import Quantity
from gonio.fitting.solve import refine

IndexArray = NDArray[np.intp]

PULL = 100.0
"""Weight of the added reading, in units of what the data say of the quantity."""


@dataclass(frozen=True, slots=True)
class Data:
    """One least-squares problem per wavelength.

    Attributes
    ----------
    y, w
        (n, m) readings and weights.
    basic, chi2
        The optimum, (m, p) and (m,).
    free
        (m, k) shape parameters that the fit was free to choose.
    scale
        (m,) variance of the residuals in units of ``1/w``.
    quantile
        (m,) Student's t.
    """

    model: FitModel
    y: FloatArray
    w: FloatArray
    basic: FloatArray
    chi2: FloatArray
    free: BoolArray
    scale: FloatArray
    quantile: FloatArray

    def of(self, rows: IndexArray) -> Data:
        """Return the part of some wavelengths."""
        along = (getattr(self, name)[rows] for name in ("basic", "chi2", "free", "scale", "quantile"))
        return Data(self.model, self.y[:, rows], self.w[:, rows], *along)


class Mover(Protocol):
    """Fits with a quantity pulled to a coordinate."""

    def __call__(
        self, coordinate: FloatArray, x: FloatArray, rows: IndexArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the coordinate reached (r,), chi2 (r,) and the shape parameters (r, k)."""
        ...


@dataclass(frozen=True, slots=True)
class Held:
    """A shape parameter is held."""

    data: Data
    shape: int

    def __call__(
        self, coordinate: FloatArray, x: FloatArray, rows: IndexArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what `Mover` says."""
        d, begin = self.data, x.copy()
        at = np.clip(coordinate, d.model.low[self.shape], d.model.high[self.shape])
        begin[:, self.shape] = at
        free = d.free[rows].copy()
        free[:, self.shape] = False
        found = refine(d.model, d.y[:, rows], d.w[:, rows], begin, free=free)
        return at, found.chi2, found.basic[:, len(d.model.linear) :]


@dataclass(frozen=True, slots=True)
class Pulled:
    """A strength is pulled to a value by one more reading of the given weight, (m,)."""

    data: Data
    quantity: Quantity
    weight: FloatArray

    def __call__(
        self, coordinate: FloatArray, x: FloatArray, rows: IndexArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what `Mover` says."""
        d, pull = self.data, self.weight[rows]
        y = np.concatenate([d.y[:, rows], coordinate[None]])
        w = np.concatenate([d.w[:, rows], pull[None]])
        found = refine(_WithReading(d.model, self.quantity), y, w, x, free=d.free[rows])
        reached = self.quantity.of(found.basic)
        return reached, found.chi2 - pull * (coordinate - reached) ** 2, found.basic[:, len(d.model.linear) :]


@dataclass(frozen=True, slots=True)
class _WithReading:
    """A model with a strength as its last reading."""

    model: FitModel
    quantity: Quantity

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
        at, k = self.model.columns(x, order), x.shape[1]
        if order == 0:
            factors = self.quantity.factors(x)
            return Columns(_extended(at.value, factors))
        factors, first, second = self.quantity.factor_slopes(x)
        value = _extended(at.value, factors)
        slopes = tuple(
            tuple(_below(own[a], first[:, j, a], at.value[j]) for a in range(k))
            for j, own in enumerate(at.first)
        )
        curves = tuple(
            tuple(
                tuple(_below(own[a][b], second[:, j, a, b], at.value[j]) for b in range(k)) for a in range(k)
            )
            for j, own in enumerate(at.second)
        )
        return Columns(value, slopes, curves)


def _extended(columns: tuple[FloatArray, ...], factors: FloatArray) -> tuple[FloatArray, ...]:
    return tuple(_row_added(column, factors[:, j]) for j, column in enumerate(columns))


def _below(column: FloatArray | None, row: FloatArray, like: FloatArray) -> FloatArray | None:
    """Return a column with one more reading; None stands for zero."""
    if column is None:
        if not np.any(row):
            return None
        column = np.zeros((like.shape[0], 1))
    return _row_added(column, row)


def _row_added(column: FloatArray, row: FloatArray) -> FloatArray:
    whole = np.empty((column.shape[0] + 1, row.size))
    whole[:-1], whole[-1] = column, row
    return whole


def mover_of(data: Data, quantity: Quantity) -> tuple[Mover, FloatArray, FloatArray]:
    """Return the mover, the coordinate at the optimum, and its distance to Wald's end as a first step."""
    at, variance = coordinate_of(data, quantity)
    if quantity.shape is not None:
        span = float(data.model.high[quantity.shape] - data.model.low[quantity.shape])
        width = np.where(variance > 0.0, data.quantile * np.sqrt(data.scale * variance), 0.05 * span)
        return Held(data, quantity.shape), at, np.minimum(width, 0.1 * span)
    tiny = np.finfo(float).tiny
    size = np.maximum(np.abs(at), np.abs(data.basic[:, 0]))  # a first step where Wald has none
    variance = np.where(variance > 0.0, variance, size**2 / np.maximum(data.scale, tiny))
    width = data.quantile * np.sqrt(data.scale * variance)
    return Pulled(data, quantity, PULL / np.maximum(variance, tiny)), at, width


def coordinate_of(data: Data, quantity: Quantity) -> tuple[FloatArray, FloatArray]:
    """Return the shape parameter or strength at the optimum, and its variance in units of `scale`, (m,)."""
    linear = len(data.model.linear)
    held = np.zeros(data.basic.shape, bool)
    held[:, linear:] = ~data.free
    unit, _ = random_and_common(data.model, data.basic, data.w, held, None)
    slopes = coordinate_slopes(quantity, data.basic)
    at = quantity.of(data.basic) if quantity.shape is None else data.basic[:, linear + quantity.shape]
    return at, delta_variance(slopes, unit)


def coordinate_slopes(quantity: Quantity, basic: FloatArray) -> FloatArray:
    """Return the derivatives of the coordinate by the basic parameters, (m, p)."""
    if quantity.shape is None:
        return quantity.slopes(basic)
    slopes = np.zeros(basic.shape)
    slopes[:, len(quantity.kind.linear) + quantity.shape] = 1.0
    return slopes


def delta_variance(slopes: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return ``slopes' covariance slopes``, (m,); an unknown covariance counts as zero."""
    known = np.nan_to_num(covariance, nan=0.0)
    return np.asarray(np.einsum("ma,mab,mb->m", slopes, known, slopes))

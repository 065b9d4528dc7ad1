"""S and P with surfaces of their own and one index in common: any model with n2, made into one of both.

The paper fits S alone, P alone, and both; between "alone" and "all in common" lies this: strength and shape
of the diffuse part and the lobe may differ between the polarizations, the index of the material may not.
"""

from __future__ import annotations

import functools
from typing import Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Receiver
from gonio.brdf import ScatteringModel
from gonio.errors import FitError
from gonio.fitting.columns import BoolArray, Columns, FitModel, FloatArray
from gonio.fitting.solve import refine

_S, _P = "[s]", "[p]"


class SeparateSurfaces:
    """`FitModel` of two surfaces that share n2, the last shape parameter of `inner`."""

    inner: ClassVar[type[FitModel]]
    name: ClassVar[str]
    linear: ClassVar[tuple[str, ...]]
    shape: ClassVar[tuple[str, ...]]
    parameters: ClassVar[tuple[str, ...]]
    low: ClassVar[FloatArray]
    high: ClassVar[FloatArray]

    def __init__(self, s: FitModel, p: FitModel, is_s: BoolArray) -> None:
        self._parts = ((s, np.flatnonzero(is_s)), (p, np.flatnonzero(~is_s)))
        self._size = is_s.size

    @classmethod
    def of(
        cls, receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: BoolArray
    ) -> Self:
        """Return the model at n positions, (n,) each; both polarizations must be among them."""
        if np.all(is_s) or not np.any(is_s):
            raise FitError(
                "S and P surfaces with a common n2 need readings of both polarizations; "
                "use polarization = 's' or 'p'"
            )
        at = [cls.inner.of(receiver, theta_i_deg[x], theta_o_deg[x], is_s[x]) for x in (is_s, ~is_s)]
        return cls(at[0], at[1], is_s)

    @classmethod
    def _basic_of(cls, part: int) -> NDArray[np.intp]:
        """Return where the basic parameters of S (0) or P (1) stand among all."""
        linear, own = len(cls.inner.linear), len(cls.inner.shape) - 1
        first = 2 * linear
        start = first + part * own
        return np.array(
            [*range(part * linear, (part + 1) * linear), *range(start, start + own), first + 2 * own]
        )

    @classmethod
    def _published_of(cls, part: int) -> NDArray[np.intp]:
        own = len(cls.inner.parameters) - 1
        return np.array([*range(part * own, (part + 1) * own), 2 * own])

    @classmethod
    def surfaces(cls, published: FloatArray) -> tuple[ScatteringModel, ScatteringModel]:
        """Return the surface that S sees and the one that P sees."""
        s, p = (cls.inner.scattering(published[:, cls._published_of(part)]) for part in (0, 1))
        return s, p

    @staticmethod
    def scattering(published: FloatArray) -> ScatteringModel:
        """Refuse: there are two surfaces, see `surfaces`."""
        raise FitError(
            "this fit has one surface for S and one for P, and no single one; fit with polarization = 'joint'"
        )

    @classmethod
    def published(cls, basic: FloatArray) -> FloatArray:
        """Return the known parameters, (m, p); S's, P's, then n2."""
        result = np.empty(basic.shape)
        for part in (0, 1):
            result[:, cls._published_of(part)] = cls.inner.published(basic[:, cls._basic_of(part)])
        return result

    @classmethod
    def published_jacobian(cls, basic: FloatArray) -> FloatArray:
        """Return the derivatives of the known by the basic parameters, (m, p, p)."""
        j = np.zeros((*basic.shape, basic.shape[1]))
        for part in (0, 1):
            rows, columns = cls._published_of(part), cls._basic_of(part)
            j[:, rows[:, None], columns] = cls.inner.published_jacobian(basic[:, columns])
        return j

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        """Return the columns of S, then those of P, each zero at the positions of the other."""
        own = len(self.inner.shape) - 1
        k = 2 * own + 1
        value: list[FloatArray] = []
        first: list[tuple[FloatArray | None, ...]] = []
        second: list[tuple[tuple[FloatArray | None, ...], ...]] = []
        for number, (part, rows) in enumerate(self._parts):
            pick = [*range(number * own, (number + 1) * own), 2 * own]
            at = part.columns(x[:, pick], order)
            value += [self._spread(column, rows) for column in at.value]
            for slopes in at.first:
                line: list[FloatArray | None] = [None] * k
                for a, slope in zip(pick, slopes, strict=True):
                    line[a] = None if slope is None else self._spread(slope, rows)
                first.append(tuple(line))
            for curves in at.second:
                table: list[list[FloatArray | None]] = [[None] * k for _ in range(k)]
                for a, line_of in zip(pick, curves, strict=True):
                    for b, curve in zip(pick, line_of, strict=True):
                        table[a][b] = None if curve is None else self._spread(curve, rows)
                second.append(tuple(tuple(line) for line in table))
        return Columns(tuple(value), tuple(first), tuple(second))

    def _spread(self, column: FloatArray, rows: NDArray[np.intp]) -> FloatArray:
        whole = np.zeros((self._size, column.shape[1]))
        whole[rows] = column
        return whole

    def start(self, y: FloatArray, w: FloatArray) -> FloatArray:
        """Return the better of: S's own optimum with P at its index, and the other way round."""
        linear, own = len(self.inner.linear), len(self.inner.shape) - 1
        alone = [
            refine(part, y[rows], w[rows], part.start(y[rows], w[rows])).basic[:, linear:]
            for part, rows in self._parts
        ]
        best = np.empty((y.shape[1], 2 * own + 1))
        least = np.full(y.shape[1], np.inf)
        for index in (alone[0][:, own], alone[1][:, own], 0.5 * (alone[0][:, own] + alone[1][:, own])):
            trial = np.concatenate([alone[0][:, :own], alone[1][:, :own], index[:, None]], axis=1)
            held = (False,) * trial.shape[1]
            chi2 = refine(cast(FitModel, self), y, w, trial, free=held).chi2
            better = chi2 < least
            best[better], least[better] = trial[better], chi2[better]
        return best


@functools.cache
def separate_surfaces(inner: type[FitModel]) -> type[FitModel]:
    """Return the model class of two surfaces of a model with one n2.

    Raises
    ------
    FitError
        The model has no n2 that S and P could share.
    """
    if not inner.shape or inner.shape[-1] != "n2":
        raise FitError(
            f"model '{inner.name}' has no n2 that S and P could share; use polarization 'joint', 's' or 'p'"
        )
    own_shape, own = inner.shape[:-1], inner.parameters[:-1]
    members: dict[str, Any] = {
        "inner": inner,
        "name": inner.name,
        "linear": tuple(f"{name}{which}" for which in (_S, _P) for name in inner.linear),
        "shape": (*(f"{name}{which}" for which in (_S, _P) for name in own_shape), "n2"),
        "parameters": (*(f"{name}{which}" for which in (_S, _P) for name in own), "n2"),
        "low": np.concatenate([inner.low[:-1], inner.low[:-1], inner.low[-1:]]),
        "high": np.concatenate([inner.high[:-1], inner.high[:-1], inner.high[-1:]]),
    }
    return cast(type[FitModel], type(f"Separate{inner.__name__}", (SeparateSurfaces,), members))

"""What have the rays of some patches met so far?  Transport rows, one for each patch and replica.

A `Rows` object is a set of patches that are refined together.  Of every round it keeps, for each unit (patch,
replica), which patches its rays met, how often, and with what diffuse reflection: transposed views of one
sparse matrix whose rows can be read replica by replica or, summed, patch by patch.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from scipy import sparse

from gonio.facade import rows
from gonio.facade.layout import FloatArray, IntArray

Matrix: TypeAlias = FloatArray | sparse.csr_array
DENSE = 700
"""Up to so many patches matrices are full and the system is factorised; beyond, sparse and iterated."""

REPLICAS = 16
"""Independent randomisations of every point set, whose scatter is the standard error."""


@dataclass(slots=True)
class Sparse:
    """Rows of units: ``data[start[u] : start[u + 1]]`` belongs to unit u and to the patches in `index`."""

    start: IntArray  # (units + 1,)
    index: IntArray  # (entries,)
    data: FloatArray  # (columns, entries): counts, then one row of weights for each band

    def matrix(self, column: int, width: int) -> sparse.csr_array:
        """Return one column of `data` as (units, width)."""
        shape = (len(self.start) - 1, width)
        return sparse.csr_array((self.data[column], self.index, self.start), shape=shape)

    def summed(self, column: int, width: int) -> Matrix:
        """Return the sum over the replicas of each patch, (units / REPLICAS, width)."""
        start = self.start[::REPLICAS]
        rows = len(start) - 1
        if width <= DENSE:
            place = np.repeat(np.arange(rows) * width, np.diff(start)) + self.index
            full = np.bincount(place, self.data[column], rows * width).reshape(rows, width)
            return np.asarray(full, np.float64)
        return sparse.csr_array((self.data[column], self.index, start), shape=(rows, width))


@dataclass(slots=True)
class Rows:
    """Transport rows of some patches.

    Attributes
    ----------
    chosen
        (c,) patches.
    points
        Points of each unit done so far.
    sums
        (c * REPLICAS, FIRST_BAND + PER_BAND bands), see `gonio.facade.rows`.
    """

    chosen: IntArray
    sums: FloatArray
    points: int = 0
    rays: int = 0
    rounds: list[Sparse] = field(default_factory=list)
    _folded: dict[int, tuple[int, Matrix]] = field(default_factory=dict)

    @classmethod
    def of(cls, chosen: IntArray, bands: int) -> Rows:
        """Return the rows of the patches `chosen`, without any ray."""
        return cls(chosen, np.zeros((len(chosen) * REPLICAS, rows.FIRST_BAND + rows.PER_BAND * bands)))

    def exposed(self) -> FloatArray:
        """Return the points that count, (c, REPLICAS)."""
        return self.sums[:, rows.EXPOSED].reshape(-1, REPLICAS)

    def column(self, number: int) -> FloatArray:
        """Return a column of `sums`, (c, REPLICAS)."""
        return self.sums[:, number].reshape(-1, REPLICAS)

    def applied(self, column: int, values: FloatArray) -> FloatArray:
        """Return the sum over the rays of ``weight * values[patch met]``, (c, REPLICAS); `values` (n,)."""
        total = np.zeros(len(self.sums))
        for part in self.rounds:
            products = part.data[column] * values[part.index]
            total += _sums(products, part.start)
        return total.reshape(-1, REPLICAS)

    def mean(self, column: int, width: int) -> Matrix:
        """Return the average over points and replicas, (c, width); 0 for patches that are hidden."""
        scale = 1.0 / np.maximum(self.exposed().sum(axis=1), 1.0)
        # rounds do not change, so their sum is kept from one solution to the next
        done, total = self._folded.get(column, (0, zeros(len(self.chosen), width)))
        for part in self.rounds[done:]:
            total = total + part.summed(column, width)
        self._folded[column] = len(self.rounds), total
        return scaled(scale, total)


def zeros(rows: int, columns: int) -> Matrix:
    """Return a matrix of zeros, full or sparse by the number of its columns."""
    return np.zeros((rows, columns)) if columns <= DENSE else sparse.csr_array((rows, columns))


def scaled(factors: FloatArray, matrix: Matrix) -> Matrix:
    """Return the matrix with its rows multiplied by `factors`."""
    if isinstance(matrix, np.ndarray):
        return factors[:, None] * matrix
    return sparse.csr_array(sparse.diags_array(factors) @ matrix)


def _sums(values: FloatArray, start: IntArray) -> FloatArray:
    """Return the sums of ``values[start[u] : start[u + 1]]``, 0 where that is empty."""
    found = np.zeros(len(start) - 1)
    filled = start[1:] > start[:-1]
    if np.any(filled):
        found[filled] = np.add.reduceat(values, start[:-1][filled])
    return found


def doubted(each: FloatArray, step: FloatArray) -> FloatArray:
    """Return replicas (c, REPLICAS) that scatter at least as if one of them had met one ray more.

    A Sobol point set meets a narrow sliver of sky or sun with the same number of rays in almost every
    scrambling, and then all replicas agree on a value that is off by up to the weight of a ray, `step` (c,).
    The scatter that is missing is added as fixed numbers of mean 0, different for each patch.
    """
    deviation = each - each.mean(axis=1, keepdims=True)
    missing = np.maximum(step**2 - np.sum(deviation**2, axis=1), 0.0)
    if not np.any(missing > 0.0):
        return each
    pattern = np.random.default_rng(each.shape[0]).standard_normal(each.shape)
    pattern -= pattern.mean(axis=1, keepdims=True)
    pattern /= np.sqrt(np.sum(pattern**2, axis=1, keepdims=True))
    return np.asarray(each + pattern * np.sqrt(missing)[:, None])


def spread(per_replica: FloatArray, exposed: FloatArray) -> FloatArray:
    """Return the replicas' estimates, (c, REPLICAS), of a mean over points from sums over points.

    Where coplanar primitives hide a part of a patch the number of points that count is random itself, and the
    mean a ratio; its replicas are those of the linearised ratio.
    """
    points = exposed.sum(axis=1)
    safe = np.maximum(points, 1.0)
    mean = per_replica.sum(axis=1) / safe
    each = safe[:, None] / REPLICAS
    return np.asarray((per_replica - mean[:, None] * exposed) / each + mean[:, None])

"""The column of a lobe with Fresnel at the half vector: readings and derivatives by log(shape) and n2."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Receiver
from gonio.fitting.columns import BoolArray, FloatArray
from gonio.fitting.models.bands import bands_of
from gonio.fitting.models.facets import Facets
from gonio.fitting.models.fresnel_ratio import distinct, ratio_p, ratio_s
from gonio.fitting.models.kernels import Kernel
from gonio.fitting.models.table import FacetTable
from gonio.fitting.problem import N2_MAX, N2_MIN

Derivatives = tuple[tuple[int, int], ...]

_ORDERS: tuple[Derivatives, ...] = (
    ((0, 0),),
    ((0, 0), (1, 0), (0, 1)),
    ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)),
)
"""What is returned up to each order: derivatives by (log(shape), n2)."""


def tabulated(kernel: Kernel, receiver: Receiver, pairs: FloatArray) -> tuple[FacetTable, FloatArray]:
    """Return a kernel's table at distinct (theta_i, theta_o), (2, g), and the facets' cosines, (g, j).

    The last few are kept: two models with the same kernel, or two fits of one scan, share their table.
    """
    key: tuple[Any, ...] = (kernel, receiver, tuple(pairs[0].tolist()), tuple(pairs[1].tolist()))
    return _tabulated(*key)


@functools.lru_cache(maxsize=4)
def _tabulated(
    kernel: Kernel, receiver: Receiver, theta_i_deg: tuple[float, ...], theta_o_deg: tuple[float, ...]
) -> tuple[FacetTable, FloatArray]:
    bands = bands_of(receiver, np.array(theta_i_deg), np.array(theta_o_deg))
    count = len(theta_i_deg)
    facets = Facets.of(bands, count, N2_MIN, N2_MAX)
    table = FacetTable.of(kernel, bands, facets, count, receiver.solid_angle_sr, receiver.lobe_growth)
    return table, facets.cosines


@dataclass(frozen=True, slots=True)
class FacetLobe:
    """``sum over j of q_x(n2, c_j) W_j(log shape)`` at n positions, q = R/R(0).

    See `gonio.fitting.models.facets`.

    Attributes
    ----------
    table
        W at the g distinct (theta_i, theta_o).
    cosines
        (g, j)
    geometry
        (n,), index into the g.
    is_s
        (n,)
    """

    table: FacetTable
    cosines: FloatArray
    geometry: NDArray[np.intp]
    is_s: BoolArray

    @classmethod
    def of(
        cls,
        kernel: Kernel,
        receiver: Receiver,
        theta_i_deg: FloatArray,
        theta_o_deg: FloatArray,
        is_s: BoolArray,
    ) -> FacetLobe:
        """Tabulate a kernel for a receiver at n positions, (n,) each."""
        pairs, index = np.unique(np.stack([theta_i_deg, theta_o_deg]), axis=1, return_inverse=True)
        table, cosines = tabulated(kernel, receiver, pairs)
        return cls(table, cosines, index.reshape(-1), is_s)

    def evaluate(self, log_shape: FloatArray, n2: FloatArray, order: int) -> tuple[FloatArray, ...]:
        """Return the column (n, m) at m points, then its derivatives by log(shape) and by n2, up to `order`.

        In the order value; d/da, d/dn; d2/da2, d2/dadn, d2/dn2.
        """
        g, j = self.cosines.shape
        parts = [w.reshape(g, j, -1) for w in self.table.evaluate(log_shape, order)]
        index, spread = distinct(n2)
        wanted = _ORDERS[order]
        result = [np.empty((self.is_s.size, n2.size)) for _ in wanted]
        for function, rows in ((ratio_s, np.flatnonzero(self.is_s)), (ratio_p, np.flatnonzero(~self.is_s))):
            if not rows.size:
                continue
            here, back = np.unique(self.geometry[rows], return_inverse=True)
            whole = here.size == g
            ratios = function(index, self.cosines[here, :, None], order)
            ratios = tuple(q[:, :, spread] for q in ratios)
            for k, (a, b) in enumerate(wanted):
                w = parts[a] if whole else parts[a][here]
                result[k][rows] = np.einsum("gjm,gjm->gm", w, ratios[b])[back]
        return tuple(result)

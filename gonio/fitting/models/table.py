"""A lobe's reading at every position and facet, for any shape at the cost of a matrix product.

The integrals W_j of `gonio.fitting.models.facets` are smooth functions of the logarithm of the shape
parameter; they are expanded once per scan in Chebyshev polynomials, after division by a smooth envelope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.brdf.directions import Directions
from gonio.fitting.models.bands import Bands
from gonio.fitting.models.facets import Facets
from gonio.fitting.models.fresnel_ratio import distinct
from gonio.fitting.models.kernels import Kernel

FloatArray = NDArray[np.float64]

_BLOCK = 60_000  # directions worked on together: scratch arrays stay in the cache


def facet_integrals(kernel: Kernel, shape: float, bands: Bands, facets: Facets, count: int) -> FloatArray:
    """Return W_j of every reading, (n, j), at one shape."""
    moments = np.zeros((count, facets.zeta.size))
    live = kernel.live(shape, bands)
    if not live.size:
        return moments
    if bands.single:
        groups = {(1, 1): live}
    else:
        chosen = bands.pick(live)
        sizes = np.stack(kernel.sizes(shape, chosen, facets.zeta.size), axis=1)
        if bands.flat:
            sizes[:, 1] = 1
        groups = {tuple(pair): live[np.all(sizes == pair, axis=1)] for pair in np.unique(sizes, axis=0)}
    for (in_plane, out), rows in groups.items():
        step = max(1, _BLOCK // (in_plane * out))
        for at in range(0, rows.size, step):
            part = bands.pick(rows[at : at + step])
            np.add.at(moments, part.position, _moments(kernel, shape, part, facets, in_plane, out))
    return moments @ facets.lagrange.T


def _moments(
    kernel: Kernel, shape: float, bands: Bands, facets: Facets, in_plane: int, out: int
) -> FloatArray:
    """Return the integrals of the lobe times T_k(zeta), (b, k), zeta as in `Facets`."""
    i = bands.theta_i[:, None]
    if bands.single:
        u, weight_u = (bands.axis - bands.theta_i)[:, None], np.ones((bands.axis.size, 1))
    else:
        u, weight_u = kernel.in_plane(shape, bands, in_plane)
    weight_u = weight_u * bands.weight[:, None]
    if bands.flat:
        at = Directions.tilted(i, u, 1.0, 0.0)
        weight = weight_u * kernel.dsf(shape, at)
    else:
        share, distance_mm = bands.accepted(i + u)
        y, weight_y = kernel.out_of_plane(shape, bands, u, distance_mm, out)
        if np.any(bands.slope):
            weight_y = weight_y * (
                bands.level[:, None, None] + bands.slope[:, None, None] * (y * distance_mm[..., None])
            )
        else:
            weight_y = weight_y * bands.level[:, None, None]
        weight_u = weight_u * share
        slope = np.cos(i + u - bands.axis[:, None])[..., None]  # tan(psi) = y slope
        cos_psi = 1.0 / np.sqrt(1.0 + (y * slope) ** 2)
        at = Directions.tilted(i[..., None], u[..., None], cos_psi, y * slope * cos_psi)
        # cos(psi) dpsi = slope cos(psi)^3 dy
        weight = kernel.dsf(shape, at) * (weight_u[..., None] * slope) * weight_y * cos_psi**3
    rows = len(weight)
    weight = weight.reshape(rows, -1)
    middle, half = facets.middle[bands.position, None], facets.half[bands.position, None]
    zeta = (at.cos_h.reshape(rows, -1) - middle) / half
    moments = np.empty((rows, facets.zeta.size))
    before, now = weight, weight * zeta
    zeta *= 2.0
    for k in range(facets.zeta.size):
        moments[:, k] = np.sum(before, axis=1)
        before, now = now, zeta * now - before
    return moments


@dataclass(frozen=True, slots=True)
class FacetTable:
    """Chebyshev coefficients of W_j at n distinct positions; the error of `evaluate` is tested."""

    kernel: Kernel
    coefficients: FloatArray  # (3, K, n * j): of the function and of its first two derivatives
    solid_angle_sr: float
    growth: float

    @classmethod
    def of(
        cls, kernel: Kernel, bands: Bands, facets: Facets, count: int, solid_angle_sr: float, growth: float
    ) -> FacetTable:
        """Tabulate a kernel over the bands of `count` readings."""
        k = np.arange(kernel.degree)
        angle = np.pi * (k + 0.5) / kernel.degree
        low, high = kernel.low, kernel.high
        log_shape = 0.5 * (low + high) + 0.5 * (high - low) * np.cos(angle)
        values = np.stack(
            [facet_integrals(kernel, float(s), bands, facets, count) for s in np.exp(log_shape)]
        )
        values /= kernel.envelope(log_shape, solid_angle_sr, growth)[0][:, None, None]
        c = 2.0 / kernel.degree * np.cos(np.outer(k, angle)) @ values.reshape(kernel.degree, -1)
        c[0] *= 0.5
        stack = np.zeros((3, *c.shape))
        stack[0] = c
        stack[1, :-1] = np.polynomial.chebyshev.chebder(c, 1, scl=2.0 / (high - low))
        stack[2, :-2] = np.polynomial.chebyshev.chebder(c, 2, scl=2.0 / (high - low))
        return cls(kernel, stack, solid_angle_sr, growth)

    def summed(self, count: int) -> FacetTable:
        """Return the table of the lobes alone, R = 1: the sums over the facets of `count` positions."""
        orders, degree = self.coefficients.shape[:2]
        sums = np.sum(self.coefficients.reshape(orders, degree, count, -1), axis=3)
        return FacetTable(self.kernel, sums, self.solid_angle_sr, self.growth)

    def evaluate(self, log_shape: FloatArray, order: int) -> tuple[FloatArray, ...]:
        """Return W at m shapes, (n * j, m), and its derivatives by the logarithm up to `order`."""
        low, high = self.kernel.low, self.kernel.high
        few, spread = distinct(log_shape)
        z = np.clip((2.0 * few - low - high) / (high - low), -1.0, 1.0)
        basis = np.cos(np.arange(self.kernel.degree)[:, None] * np.arccos(z))
        g, g1, g2 = self.kernel.envelope(few, self.solid_angle_sr, self.growth)
        f = [self.coefficients[k].T @ basis for k in range(order + 1)]
        result = [f[0] * g]
        if order > 0:
            result.append(f[1] * g + f[0] * g1)
        if order > 1:
            result.append(f[2] * g + 2.0 * f[1] * g1 + f[0] * g2)
        return tuple(x[:, spread] for x in result)

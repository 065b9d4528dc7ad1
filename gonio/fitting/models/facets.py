"""How does the Fresnel term at the half vector vary over an aperture?  Interpolated between a few facets.

Within one aperture the incidence theta_h on the half-vector facet changes by a few degrees, so ``R(n2,
theta_h)`` is a polynomial in ``c = cos(theta_h)`` to high accuracy: with Chebyshev nodes c_j of that
position's range

    ∫ lobe R(n2, theta_h) dOmega = sum over j of R(n2, c_j) W_j,   W_j = ∫ lobe l_j(c) dOmega,

l_j Lagrange's polynomials.  W_j knows nothing of n2, and R(n2, c_j) nothing of the lobe.  R as a function of
c is analytic up to ``c = ± i sqrt(n2^2 - 1)`` (s and p), and up to ``c = -1/sqrt(n2^2 + 1)`` (p); the number
of nodes follows from the nearest of these over the indices of the fit, for the position that needs most.
Another's quadrature may not resolve the highest of these polynomials; there they multiply coefficients that
are rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.models.bands import Bands

FloatArray = NDArray[np.float64]

_ACCURACY = 1e-13  # of the interpolation, but for a constant that grows to 1e4 near grazing incidence
_FEWEST, _MOST = 4, 40


@dataclass(frozen=True, slots=True)
class Facets:
    """Interpolation nodes of n readings: ``c = middle + half zeta``, zeta in -1...1."""

    middle: FloatArray  # (n,)
    half: FloatArray  # (n,)
    zeta: FloatArray  # (j,), Chebyshev nodes
    lagrange: FloatArray  # (j, j): Lagrange's polynomials in terms of Chebyshev's

    @classmethod
    def of(cls, bands: Bands, count: int, least_index: float, most_index: float) -> Facets:
        """Return the nodes for n readings and indices between the two, both above 1."""
        low, high = np.full(count, np.inf), np.zeros(count)
        # cos(theta_h)^2 = (1 + cos(psi) cos(t + theta_i)) / 2: the range of the product of two ranges
        a, b = bands.low + bands.theta_i, bands.high + bands.theta_i
        most = np.where((a < 0.0) & (b > 0.0), 1.0, np.maximum(np.cos(a), np.cos(b)))
        least = np.minimum(np.cos(a), np.cos(b))
        rim = np.cos(bands.psi_most)
        square = 0.5 * (1.0 + np.minimum(least, least * rim)), 0.5 * (1.0 + np.maximum(most, most * rim))
        filled = (bands.high > bands.low) | bands.single
        ends = [np.sqrt(np.clip(x, 0.0, 1.0)) for x in square]
        np.minimum.at(low, bands.position[filled], ends[0][filled])
        np.maximum.at(high, bands.position[filled], ends[1][filled])
        low = np.where(np.isfinite(low), low, high)
        middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-9)
        nodes = _nodes_needed(middle, half, least_index, most_index)
        k = np.arange(nodes)
        angle = np.pi * (k + 0.5) / nodes
        lagrange = 2.0 / nodes * np.cos(np.outer(angle, k))
        lagrange[:, 0] *= 0.5
        return cls(middle, half, np.cos(angle), lagrange)

    @property
    def cosines(self) -> FloatArray:
        """Cosines of the incidence on the facets, (n, j)."""
        return np.clip(self.middle[:, None] + self.half[:, None] * self.zeta, 0.0, 1.0)


def _nodes_needed(middle: FloatArray, half: FloatArray, least_index: float, most_index: float) -> int:
    """Return how many nodes leave `_ACCURACY`, by the ellipse through the nearest singularity (Bernstein)."""
    branch = np.sqrt(least_index**2 - 1.0)
    pole = -1.0 / np.sqrt(most_index**2 + 1.0)
    rho = np.inf
    for singular in (1j * branch, complex(pole)):
        z = (singular - middle) / half
        root = np.sqrt(z - 1.0) * np.sqrt(z + 1.0)
        rho = min(rho, float(np.min(np.maximum(np.abs(z + root), np.abs(z - root)))))
    needed = np.ceil(-np.log(_ACCURACY) / np.log(max(rho, 1.0 + 1e-6)))
    return int(np.clip(needed, _FEWEST, _MOST))

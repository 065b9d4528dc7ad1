"""What is a scattering model to the fit: columns that enter linearly, and how their shape depends on the rest.

    r_i = sum over l of  c_l Phi_l,i(x)

At n positions and m wavelengths a model gives the readings as a sum of **columns** Phi, each with a linear
coefficient c (rho_d, k_n, ...), whose shape depends on few nonlinear parameters x (log_alpha, n2).  The fit
eliminates c (variable projection) and searches over x alone.  The **basic** parameters of a wavelength are
``(*c, *x)`` in this order; `FitModel.published` turns them into the parameters people know.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Columns:
    """L columns at m sets of k shape parameters, with the derivatives that were asked for.

    Every array is (n, m), or (n, 1) where it is the same for all m; None stands for zero.

    Attributes
    ----------
    value
        L arrays.
    first
        ``first[l][a]``: derivative of column l by shape parameter a; empty if not asked for.
    second
        ``second[l][a][b]``, symmetric in a and b; empty if not asked for.
    """

    value: tuple[FloatArray, ...]
    first: tuple[tuple[FloatArray | None, ...], ...] = ()
    second: tuple[tuple[tuple[FloatArray | None, ...], ...], ...] = ()


class FitModel(Protocol):
    """A scattering model seen through a receiver at n positions."""

    @property
    def name(self) -> str:
        """Name in files and tables, that of the `gonio.brdf` model."""
        ...

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the L coefficients."""
        ...

    @property
    def shape(self) -> tuple[str, ...]:
        """Names of the k shape parameters; may be empty."""
        ...

    @property
    def low(self) -> FloatArray:
        """Lower ends of the range of the shape parameters, (k,)."""
        ...

    @property
    def high(self) -> FloatArray:
        """Upper ends, (k,)."""
        ...

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters people know, as many as basic ones."""
        ...

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        """Return the columns at x, (m, k), and their derivatives up to `order`, 0...2."""
        ...

    def start(self, y: FloatArray, w: FloatArray) -> FloatArray:
        """Return a point (m, k) in the basin of the global optimum of each wavelength.

        `y` and `w` are readings and weights, (n, m); a reading of weight 0 is not used.  The whole range is
        searched: nothing depends on a starting value.
        """
        ...

    def published(self, basic: FloatArray) -> FloatArray:
        """Return the known parameters, (m, p), from basic ones, (m, p)."""
        ...

    def published_jacobian(self, basic: FloatArray) -> FloatArray:
        """Return the derivatives of the known by the basic parameters, (m, p, p)."""
        ...

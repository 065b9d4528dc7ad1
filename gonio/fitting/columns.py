"""What is a scattering model to the fit: columns that enter linearly, and shape parameters.

    r_i = sum over l of  c_l Phi_l,i(x)

At n positions and m wavelengths a model gives the readings as a sum of **columns** Phi, each with a linear
coefficient c (rho_d, k_n, ...), whose shape depends on few nonlinear parameters x (log_alpha, n2).  The fit
eliminates c (variable projection) and searches over x alone.  The **basic** parameters of a wavelength are
``(*c, *x)`` in this order; `FitModel.published` turns them into the parameters people know.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Receiver
from gonio.brdf import ScatteringModel

if TYPE_CHECKING:  # whose contract is a part of this one
    from gonio.fitting.separable import Separable

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


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

    name: ClassVar[str]
    """That of the `gonio.brdf` model, in files and tables."""
    linear: ClassVar[tuple[str, ...]]
    """Names of the L coefficients."""
    shape: ClassVar[tuple[str, ...]]
    """Names of the k shape parameters; may be empty."""
    parameters: ClassVar[tuple[str, ...]]
    """Names of the parameters people know, as many as basic ones, in the order of `scattering`."""
    low: ClassVar[FloatArray]
    """Lower ends of the range of the shape parameters, (k,)."""
    high: ClassVar[FloatArray]
    """Upper ends, (k,)."""

    @classmethod
    def of(
        cls, receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: BoolArray
    ) -> Self:
        """Return the model at n positions, (n,) each."""
        ...

    @staticmethod
    def scattering(published: FloatArray) -> ScatteringModel:
        """Return the surface with the known parameters, (m, p)."""
        ...

    @staticmethod
    def published(basic: FloatArray) -> FloatArray:
        """Return the known parameters, (m, p), from basic ones, (m, p)."""
        ...

    @staticmethod
    def published_jacobian(basic: FloatArray) -> FloatArray:
        """Return the derivatives of the known by the basic parameters, (m, p, p)."""
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


def readings(model: FitModel, basic: FloatArray) -> FloatArray:
    """Return the readings r, (n, m), of m sets of basic parameters (m, p)."""
    count = len(model.linear)
    total = 0.0
    for c, column in zip(basic[:, :count].T, model.columns(basic[:, count:]).value, strict=True):
        total = total + c * column
    return np.asarray(total)


def jacobian(model: Separable, basic: FloatArray) -> FloatArray:
    """Return the derivatives of the readings by the basic parameters, (m, n, p).

    A column beyond the model's coefficients has the coefficient 1.
    """
    count = len(model.linear)
    at = model.columns(basic[:, count:], 1)
    m, p = basic.shape
    j = np.zeros((m, at.value[0].shape[0], p))
    for k in range(count):
        j[:, :, k] = at.value[k].T
    for k, slopes in enumerate(at.first):
        for a, slope in enumerate(slopes):
            if slope is not None:
                j[:, :, count + a] += (basic[:, k] * slope if k < count else slope).T
    return j

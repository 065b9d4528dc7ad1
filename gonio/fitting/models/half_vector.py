"""The reciprocal lobe and GGX as the fit sees them: a white diffuse column and a lobe of half-vector facets.

r = rho_d D_i + k_n sum over j of q_x(n2, c_ij) W_ij(log shape),   k_n = rho_s R(0)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from gonio.aperture import Receiver
from gonio.brdf import GGX, ReciprocalLobe, ScatteringModel
from gonio.fitting.columns import BoolArray, Columns, FloatArray
from gonio.fitting.models.kernels import CosineKernel, GGXKernel, Kernel
from gonio.fitting.models.lobes import FacetLobe
from gonio.fitting.problem import N2_MAX, N2_MIN, Problem
from gonio.fitting.solve import grid_start

_GRID_N2 = np.unique(
    np.concatenate([1.0 + np.geomspace(1e-3, 9.0, 9), np.arange(1.15, 2.05, 0.1), [2.5, 3.0]])
)


def shape_grid(low: float, high: float, count: int) -> FloatArray:
    """Return `count` logarithms of the shape with every index, (G, 2): where a search begins."""
    log_shape, n2 = np.meshgrid(np.linspace(low, high, count), _GRID_N2, indexing="ij")
    return np.stack([log_shape.ravel(), n2.ravel()], axis=1)


@dataclass(frozen=True, slots=True)
class HalfVectorLobe:
    """What `gonio.fitting.columns.FitModel` asks, for any kernel."""

    kernel: ClassVar[Kernel]
    starts: ClassVar[int]
    linear: ClassVar[tuple[str, ...]] = ("rho_d", "k_n")
    name: ClassVar[str]
    shape: ClassVar[tuple[str, ...]]
    parameters: ClassVar[tuple[str, ...]]
    low: ClassVar[FloatArray]
    high: ClassVar[FloatArray]

    diffuse: FloatArray  # (n,)
    lobe: FacetLobe

    @classmethod
    def of(
        cls, receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: BoolArray
    ) -> Self:
        """Tabulate a receiver at n positions, (n,) each."""
        lobe = FacetLobe.of(cls.kernel, receiver, theta_i_deg, theta_o_deg, is_s)
        return cls(receiver.diffuse_integral(theta_o_deg, theta_i_deg), lobe)

    @staticmethod
    def published(basic: FloatArray) -> FloatArray:
        """Return (rho_d, rho_s, shape, n2), (m, 4), from (rho_d, k_n, log_shape, n2)."""
        return Problem.published(basic)

    @staticmethod
    def published_jacobian(basic: FloatArray) -> FloatArray:
        """Return the derivatives of the known by the basic parameters, (m, 4, 4)."""
        return Problem.published_jacobian(basic)

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        """Return the two columns at (log_shape, n2), (m, 2), and their derivatives up to `order`."""
        parts = self.lobe.evaluate(x[:, 0], x[:, 1], order)
        value = (self.diffuse[:, None], parts[0])
        if order == 0:
            return Columns(value)
        first = ((None, None), (parts[1], parts[2]))
        if order == 1:
            return Columns(value, first)
        none = ((None, None), (None, None))
        return Columns(value, first, (none, ((parts[3], parts[4]), (parts[4], parts[5]))))

    def start(self, y: FloatArray, w: FloatArray) -> FloatArray:
        """Return the best point of a grid over the whole range, (m, 2)."""
        return grid_start(self, y, w, shape_grid(float(self.low[0]), float(self.high[0]), self.starts))


@dataclass(frozen=True, slots=True)
class FitReciprocal(HalfVectorLobe):
    """`gonio.brdf.ReciprocalLobe`."""

    kernel: ClassVar[Kernel] = CosineKernel()
    starts: ClassVar[int] = 40
    name: ClassVar[str] = "reciprocal lobe"
    shape: ClassVar[tuple[str, ...]] = ("log_alpha", "n2")
    parameters: ClassVar[tuple[str, ...]] = ("rho_d", "rho_s", "alpha", "n2")
    low: ClassVar[FloatArray] = np.array([CosineKernel.low, N2_MIN])
    high: ClassVar[FloatArray] = np.array([CosineKernel.high, N2_MAX])

    @staticmethod
    def scattering(published: FloatArray) -> ScatteringModel:
        """Return the surface with (rho_d, rho_s, alpha, n2), (m, 4)."""
        return ReciprocalLobe(*published.T)


@dataclass(frozen=True, slots=True)
class FitGGX(HalfVectorLobe):
    """`gonio.brdf.GGX`."""

    kernel: ClassVar[Kernel] = GGXKernel()
    starts: ClassVar[int] = 40
    name: ClassVar[str] = "GGX"
    shape: ClassVar[tuple[str, ...]] = ("log_roughness", "n2")
    parameters: ClassVar[tuple[str, ...]] = ("rho_d", "rho_s", "roughness", "n2")
    low: ClassVar[FloatArray] = np.array([GGXKernel.low, N2_MIN])
    high: ClassVar[FloatArray] = np.array([GGXKernel.high, N2_MAX])

    @staticmethod
    def scattering(published: FloatArray) -> ScatteringModel:
        """Return the surface with (rho_d, rho_s, roughness, n2), (m, 4)."""
        return GGX(*published.T)

"""Coupled diffuse as the fit sees it: a body under a Fresnel interface, and the reciprocal lobe.

    r = rho_d B_i(n2) + k_n sum over j of q_x(n2, c_ij) W_ij(log_alpha),   k_n = rho_s R(0)

Here n2 shapes the diffuse column too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gonio.aperture import Receiver
from gonio.brdf import CoupledDiffuse, ScatteringModel
from gonio.fitting.columns import BoolArray, Columns, FloatArray
from gonio.fitting.models.body import Body
from gonio.fitting.models.half_vector import shape_grid
from gonio.fitting.models.kernels import CosineKernel
from gonio.fitting.models.lobes import FacetLobe
from gonio.fitting.problem import N2_MAX, N2_MIN, Problem
from gonio.fitting.solve import grid_start


@dataclass(frozen=True, slots=True)
class FitCoupled:
    """`gonio.fitting.columns.FitModel` of `gonio.brdf.CoupledDiffuse`."""

    name: ClassVar[str] = "coupled diffuse"
    linear: ClassVar[tuple[str, ...]] = ("rho_d", "k_n")
    shape: ClassVar[tuple[str, ...]] = ("log_alpha", "n2")
    parameters: ClassVar[tuple[str, ...]] = ("rho_d", "rho_s", "alpha", "n2")
    low: ClassVar[FloatArray] = np.array([CosineKernel.low, N2_MIN])
    high: ClassVar[FloatArray] = np.array([CosineKernel.high, N2_MAX])

    body: Body
    lobe: FacetLobe

    @classmethod
    def of(
        cls, receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: BoolArray
    ) -> FitCoupled:
        """Tabulate a receiver at n positions, (n,) each."""
        return cls(
            Body.of(receiver, theta_i_deg, theta_o_deg, is_s),
            FacetLobe.of(CosineKernel(), receiver, theta_i_deg, theta_o_deg, is_s),
        )

    @staticmethod
    def scattering(published: FloatArray) -> ScatteringModel:
        """Return the surface with (rho_d, rho_s, alpha, n2), (m, 4)."""
        return CoupledDiffuse(*published.T)

    @staticmethod
    def published(basic: FloatArray) -> FloatArray:
        """Return (rho_d, rho_s, alpha, n2), (m, 4), from (rho_d, k_n, log_alpha, n2)."""
        return Problem.published(basic)

    @staticmethod
    def published_jacobian(basic: FloatArray) -> FloatArray:
        """Return the derivatives of the known by the basic parameters, (m, 4, 4)."""
        return Problem.published_jacobian(basic)

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        """Return the two columns at (log_alpha, n2), (m, 2), and their derivatives up to `order`."""
        body, body_n, body_nn = self.body.evaluate(x[:, 1])
        parts = self.lobe.evaluate(x[:, 0], x[:, 1], order)
        value = (body, parts[0])
        if order == 0:
            return Columns(value)
        first = ((None, body_n), (parts[1], parts[2]))
        if order == 1:
            return Columns(value, first)
        curve = ((parts[3], parts[4]), (parts[4], parts[5]))
        return Columns(value, first, (((None, None), (None, body_nn)), curve))

    def start(self, y: FloatArray, w: FloatArray) -> FloatArray:
        """Return the best point of a grid over the whole range, (m, 2)."""
        return grid_start(self, y, w, shape_grid(float(self.low[0]), float(self.high[0]), 40))

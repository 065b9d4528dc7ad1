"""Modified Phong as the fit sees it: a white diffuse column and a lobe without Fresnel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Receiver
from gonio.brdf import ModifiedPhong, ScatteringModel
from gonio.fitting.columns import BoolArray, Columns, FloatArray
from gonio.fitting.models.kernels import CosineKernel
from gonio.fitting.models.lobes import tabulated
from gonio.fitting.models.table import FacetTable
from gonio.fitting.solve import grid_start


@dataclass(frozen=True, slots=True)
class FitPhong:
    """`gonio.brdf.ModifiedPhong`: ``r = rho_d D_i + rho_s L_i(log alpha)``."""

    name: ClassVar[str] = "modified Phong"
    linear: ClassVar[tuple[str, ...]] = ("rho_d", "rho_s")
    shape: ClassVar[tuple[str, ...]] = ("log_alpha",)
    parameters: ClassVar[tuple[str, ...]] = ("rho_d", "rho_s", "alpha")
    low: ClassVar[FloatArray] = np.array([CosineKernel.low])
    high: ClassVar[FloatArray] = np.array([CosineKernel.high])

    diffuse: FloatArray  # (n,)
    table: FacetTable
    geometry: NDArray[np.intp]  # (n,) index into the table's positions

    @classmethod
    def of(
        cls, receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: BoolArray
    ) -> FitPhong:
        """Tabulate a receiver at n positions, (n,) each; the polarization plays no part."""
        pairs, index = np.unique(np.stack([theta_i_deg, theta_o_deg]), axis=1, return_inverse=True)
        table, _ = tabulated(CosineKernel(), receiver, pairs)
        diffuse = receiver.diffuse_integral(theta_o_deg, theta_i_deg)
        return cls(diffuse, table.summed(pairs.shape[1]), index.reshape(-1))

    @staticmethod
    def scattering(published: FloatArray) -> ScatteringModel:
        """Return the surface with (rho_d, rho_s, alpha), (m, 3)."""
        return ModifiedPhong(*published.T)

    @staticmethod
    def published(basic: FloatArray) -> FloatArray:
        """Return (rho_d, rho_s, alpha), (m, 3), from (rho_d, rho_s, log_alpha)."""
        return np.stack([basic[:, 0], basic[:, 1], np.exp(basic[:, 2])], axis=1)

    @staticmethod
    def published_jacobian(basic: FloatArray) -> FloatArray:
        """Return the derivatives of the known by the basic parameters, (m, 3, 3)."""
        j = np.zeros((len(basic), 3, 3))
        j[:, 0, 0] = j[:, 1, 1] = 1.0
        j[:, 2, 2] = np.exp(basic[:, 2])
        return j

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        """Return the two columns at log_alpha, (m, 1), and their derivatives up to `order`."""
        parts = [w[self.geometry] for w in self.table.evaluate(x[:, 0], order)]
        value = (self.diffuse[:, None], parts[0])
        if order == 0:
            return Columns(value)
        first = ((None,), (parts[1],))
        return Columns(value, first) if order == 1 else Columns(value, first, (((None,),), ((parts[2],),)))

    def start(self, y: FloatArray, w: FloatArray) -> FloatArray:
        """Return the best point of a grid over the whole range, (m, 1)."""
        return grid_start(self, y, w, np.linspace(self.low, self.high, 120))

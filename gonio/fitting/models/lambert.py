"""Lambert as the fit sees it: one column, nothing to search for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gonio.aperture import Receiver
from gonio.brdf import Lambert, ScatteringModel
from gonio.fitting.columns import BoolArray, Columns, FloatArray


@dataclass(frozen=True, slots=True)
class FitLambert:
    """`gonio.fitting.columns.FitModel` of `gonio.brdf.Lambert`: ``r = rho_d D_i``."""

    name: ClassVar[str] = "Lambert"
    linear: ClassVar[tuple[str, ...]] = ("rho_d",)
    shape: ClassVar[tuple[str, ...]] = ()
    parameters: ClassVar[tuple[str, ...]] = ("rho_d",)
    low: ClassVar[FloatArray] = np.zeros(0)
    high: ClassVar[FloatArray] = np.zeros(0)

    diffuse: FloatArray  # (n,)

    @classmethod
    def of(
        cls, receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: BoolArray
    ) -> FitLambert:
        """Return the model at n positions, (n,) each; only the observation plays a part."""
        return cls(receiver.diffuse_integral(theta_o_deg, theta_i_deg))

    @staticmethod
    def scattering(published: FloatArray) -> ScatteringModel:
        """Return the surface with (rho_d,), (m, 1)."""
        return Lambert(*published.T)

    @staticmethod
    def published(basic: FloatArray) -> FloatArray:
        """Return (rho_d,), (m, 1): the basic parameter is the known one."""
        return basic.copy()

    @staticmethod
    def published_jacobian(basic: FloatArray) -> FloatArray:
        """Return ones, (m, 1, 1)."""
        return np.ones((len(basic), 1, 1))

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        """Return the column, (n, 1); nothing to derive it by."""
        value = (self.diffuse[:, None],)
        return Columns(value, ((),) if order > 0 else (), ((),) if order > 1 else ())

    def start(self, y: FloatArray, w: FloatArray) -> FloatArray:
        """Return no shape parameters, (m, 0)."""
        return np.zeros((y.shape[1], 0))

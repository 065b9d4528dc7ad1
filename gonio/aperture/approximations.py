"""The receivers of Raybaud et al. (2022): Eq 22 and Eq 18, kept so that their bias can be shown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gonio.angles import cos_deg
from gonio.aperture.receiver import FloatArray
from gonio.brdf.quadrature import band_integral, band_integral_table


@dataclass(frozen=True, slots=True)
class InPlaneAverage:
    """Eq 22: the dsf averaged over the in-plane angle only, times a solid angle."""

    half_width_deg: float
    solid_angle_sr: float

    @property
    def lobe_growth(self) -> float:
        """One half: a lobe is averaged over one angle, and its peak grows with the other."""
        return 0.5

    def lobe_integral(
        self,
        alpha: ArrayLike,
        delta_deg: ArrayLike,
        theta_o_deg: ArrayLike | None = None,
        theta_i_deg: ArrayLike | None = None,
    ) -> FloatArray:
        """Return Eq 22's lobe term; arguments as `Aperture.lobe_integral`."""
        half = np.deg2rad(self.half_width_deg)
        return band_integral(alpha, delta_deg, half, theta_o_deg, self._per_angle)

    def lobe_table(
        self,
        alpha: FloatArray,
        delta_deg: FloatArray,
        theta_o_deg: FloatArray,
        theta_i_deg: FloatArray | None = None,
    ) -> FloatArray:
        """Return `lobe_integral` of every alpha (n_alpha,) at every position (n,), as (n_alpha, n)."""
        half = np.deg2rad(self.half_width_deg)
        return band_integral_table(alpha, delta_deg, half, theta_o_deg, self._per_angle)

    def _per_angle(self, alpha: FloatArray, t: FloatArray) -> FloatArray:
        per_radian = self.solid_angle_sr / (2.0 * np.deg2rad(self.half_width_deg))
        return np.broadcast_to(
            per_radian * (alpha + 1.0) / (2.0 * np.pi), np.broadcast_shapes(alpha.shape, t.shape)
        )

    def diffuse_integral(self, theta_o_deg: ArrayLike, theta_i_deg: ArrayLike | None = None) -> FloatArray:
        """Return Eq 22's diffuse term, the in-plane mean of ``cos(theta)/pi`` above the sample plane."""
        theta_o = np.asarray(theta_o_deg, np.float64)
        low = np.clip(theta_o - self.half_width_deg, -90.0, 90.0)
        high = np.clip(theta_o + self.half_width_deg, -90.0, 90.0)
        # sin(high) - sin(low) without cancellation
        area = 2.0 * cos_deg(0.5 * (low + high)) * np.sin(np.deg2rad(0.5 * (high - low)))
        return np.asarray(self.solid_angle_sr / (2.0 * np.deg2rad(self.half_width_deg)) * area / np.pi)


@dataclass(frozen=True, slots=True)
class PointReceiver:
    """Eq 18: the dsf at the detector's axis, times a solid angle."""

    solid_angle_sr: float

    @property
    def lobe_growth(self) -> float:
        """One: the reading at the peak is the peak itself."""
        return 1.0

    def lobe_integral(
        self,
        alpha: ArrayLike,
        delta_deg: ArrayLike,
        theta_o_deg: ArrayLike | None = None,
        theta_i_deg: ArrayLike | None = None,
    ) -> FloatArray:
        """Return Eq 18's lobe term; arguments as `Aperture.lobe_integral`."""
        a, delta = np.asarray(alpha, np.float64), np.asarray(delta_deg, np.float64)
        log_cos = np.log1p(-2.0 * np.sin(np.deg2rad(0.5 * np.where(np.abs(delta) < 90.0, delta, 0.0))) ** 2)
        lobe = np.where(np.abs(delta) < 90.0, np.exp(a * log_cos), np.where(np.isnan(delta), np.nan, 0.0))
        if theta_o_deg is not None:
            lobe = np.where(np.abs(np.asarray(theta_o_deg, np.float64)) < 90.0, lobe, 0.0)
        return np.asarray(self.solid_angle_sr * (a + 1.0) / (2.0 * np.pi) * lobe)

    def lobe_table(
        self,
        alpha: FloatArray,
        delta_deg: FloatArray,
        theta_o_deg: FloatArray,
        theta_i_deg: FloatArray | None = None,
    ) -> FloatArray:
        """Return `lobe_integral` of every alpha (n_alpha,) at every position (n,), as (n_alpha, n)."""
        return self.lobe_integral(alpha[:, None], delta_deg, theta_o_deg)

    def diffuse_integral(self, theta_o_deg: ArrayLike, theta_i_deg: ArrayLike | None = None) -> FloatArray:
        """Return Eq 18's diffuse term, ``cos(theta_o)/pi``, zero below the sample plane."""
        return np.asarray(self.solid_angle_sr * np.maximum(cos_deg(theta_o_deg), 0.0) / np.pi)

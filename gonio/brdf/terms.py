"""What all models share: a diffuse term and a lobe, zero below the sample plane, and their sums."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.brdf.directions import Directions
from gonio.brdf.quantities import brdf_from_dsf
from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]


class DiffuseAndLobe(ABC):
    """Everything of `gonio.brdf.protocol.ScatteringModel` that follows from the terms of the dsf."""

    __slots__ = ()

    @abstractmethod
    def above(self, at: Directions, polarization: Polarization) -> FloatArray:
        """Return the dsf, 1/sr, of pairs of directions; what it says below the sample plane is not used."""

    @abstractmethod
    def diffuse_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_d: the part of the incident power that the diffuse term reflects."""

    @abstractmethod
    def specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_s: the part that the lobe reflects above the horizon."""

    def dsf(
        self,
        theta_i_deg: ArrayLike,
        theta_o_deg: ArrayLike,
        polarization: Polarization,
        azimuth_deg: ArrayLike = 0.0,
    ) -> FloatArray:
        """Return the differential scattering function, 1/sr; zero below the sample plane."""
        at = Directions.polar(theta_i_deg, theta_o_deg, azimuth_deg)
        return np.asarray(np.where(at.cos_o >= 0.0, self.above(at, polarization), 0.0))

    def brdf(
        self,
        theta_i_deg: ArrayLike,
        theta_o_deg: ArrayLike,
        polarization: Polarization,
        azimuth_deg: ArrayLike = 0.0,
    ) -> FloatArray:
        """Return the true BRDF, 1/sr; NaN at grazing observation and below the sample plane."""
        return brdf_from_dsf(self.dsf(theta_i_deg, theta_o_deg, polarization, azimuth_deg), theta_o_deg)

    def directional_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_g above the horizon, ``k_d + k_s``."""
        return np.asarray(
            self.diffuse_albedo(theta_i_deg, polarization) + self.specular_albedo(theta_i_deg, polarization)
        )


def spread(value: ArrayLike, theta_i_deg: ArrayLike) -> FloatArray:
    """Return a parameter in the broadcast shape of itself and the incidence, where that plays no part."""
    shape = np.broadcast_shapes(np.shape(value), np.shape(theta_i_deg))
    return np.array(np.broadcast_to(np.asarray(value, np.float64), shape))

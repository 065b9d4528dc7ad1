"""Lambert: perfectly diffuse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.brdf.directions import Directions
from gonio.brdf.terms import DiffuseAndLobe, spread
from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Lambert(DiffuseAndLobe):
    """A perfectly diffuse surface, ``dsf = rho_d/pi cos(theta_o)``, for every incidence and polarization."""

    rho_d: ArrayLike

    @property
    def name(self) -> str:
        """Name in files and tables."""
        return "Lambert"

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the constructor."""
        return ("rho_d",)

    def above(self, at: Directions, polarization: Polarization) -> FloatArray:
        """Return the dsf above the sample plane, 1/sr."""
        cos_o = np.broadcast_arrays(at.cos_o, at.versine)[0]
        return np.asarray(np.asarray(self.rho_d, np.float64) / np.pi * cos_o)

    def diffuse_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d``, whatever the incidence."""
        return spread(self.rho_d, theta_i_deg)

    def specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return zero."""
        return np.zeros_like(spread(self.rho_d, theta_i_deg))

    def published_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d``, whatever the incidence."""
        return self.diffuse_albedo(theta_i_deg, polarization)

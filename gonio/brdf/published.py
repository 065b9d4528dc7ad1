"""The published four-parameter lobe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio import fresnel
from gonio.brdf.directions import Directions
from gonio.brdf.lobe import lobe_above_horizon, lobe_dsf
from gonio.brdf.terms import DiffuseAndLobe, spread
from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PublishedLobe(DiffuseAndLobe):
    """Eq 17 of Raybaud et al. 2022: Lambert plus a Fresnel-weighted cosine lobe.

    ``dsf = rho_d/pi cos(theta_o) + rho_s R_x(n2, theta_i) (alpha + 1)/(2 pi) cos_+(theta_s)^alpha``

    It is not reciprocal, and near grazing incidence it may create energy; its BRDF diverges at grazing
    observation.

    Parameters
    ----------
    rho_d, rho_s, alpha, n2
        Numbers or arrays of one shape (per wavelength); they broadcast against the angles.
    """

    rho_d: ArrayLike
    rho_s: ArrayLike
    alpha: ArrayLike
    n2: ArrayLike

    @property
    def name(self) -> str:
        """Name in files and tables."""
        return "published lobe"

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the constructor."""
        return ("rho_d", "rho_s", "alpha", "n2")

    def above(self, at: Directions, polarization: Polarization) -> FloatArray:
        """Return the dsf above the sample plane, 1/sr (Eq 17)."""
        diffuse = np.asarray(self.rho_d, np.float64) / np.pi * at.cos_o
        r = fresnel.reflectance_at_cosine(self.n2, at.cos_i, polarization)
        return np.asarray(diffuse + np.asarray(self.rho_s) * r * lobe_dsf(self.alpha, at.versine))

    def diffuse_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``k_d = rho_d``, whatever the incidence."""
        return spread(self.rho_d, theta_i_deg)

    def specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_s: the lobe's energy above the horizon over the incident power."""
        published = self.published_specular_albedo(theta_i_deg, polarization)
        return np.asarray(published * lobe_above_horizon(self.alpha, theta_i_deg))

    def published_specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return Eq 19's ``k_s = rho_s R``, which counts the part of the lobe below the sample plane."""
        return np.asarray(np.asarray(self.rho_s) * fresnel.reflectance(self.n2, theta_i_deg, polarization))

    def published_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return Eq 20's ``k_g = rho_d + rho_s R``."""
        return np.asarray(np.asarray(self.rho_d) + self.published_specular_albedo(theta_i_deg, polarization))

"""The modified Phong model: Lambert and a cosine lobe, both as BRDFs, without Fresnel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.brdf.directions import Directions
from gonio.brdf.lobe import lobe_brdf, lobe_brdf_albedo
from gonio.brdf.terms import DiffuseAndLobe, spread
from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ModifiedPhong(DiffuseAndLobe):
    """Lafortune and Willems 1994 (report CW 197, KU Leuven): reciprocal, passive if ``rho_d + rho_s <= 1``.

    ``brdf = rho_d/pi + rho_s (alpha + 2)/(2 pi) cos_+(theta_s)^alpha``

    The same for S and P: the fit of a dielectric surface with it fails in the trend over incidence.

    Parameters
    ----------
    rho_d, rho_s, alpha
        Numbers or arrays of one shape (per wavelength); they broadcast against the angles.
    """

    rho_d: ArrayLike
    rho_s: ArrayLike
    alpha: ArrayLike

    @property
    def name(self) -> str:
        """Name in files and tables."""
        return "modified Phong"

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the constructor."""
        return ("rho_d", "rho_s", "alpha")

    def above(self, at: Directions, polarization: Polarization) -> FloatArray:
        """Return the dsf above the sample plane, 1/sr."""
        lobe = np.asarray(self.rho_s, np.float64) * lobe_brdf(self.alpha, at.versine)
        return np.asarray((np.asarray(self.rho_d, np.float64) / np.pi + lobe) * at.cos_o)

    def diffuse_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d``, whatever the incidence."""
        return spread(self.rho_d, theta_i_deg)

    def specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_s: `lobe_brdf_albedo` times rho_s, about ``rho_s cos(theta_i)`` for a narrow lobe."""
        return np.asarray(np.asarray(self.rho_s, np.float64) * lobe_brdf_albedo(self.alpha, theta_i_deg))

    def published_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d + rho_s``: what the authors ask to be at most 1, reached at normal incidence."""
        return spread(np.asarray(self.rho_d, np.float64) + np.asarray(self.rho_s, np.float64), theta_i_deg)

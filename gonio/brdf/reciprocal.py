"""The reciprocal lobe: the published one with what reciprocity asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio import fresnel
from gonio.brdf.directions import Directions
from gonio.brdf.hemisphere import lobe_albedo
from gonio.brdf.lobe import lobe_brdf
from gonio.brdf.terms import DiffuseAndLobe, spread
from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]

_NEGLIGIBLE = 40.0  # cos^alpha = exp(-40) ends the lobe


def reciprocal_lobe_dsf(
    alpha: ArrayLike, n2: ArrayLike, at: Directions, polarization: Polarization
) -> FloatArray:
    """Return ``R_x(n2, theta_h) (alpha + 2)/(2 pi) cos_+(theta_s)^alpha cos(theta_o)``, 1/sr."""
    r = fresnel.reflectance_at_cosine(n2, at.cos_h, polarization)
    return np.asarray(r * lobe_brdf(alpha, at.versine) * np.maximum(at.cos_o, 0.0))


def reciprocal_lobe_albedo(
    alpha: ArrayLike, n2: ArrayLike, theta_i_deg: ArrayLike, polarization: Polarization
) -> FloatArray:
    """Return the directional albedo of `reciprocal_lobe_dsf`, by quadrature, to about 1e-9 relative."""
    a = np.asarray(alpha, np.float64)
    with np.errstate(divide="ignore"):
        fall = -np.expm1(-_NEGLIGIBLE / a)  # 1 - cos at the end of the lobe
    end = 2.0 * np.arcsin(np.sqrt(0.5 * np.minimum(fall, 1.0)))

    def lobe(at: Directions, exponent: float, index: float) -> FloatArray:
        return reciprocal_lobe_dsf(exponent, index, at, polarization)

    return lobe_albedo(
        lobe, theta_i_deg, (a, n2), backward_rad=end, across_rad=end, width_rad=np.minimum(end, 0.3)
    )


@dataclass(frozen=True, slots=True)
class ReciprocalLobe(DiffuseAndLobe):
    """The published lobe made reciprocal: a BRDF with R at the incidence on the half-vector facet.

    ``brdf = rho_d/pi + rho_s R_x(n2, theta_h) (alpha + 2)/(2 pi) cos_+(theta_s)^alpha``

    For a narrow lobe k_s tends to ``rho_s R_x(theta_i) cos(theta_i)``: as a BRDF the lobe loses the cosine
    that the published dsf keeps.  Out of the plane of incidence the facet's own plane of incidence is turned
    against the polarizer's by a few degrees; R of the named polarization is taken nevertheless (the mean of S
    and P is exact).

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
        return "reciprocal lobe"

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the constructor."""
        return ("rho_d", "rho_s", "alpha", "n2")

    def above(self, at: Directions, polarization: Polarization) -> FloatArray:
        """Return the dsf above the sample plane, 1/sr."""
        lobe = reciprocal_lobe_dsf(self.alpha, self.n2, at, polarization)
        return np.asarray(
            np.asarray(self.rho_d, np.float64) / np.pi * at.cos_o + np.asarray(self.rho_s, np.float64) * lobe
        )

    def diffuse_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d``, whatever the incidence."""
        return spread(self.rho_d, theta_i_deg)

    def specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_s, the lobe's energy above the horizon, by quadrature."""
        albedo = reciprocal_lobe_albedo(self.alpha, self.n2, theta_i_deg, polarization)
        return np.asarray(np.asarray(self.rho_s, np.float64) * albedo)

    def published_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d + rho_s R(theta_i)``, the published lobe's Eq 20: too large by the cosine."""
        r = fresnel.reflectance(self.n2, theta_i_deg, polarization)
        return np.asarray(np.asarray(self.rho_d) + np.asarray(self.rho_s) * r)

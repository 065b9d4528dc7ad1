"""Coupled diffuse: what the interface reflects cannot reach the body beneath it.

Light of polarization x enters the body with ``1 - R_x(theta_i)``, is scattered there, loses its polarization,
and leaves with ``1 - R_u(theta_o)``, u the mean of S and P:

    brdf_d = rho_d / (pi (1 - Rm)) (1 - R_x(n2, theta_i)) (1 - R_u(n2, theta_o)),
    Rm = ∫ R_u 2 cos(theta) d cos(theta)

The factor ``1/(1 - Rm)`` makes **rho_d the part of the entered light that comes out again** (the body's
albedo, internal reflections included): the directional albedo of this term is exactly ``rho_d (1 -
R_x(theta_i))``.  With a lobe that reflects at most R_x(theta_i) energy is kept for every rho_d <= 1.  (The
reciprocal diffuse terms of Shirley et al. 1997 and of Ashikhmin and Shirley 2000 have this form, with
Schlick's R.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio import fresnel
from gonio.brdf.directions import Directions
from gonio.brdf.hemisphere import mean_reflectance
from gonio.brdf.lobe import lobe_above_horizon, lobe_dsf
from gonio.brdf.reciprocal import reciprocal_lobe_albedo, reciprocal_lobe_dsf
from gonio.brdf.terms import DiffuseAndLobe
from gonio.errors import GonioError
from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]
Lobe = Literal["reciprocal", "published"]


@dataclass(frozen=True, slots=True)
class CoupledDiffuse(DiffuseAndLobe):
    """A body under a Fresnel interface: the coupled diffuse term and a lobe.

    Parameters
    ----------
    rho_d, rho_s, alpha, n2
        Numbers or arrays of one shape (per wavelength); they broadcast against the angles.
    lobe
        ``"reciprocal"`` (that of `ReciprocalLobe`) or ``"published"`` (that of `PublishedLobe`, not
        reciprocal).

    Raises
    ------
    GonioError
        Another lobe.
    """

    rho_d: ArrayLike
    rho_s: ArrayLike
    alpha: ArrayLike
    n2: ArrayLike
    lobe: Lobe = "reciprocal"

    def __post_init__(self) -> None:
        if self.lobe not in ("reciprocal", "published"):
            raise GonioError(f"lobe = {self.lobe!r} is not known; use 'reciprocal' or 'published'")

    @property
    def name(self) -> str:
        """Name in files and tables."""
        return "coupled diffuse" if self.lobe == "reciprocal" else "coupled diffuse, published lobe"

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the constructor."""
        return ("rho_d", "rho_s", "alpha", "n2")

    def above(self, at: Directions, polarization: Polarization) -> FloatArray:
        """Return the dsf above the sample plane, 1/sr."""
        r_in = fresnel.reflectance_at_cosine(self.n2, at.cos_i, polarization)
        r_out = fresnel.reflectance_at_cosine(self.n2, np.maximum(at.cos_o, 0.0), "unpolarized")
        share = (1.0 - r_in) * (1.0 - r_out) / (1.0 - mean_reflectance(self.n2))
        diffuse = np.asarray(self.rho_d, np.float64) / np.pi * share * at.cos_o
        if self.lobe == "reciprocal":
            lobe = reciprocal_lobe_dsf(self.alpha, self.n2, at, polarization)
        else:
            lobe = r_in * lobe_dsf(self.alpha, at.versine)
        return np.asarray(diffuse + np.asarray(self.rho_s, np.float64) * lobe)

    def diffuse_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d (1 - R_x(theta_i))``, exactly."""
        return np.asarray(
            np.asarray(self.rho_d, np.float64)
            * (1.0 - fresnel.reflectance(self.n2, theta_i_deg, polarization))
        )

    def specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_s, the lobe's energy above the horizon."""
        if self.lobe == "reciprocal":
            albedo = reciprocal_lobe_albedo(self.alpha, self.n2, theta_i_deg, polarization)
        else:
            r = fresnel.reflectance(self.n2, theta_i_deg, polarization)
            albedo = r * lobe_above_horizon(self.alpha, theta_i_deg)
        return np.asarray(np.asarray(self.rho_s, np.float64) * albedo)

    def published_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d (1 - R) + rho_s R``, which counts the whole lobe."""
        r = fresnel.reflectance(self.n2, theta_i_deg, polarization)
        return np.asarray(np.asarray(self.rho_d) * (1.0 - r) + np.asarray(self.rho_s) * r)

"""Microfacets: GGX slopes, Smith masking, Fresnel at the half vector, over Lambert.

Walter, Marschner, Li, Torrance, *Microfacet models for refraction through rough surfaces*, EGSR 2007: the
distribution of normals (Eq 33) and the reflection term (Eq 20); Cook and Torrance 1982 for the form.  Masking
and shadowing are **height-correlated** (Heitz, JCGT 3(2), 2014, Eq 99), ``G = 1 / (1 + L_i + L_o)``, not
Walter's product ``G1(i) G1(o)``, which counts a facet that is both masked and shadowed twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio import fresnel
from gonio.angles import cos_deg
from gonio.brdf.directions import Directions
from gonio.brdf.hemisphere import lobe_albedo
from gonio.brdf.terms import DiffuseAndLobe, spread
from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]


def ggx_dsf(roughness: ArrayLike, at: Directions) -> FloatArray:
    """Return ``D G cos(theta_o) / (4 cos(theta_i) cos(theta_o))``, 1/sr: the lobe with R = 1.

    ``D = a^2 / (pi cos^4(theta_m) (a^2 + tan^2(theta_m))^2)`` and ``G / (4 cos_i cos_o) = 1 / (2 (cos_o
    sqrt(cos_i^2 + a^2 sin_i^2) + cos_i sqrt(cos_o^2 + a^2 sin_o^2)))``; finite at grazing incidence and
    observation.
    """
    a2 = np.asarray(roughness, np.float64) ** 2
    length2 = at.tangential2 + at.normal2
    below = a2 * at.normal2 + at.tangential2
    # i and o opposite and both grazing: any facet would do
    slopes = a2 / np.pi * (length2 / np.where(below > 0.0, below, 1.0)) ** 2
    cos_i, cos_o = at.cos_i, np.maximum(at.cos_o, 0.0)
    seen = cos_o * np.sqrt(cos_i**2 + a2 * (1.0 - cos_i**2)) + cos_i * np.sqrt(
        cos_o**2 + a2 * (1.0 - cos_o**2)
    )
    return np.asarray(slopes * 0.5 * cos_o / np.where(seen > 0.0, seen, 1.0))


def ggx_albedo(
    roughness: ArrayLike, n2: ArrayLike, theta_i_deg: ArrayLike, polarization: Polarization
) -> FloatArray:
    """Return the directional albedo of `ggx_dsf` times R, by quadrature, to about 1e-9 relative."""
    a = np.asarray(roughness, np.float64)

    def lobe(at: Directions, rough: float, index: float) -> FloatArray:
        return ggx_dsf(rough, at) * fresnel.reflectance_at_cosine(index, at.cos_h, polarization)

    cos_i = np.maximum(cos_deg(theta_i_deg), 0.0)
    return lobe_albedo(
        lobe,
        theta_i_deg,
        (a, n2),
        backward_rad=0.5 * np.pi + np.deg2rad(np.asarray(theta_i_deg, np.float64)),
        across_rad=0.5 * np.pi,
        # seen from the side the lobe is foreshortened across the plane of incidence
        width_rad=np.minimum(a, 0.3) * np.maximum(cos_i, np.minimum(a, 0.3)),
    )


@dataclass(frozen=True, slots=True)
class GGX(DiffuseAndLobe):
    """Lambert plus rough dielectric facets.

    ``brdf = rho_d/pi + rho_s R_x(n2, theta_h) D G / (4 cos(theta_i) cos(theta_o))``

    The facets reflect once; what they would reflect twice is lost: of R = 1 at normal incidence 1.2 % at
    roughness 0.1, 12 % at 0.3, and ln 2 = 69 % at 1.  With rho_s = 1 this is a real interface.  At normal
    incidence the lobe falls to half at the same angle as a cosine lobe of ``alpha = 0.84 / roughness^2``, and
    has longer tails.  Polarization out of plane as in `ReciprocalLobe`.

    Parameters
    ----------
    rho_d, rho_s, roughness, n2
        Numbers or arrays of one shape (per wavelength); they broadcast against the angles. `roughness` is
        Walter's alpha_g, the rms-like slope, 1e-4...1.
    """

    rho_d: ArrayLike
    rho_s: ArrayLike
    roughness: ArrayLike
    n2: ArrayLike

    @property
    def name(self) -> str:
        """Name in files and tables."""
        return "GGX"

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the constructor."""
        return ("rho_d", "rho_s", "roughness", "n2")

    def above(self, at: Directions, polarization: Polarization) -> FloatArray:
        """Return the dsf above the sample plane, 1/sr."""
        r = fresnel.reflectance_at_cosine(self.n2, at.cos_h, polarization)
        lobe = np.asarray(self.rho_s, np.float64) * r * ggx_dsf(self.roughness, at)
        return np.asarray(np.asarray(self.rho_d, np.float64) / np.pi * at.cos_o + lobe)

    def diffuse_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d``, whatever the incidence."""
        return spread(self.rho_d, theta_i_deg)

    def specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_s, what the facets reflect above the horizon at the first bounce, by quadrature."""
        albedo = ggx_albedo(self.roughness, self.n2, theta_i_deg, polarization)
        return np.asarray(np.asarray(self.rho_s, np.float64) * albedo)

    def published_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d + rho_s R(theta_i)``, the limit of a flat surface; no other formula is published."""
        r = fresnel.reflectance(self.n2, theta_i_deg, polarization)
        return np.asarray(np.asarray(self.rho_d) + np.asarray(self.rho_s) * r)

"""What is the scattering of a surface: the published four-parameter lobe, and Lambert.

A model gives its **dsf** [1/sr], the differential scattering function of ASTM E2387: reflected intensity per
incident power.  The true BRDF is ``dsf / cos(theta_o)``; conversions have names (`brdf_from_dsf`,
`reflectance_factor_from_brdf`) and nothing here calls a dsf a BRDF.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from gonio import fresnel
from gonio.angles import cos_deg, one_minus_cos_to_mirror
from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]


@runtime_checkable
class ScatteringModel(Protocol):
    """What checks, exporters and figures ask of a model; every method broadcasts over its parameters."""

    @property
    def name(self) -> str:
        """Name in files and tables."""
        ...

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the constructor."""
        ...

    def dsf(
        self,
        theta_i_deg: ArrayLike,
        theta_o_deg: ArrayLike,
        polarization: Polarization,
        azimuth_deg: ArrayLike = 0.0,
    ) -> FloatArray:
        """Return the differential scattering function, 1/sr; zero below the sample plane."""
        ...

    def directional_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return the part of the incident power that is reflected above the horizon."""
        ...

    def published_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return the albedo by the model's published formula, whatever it leaves out."""
        ...


def brdf_from_dsf(dsf: ArrayLike, theta_o_deg: ArrayLike) -> FloatArray:
    """Return the BRDF, 1/sr: ``dsf / cos(theta_o)``; NaN where it is undefined, at grazing observation."""
    c = cos_deg(theta_o_deg)
    return np.asarray(np.asarray(dsf, np.float64) / np.where(c > 0.0, c, np.nan))


def dsf_from_brdf(brdf: ArrayLike, theta_o_deg: ArrayLike) -> FloatArray:
    """Return the differential scattering function, 1/sr: ``brdf * cos(theta_o)``."""
    return np.asarray(np.asarray(brdf, np.float64) * np.maximum(cos_deg(theta_o_deg), 0.0))


def reflectance_factor_from_brdf(brdf: ArrayLike) -> FloatArray:
    """Return the reflectance factor, ``pi * brdf``: relative to the perfect Lambertian reflector."""
    return np.asarray(np.pi * np.asarray(brdf, np.float64))


def lobe_dsf(alpha: ArrayLike, one_minus_cos: ArrayLike) -> FloatArray:
    """Return ``(alpha + 1)/(2 pi) cos_+(theta_s)^alpha``, 1/sr, from ``1 - cos(theta_s)``."""
    a, versine = np.asarray(alpha, np.float64), np.asarray(one_minus_cos, np.float64)
    front = versine < 1.0
    power = np.exp(a * np.log1p(-np.where(front, versine, 0.0)))
    return np.asarray((a + 1.0) / (2.0 * np.pi) * np.where(front, power, 0.0))


def lobe_above_horizon(alpha: ArrayLike, theta_i_deg: ArrayLike) -> FloatArray:
    """Return the fraction of the lobe's energy above the sample plane.

    With the in-plane angle t from the mirror direction the horizon is ``t = 90 deg - theta_i`` for every psi,
    so the psi integral factors out and ``∫ cos(t)^alpha dt`` leaves ``(1 + I_x(1/2, (alpha + 1)/2)) / 2``,
    ``x = cos(theta_i)^2``.  It is 1 at normal incidence and 1/2 at grazing.
    """
    x = cos_deg(theta_i_deg) ** 2
    return np.asarray(0.5 + 0.5 * special.betainc(0.5, 0.5 * (np.asarray(alpha, np.float64) + 1.0), x))


def lobe_above_horizon_dlog_alpha(alpha: ArrayLike, theta_i_deg: ArrayLike) -> FloatArray:
    """Return the derivative of `lobe_above_horizon` by log(alpha), from central differences (1e-9)."""
    a, step = np.asarray(alpha, np.float64), 1e-4
    up, down = (
        lobe_above_horizon(a * np.exp(step), theta_i_deg),
        lobe_above_horizon(a * np.exp(-step), theta_i_deg),
    )
    return np.asarray((up - down) / (2.0 * step))


@dataclass(frozen=True, slots=True)
class PublishedLobe:
    """Eq 17 of Raybaud et al. 2022: Lambert plus a Fresnel-weighted cosine lobe.

    ``dsf = rho_d/pi cos(theta_o) + rho_s R_x(n2, theta_i) (alpha + 1)/(2 pi) cos_+(theta_s)^alpha``

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

    def dsf(
        self,
        theta_i_deg: ArrayLike,
        theta_o_deg: ArrayLike,
        polarization: Polarization,
        azimuth_deg: ArrayLike = 0.0,
    ) -> FloatArray:
        """Return the dsf, 1/sr; zero below the sample plane (Eq 17)."""
        lobe = lobe_dsf(self.alpha, one_minus_cos_to_mirror(theta_i_deg, theta_o_deg, azimuth_deg))
        above = cos_deg(theta_o_deg)
        diffuse = np.asarray(self.rho_d, np.float64) / np.pi * above
        specular = np.asarray(self.rho_s) * fresnel.reflectance(self.n2, theta_i_deg, polarization) * lobe
        return np.asarray(np.where(above >= 0.0, diffuse + specular, 0.0))

    def brdf(
        self,
        theta_i_deg: ArrayLike,
        theta_o_deg: ArrayLike,
        polarization: Polarization,
        azimuth_deg: ArrayLike = 0.0,
    ) -> FloatArray:
        """Return the true BRDF, 1/sr; it diverges at grazing observation, where it is NaN."""
        return brdf_from_dsf(self.dsf(theta_i_deg, theta_o_deg, polarization, azimuth_deg), theta_o_deg)

    def specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_s: the lobe's energy above the horizon over the incident power."""
        published = self.published_specular_albedo(theta_i_deg, polarization)
        return np.asarray(published * lobe_above_horizon(self.alpha, theta_i_deg))

    def published_specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return Eq 19's ``k_s = rho_s R``, which counts the part of the lobe below the sample plane."""
        return np.asarray(np.asarray(self.rho_s) * fresnel.reflectance(self.n2, theta_i_deg, polarization))

    def directional_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_g above the horizon, ``rho_d + k_s``; it may pass 1 at grazing incidence."""
        return np.asarray(np.asarray(self.rho_d) + self.specular_albedo(theta_i_deg, polarization))

    def published_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return Eq 20's ``k_g = rho_d + rho_s R``."""
        return np.asarray(np.asarray(self.rho_d) + self.published_specular_albedo(theta_i_deg, polarization))


@dataclass(frozen=True, slots=True)
class Lambert:
    """A perfectly diffuse surface, ``dsf = rho_d/pi cos(theta_o)``."""

    rho_d: ArrayLike

    @property
    def name(self) -> str:
        """Name in files and tables."""
        return "Lambert"

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the constructor."""
        return ("rho_d",)

    def dsf(
        self,
        theta_i_deg: ArrayLike,
        theta_o_deg: ArrayLike,
        polarization: Polarization,
        azimuth_deg: ArrayLike = 0.0,
    ) -> FloatArray:
        """Return the dsf, 1/sr, the same for every incidence, azimuth and polarization."""
        above = np.broadcast_arrays(theta_i_deg, cos_deg(theta_o_deg), azimuth_deg)[1]
        return np.asarray(np.asarray(self.rho_d, np.float64) / np.pi * np.maximum(above, 0.0))

    def brdf(
        self,
        theta_i_deg: ArrayLike,
        theta_o_deg: ArrayLike,
        polarization: Polarization,
        azimuth_deg: ArrayLike = 0.0,
    ) -> FloatArray:
        """Return ``rho_d / pi``, 1/sr; NaN below the sample plane."""
        return brdf_from_dsf(self.dsf(theta_i_deg, theta_o_deg, polarization, azimuth_deg), theta_o_deg)

    def directional_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d``, whatever the incidence."""
        return np.asarray(np.asarray(self.rho_d, np.float64) + 0.0 * np.asarray(theta_i_deg))

    def published_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return ``rho_d``, whatever the incidence."""
        return self.directional_albedo(theta_i_deg, polarization)

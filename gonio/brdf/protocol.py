"""What does every scattering model answer?

A model gives its **dsf** [1/sr], the differential scattering function of ASTM E2387: reflected intensity per
incident power.  The true BRDF is ``dsf / cos(theta_o)``; conversions have names
(`gonio.brdf.quantities`) and nothing here calls a dsf a BRDF.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]


@runtime_checkable
class ScatteringModel(Protocol):
    """What checks, exporters, figures and the fit ask of a model; every method broadcasts over parameters.

    The polarization is that of the incident light; the detector sees both (`gonio.brdf.checks` says what
    reciprocity means then).
    """

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

    def brdf(
        self,
        theta_i_deg: ArrayLike,
        theta_o_deg: ArrayLike,
        polarization: Polarization,
        azimuth_deg: ArrayLike = 0.0,
    ) -> FloatArray:
        """Return the true BRDF, ``dsf / cos(theta_o)``, 1/sr; NaN at grazing and below the plane."""
        ...

    def diffuse_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_d: the part of the incident power that the diffuse term reflects."""
        ...

    def specular_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_s: the part that the lobe reflects above the horizon."""
        ...

    def directional_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return k_g, the sum of both: all that is reflected above the horizon."""
        ...

    def published_albedo(self, theta_i_deg: ArrayLike, polarization: Polarization) -> FloatArray:
        """Return the albedo by the model's published formula, whatever it leaves out."""
        ...

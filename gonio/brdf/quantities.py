"""How do dsf, BRDF and reflectance factor follow from each other?"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.angles import cos_deg

FloatArray = NDArray[np.float64]


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

"""Power reflectance of the sample's smooth surface, air to refractive index n2."""

from __future__ import annotations

import math


def reflectances(cos_theta_i: float, n2: float) -> tuple[float, float]:
    """Return the Fresnel power reflectances (R_s, R_p) for light from air.

    Snell's law in the form ``q = n2 cos(theta_t) = sqrt(n2^2 - 1 + cos^2(theta_i))``, in which n2 = 1 gives
    exactly 0 and grazing incidence exactly 1:  ``r_s = (c - q)/(c + q)``,  ``r_p = (n2^2 c - q)/(n2^2 c +
    q)`` (Raybaud et al. 2022, Eq 11-12).

    Parameters
    ----------
    cos_theta_i
        Cosine of the incidence angle, 0...1.
    n2
        Refractive index of the sample, at least 1.
    """
    c, n_squared = cos_theta_i, n2 * n2
    if n2 == 1.0:
        return 0.0, 0.0
    q = math.sqrt((n2 - 1.0) * (n2 + 1.0) + c * c)
    return ((c - q) / (c + q)) ** 2, ((n_squared * c - q) / (n_squared * c + q)) ** 2

"""How do two directions lie to the normal, to the mirror direction and to their half vector?

With i the direction towards the source and o that of observation, unit vectors, z along the normal and x in
the plane of incidence on the specular side: ``i = (-sin theta_i, 0, cos theta_i)``.  A lobe about the mirror
direction asks for ``1 - cos(theta_s)``, a microfacet for the slope of ``h = i + o`` and for the incidence
theta_h on a facet with that normal, ``cos(theta_h) = |i + o| / 2``.  All are written as sums of small terms:
a lobe of 1e-4 rad would lose every digit in differences of cosines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.angles import cos_deg, one_minus_cos_to_mirror, sin_deg

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Directions:
    """Pairs of incidence and observation; every array in one broadcast shape.

    Attributes
    ----------
    cos_i, cos_o
        Cosines to the normal; `cos_o` is negative below the sample plane.
    versine
        ``1 - cos(theta_s)``, theta_s the angle to the mirror direction.
    cos_h
        Cosine of the incidence on a facet whose normal is the half vector.
    tangential2, normal2
        Squares of the parts of ``i + o`` along the surface and along its normal; their ratio is the square of
        the facet's slope.
    """

    cos_i: FloatArray
    cos_o: FloatArray
    versine: FloatArray
    cos_h: FloatArray
    tangential2: FloatArray
    normal2: FloatArray

    @classmethod
    def polar(
        cls, theta_i_deg: ArrayLike, theta_o_deg: ArrayLike, azimuth_deg: ArrayLike = 0.0
    ) -> Directions:
        """Return the pairs of angles from the normal and of azimuth, degrees; see `gonio.angles`."""
        theta_i, theta_o = np.asarray(theta_i_deg, np.float64), np.asarray(theta_o_deg, np.float64)
        azimuth = np.asarray(azimuth_deg, np.float64)
        sin_i, sin_o, turn = sin_deg(theta_i), sin_deg(theta_o), sin_deg(0.5 * azimuth) ** 2
        middle = cos_deg(0.5 * (theta_o + theta_i))
        dx = 2.0 * middle * sin_deg(0.5 * (theta_o - theta_i)) - 2.0 * sin_o * turn
        cos_i, cos_o = cos_deg(theta_i), cos_deg(theta_o)
        return cls(
            cos_i,
            cos_o,
            one_minus_cos_to_mirror(theta_i, theta_o, azimuth),
            np.sqrt(np.maximum(middle**2 + sin_i * sin_o * turn, 0.0)),
            dx**2 + (sin_o * sin_deg(azimuth)) ** 2,
            (cos_i + cos_o) ** 2,
        )

    @classmethod
    def off_plane(cls, theta_i: ArrayLike, offset: ArrayLike, psi: ArrayLike) -> Directions:
        """Return the pairs of directions `psi` out of the plane of incidence, radians.

        `offset` is the in-plane angle from the mirror direction: ``o = (sin(t) cos(psi), sin(psi), cos(t)
        cos(psi))``, ``t = theta_i + offset``, ``dOmega = cos(psi) dpsi dt``.
        """
        p = np.asarray(psi, np.float64)
        return cls.tilted(theta_i, offset, np.cos(p), np.sin(p))

    @classmethod
    def tilted(
        cls, theta_i: ArrayLike, offset: ArrayLike, cos_psi: ArrayLike, sin_psi: ArrayLike
    ) -> Directions:
        """Return the pairs of `off_plane` from cosine and sine of psi, ``|psi| <= 90 deg``."""
        i, u, cos_p, sin_p = (np.asarray(x, np.float64) for x in (theta_i, offset, cos_psi, sin_psi))
        across2, middle = sin_p**2, np.cos(i + 0.5 * u)
        rise = across2 / (1.0 + cos_p)  # 1 - cos(psi)
        cos_i, cos_o = np.cos(i), np.cos(i + u) * cos_p
        dx = 2.0 * middle * np.sin(0.5 * u) - np.sin(i + u) * rise
        return cls(
            cos_i,
            cos_o,
            2.0 * np.sin(0.5 * u) ** 2 + np.cos(u) * rise,
            np.sqrt(middle**2 * cos_p + 0.5 * rise),
            dx**2 + across2,
            (cos_i + cos_o) ** 2,
        )

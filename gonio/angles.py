"""Angles of a goniospectrophotometer, their signs, and the conversions between them.

Everything is measured in the plane of incidence, from the sample's normal, in degrees at every boundary::

                         normal
                           |
        incident beam      |        mirror direction
        theta_o = -theta_i |        theta_o = +theta_i
                  \\        |        /
                   \\       |       /      . detector at theta_o
                    \\      |      /    .
                     \\  i  |  i  /  .
                      \\    |    /.   theta_o > 0: the specular side
        ---------------------o---------------------- sample
                      ^ theta_mes is measured from the incident beam,
                        over the normal, to the detector: theta_o = theta_mes - theta_i

* `theta_i` 0...90, incidence; it is never negative.
* `theta_o` -90...90, observation, positive on the specular side.
* `theta_mes` the detector arm's own angle.  With ``|theta_mes| < 15`` the arm would shadow the beam (blind
zone).
* `delta = theta_i - theta_o` leads from the detector's axis to the mirror direction.
* `azimuth` leaves the plane of incidence: 0 on the specular side, 180 on the side of the incident beam.

Sines and cosines here are exact at multiples of 90 degrees: a beam at 90 degrees grazes, it is not 6e-17
above.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def theta_o_from_theta_mes(*, theta_mes_deg: ArrayLike, theta_i_deg: ArrayLike) -> FloatArray:
    """Return the observation angle, degrees from the normal, of a detector at `theta_mes_deg`."""
    return np.asarray(np.asarray(theta_mes_deg, np.float64) - np.asarray(theta_i_deg, np.float64))


def theta_mes_from_theta_o(*, theta_o_deg: ArrayLike, theta_i_deg: ArrayLike) -> FloatArray:
    """Return the detector arm's angle from the incident beam, degrees."""
    return np.asarray(np.asarray(theta_o_deg, np.float64) + np.asarray(theta_i_deg, np.float64))


def cos_deg(angle_deg: ArrayLike) -> FloatArray:
    """Return the cosine of an angle in degrees, exactly 0 at ±90 and ±1 at multiples of 180."""
    # fmod and the differences from 90 are exact in binary arithmetic, so no digit is lost near the zero
    folded = np.abs(np.fmod(np.asarray(angle_deg, np.float64), 360.0))
    folded = np.where(folded > 180.0, 360.0 - folded, folded)
    return np.asarray(np.sin(np.deg2rad(90.0 - folded)))


def sin_deg(angle_deg: ArrayLike) -> FloatArray:
    """Return the sine of an angle in degrees, exactly 0 at multiples of 180."""
    angle = np.fmod(np.asarray(angle_deg, np.float64), 360.0)
    angle = np.where(angle > 180.0, angle - 360.0, np.where(angle < -180.0, angle + 360.0, angle))
    folded = np.where(angle > 90.0, 180.0 - angle, np.where(angle < -90.0, -180.0 - angle, angle))
    return np.asarray(np.sin(np.deg2rad(folded)))


def one_minus_cos_to_mirror(
    theta_i_deg: ArrayLike, theta_o_deg: ArrayLike, azimuth_deg: ArrayLike = 0.0
) -> FloatArray:
    """Return ``1 - cos(theta_s)``, theta_s the angle between an observation and the mirror direction.

    In plane ``theta_s = theta_o - theta_i``; a negative `theta_o_deg` with azimuth 0 is the same direction as
    a positive one with azimuth 180.  Haversines keep the digits that ``1 - cos`` loses for narrow lobes.
    """
    theta_i, theta_o = np.asarray(theta_i_deg, np.float64), np.asarray(theta_o_deg, np.float64)
    in_plane = 2.0 * sin_deg((theta_o - theta_i) / 2.0) ** 2
    across = 2.0 * sin_deg(np.asarray(azimuth_deg, np.float64) / 2.0) ** 2
    return np.asarray(in_plane + sin_deg(theta_i) * sin_deg(theta_o) * across)

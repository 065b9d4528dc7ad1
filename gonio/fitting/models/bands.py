"""Which directions does a receiver see?  Bands of in-plane angle, each with an extent out of plane.

Angles are those of `gonio.aperture`: t in plane and psi out of plane, ``dOmega = cos(psi) dpsi dt``.  The
scattering models are symmetric in psi, so a rectangle is one half, ``0 <= psi <= atan(tangent cos(t))`` with
t from the arm's axis, counted twice; a rectangle seen from beside its axis is two halves with different
tangents.  Eq 22 of Raybaud et al. (2022) is a band without extent, Eq 18 a single direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture, InPlaneAverage, PointReceiver, Receiver
from gonio.errors import FitError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Bands:
    """Bands of n readings; a reading is the weighted sum of the integrals over its bands.

    Attributes
    ----------
    position
        The reading that a band belongs to, (b,).
    theta_i, low, high
        Incidence and in-plane limits from the normal, radians, (b,); cut at the sample plane, empty where
        ``low >= high`` (but for `single` directions).
    axis
        The arm's direction from the normal, radians, (b,): psi ends at ``atan(tangent cos(t - axis))``.
    tangent
        (b,); 0 where there is no extent out of plane.
    weight
        (b,).
    flat
        The integral is over t alone, ``∫ dsf dt``, at psi = 0.
    single
        The value at `axis`, without any integral.
    """

    position: NDArray[np.intp]
    theta_i: FloatArray
    low: FloatArray
    high: FloatArray
    axis: FloatArray
    tangent: FloatArray
    weight: FloatArray
    flat: bool
    single: bool

    @property
    def psi_most(self) -> FloatArray:
        """Largest psi of every band, (b,)."""
        return np.arctan(self.tangent)

    def pick(self, rows: NDArray[np.intp]) -> Bands:
        """Return some of the bands."""
        return Bands(
            self.position[rows],
            self.theta_i[rows],
            self.low[rows],
            self.high[rows],
            self.axis[rows],
            self.tangent[rows],
            self.weight[rows],
            self.flat,
            self.single,
        )


def bands_of(receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray) -> Bands:
    """Return the bands of a receiver at n positions, (n,) degrees each.

    Raises
    ------
    FitError
        A receiver that is not known here.
    """
    n = theta_i_deg.size
    theta_i, axis = np.deg2rad(theta_i_deg), np.deg2rad(theta_o_deg)
    position, tangent = np.arange(n), np.zeros(n)
    if isinstance(receiver, Aperture):
        half, flat, single = np.deg2rad(receiver.half_angles_deg[0]), False, False
        tangent = np.full(n, receiver.height_mm / (2.0 * receiver.distance_mm))
        weight = 2.0
    elif isinstance(receiver, InPlaneAverage):
        half, flat, single = np.deg2rad(receiver.half_width_deg), True, False
        weight = receiver.solid_angle_sr / (2.0 * half)
    elif isinstance(receiver, PointReceiver):
        half, flat, single, weight = 0.0, True, True, receiver.solid_angle_sr
    else:
        raise FitError(
            f"{type(receiver).__name__} cannot be integrated over this scattering model; "
            "use the aperture or one of its variants, or fit the published lobe"
        )
    horizon = 0.5 * np.pi
    low, high = np.maximum(axis - half, -horizon), np.minimum(axis + half, horizon)
    return Bands(position, theta_i, low, high, axis, tangent, np.full(n, float(weight)), flat, single)

"""What a model of the instrument must answer: how much of a lobe, and of diffuse light, makes a reading."""

from __future__ import annotations

from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
ApertureName = Literal["exact", "eq22", "point", "published"]
APERTURE_NAMES: tuple[ApertureName, ...] = get_args(ApertureName)


class Receiver(Protocol):
    """What turns a dsf into the reading r: the exact aperture or one of its approximations."""

    @property
    def solid_angle_sr(self) -> float:
        """The solid angle that multiplies a constant intensity."""
        ...

    @property
    def lobe_growth(self) -> float:
        """Exponent g of the peak reading, ``alpha^g``, for a lobe much narrower than the aperture."""
        ...

    def lobe_integral(
        self,
        alpha: ArrayLike,
        delta_deg: ArrayLike,
        theta_o_deg: ArrayLike | None = None,
        theta_i_deg: ArrayLike | None = None,
    ) -> FloatArray:
        """Return the received part of ``(alpha + 1)/(2 pi) cos_+(theta_s)^alpha``.

        `theta_i_deg` matters only to a beam with a width, and is ``theta_o + delta`` if not given.
        """
        ...

    def lobe_table(
        self,
        alpha: FloatArray,
        delta_deg: FloatArray,
        theta_o_deg: FloatArray,
        theta_i_deg: FloatArray | None = None,
    ) -> FloatArray:
        """Return `lobe_integral` of every alpha with every position, (n_alpha, n_position)."""
        ...

    def diffuse_integral(self, theta_o_deg: ArrayLike, theta_i_deg: ArrayLike | None = None) -> FloatArray:
        """Return the received part of ``cos(theta)/pi``; a beam with a width needs `theta_i_deg`."""
        ...

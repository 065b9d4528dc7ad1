"""How much does a lobe without a closed form reflect above the horizon?

In the angles u (in plane, from the mirror direction) and psi (out of plane) the sample plane is the line
``u = 90 deg - theta_i``, so the half-space is a rectangle.  The peak lies at u = 0, psi = 0; a lobe of any
width, an algebraic tail, the Fresnel term near grazing and the end of cos_+ are all features at ends of the
intervals ``(-backward, 0)``, ``(0, 90 deg - theta_i)`` and ``(0, across)``, where the tanh-sinh rule
(Takahasi and Mori 1974) clusters its nodes geometrically.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from gonio.brdf.directions import Directions
from gonio.fresnel import reflectance_at_cosine

FloatArray = NDArray[np.float64]

_END = 3.4  # the outermost nodes lie 1e-20 of the interval from its ends
_COARSEST = 12  # steps per unit
_FINEST = 64
_STEPS_PER_DECADE = 6.6
"""A peak of relative width w needs steps in proportion to log(1/w): 1e-10 is left at this rate."""


@functools.cache
def tanh_sinh(steps_per_unit: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights on (0, 1), clustered at both ends; each (2 * 3.4 * steps_per_unit + 1,)."""
    count = int(np.ceil(_END * steps_per_unit))
    x = np.arange(-count, count + 1) / steps_per_unit
    nodes = special.expit(np.pi * np.sinh(x))
    weights = np.pi * np.cosh(x) * nodes * special.expit(-np.pi * np.sinh(x)) / steps_per_unit
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights


def lobe_albedo(
    lobe: Callable[..., FloatArray],
    theta_i_deg: ArrayLike,
    parameters: tuple[ArrayLike, ...],
    *,
    backward_rad: ArrayLike,
    across_rad: ArrayLike,
    width_rad: ArrayLike,
) -> FloatArray:
    """Return ``∫ lobe dOmega`` above the sample plane, to about 1e-9 relative.

    Parameters
    ----------
    lobe
        ``lobe(directions, *parameters)``, a dsf in 1/sr, symmetric in psi.
    theta_i_deg, parameters
        They broadcast; the result has their shape.
    backward_rad, across_rad
        Where the lobe ends towards the source and out of plane, at most pi/2 + theta_i and pi/2; forward it
        ends as far as across, or at the horizon.
    width_rad
        The smallest scale of the lobe about its peak.
    """
    arrays = np.broadcast_arrays(
        *(np.asarray(x, np.float64) for x in (theta_i_deg, backward_rad, across_rad, width_rad, *parameters))
    )
    rows = np.stack([x.reshape(-1) for x in arrays], axis=1)
    known, inverse = np.unique(rows, axis=0, return_inverse=True)
    values = np.array([_one(lobe, *row) if np.all(np.isfinite(row)) else np.nan for row in known])
    return np.asarray(values[inverse.reshape(-1)].reshape(arrays[0].shape))


def _one(
    lobe: Callable[..., FloatArray],
    theta_i_deg: float,
    backward: float,
    across: float,
    width: float,
    *rest: float,
) -> float:
    theta_i = np.deg2rad(theta_i_deg)
    decades = np.log10(np.pi / width)
    nodes, weights = tanh_sinh(int(np.clip(np.ceil(_STEPS_PER_DECADE * decades), _COARSEST, _FINEST)))
    psi = across * nodes
    over_psi = 2.0 * across * weights * np.cos(psi)  # both sides of the plane of incidence
    total = 0.0
    for end in (-backward, min(across, 0.5 * np.pi - theta_i)):
        at = Directions.off_plane(theta_i, end * nodes[:, None], psi)
        total += abs(end) * float(weights @ (lobe(at, *rest) @ over_psi))
    return total


@functools.cache
def _mean_rule() -> tuple[FloatArray, FloatArray]:
    nodes, weights = tanh_sinh(16)
    return nodes, 2.0 * weights * nodes


def mean_reflectance(n2: ArrayLike) -> FloatArray:
    """Return the hemispherical mean of the unpolarized R, ``∫ R 2 cos(theta) d cos(theta)``.

    The external diffuse reflectance (Walsh 1926); 0 at n2 = 1, 0.0918 at n2 = 1.5.
    """
    cosine, weights = _mean_rule()
    r = reflectance_at_cosine(np.asarray(n2, np.float64)[..., None], cosine, "unpolarized")
    return np.asarray(r @ weights)

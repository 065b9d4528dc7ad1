"""What does it cost to leave a part of the instrument function out?

The change of every reading is computed, with the part and without it, at the alphas given: it is what is
left out, not an estimate of it.  Changes of several parts do not add up; they are computed together as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gonio.aperture.instrument import InstrumentFunction
from gonio.aperture.receiver import FloatArray, Receiver


@dataclass(frozen=True, slots=True)
class LeftOut:
    """The largest changes over all positions and alphas when a part is left out.

    Attributes
    ----------
    part
        What is left out.
    lobe, diffuse
        Largest change of the lobe integral, and of the diffuse integral.
    relative_lobe, relative_diffuse
        The same over the largest reading at that alpha, and over the largest diffuse reading.
    """

    part: str
    lobe: float
    diffuse: float
    relative_lobe: float
    relative_diffuse: float

    def reading(self, rho_d: float, specular: float) -> float:
        """Return a bound of the change of r, for albedo `rho_d` and a lobe of `specular` = rho_s R."""
        return rho_d * self.diffuse + specular * self.lobe


def leaving_out(
    instrument: InstrumentFunction, alpha: ArrayLike, theta_i_deg: ArrayLike, theta_o_deg: ArrayLike
) -> tuple[LeftOut, ...]:
    """Return what each part costs, then the beam as a whole; parts that are not there are not listed.

    Parameters
    ----------
    alpha
        Exponents, any shape; (n_alpha,) once flattened.
    theta_i_deg, theta_o_deg
        (n,), the positions.  `RefusedError` as from `InstrumentFunction.lobe_table`.

    Notes
    -----
    The height of the aperture is left out by Eq 22: its in-plane average times the solid angle.  The beam's
    divergence is that of the lobe's geometry; the Fresnel reflectance over it is another matter.
    """
    beam, aperture = instrument.beam, instrument.aperture
    parts: list[tuple[str, Receiver, Receiver]] = [
        ("height of the aperture", aperture, aperture.variant("eq22")),
    ]
    for part, name in (
        ("length of the spot", "width_mm"),
        ("height of the spot", "height_mm"),
        ("divergence", "divergence_deg"),
    ):
        if getattr(beam, name) > 0.0:
            parts.append((part, instrument, InstrumentFunction(aperture, replace(beam, **{name: 0.0}))))
    if len(parts) > 2:
        parts.append(("the beam as a whole", instrument, aperture))
    alphas = np.unique(np.asarray(alpha, np.float64))
    positions = np.stack(
        np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (theta_i_deg, theta_o_deg)))
    )
    theta_i, theta_o = np.unique(positions.reshape(2, -1), axis=1)
    known: dict[Receiver, tuple[FloatArray, FloatArray]] = {}

    def seen(receiver: Receiver) -> tuple[FloatArray, FloatArray]:
        if receiver not in known:
            lobes = receiver.lobe_table(alphas, theta_i - theta_o, theta_o, theta_i)
            known[receiver] = lobes, receiver.diffuse_integral(theta_o, theta_i)
        return known[receiver]

    result = []
    for part, whole, without in parts:
        (lobe, diffuse), (less, less_diffuse) = seen(whole), seen(without)
        change, dim = np.abs(less - lobe), np.abs(less_diffuse - diffuse)
        peak = np.max(lobe, axis=1, keepdims=True)
        result.append(
            LeftOut(
                part,
                float(np.max(change)),
                float(np.max(dim)),
                float(np.max(change / np.where(peak > 0.0, peak, 1.0))),
                float(np.max(dim) / max(float(np.max(diffuse)), 1e-300)),
            )
        )
    return tuple(result)

"""How is the diffuse light spread over the sky?  `Sky`, and the seven numbers the kernels read.

Every model gives a relative radiance; it is scaled so that an unobstructed horizontal plane receives the DHI.
The disc of the sun is not in it (`gonio.facade.sun`): the circumsolar brightness of a model belongs to the
DHI, as a shaded pyranometer sees it.  Skylight is unpolarised here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.errors import SceneError
from gonio.facade.layout import LEAST_COSINE
from gonio.facade.perez import Perez, all_weather
from gonio.facade.sun import SOLAR_CONSTANT_W_M2, Sun

FloatArray = NDArray[np.float64]

_GRADATION = ((4.0, -0.70), (1.1, -0.8), (0.0, -1.0), (-1.0, -0.55), (-1.0, -0.32), (-1.0, -0.15))
_INDICATRIX = (
    (0.0, -1.0, 0.0), (2.0, -1.5, 0.15), (5.0, -2.5, 0.30), (10.0, -3.0, 0.45), (16.0, -3.0, 0.30),
    (24.0, -2.8, 0.15),
)  # fmt: skip
_TYPES = (
    (1, 1), (1, 2), (2, 1), (2, 2), (3, 1), (3, 2), (3, 3), (3, 4), (4, 2), (4, 3), (4, 4), (5, 4), (5, 5),
    (6, 5), (6, 6),
)  # fmt: skip
"""Groups of gradation (a, b) and indicatrix (c, d, e) of the 15 skies of CIE S 011/E:2003 (ISO 15469)."""

_NAMES = {"cie_overcast": 1, "cie_clear": 12, "cie_clear_polluted": 13}

MODELS = ("isotropic", *_NAMES, *(f"cie{i}" for i in range(1, 16)), "perez")
"""What `Sky.model` may be."""


@dataclass(frozen=True, slots=True)
class Sky:
    """A model of the sky.

    Parameters
    ----------
    model
        ``"isotropic"``; ``"cie1"`` ... ``"cie15"``, the CIE standard general skies; ``"cie_overcast"``,
        ``"cie_clear"`` and ``"cie_clear_polluted"``, which are types 1, 12 and 13 of them; ``"perez"``, the
        all-weather sky of DNI and DHI.
    extraterrestrial_w_m2
        Irradiance outside the atmosphere on a plane facing the sun, for Perez' brightness only: by
        `gonio.facade.sun.extraterrestrial` where the date is known.

    Raises
    ------
    SceneError
        An unknown model, or an extraterrestrial irradiance outside 1000...2000 W/m2.
    """

    model: str = "isotropic"
    extraterrestrial_w_m2: float = SOLAR_CONSTANT_W_M2

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise SceneError(f"sky model '{self.model}' is not known; choose among {', '.join(MODELS)}")
        if not 1000.0 <= self.extraterrestrial_w_m2 <= 2000.0:
            raise SceneError(
                f"extraterrestrial_w_m2 = {self.extraterrestrial_w_m2:g} W/m2 is outside 1000...2000 W/m2; "
                f"leave it out for {SOLAR_CONSTANT_W_M2:g} W/m2"
            )


def coefficients(sky: Sky, sun: Sun, dhi_w_m2: float, *, broadband_w_m2: tuple[float, float]) -> FloatArray:
    """Return (7,) float64 for `gonio.facade.skylight.sky_radiance`, in the order of its columns.

    `broadband_w_m2` is DNI and DHI of the whole spectrum, which tell a clear sky from a cloudy one;
    `dhi_w_m2` is what the sky gives in this simulation, perhaps one band of it.
    """
    shape = np.array([1.0, *_shape(sky, sun, broadband_w_m2)])
    if sky.model != "isotropic":
        shape[0] = math.pi / horizontal_irradiance(shape, _zenith(sun))
    shape[0] *= dhi_w_m2 / math.pi
    return shape


def notes(sky: Sky, sun: Sun, broadband_w_m2: tuple[float, float]) -> tuple[str, ...]:
    """Return what a reader of the result should know about the sky; empty for the isotropic one."""
    if sky.model == "isotropic":
        return ()
    if sky.model == "perez":
        found = _perez(sky, sun, broadband_w_m2)
        head = (
            f"Perez sky: clearness epsilon = {found.epsilon:.3f}, brightness delta = {found.delta:.4f} "
            f"(extraterrestrial irradiance {sky.extraterrestrial_w_m2:.1f} W/m2)"
        )
        return (head, *found.notes)
    return (f"sky: CIE standard general sky type {_cie_type(sky.model)}",)


def radiance(shape: FloatArray, sun_direction: ArrayLike, directions: ArrayLike) -> FloatArray:
    """Return the radiance of the sky in unit directions (..., 3), W/m2/sr: as the kernels compute it."""
    d = np.asarray(directions, np.float64)
    cosine = np.clip(d @ np.asarray(sun_direction, np.float64), -1.0, 1.0)
    return np.asarray(np.where(d[..., 2] > 0.0, _relative(shape, d[..., 2], cosine), 0.0))


def horizontal_irradiance(shape: FloatArray, zenith_rad: float) -> float:
    """Return the integral of radiance times cosine over the sky of a sun at `zenith_rad`, to 1e-7 relative.

    Gauss-Legendre in zenith angle and azimuth from the sun.  The indicatrix has a cusp at the sun and the
    gradation a kink at `LEAST_COSINE`: the zenith angle is split there, and nodes crowd towards the sun.
    Points are doubled until nothing changes, which an odd Perez sky with a radiance cut at 0 needs.
    """
    horizon, kink = 0.5 * math.pi, math.acos(LEAST_COSINE)
    sun_zenith = min(zenith_rad, horizon)
    edges = sorted({0.0, min(sun_zenith, kink), kink, max(sun_zenith, kink), horizon})
    before = math.inf
    for n in (24, 48, 96, 192, 384, 768):
        node, weight = np.polynomial.legendre.leggauss(n)
        t, w = 0.5 * (node + 1.0), 0.5 * weight
        graded, slope = t**3, 3.0 * t**2 * w  # towards 0
        azimuth, azimuth_weight = math.pi * graded, math.pi * slope
        total = 0.0
        for low, high in pairwise(edges):
            start = (high, low) if high == sun_zenith else (low, high)
            z = start[0] + (start[1] - start[0]) * graded
            c, s = np.cos(z)[:, None], np.sin(z)[:, None]
            gamma = c * math.cos(zenith_rad) + s * math.sin(zenith_rad) * np.cos(azimuth)
            value = _relative(shape, c, np.clip(gamma, -1.0, 1.0)) * c * s
            total += float((high - low) * slope @ (value @ azimuth_weight))
        total *= 2.0  # the other half of the azimuths
        if abs(total - before) <= 1e-7 * total:
            break
        before = total
    return total


def _relative(shape: FloatArray, cos_z: FloatArray, cosine: FloatArray) -> FloatArray:
    scale, a, b, k, c, d, e = shape
    gradation = 1.0 + a * np.exp(b / np.maximum(cos_z, LEAST_COSINE))
    indicatrix = k + c * np.exp(d * np.arccos(cosine)) + e * cosine**2
    return np.asarray(np.maximum(scale * gradation * indicatrix, 0.0))


def _shape(
    sky: Sky, sun: Sun, broadband_w_m2: tuple[float, float]
) -> tuple[float, float, float, float, float, float]:
    """Return a, b, k, c, d, e."""
    if sky.model == "isotropic":
        return 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    if sky.model == "perez":
        p = _perez(sky, sun, broadband_w_m2)
        return p.a, p.b, 1.0, p.c, p.d, p.e
    gradation, indicatrix = _TYPES[_cie_type(sky.model) - 1]
    a, b = _GRADATION[gradation - 1]
    c, d, e = _INDICATRIX[indicatrix - 1]
    return a, b, 1.0 - c * math.exp(0.5 * math.pi * d), c, d, e


def _cie_type(model: str) -> int:
    return _NAMES[model] if model in _NAMES else int(model.removeprefix("cie"))


def _perez(sky: Sky, sun: Sun, broadband_w_m2: tuple[float, float]) -> Perez:
    return all_weather(
        zenith_rad=_zenith(sun),
        dni_w_m2=broadband_w_m2[0],
        dhi_w_m2=broadband_w_m2[1],
        extraterrestrial_w_m2=sky.extraterrestrial_w_m2,
    )


def _zenith(sun: Sun) -> float:
    return math.radians(90.0 - sun.elevation_deg)

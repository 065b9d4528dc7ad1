"""Which sky belongs to measured DNI and DHI?  The all-weather model of Perez et al. (1993).

The sky's clearness epsilon and brightness delta choose one of eight rows of coefficients; the relative
radiance is ``(1 + a exp(b / cos z)) (1 + c exp(d gamma) + e cos^2 gamma)`` as in `gonio.facade.skylight`.

R. Perez, R. Seals, J. Michalsky, "All-weather model for sky luminance distribution", Solar Energy 50 (1993)
235-245 and the erratum in 51 (1993) 423.  Where the paper is silent this follows Radiance's gendaylit, with
which the coefficients are compared in the tests; docs/decisions/sky.md lists the choices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

_KAPPA = 1.041  # epsilon's dependence on the zenith angle, for radians
_BOUNDS = (1.065, 1.230, 1.500, 1.950, 2.800, 4.500, 6.200)
_DELTA_LOW, _DELTA_HIGH = 0.01, 0.6
_DELTA_INTERMEDIATE = 0.2

# fmt: off
_TABLE = np.array([  # for each bin of epsilon: rows a ... e of 1, Z, delta, delta Z
    [[1.3525, -0.2576, -0.2690, -1.4366], [-0.7670, 0.0007, 1.2734, -0.1233],
     [2.8000, 0.6004, 1.2375, 1.0000], [1.8734, 0.6297, 0.9738, 0.2809],
     [0.0356, -0.1246, -0.5718, 0.9938]],
    [[-1.2219, -0.7730, 1.4148, 1.1016], [-0.2054, 0.0367, -3.9128, 0.9156],
     [6.9750, 0.1774, 6.4477, -0.1239], [-1.5798, -0.5081, -1.7812, 0.1080],
     [0.2624, 0.0672, -0.2190, -0.4285]],
    [[-1.1000, -0.2515, 0.8952, 0.0156], [0.2782, -0.1812, -4.5000, 1.1766],
     [24.7219, -13.0812, -37.7000, 34.8438], [-5.0000, 1.5218, 3.9229, -2.6204],
     [-0.0156, 0.1597, 0.4199, -0.5562]],
    [[-0.5484, -0.6654, -0.2672, 0.7117], [0.7234, -0.6219, -5.6812, 2.6297],
     [33.3389, -18.3000, -62.2500, 52.0781], [-3.5000, 0.0016, 1.1477, 0.1062],
     [0.4659, -0.3296, -0.0876, -0.0329]],
    [[-0.6000, -0.3566, -2.5000, 2.3250], [0.2937, 0.0496, -5.6812, 1.8415],
     [21.0000, -4.7656, -21.5906, 7.2492], [-3.5000, -0.1554, 1.4062, 0.3988],
     [0.0032, 0.0766, -0.0656, -0.1294]],
    [[-1.0156, -0.3670, 1.0078, 1.4051], [0.2875, -0.5328, -3.8500, 3.3750],
     [14.0000, -0.9999, -7.1406, 7.5469], [-3.4000, -0.1078, -1.0750, 1.5702],
     [-0.0672, 0.4016, 0.3017, -0.4844]],
    [[-1.0000, 0.0211, 0.5025, -0.5119], [-0.3000, 0.1922, 0.7023, -1.6317],
     [19.0000, -5.0000, 1.2438, -1.9094], [-4.0000, 0.0250, 0.3844, 0.2656],
     [1.0468, -0.3788, -2.4517, 1.4656]],
    [[-1.0500, 0.0289, 0.4260, 0.3590], [-0.3250, 0.1156, 0.7781, 0.0025],
     [31.0625, -14.5000, -46.1148, 55.3750], [-7.2312, 0.4050, 13.3500, 0.6234],
     [1.5000, -0.6426, 1.8564, 0.5636]],
])
# fmt: on


@dataclass(frozen=True, slots=True)
class Perez:
    """Clearness, brightness and shape of one sky; `notes` says what was moved into the model's range."""

    epsilon: float
    delta: float
    a: float
    b: float
    c: float
    d: float
    e: float
    notes: tuple[str, ...] = ()


def air_mass(zenith_rad: float) -> float:
    """Return the relative optical air mass of Kasten (1966); beyond 90 deg that of the horizon (36.5)."""
    zenith_deg = min(math.degrees(zenith_rad), 90.0)
    return 1.0 / (math.cos(math.radians(zenith_deg)) + 0.15 * math.pow(93.885 - zenith_deg, -1.253))


def clearness(*, zenith_rad: float, dni_w_m2: float, dhi_w_m2: float) -> float:
    """Return epsilon (Perez et al. 1993, Eq 1): 1 for an overcast sky, infinite without any diffuse light."""
    if dni_w_m2 == 0.0:
        return 1.0
    if dhi_w_m2 == 0.0:
        return math.inf
    return 1.0 + dni_w_m2 / dhi_w_m2 / (1.0 + _KAPPA * zenith_rad**3)


def all_weather(
    *, zenith_rad: float, dni_w_m2: float, dhi_w_m2: float, extraterrestrial_w_m2: float
) -> Perez:
    """Return the sky of a zenith angle of the sun, DNI and DHI; with the sun below the horizon DNI counts 0.

    delta is held inside 0.01...0.6, and above 0.2 in the intermediate bins 1.065 < epsilon < 2.8; the sun's
    zenith angle counts at most 90 deg; an exponent b above 0, whose gradation would have a pole at the
    horizon, becomes 0.  `Perez.notes` names each that happened.
    """
    notes: list[str] = []
    if zenith_rad >= 0.5 * math.pi:
        notes.append("Perez sky: the sun is below the horizon, the sky is that of the overcast bin")
        zenith_rad, dni_w_m2 = 0.5 * math.pi, 0.0
    epsilon = clearness(zenith_rad=zenith_rad, dni_w_m2=dni_w_m2, dhi_w_m2=dhi_w_m2)
    asked = dhi_w_m2 * air_mass(zenith_rad) / extraterrestrial_w_m2
    low = _DELTA_INTERMEDIATE if _BOUNDS[0] < epsilon < _BOUNDS[4] else _DELTA_LOW
    delta = min(max(asked, low), _DELTA_HIGH)
    if delta != asked and dhi_w_m2 > 0.0:
        notes.append(
            f"Perez sky: brightness delta = {asked:.4f} is outside {low:g}...{_DELTA_HIGH:g} "
            f"at clearness epsilon = {epsilon:.3f}; {delta:g} is used"
        )
    number = int(np.searchsorted(_BOUNDS, epsilon, side="right"))
    x = _TABLE[number]
    a, b, c, d, e = (
        float(v) for v in x[:, 0] + x[:, 1] * zenith_rad + delta * (x[:, 2] + x[:, 3] * zenith_rad)
    )
    if number == 0:
        c1, c2, c3, c4 = x[2]
        d1, d2, d3, d4 = x[3]
        c = math.exp((delta * (c1 + c2 * zenith_rad)) ** c3) - c4
        d = -math.exp(delta * (d1 + d2 * zenith_rad)) + d3 + delta * d4
    if b > 0.0:
        notes.append(
            f"Perez sky: epsilon = {epsilon:.3f} and delta = {delta:.4f} are outside the data of the model "
            f"(b = {b:.4f} > 0 would make the horizon infinitely bright); b = 0 is used"
        )
        b = 0.0
    return Perez(epsilon, delta, a, b, c, d, e, tuple(notes))

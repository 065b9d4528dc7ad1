"""How do the readings change when an input of the budget is off by one standard uncertainty?

Geometry by central differences of the model through apertures and positions that are off; what is even in its
input (a tilt out of the plane, a turned polarizer) by its second derivative.  A surface that lies z along its
normal from the axis is seen from ``z cos(theta_mes) / cos(theta_i)`` nearer and under an arm turned by ``z
sin(theta_mes) / cos(theta_i) / R``, to first order.  A mirror direction that leaves the plane by y at the
aperture is received like half of an aperture ``2 y`` higher and half of one ``2 y`` lower.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture
from gonio.fitting.columns import FitModel, readings
from gonio.fitting.inputs import Input
from gonio.fitting.limits import is_lobe

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_STEP_DEG = 0.01  # of central differences in angle; the lobe of alpha = 3e5 is ten times as wide
_STEP_RELATIVE = 1e-3  # of those in a length


@dataclass(frozen=True, slots=True)
class Seen:
    """What is changed: a fitted surface at m wavelengths, seen at n positions through an aperture.

    `basic` (m, p) must be finite.
    """

    kind: type[FitModel]
    instrument: Aperture
    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    is_s: BoolArray
    basic: FloatArray

    def lobe_alone(self) -> Seen:
        """Return the same without the diffuse part."""
        basic = self.basic.copy()
        basic[:, [k for k, name in enumerate(self.kind.linear) if not is_lobe(name)]] = 0.0
        return replace(self, basic=basic)

    def readings(
        self,
        *,
        aperture: Aperture | None = None,
        arm_deg: float = 0.0,
        theta_i_deg: float = 0.0,
        swapped: bool = False,
    ) -> FloatArray:
        """Return r, (n, m), with another aperture, with zeros off, or with S and P exchanged."""
        model = self.kind.of(
            self.instrument if aperture is None else aperture,
            self.theta_i_deg + theta_i_deg,
            self.theta_o_deg + arm_deg - theta_i_deg,
            ~self.is_s if swapped else self.is_s,
        )
        return readings(model, self.basic)


def changes(seen: Seen, inputs: tuple[Input, ...]) -> FloatArray:
    """Return the change of every reading by one standard uncertainty of each stated input, (g, n, m).

    The wavelength is not among them, since it moves no reading of one wavelength: its rows are zero.
    """
    base = seen.readings()
    found = np.zeros((len(inputs), *base.shape))
    for k, given in enumerate(inputs):
        if given.u:
            factor = given.root_mean_fourth if given.even else 1.0
            found[k] = factor * _CHANGES[given.name](seen, base, given.u)
    return found


def _length(name: str) -> Callable[[Seen, FloatArray, float], FloatArray]:
    def change(seen: Seen, _base: FloatArray, u: float) -> FloatArray:
        at = getattr(seen.instrument, name)
        step = _STEP_RELATIVE * at
        up, down = (
            seen.readings(aperture=replace(seen.instrument, **{name: at + sign * step}))
            for sign in (1.0, -1.0)
        )
        return np.asarray(u * (up - down) / (2.0 * step))

    return change


def _arm(seen: Seen, _base: FloatArray, u: float) -> FloatArray:
    up, down = (seen.readings(arm_deg=sign * _STEP_DEG) for sign in (1.0, -1.0))
    return np.asarray(u * (up - down) / (2.0 * _STEP_DEG))


def _theta_i(seen: Seen, _base: FloatArray, u: float) -> FloatArray:
    up, down = (seen.readings(theta_i_deg=sign * _STEP_DEG) for sign in (1.0, -1.0))
    return np.asarray(u * (up - down) / (2.0 * _STEP_DEG))


def _offset(seen: Seen, base: FloatArray, u: float) -> FloatArray:
    theta_mes = np.deg2rad(seen.theta_i_deg + seen.theta_o_deg)
    per_mm = u / np.cos(np.deg2rad(seen.theta_i_deg))
    nearer = (per_mm * np.cos(theta_mes))[:, None]
    turned_deg = np.rad2deg(per_mm * np.sin(theta_mes) / seen.instrument.distance_mm)[:, None]
    closer = _length("distance_mm")(seen, base, 1.0)
    return np.asarray(turned_deg * _arm(seen, base, 1.0) - nearer * closer)


def _tilt(seen: Seen, base: FloatArray, u: float) -> FloatArray:
    """Return half the second derivative times u^2.

    With the normal ``(0, sin u, cos u)`` the mirror direction is ``(sin i, cos i sin 2u, cos i cos 2u)``: out
    of the plane by ``2 u cos i``, and in it further by ``2 u^2 sin i cos i``.  The incidence grows by ``u^2 /
    2 cot i``, the plane of incidence is turned by ``u / sin i``, the diffuse light falls by ``u^2 / 2``.  A
    lobe as wide as the aperture leaves an error of a tenth of the effect.
    """
    lobe = seen.lobe_alone()
    i, angle = np.deg2rad(seen.theta_i_deg), np.deg2rad(u)
    step = _STEP_RELATIVE * seen.instrument.height_mm
    up, here, down = (
        lobe.readings(
            aperture=replace(seen.instrument, height_mm=seen.instrument.height_mm + sign * 2.0 * step)
        )
        for sign in (1.0, 0.0, -1.0)
    )
    per_mm2 = 0.5 * (up - 2.0 * here + down) / step**2
    y_mm = seen.instrument.distance_mm * 2.0 * angle * np.cos(i)
    further_deg = np.rad2deg(2.0 * angle**2 * np.sin(i) * np.cos(i))
    # more incidence with the lobe at the same place: the arm follows the mirror direction
    grown, less = (
        lobe.readings(theta_i_deg=sign * _STEP_DEG, arm_deg=2.0 * sign * _STEP_DEG) for sign in (1.0, -1.0)
    )
    steep = np.maximum(np.sin(i), np.sin(np.deg2rad(1.0)))
    more_deg = np.rad2deg(0.5 * angle**2 * np.cos(i) / steep)
    turned = (angle / steep) ** 2
    return np.asarray(
        per_mm2 * (y_mm**2)[:, None]
        - further_deg[:, None] * _arm(lobe, here, 1.0)
        + more_deg[:, None] * (grown - less) / (2.0 * _STEP_DEG)
        + turned[:, None] * (seen.readings(swapped=True) - base)
        - 0.5 * angle**2 * (base - here)
    )


def _polarizer(seen: Seen, base: FloatArray, u: float) -> FloatArray:
    return float(np.sin(np.deg2rad(u)) ** 2) * (seen.readings(swapped=True) - base)


def _extinction(seen: Seen, base: FloatArray, u: float) -> FloatArray:
    return u * (seen.readings(swapped=True) - base)


def _baseline(which: str) -> Callable[[Seen, FloatArray, float], FloatArray]:
    def change(seen: Seen, base: FloatArray, u: float) -> FloatArray:
        chosen = {"s": seen.is_s, "p": ~seen.is_s, "both": np.ones_like(seen.is_s)}[which]
        return u * base * chosen[:, None]

    return change


def _zero(_seen: Seen, base: FloatArray, u: float) -> FloatArray:
    return np.full(base.shape, u)


def _nonlinearity(_seen: Seen, base: FloatArray, u: float) -> FloatArray:
    """The baseline is read at r = 1, from where the response is off by u per decade."""
    return u * base * np.log10(np.maximum(np.abs(base), 1e-12))


def _wavelength(_seen: Seen, base: FloatArray, _u: float) -> FloatArray:
    return np.zeros(base.shape)


_CHANGES: dict[str, Callable[[Seen, FloatArray, float], FloatArray]] = {
    "aperture_width": _length("width_mm"),
    "aperture_height": _length("height_mm"),
    "distance": _length("distance_mm"),
    "arm_zero": _arm,
    "theta_i_zero": _theta_i,
    "sample_tilt": _tilt,
    "sample_offset": _offset,
    "baseline": _baseline("both"),
    "baseline_s": _baseline("s"),
    "baseline_p": _baseline("p"),
    "zero_offset": _zero,
    "polarizer_angle": _polarizer,
    "polarizer_extinction": _extinction,
    "wavelength": _wavelength,
    "nonlinearity": _nonlinearity,
}

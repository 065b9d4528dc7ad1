"""What an SR830 shows and answers: X, Y, R and theta with offset and expand, noise, displays, number forms.

Offset is a percentage of full scale that is taken off; expand (1, 10 or 100) makes the rest of the range
finer and smaller.  Offsets of X and Y do not reach R and theta.  Nothing is plugged into the auxiliary
inputs: they read 0 V, and a display that is the ratio to one of them stands at its limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gonio_simulators.bench.lockin import OVERLOAD, STEPS_OF_FULL_SCALE, Lockin
from gonio_simulators.wire.sr830_parameters import OutOfRange
from gonio_simulators.wire.sr830_status import INPUT_OVERLOAD, OUTPUT_OVERLOAD, StatusRegisters

X, Y, R, THETA = 1, 2, 3, 4
EXPAND = (1, 10, 100)
OFFSET_LIMIT_PERCENT = 105.0
AUXILIARY_V = 0.0


@dataclass(frozen=True, slots=True)
class Scaling:
    """Offset in percent of full scale, and the index of the expand, of X, Y or R."""

    offset_percent: float = 0.0
    expand: int = 0


class Outputs:
    """The amplifier's outputs; one look serves all queries of a line."""

    def __init__(self, lockin: Lockin, status: StatusRegisters) -> None:
        self._lockin = lockin
        self._status = status
        self._look: tuple[float, float, float] | None = None
        self.reset()

    def reset(self) -> None:
        """Go back to X and Y on the displays, without offset and expand."""
        self.scaling = dict.fromkeys((X, Y, R), Scaling())
        self.display = {1: (0, 0), 2: (0, 0)}
        self.forget()

    def forget(self) -> None:
        """Look anew at the next query."""
        self._look = None

    def look(self) -> tuple[float, float, float]:
        """Return X, Y as they are put out, and R before its own scaling, volts; overloads set their bits."""
        if self._look is None:
            x_v, y_v, input_overload, output_overload = self._lockin.sample()
            magnitude_v = math.hypot(x_v, y_v)
            if self.scaling[X] != Scaling() or self.scaling[Y] != Scaling():
                raw = self._lockin.demodulated()
                limit_v = OVERLOAD * self._lockin.sensitivity_v
                # an overload that offset and expand are not the reason of stays
                output_overload = output_overload and max(map(abs, raw)) <= limit_v
                x_v, x_over = self._scaled(raw[0], self.scaling[X])
                y_v, y_over = self._scaled(raw[1], self.scaling[Y])
                output_overload = output_overload or x_over or y_over
            if input_overload or output_overload:
                self._status.lia |= (INPUT_OVERLOAD if input_overload else 0) | (
                    OUTPUT_OVERLOAD if output_overload else 0
                )
            self._look = (x_v, y_v, magnitude_v)
        return self._look

    def auto_offset_percent(self, which: int) -> float:
        """Return the offset that makes an output zero, as far as it goes."""
        raw_x_v, raw_y_v = self._lockin.demodulated()
        value_v = {X: raw_x_v, Y: raw_y_v, R: math.hypot(raw_x_v, raw_y_v)}[which]
        percent = 100.0 * value_v / self._lockin.sensitivity_v
        return round(min(max(percent, -OFFSET_LIMIT_PERCENT), OFFSET_LIMIT_PERCENT), 2)

    def value(self, which: int) -> float:
        """Return X, Y, R in volts or theta in degrees."""
        x_v, y_v, magnitude_v = self.look()
        if which == X:
            return x_v
        if which == Y:
            return y_v
        if which == R:
            if self.scaling[R] == Scaling():
                return magnitude_v
            scaled_v, over = self._scaled(magnitude_v, self.scaling[R])
            if over:
                self._status.lia |= OUTPUT_OVERLOAD
            return scaled_v
        if self.scaling[X] == self.scaling[Y] == Scaling():
            return math.degrees(math.atan2(y_v, x_v))
        raw_x_v, raw_y_v = self._lockin.demodulated()
        return math.degrees(math.atan2(raw_y_v, raw_x_v))

    def shown(self, channel: int) -> float:
        """Return what display CH1 or CH2 shows and the data buffer stores, in the units of the quantity.

        Noise is what the instrument's estimate tends to, in volts per root hertz.
        """
        quantity, ratio = self.display[channel]
        if quantity in (0, 1):
            value = self.value(((X, R), (Y, THETA))[channel - 1][quantity])
        elif quantity == 2:
            value = self._lockin.noise_density_v()[channel - 1]
        else:
            value = AUXILIARY_V
        if ratio:
            self._status.lia |= OUTPUT_OVERLOAD
            return math.copysign(OVERLOAD * self._lockin.sensitivity_v, value)
        return value

    def text(self, which: int, reference_hz: float) -> str:
        """Return a parameter of ``SNAP?`` as it is answered."""
        if X <= which <= THETA:
            return f"{self.value(which):g}"
        if 5 <= which <= 8:
            return auxiliary_text()
        if which == 9:
            return frequency_text(reference_hz)
        if which in (10, 11):
            return f"{self.shown(which - 9):g}"
        raise OutOfRange

    def _scaled(self, value_v: float, scaling: Scaling) -> tuple[float, bool]:
        """Take the offset off and limit to the expanded range; say whether that is an overload."""
        full_v = self._lockin.sensitivity_v
        rest_v = value_v - scaling.offset_percent / 100.0 * full_v
        limit_v = OVERLOAD * full_v / EXPAND[scaling.expand]
        quantum_v = full_v / STEPS_OF_FULL_SCALE / EXPAND[scaling.expand]
        return round(min(max(rest_v, -limit_v), limit_v) / quantum_v) * quantum_v, abs(rest_v) > limit_v


def frequency_text(frequency_hz: float) -> str:
    """Return a frequency with six digits, as in the manual's ``1000.00``."""
    return f"{frequency_hz:#.6g}"


def auxiliary_text() -> str:
    """Return the voltage of an auxiliary input (resolution 1/3 mV)."""
    return f"{AUXILIARY_V:.3f}"

"""The lock-in amplifier: the detector's signal through a first-order low-pass, with the noise that passes it.

White noise whose 1 s average has standard deviation ``sigma_1`` (equivalent noise bandwidth 1/(2 * 1 s))
leaves a low-pass of time constant tau (equivalent noise bandwidth 1/(4 tau)) as an Ornstein-Uhlenbeck process
with standard deviation ``sigma_1 / sqrt(2 tau)``.  Both the mean and the noise are carried on exactly from
one reading to the next, so readings closer than a time constant are correlated as on the real instrument.
Steeper slopes are several such low-passes in a row, see `lowpass`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from gonio_simulators.bench.lowpass import kick, response
from gonio_simulators.clock import BenchClock

MEMORY_TIME_CONSTANTS = 30.0
"""What happened longer ago than this is forgotten: exp(-30) = 1e-13."""

OVERLOAD = 1.09
"""Output overload, as a fraction of full scale."""

INPUT_LIMIT_V = 1.09
"""Input overload of the voltage input (full range 1 V)."""

STEPS_OF_FULL_SCALE = 32768


class DetectorSignal(NamedTuple):
    """What leaves the detector, and the white noise on it as standard deviations of a 1 s average; volts."""

    mean_v: float
    in_phase_sd_v: float  # everything that is modulated with the light: flicker, shot noise, floor
    quadrature_sd_v: float


class LockinReading(NamedTuple):
    """One look at the outputs."""

    x_v: float
    y_v: float
    input_overload: bool
    output_overload: bool


class Recorder(Protocol):
    """Something that looks at the outputs at certain instants, such as the instrument's data buffer."""

    next_s: float
    """Bench time of the next look; infinite for none."""

    def take(self) -> None:
        """Look: the amplifier has been carried on to `next_s`."""
        ...


class Lockin:
    """Evolves exactly to the present whenever it is asked.

    Parameters
    ----------
    signal_at
        Detector signal at a bench time.
    moving_between
        Start and end of everything that changes the signal within an interval, possibly overlapping.
    clock, rng
        Bench time and the source of the noise.
    time_constant_s
        Of the low-pass, when power comes on.
    """

    def __init__(
        self,
        signal_at: Callable[[float], DetectorSignal],
        moving_between: Callable[[float, float], Sequence[tuple[float, float]]],
        clock: BenchClock,
        rng: np.random.Generator,
        time_constant_s: float = 0.1,
    ) -> None:
        self._signal_at = signal_at
        self._moving_between = moving_between
        self.clock = clock
        self._rng = rng
        self._time_constant_s = time_constant_s
        self._sensitivity_v = 1.0
        self.phase_deg = 0.0
        self._input_was_over = self._output_was_over = False  # since the last look
        self._time_s = clock.now_s()
        self._signal = signal_at(self._time_s)
        self._mean_v = self._signal.mean_v
        self._stock: list[float] = []
        self._noise_x_v = 0.0
        self._noise_y_v = 0.0
        self._order = 1
        self._stages = np.zeros((3, 1))  # of mean, X noise and Y noise; used with more than one low-pass
        self.recorder: Recorder | None = None
        self._recording = False
        self.before_look: Callable[[], None] | None = None
        """Called before each look at the outputs: the moment at which a fault may strike."""
        self._spike: tuple[bool, bool] | None = None

    @property
    def order(self) -> int:
        """How many low-passes follow one another, 6 dB/octave each."""
        return self._order

    @order.setter
    def order(self, value: int) -> None:
        self.advance()
        last = np.array([[self._mean_v], [self._noise_x_v], [self._noise_y_v]])
        kept = self._stages[:, :value] if self._order > 1 else last
        # a further stage wakes up settled on what it is given
        self._stages = np.concatenate([kept] + [kept[:, -1:]] * (value - kept.shape[1]), axis=1)
        self._mean_v, self._noise_x_v, self._noise_y_v = map(float, self._stages[:, -1])
        self._order = value

    @property
    def time_constant_s(self) -> float:
        """Time constant of the low-pass, seconds."""
        return self._time_constant_s

    @time_constant_s.setter
    def time_constant_s(self, value: float) -> None:
        self.advance()
        self._time_constant_s = value

    @property
    def sensitivity_v(self) -> float:
        """Full scale of the outputs, volts."""
        return self._sensitivity_v

    @sensitivity_v.setter
    def sensitivity_v(self, value: float) -> None:
        self.advance()
        self._sensitivity_v = value

    def sample(self) -> LockinReading:
        """Return X and Y in volts, and whether input and output are overloaded, or were since the last look.

        The outputs are those of the instrument: limited to 1.09 of full scale (then the flag is up) and
        quantised to full scale / 32768.
        """
        if self.before_look is not None and not self._recording:
            self.before_look()
        self.advance()
        x, y = self.demodulated()
        limit = OVERLOAD * self.sensitivity_v
        input_overload = abs(self._signal.mean_v) > INPUT_LIMIT_V or self._input_was_over
        output_overload = max(abs(x), abs(y)) > limit or self._output_was_over
        if not self._recording:
            self._input_was_over = self._output_was_over = False
        if self._spike is not None:
            input_overload |= self._spike[0]
            output_overload |= self._spike[1]
            self._spike = None
        return LockinReading(self._output(x), self._output(y), input_overload, output_overload)

    def spike(self, size: float, *, at_input: bool) -> None:
        """Let an interference pass: an overload that is seen once, and `size` full scales in the low-pass."""
        self.advance()
        self._mean_v += size * self.sensitivity_v
        self._stages[0] += size * self.sensitivity_v
        self._spike = (at_input, not at_input)

    def power_cycle(self) -> None:
        """Switch off and on: the low-pass begins at zero."""
        self.advance()
        self._mean_v = self._noise_x_v = self._noise_y_v = 0.0
        self._stages[:] = 0.0
        self._spike = None

    def demodulated(self) -> tuple[float, float]:
        """Return X and Y behind the low-pass in volts, before range and resolution, as last carried on."""
        phase = math.radians(self.phase_deg)
        in_phase, quadrature = self._mean_v + self._noise_x_v, self._noise_y_v
        x = in_phase * math.cos(phase) + quadrature * math.sin(phase)
        y = quadrature * math.cos(phase) - in_phase * math.sin(phase)
        return x, y

    def noise_density_v(self) -> tuple[float, float]:
        """Return the noise of X and Y at the input now, V per root hertz.

        A 1 s average has an equivalent noise bandwidth of 1/2 Hz.
        """
        phase = math.radians(self.phase_deg)
        along, across = self._signal.in_phase_sd_v, self._signal.quadrature_sd_v
        c, s = math.sqrt(2.0) * math.cos(phase), math.sqrt(2.0) * math.sin(phase)
        return math.hypot(along * c, across * s), math.hypot(across * c, along * s)

    def _output(self, value_v: float) -> float:
        limit = OVERLOAD * self.sensitivity_v
        quantum = self.sensitivity_v / STEPS_OF_FULL_SCALE
        return round(min(max(value_v, -limit), limit) / quantum) * quantum

    def advance(self) -> None:
        """Carry mean and noise on to the present, halting where a recorder wants to look."""
        if self._recording:
            return  # the recorder looks at an instant of the past
        now_s = self.clock.now_s()
        while self.recorder is not None and self.recorder.next_s <= now_s:
            self._carry_to(self.recorder.next_s)
            self._recording = True
            try:
                self.recorder.take()
            finally:
                self._recording = False
        self._carry_to(now_s)

    def _carry_to(self, now_s: float) -> None:
        if now_s <= self._time_s:
            return
        tau = self._time_constant_s
        start_s = max(self._time_s, now_s - MEMORY_TIME_CONSTANTS * tau)
        for end_s, moving in self._pieces(start_s, now_s):
            if moving:
                self._follow(start_s, end_s)
            else:
                self._signal = self._signal_at(0.5 * (start_s + end_s))
                self._settle(end_s - start_s, self._signal)
            start_s = end_s
        self._time_s = now_s

    def _pieces(self, start_s: float, end_s: float) -> list[tuple[float, bool]]:
        """Cut an interval where changes begin and end; of each piece its end, and whether it changes."""
        changes = self._moving_between(start_s, end_s)
        if not changes:
            return [(end_s, False)]
        cuts = sorted({min(max(t, start_s), end_s) for change in changes for t in change} | {start_s, end_s})
        return [(b, any(s <= 0.5 * (a + b) < e for s, e in changes)) for a, b in itertools.pairwise(cuts)]

    def _follow(self, start_s: float, end_s: float) -> None:
        """Follow a changing signal in steps of half a time constant, straight in between."""
        steps = max(1, math.ceil(2.0 * (end_s - start_s) / self._time_constant_s))
        length = (end_s - start_s) / steps
        tiny = 1e-9 * length  # inside the change, not at the instants where it begins and ends
        before = self._signal_at(start_s + tiny)
        for i in range(steps):
            after = self._signal_at(start_s + (i + 1) * length - tiny)
            self._settle(length, before, after)
            before = self._signal = after

    def _settle(self, duration_s: float, before: DetectorSignal, after: DetectorSignal | None = None) -> None:
        """Exact response to a signal that is constant, or goes straight from `before` to `after`."""
        self._input_was_over |= max(abs(before.mean_v), abs((after or before).mean_v)) > INPUT_LIMIT_V
        self._pass_through(duration_s, before, after)
        self._output_was_over |= abs(self._mean_v) > OVERLOAD * self._sensitivity_v

    def _pass_through(self, duration_s: float, before: DetectorSignal, after: DetectorSignal | None) -> None:
        if self._order > 1:
            self._settle_steeply(duration_s, before, after or before)
            return
        tau = self._time_constant_s
        gain = -math.expm1(-duration_s / tau)
        decay = 1.0 - gain
        end = after or before
        self._mean_v = decay * self._mean_v + gain * before.mean_v
        if after is not None:
            self._mean_v += (after.mean_v - before.mean_v) * (1.0 - gain * tau / duration_s)
        # Ornstein-Uhlenbeck: variance sigma_1**2 / (2 tau) in the long run, reached as 1 - decay**2.
        fresh = math.sqrt(gain * (1.0 + decay) / (2.0 * tau))
        kick_x, kick_y = self._kicks()
        self._noise_x_v = decay * self._noise_x_v + fresh * end.in_phase_sd_v * kick_x
        self._noise_y_v = decay * self._noise_y_v + fresh * end.quadrature_sd_v * kick_y

    def _settle_steeply(self, duration_s: float, before: DetectorSignal, after: DetectorSignal) -> None:
        """Do the same with several low-passes."""
        tau = self._time_constant_s
        inputs = np.array([[before.mean_v, after.mean_v], [0.0, 0.0], [0.0, 0.0]])
        stages = response(self._stages, duration_s, tau, inputs)
        normal = np.array([number for _ in range(self._order) for number in self._kicks()]).reshape(-1, 2)
        sd_v = np.array([[after.in_phase_sd_v], [after.quadrature_sd_v]]) / math.sqrt(tau)
        stages[1:] += sd_v * (kick(self._order, duration_s / tau) @ normal).T
        self._stages = stages
        self._mean_v, self._noise_x_v, self._noise_y_v = stages[:, -1].tolist()

    def _kicks(self) -> tuple[float, float]:
        """Two standard normal numbers, from a stock, as the generator is slow for single ones."""
        if len(self._stock) < 2:
            self._stock = self._rng.standard_normal(256).tolist()
        return self._stock.pop(), self._stock.pop()

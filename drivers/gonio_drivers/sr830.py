"""The detector's amplifier: Stanford Research SR830 lock-in.

Replies carry nothing of the question, so after a failed reply the identity is asked: no other answer looks
like it. Several statements go on one line; each question among them gets an answer of its own.

The signal is X, the component in phase with the chopper, and not R = sqrt(X2 + Y2): the magnitude of noise is
never zero, so R of a weak signal is too large (for X = 0 it reads 1.25 standard deviations of the noise).  X
needs the right phase; see `SR830Config.phase_deg`.
Reference: Stanford Research Systems, SR830 manual, chapter 5.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Self

from pydantic import model_validator

from gonio.config import Count, Number, Positive, Strict
from gonio.errors import ConnectionFailed, DeviceError, ReplyError
from gonio.rig import SIMULATED, Context
from gonio_drivers.decimals import decimal, whole
from gonio_drivers.lines import Line, NoReply, connecting, open_line
from gonio_drivers.sr830_guards import FIELDS, GUARDS, check_guards, check_unchanged, numbers_of

_IDENTITY = re.compile(r"stanford[_ ]research[_ ]systems *, *SR830\b", re.IGNORECASE)
_LOCK_ATTEMPTS = 3  # at least
_LOCK_S = 1.0  # instrument seconds in which a chopper that runs is found again

FULL_SCALE_V = tuple(
    mantissa * 10.0**decade
    for decade in range(-9, 1)
    for mantissa in (1.0, 2.0, 5.0)
    if 2e-9 <= mantissa * 10.0**decade <= 1.0
)
"""Full scale of ``SENS i``, volts: 2 nV, 5 nV, 10 nV, ... 1 V."""

TIME_CONSTANT_S = tuple(mantissa * 10.0**decade for decade in range(-5, 5) for mantissa in (1.0, 3.0))
"""Time constant of ``OFLT i``, seconds: 10 us, 30 us, ... 30 ks."""

SLOPES_DB_OCT = (6, 12, 18, 24)
"""Slope of ``OFSL i``; each 6 dB/octave is one more low-pass of the same time constant."""

SPACING_TIME_CONSTANTS = {6: 3.0, 12: 4.8, 18: 6.0, 24: 7.0}
"""Distance of readings that are nearly independent: the noise behind the filter is then correlated by at most
5 %.

White noise behind n equal low-passes has the correlation exp(-x) p_n(x) at x time constants, with p_1 = 1,
p_2 = 1 + x, p_3 = 1 + x + x2/3, p_4 = 1 + x + 2 x2/5 + x3/15.
"""

INPUT_OVERLOAD, FILTER_OVERLOAD, OUTPUT_OVERLOAD, UNLOCKED = 1, 2, 4, 8  # bits of LIAS?
_LARGEST_V = 10.0  # the largest range is 1 V; far more is a damaged exponent
_STOP = 1.08  # of full scale: outputs end at 1.09
_LOOKS_AT_MAGNITUDE = 3


class SR830Config(Strict):
    """``[spectrometer.lockin]`` with ``driver = "sr830"``."""

    driver: Literal["sr830"]
    address: str = SIMULATED
    time_constant_s: Positive = 0.1
    settle_time_constants: Positive = 5.0  # waited before each reading
    slope_db_oct: Literal[6, 12, 18, 24] = 6
    phase_deg: Number | None = None
    """Reference phase.  Not given, it stays as set on the instrument: turn it once with AUTO PHASE on the
    direct beam. It is the same for all readings of a scan, so that it cancels in sample over baseline."""
    smallest_range_v: Positive = 1e-3
    """Least full scale that is chosen; its resolution, 1/32768, lies well below the detector's noise."""
    baudrate: Count = 9600

    @model_validator(mode="after")
    def _exists(self) -> Self:
        if _index(TIME_CONSTANT_S, self.time_constant_s) is None:
            near = min(TIME_CONSTANT_S, key=lambda t: abs(t - self.time_constant_s))
            raise ValueError(
                f"lockin.time_constant_s = {self.time_constant_s:g} s: the instrument has 1 and 3 times "
                f"powers of ten; the nearest is {near:g}"
            )
        if self.smallest_range_v > FULL_SCALE_V[-1]:
            raise ValueError(
                f"lockin.smallest_range_v = {self.smallest_range_v:g} V is above the largest range, 1 V"
            )
        left = self.left_of_a_step()
        if left > 0.05:
            raise ValueError(
                f"lockin.settle_time_constants = {self.settle_time_constants:g} leaves {left:.0%} of a step "
                f"behind a filter of {self.slope_db_oct} dB/octave; wait longer, so that 5 % or less is left"
            )
        return self

    def left_of_a_step(self) -> float:
        """Return what is left of a change of the signal after `settle_time_constants`, relative.

        The step response of n equal low-passes leaves exp(-x) sum_{k<n} x^k / k! after x time constants.
        """
        x = self.settle_time_constants
        n = 1 + SLOPES_DB_OCT.index(self.slope_db_oct)
        return math.exp(-x) * sum(x**k / math.factorial(k) for k in range(n))

    def settle_s(self) -> float:
        """Return the time waited before a reading that differs little from the one before, seconds."""
        return self.settle_time_constants * self.time_constant_s

    def jump_settle_s(self) -> float:
        """Return the time waited after the signal may have changed by orders of magnitude, seconds.

        What is left of the old signal falls by another factor of 1000 (ln 1000 = 6.9) compared with
        `settle_s`; for steeper slopes the tail is a polynomial longer, so the same number is added for each
        further low-pass.
        """
        extra = 7.0 + 2.0 * SLOPES_DB_OCT.index(self.slope_db_oct)
        return (self.settle_time_constants + extra) * self.time_constant_s

    def spacing_s(self) -> float:
        """Return the time between readings that are averaged, seconds."""
        return SPACING_TIME_CONSTANTS[self.slope_db_oct] * self.time_constant_s


def _index(table: tuple[float, ...], value: float) -> int | None:
    return next((i for i, entry in enumerate(table) if abs(entry - value) <= 1e-6 * entry), None)


@dataclass(frozen=True, slots=True)
class LockinReading:
    """One look at the outputs, volts."""

    x_v: float
    y_v: float
    overload: bool


class SR830:
    """The lock-in on its line."""

    def __init__(self, config: SR830Config, context: Context, line: Line) -> None:
        self._config = config
        self._line = line
        self._clock = context.clock
        self._guarded: dict[str, str] = {}  # answers on connecting, by question
        self._range = -1  # not known yet
        self._status_first = True
        self._magnitude_agrees: bool | None = None  # whether R is that of X and Y; None: not seen yet
        self._disagreements = 0
        self._greet()
        self._description = self._identified()
        self._set_up()

    @property
    def line(self) -> Line:
        """The line, for its statistics."""
        return self._line

    @property
    def range_index(self) -> int:
        """Index of the range in use, into `FULL_SCALE_V`."""
        return self._range

    def identify(self) -> str:
        """Return what the instrument says of itself."""
        return self._description

    def verify(self) -> None:
        """Ask for the settings that decide what a reading means, in one exchange.

        Raises
        ------
        DeviceError
            Something is not as it was set; the readings since the last look are not to be trusted.
        """
        statements = ("OFLT?", "OFSL?", "SENS?", *self._guarded)
        expected = [self._time_constant, SLOPES_DB_OCT.index(self._config.slope_db_oct), self._range]
        answers = self._line.query(lambda: self._exchange(";".join(statements), len(statements)))
        got = [self._numbers(answer, 1)[0] for answer in answers[:3]]
        if got != expected:
            self._range = -1  # unknown: the next range is set whatever it is
            raise DeviceError(
                self._line.device,
                f"answers {';'.join(statements[:3])} with {', '.join(f'{g:g}' for g in got)}, although "
                f"{', '.join(str(e) for e in expected)} was set: it was switched off and on, or set at its "
                "panel",
                "leave it alone while it measures, check its power supply, then repeat",
            )
        check_unchanged(self._line.device, self._guarded, answers[3:])

    def recover(self) -> str:
        """Come back to a known state after a failure: line, identity, settings; say what was done.

        Raises
        ------
        ConnectionFailed
            The line cannot be opened (yet).
        DeviceError
            The instrument does not answer, is another one, or does not take a setting.
        """
        done = "connection opened anew" if self._line.renew() else ""
        self._greet()
        description = self._identified()
        if description != self._description:
            raise DeviceError(
                self._line.device,
                f"is another instrument now: {description} instead of {self._description}",
                "connect the one that the scan began with, or open the rig again",
            )
        self._set_up()
        return done

    def set_range(self, index: int) -> bool:
        """Select a range and verify it, in one exchange; return whether it is a change."""
        if index == self._range:
            return False
        self._range = -1  # unknown, should the reply fail: the range may have changed all the same
        self._set("SENS", index)
        self._range = index
        return True

    def read(self) -> LockinReading:
        """Return X and Y at one instant and whether anything overloaded since the last look; one exchange.

        Raises
        ------
        DeviceError
            The instrument does not answer, or is not locked to the chopper.
        """
        reading, bits = self._reading()
        overload = reading.overload
        settle_s = self._config.jump_settle_s()
        for _ in range(max(_LOCK_ATTEMPTS, math.ceil(_LOCK_S / settle_s))):
            if not bits & UNLOCKED:
                return LockinReading(reading.x_v, reading.y_v, overload)
            # The bit is latched: the lock may be back, and the filter then needs its time.
            self._clock.sleep(settle_s)
            reading, bits = self._reading()
            overload |= reading.overload
        if not bits & UNLOCKED:
            return LockinReading(reading.x_v, reading.y_v, overload)
        raise DeviceError(
            self._line.device,
            "is not locked to its reference: what it reads means nothing",
            "check that the chopper turns and that its reference cable is plugged in, then repeat",
        )

    def _reading(self) -> tuple[LockinReading, int]:
        """Return one look at outputs and status bits."""
        x_v, y_v, bits = self._line.query(self._look)
        overload = bool(bits & (INPUT_OVERLOAD | FILTER_OVERLOAD | OUTPUT_OVERLOAD))
        # Bits can be damaged on the way, and an output at its stop is one whatever they say.
        overload |= self._range >= 0 and max(abs(x_v), abs(y_v)) > _STOP * FULL_SCALE_V[self._range]
        return LockinReading(x_v, y_v, overload), bits

    def close(self) -> None:
        """Release the line."""
        self._line.close()

    def _look(self) -> tuple[float, float, int]:
        """Ask for X, Y [V] and status bits, in one order and the other by turns.

        Replies carry no number.  A reply that comes twice, the second time after the next question, would be
        taken for the answer to that one; in the other order it has the wrong form.

        Nor do they carry a checksum: a digit that was damaged on the way is a number like any other.  So R is
        asked for as well, which must be the magnitude of X and Y to within the output's resolution.
        """
        self._status_first = not self._status_first
        snap = "SNAP? 1,2" if self._magnitude_agrees is False else "SNAP? 1,2,3"
        if self._status_first:
            status, outputs = self._exchange(f"LIAS?;{snap}", 2)
        else:
            outputs, status = self._exchange(f"{snap};LIAS?", 2)
        if "," in status:
            raise self._line.damaged(status.encode("latin-1", "replace"), "not a status")
        bits = self._whole(status, 255)
        if self._magnitude_agrees is False:
            x_v, y_v = self._numbers(outputs, 2)
        else:
            x_v, y_v = self._proven(outputs)
        if max(abs(x_v), abs(y_v)) > _LARGEST_V:
            raise self._line.damaged(
                outputs.encode("latin-1", "replace"), f"more than {_LARGEST_V:g} V, which no range shows"
            )
        return x_v, y_v, bits

    def _proven(self, outputs: str) -> tuple[float, float]:
        """Return X and Y if R is their magnitude.

        An instrument that has shown it once must always; one that never does (R expanded, a clone that makes
        it up) is not asked for it any more, and can then not be protected.
        """
        resolution_v = FULL_SCALE_V[self._range] / 32768.0
        with contextlib.suppress(ReplyError):
            x_v, y_v, r_v = self._numbers(outputs, 3)
            magnitude_v = math.hypot(x_v, y_v)
            if abs(r_v - magnitude_v) <= 2.0 * resolution_v + 1e-5 * magnitude_v:
                if magnitude_v > 10.0 * resolution_v:
                    self._magnitude_agrees = True
                return x_v, y_v
        self._disagreements += 1
        if self._magnitude_agrees is None and self._disagreements >= _LOOKS_AT_MAGNITUDE:
            self._magnitude_agrees = False
        raise self._line.damaged(outputs.encode("latin-1", "replace"), "R is not the magnitude of X and Y")

    def _greet(self) -> None:
        """Have replies sent to RS-232; the statement itself has none."""
        with self._line.transaction(self._prove):
            self._line.send(b"OUTX 0\r")

    def _set_up(self) -> None:
        config = self._config
        time_constant = _index(TIME_CONSTANT_S, config.time_constant_s)
        assert time_constant is not None
        self._time_constant = time_constant
        self._set("OFLT", time_constant)
        self._set("OFSL", SLOPES_DB_OCT.index(config.slope_db_oct))
        if config.phase_deg is not None:
            self._set_phase(config.phase_deg)
        (answer,) = self._line.query(lambda: self._exchange("SENS?", 1))
        self._range = self._whole(answer, len(FULL_SCALE_V) - 1)
        self._guarded = self._found_or_set()
        try:
            check_guards(self._line.device, self._guarded)
        except DeviceError:  # or a damaged digit: what is wrong is wrong twice
            self._guarded = self._found_or_set()
            check_guards(self._line.device, self._guarded)
        if self._magnitude_agrees is None:
            self._try_magnitude()  # only now: an offset is part of X, but not of R

    def _try_magnitude(self) -> None:
        """Find out whether R can prove X and Y."""
        for _ in range(_LOOKS_AT_MAGNITUDE):
            with contextlib.suppress(ReplyError):
                self._look()
                return

    def _found_or_set(self) -> dict[str, str]:
        """Return the answer to each of `GUARDS` that the instrument knows, all in one exchange."""
        try:
            return self._line.query(self._guards)
        except NoReply:  # a clone that takes no further statement of a line after one that it does not know
            return {}

    def _guards(self) -> dict[str, str]:
        found: dict[str, str] = {}
        for question, section in zip(GUARDS, self._sections(list(GUARDS.values())), strict=True):
            numbers = [answer for answer in section if numbers_of(answer)]
            if len(section) > 1 or any(len(numbers_of(n)) != FIELDS[question] for n in numbers):
                raise self._line.damaged("; ".join(section).encode("latin-1"), f"not an answer to {question}")
            if numbers:
                found[question] = numbers[0]
        return found

    def _identified(self) -> str:
        (answer,) = self._line.query(lambda: self._exchange("*IDN?", 1))
        if not _is_sr830(answer):
            raise ConnectionFailed(
                self._line.device,
                f"identified itself as '{answer}', not as an SR830",
                "check the address of the lock-in in the rig file; other models (SR810, SR850, SR865) have "
                "other ranges and status bits and need a driver of their own",
            )
        return answer

    def _set(self, what: str, value: int) -> None:
        got = self._one_number(f"{what} {value};{what}?")
        if got != value:
            raise DeviceError(
                self._line.device,
                f"was told {what} {value} and reads {got:g}",
                "leave its front panel alone, check SYNC and reserve, and repeat",
            )

    def _set_phase(self, phase_deg: float) -> None:
        got_deg = self._one_number(f"PHAS {phase_deg:.2f};PHAS?")
        if abs((got_deg - phase_deg + 180.0) % 360.0 - 180.0) > 0.02:
            raise DeviceError(
                self._line.device,
                f"was told phase = {phase_deg:g} deg and reads {got_deg:g} deg",
                "give lockin.phase_deg between -180 and 180 deg",
            )

    def _one_number(self, statements: str) -> float:
        (answer,) = self._line.query(lambda: self._exchange(statements, 1))
        (number,) = self._numbers(answer, 1)
        return number

    def _numbers(self, answer: str, count: int) -> list[float]:
        try:
            numbers = [decimal(field) for field in answer.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) != count:
            raise self._line.damaged(answer.encode("latin-1", "replace"), f"not {count} numbers")
        return numbers

    def _whole(self, answer: str, highest: int) -> int:
        try:
            number = whole(answer)
        except ValueError:
            number = -1
        if not 0 <= number <= highest:
            raise self._line.damaged(
                answer.encode("latin-1", "replace"), f"not one of the whole numbers 0...{highest}"
            )
        return number

    def _sections(self, statements: Sequence[str]) -> list[list[str]]:
        """Return what is answered to each statement; the identity ends each."""
        sections: list[list[str]] = []
        with self._line.transaction(self._prove):
            self._line.send(
                ";".join(f"{statement};*IDN?" for statement in statements).encode("ascii") + b"\r"
            )
            deadline_s = self._line.deadline_s()
            for _ in statements:
                section: list[str] = []
                while not _is_sr830(text := self._line.read_line(deadline_s).strip().decode("latin-1")):
                    section.append(text)
                sections.append(section)
            self._line.answered()
        return sections

    def _exchange(self, statements: str, answers: int) -> list[str]:
        with self._line.transaction(self._prove):
            return self._ask(statements, answers)

    def _ask(self, statements: str, answers: int) -> list[str]:
        line = self._line
        line.send(statements.encode("ascii") + b"\r")
        deadline_s = line.deadline_s()
        got = [line.read_line(deadline_s).strip().decode("latin-1") for _ in range(answers)]
        line.answered()
        return got

    def _prove(self) -> None:
        (answer,) = self._ask("*IDN?", 1)
        if not _is_sr830(answer):
            raise self._line.damaged(answer.encode("latin-1"), "not its identity")


def _is_sr830(answer: str) -> bool:
    return _IDENTITY.match(answer) is not None


def open_sr830(config: SR830Config, context: Context) -> SR830:
    """Connect to the lock-in and set time constant, slope and phase.

    Raises
    ------
    ConnectionFailed
        The address cannot be opened, or no SR830 answers there.
    DeviceError
        The instrument does not take a setting.
    """
    line = open_line("lockin", config.address, context, protocol="sr830", baudrate=config.baudrate)
    with connecting(line):
        return SR830(config, context, line)

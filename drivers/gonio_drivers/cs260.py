"""The monochromator: Oriel Cornerstone 260 (grating, order-sorting filter, shutter, output port).

A statement that moves something is accepted at once, and on the original the next query is answered when
the motion has ended: a query after each statement is both the wait and the proof.  The B model answers at
once with what it passes, and some firmware is deaf while it moves.  So an answer that is not what was asked
for is asked for again, until the motion must have ended.  Reference: Oriel Instruments, Cornerstone 260
user's manual, appendix on the command set.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, Self, TypeVar

from pydantic import Field, model_validator

from gonio.config import Count, NotNegative, Positive, Strict
from gonio.errors import DeviceError, RefusedError
from gonio.rig import SIMULATED, Context
from gonio_drivers.cs260_line import CS260Line
from gonio_drivers.decimals import decimal
from gonio_drivers.lines import Line, NoReply, connecting, open_line

Value = TypeVar("Value")

_REAL_ARRIVAL_S = 0.5
_LOOK_S = 0.05  # instrument seconds between two looks at something that may still move
_LOST_IN_A_ROW = 2  # drives without an answer, after which the instrument is taken to be deaf while it moves
_REMEDY = "repeat; if it stays, look at the instrument's own display"
_SLACK = 3.0  # a motion may take so many times as long as the configuration says

_ERRORS: Mapping[int, tuple[str, str]] = {
    1: ("does not know the statement", "check model and firmware"),
    2: ("refused the parameter", "check gratings, filters and ports in the rig file"),
    3: ("cannot go to that destination", "check the gratings' ranges in the rig file"),
    6: ("does not have that accessory", "remove it from the rig file or connect it"),
    8: ("could not find its home position", "switch it off and on; if it stays, it needs service"),
}


class BandConfig(Strict):
    """A grating or filter and its wavelengths, closed below and open above but for the last."""

    number: Count
    range_nm: tuple[Positive, Positive]


class CS260Config(Strict):
    """``[spectrometer.monochromator]`` with ``driver = "cs260"``."""

    driver: Literal["cs260"]
    address: str = SIMULATED
    gratings: tuple[BandConfig, ...] = Field(min_length=1)
    filters: tuple[BandConfig, ...] = ()  # none: no filter wheel
    slit_um: Positive | None = None  # entrance and exit slit; left as they are if not given
    tolerance_nm: Positive = 0.1
    baudrate: Count = 9600
    # True: WAVE? goes out right behind GOWAVE, which saves a round trip per wavelength.  The instrument must
    # then
    # buffer a statement while it carries out another; its manual does not promise that.
    pipelined: bool = False
    # how long things take, for estimates and deadlines
    drive_nm_s: Positive = 175.0
    drive_start_s: NotNegative = 0.02  # of every drive, however short
    grating_change_s: NotNegative = 5.0
    filter_step_s: NotNegative = 0.8
    port_change_s: NotNegative = 1.0

    @model_validator(mode="after")
    def _bands_ascend(self) -> Self:
        for what, bands in (("grating", self.gratings), ("filter", self.filters)):
            for band in bands:
                low, high = band.range_nm
                if not low < high:
                    raise ValueError(
                        f"{what} {band.number}: range_nm = [{low}, {high}] nm must ascend; correct it"
                    )
            for first, second in itertools.pairwise(bands):
                if second.range_nm[0] != first.range_nm[1]:
                    raise ValueError(
                        f"{what} {second.number} begins at {second.range_nm[0]:g} nm, {what} {first.number} "
                        f"ends at {first.range_nm[1]:g} nm; list them ascending, with ranges that meet"
                    )
        return self

    def grating_for(self, wavelength_nm: float) -> int:
        """Return the number of the grating that covers a wavelength; `RefusedError` if none does."""
        return _band_for("grating", self.gratings, wavelength_nm)

    def filter_for(self, wavelength_nm: float) -> int | None:
        """Return the number of the filter, None without a wheel; `RefusedError` if none fits."""
        return _band_for("filter", self.filters, wavelength_nm) if self.filters else None


def _band_for(what: str, bands: Sequence[BandConfig], wavelength_nm: float) -> int:
    for band in bands:
        low, high = band.range_nm
        if low <= wavelength_nm < high or (band is bands[-1] and wavelength_nm == high):
            return band.number
    raise RefusedError(
        f"wavelength = {wavelength_nm:g} nm is covered by no {what} of the monochromator "
        f"({bands[0].range_nm[0]:g}-{bands[-1].range_nm[1]:g} nm); choose another or add the {what} to the "
        "rig file"
    )


class CS260:
    """The monochromator on its line.  Everything set is read back; what stands already is not set again."""

    def __init__(self, config: CS260Config, context: Context, line: Line) -> None:
        self._config = config
        self._line = line
        self._says = CS260Line(line)
        self._clock = context.clock
        self._known: dict[str, str] = {}  # last verified answers, by query
        self._wavelength_nm: float | None = None
        self._pipelined = config.pipelined
        self._lost_in_a_row = 0  # drives whose answer did not come at the first attempt
        self._is_deaf = False  # while it moves: it is asked when the motion must be over
        self._description = self._says.greet()
        self._answers_early = "260B" in self._description or "130B" in self._description
        self._set_slits()

    @property
    def line(self) -> Line:
        """The line, for its statistics."""
        return self._line

    def identify(self) -> str:
        """Return what the instrument says of itself."""
        return self._description

    def select_bands(self, wavelength_nm: float) -> bool:
        """Select the grating and the filter for a wavelength; return whether either changed.

        Raises
        ------
        RefusedError
            Nothing covers the wavelength; nothing was sent.
        DeviceError
            The instrument does not answer, or something else is selected afterwards.
        """
        grating = self._config.grating_for(wavelength_nm)
        filter_ = self._config.filter_for(wavelength_nm)
        # The whole wheel for the deadline: where it stands is known only after the first query.
        wheel_s = self._config.filter_step_s * max(1, len(self._config.filters))
        changed = self._set("GRAT", str(grating), duration_s=self._config.grating_change_s)
        if changed:
            self._wavelength_nm = None  # the same angle is another wavelength now
        if filter_ is not None:
            changed |= self._set("FILTER", str(filter_), duration_s=wheel_s)
        return changed

    def select_port(self, number: int) -> bool:
        """Send the light to an output port; return whether that is a change."""
        return self._set("OUTPORT", str(number), duration_s=self._config.port_change_s)

    def set_shutter(self, is_open: bool) -> bool:
        """Open or close the shutter; return whether that is a change."""
        return self._set("SHUTTER", "O" if is_open else "C", duration_s=0.5)

    def close_shutter(self) -> None:
        """Close the shutter, whatever is believed of it."""
        self._known.pop("SHUTTER?", None)
        self._set("SHUTTER", "C", duration_s=0.5, always=True)

    def verify(self) -> None:
        """Ask for everything that was set, once more.

        Between two readings nothing but the wavelength is asked for.  A monochromator that was switched off
        and on meanwhile, or whose wheel was turned from its panel, would otherwise go unnoticed.

        Raises
        ------
        DeviceError
            Something is not as it was set; the readings since the last look are not to be trusted.
        """
        for question, expected in list(self._known.items()):
            got = _value(question, self.query(question))
            if got != expected:
                self._known.clear()
                self._wavelength_nm = None
                raise DeviceError(
                    self._line.device,
                    f"answers {question} with {got}, although {expected} was set: it was switched off and "
                    "on, or set by somebody else",
                    "leave it alone while it measures, check its power supply, then repeat",
                )

    def recover(self) -> str:
        """Come back to a known state after a failure: line, identity, shutter closed; say what was done.

        Nothing is believed of the instrument's state from here; the next reading sets it anew.

        Raises
        ------
        ConnectionFailed
            The line cannot be opened (yet).
        DeviceError
            The instrument does not answer, is another one, or does not close its shutter.
        """
        done = "connection opened anew" if self._line.renew() else ""
        self._known.clear()
        self._wavelength_nm = None
        description = self._says.greet()
        if description != self._description:
            raise DeviceError(
                self._line.device,
                f"is another instrument now: {description} instead of {self._description}",
                "connect the one that the scan began with, or open the rig again",
            )
        self._set_slits()
        self.close_shutter()
        return done

    def go_to(self, wavelength_nm: float) -> float:
        """Drive to a wavelength and return the one read back, nanometres.

        Raises
        ------
        DeviceError
            The instrument does not answer, or stands further than the tolerance from the wavelength.
        """
        far_nm = 2000.0 if self._wavelength_nm is None else abs(wavelength_nm - self._wavelength_nm)
        duration_s = 0.1 + far_nm / self._config.drive_nm_s
        self._wavelength_nm = None
        attempts = itertools.count()
        statement = f"GOWAVE {wavelength_nm:.3f}"
        got_nm = self._line.query(lambda: self._go(statement, duration_s, next(attempts)))
        self._lost_in_a_row = self._lost_in_a_row + 1 if next(attempts) > 1 else 0
        if self._lost_in_a_row >= _LOST_IN_A_ROW:
            self._pipelined, self._is_deaf = False, True

        def is_there(nm: float) -> bool:
            return abs(nm - wavelength_nm) <= self._config.tolerance_nm

        if self._answers_early or not is_there(got_nm):
            got_nm = self._seen_to_arrive(
                got_nm,
                lambda: self._number(self.query("WAVE?")),
                is_there,
                duration_s,
                lambda nm: f"stands at {nm:.3f} nm instead of {wavelength_nm:.3f} nm",
            )
        self._wavelength_nm = got_nm
        return got_nm

    def close(self) -> None:
        """Release the line."""
        self._line.close()

    # -- statements ------------------------------------------------------------------------------------------

    def query(self, question: str, *, timeout_s: float | None = None) -> str:
        """Ask and return the answer; repeated once if the reply fails."""
        return self._says.query(question, timeout_s=timeout_s)

    def _go(self, statement: str, duration_s: float, attempt: int) -> float:
        """Both statements are harmless to repeat, so a failed reply to either repeats both."""
        timeout_s = self._timeout_s(duration_s)
        if self._pipelined and not attempt:
            return self._number(self._says.exchange(statement, "WAVE?", timeout_s=timeout_s))
        self._says.exchange(statement)
        if attempt or self._is_deaf:
            self._clock.sleep(duration_s)
        return self._number(self._says.exchange("WAVE?", timeout_s=timeout_s))

    def _seen_to_arrive(
        self,
        got: Value,
        ask: Callable[[], Value],
        is_there: Callable[[Value], bool],
        duration_s: float,
        words: Callable[[Value], str],
    ) -> Value:
        """Return the answer that is as it should be, twice in a row; asked for while the motion may last.

        Raises
        ------
        DeviceError
            The instrument reports an error, or the motion must have ended long ago.
        """
        if not is_there(got):
            self._refuse_if_it_reports(words(got))
            self._answers_early = True
        end_s = time.monotonic() + _REAL_ARRIVAL_S + _SLACK * duration_s / self._clock.speed
        while True:
            if not is_there(got):
                self._clock.sleep(_LOOK_S)
            before, got = got, ask()
            if is_there(got) and got == before:
                return got
            if time.monotonic() > end_s:
                raise self._failed(words(got))

    def _set_slits(self) -> None:
        if self._config.slit_um is not None:
            for slit in (1, 2):
                self._set(f"SLIT{slit}MICRONS", f"{self._config.slit_um:.0f}", duration_s=5.0)

    def _set(self, what: str, value: str, *, duration_s: float, always: bool = False) -> bool:
        """Set something unless it stands there already, verify it, and return whether it was a change."""
        question = f"{what}?"
        timeout_s = self._timeout_s(duration_s)
        before = self._known.get(question)
        if before is None and not always:
            before = self._known[question] = self._asked_first(question, timeout_s)
        if before == value:
            return False
        self._known.pop(question, None)
        attempts = itertools.count()
        got = self._line.query(
            lambda: self._set_and_ask(f"{what} {value}", question, duration_s, next(attempts))
        )
        if got != value:
            got = self._seen_to_arrive(
                got,
                lambda: _value(question, self.query(question, timeout_s=timeout_s)),
                value.__eq__,
                duration_s,
                lambda answer: f"was told {what} {value} and reads {answer}",
            )
        elif self._answers_early:
            self._clock.sleep(duration_s)  # it says where it will be
        self._known[question] = got
        return True

    def _asked_first(self, question: str, timeout_s: float) -> str:
        try:
            return _value(question, self.query(question, timeout_s=timeout_s))
        except NoReply:
            self._refuse_if_it_reports(f"gave no answer to {question}")
            raise

    def _set_and_ask(self, statement: str, question: str, duration_s: float, attempt: int) -> str:
        self._says.exchange(statement)
        if attempt or self._is_deaf:
            self._clock.sleep(duration_s)
        return _value(question, self._says.exchange(question, timeout_s=self._timeout_s(duration_s)))

    def _timeout_s(self, duration_s: float) -> float:
        """Real seconds for a reply that waits for a motion of `duration_s` instrument seconds."""
        return self._line.reply_timeout_s + _SLACK * duration_s / self._clock.speed

    def _number(self, answer: str) -> float:
        number, _, unit = answer.strip().partition(" ")
        try:
            return decimal(number if unit.strip().upper() == "NM" else answer)
        except ValueError:
            raise self._line.damaged(answer.encode("ascii", "replace"), "not a number") from None

    def _refuse_if_it_reports(self, what: str) -> None:
        """Raise an error with the reason that the instrument itself gives, if it gives one."""
        code = self.query("ERROR?")
        if code.isdigit() and len(code) <= 3 and int(code):
            words, remedy = _ERRORS.get(int(code), ("has an unknown error", _REMEDY))
            raise DeviceError(self._line.device, f"{what}: it {words} (error {int(code)})", remedy)

    def _failed(self, what: str) -> DeviceError:
        self._refuse_if_it_reports(what)
        return DeviceError(self._line.device, what, _REMEDY)


def _value(question: str, answer: str) -> str:
    """Return the first field (``GRAT?`` answers ``1,1200,LABEL``), in the form in which it is set."""
    field = answer.split(",")[0].strip().upper()
    if question == "SHUTTER?":
        return {"1": "O", "0": "C"}.get(field, field[:1])
    try:
        return f"{decimal(field):g}"
    except ValueError:
        return field


def open_cs260(config: CS260Config, context: Context) -> CS260:
    """Connect to the monochromator.

    Raises
    ------
    ConnectionFailed
        The address cannot be opened.
    DeviceError
        The instrument does not answer.
    """
    line = open_line("monochromator", config.address, context, protocol="cs260", baudrate=config.baudrate)
    with connecting(line):
        return CS260(config, context, line)

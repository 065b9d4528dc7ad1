"""The monochromator: Oriel Cornerstone 260 (grating, order-sorting filter, shutter, output port).

Over RS-232 the instrument echoes each statement before it answers; the echo is what tells one reply from
another. A statement that moves something is accepted at once and the next query is answered when the motion
has ended, so a query after each statement is both the wait and the proof. Reference: Oriel Instruments,
Cornerstone 260 user's manual, appendix on the command set.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, Self

from pydantic import Field, model_validator

from gonio.config import Count, NotNegative, Positive, Strict
from gonio.errors import DeviceError, RefusedError
from gonio.rig import SIMULATED, Context
from gonio_drivers.decimals import decimal
from gonio_drivers.lines import Line, connecting, open_line

_REAL_REPLY_S = 2.0
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
        self._clock_speed = context.clock.speed
        self._known: dict[str, str] = {}  # last verified answers, by query
        self._wavelength_nm: float | None = None
        self._description = self.query("INFO?")
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
            got = _first(self.query(question))
            if got != expected:
                self._known.clear()
                self._wavelength_nm = None
                raise DeviceError(
                    self._line.device,
                    f"answers {question} with {got}, although {expected} was set: it was switched off and on, "
                    "or set by somebody else",
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
        description = self.query("INFO?")
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
        timeout_s = self._timeout_s(0.1 + far_nm / self._config.drive_nm_s)
        self._wavelength_nm = None
        got_nm = self._line.query(lambda: self._go(f"GOWAVE {wavelength_nm:.3f}", timeout_s))
        if not abs(got_nm - wavelength_nm) <= self._config.tolerance_nm:
            raise self._failed(f"stands at {got_nm:.3f} nm instead of {wavelength_nm:.3f} nm")
        self._wavelength_nm = got_nm
        return got_nm

    def close(self) -> None:
        """Release the line."""
        self._line.close()

    # -- statements ------------------------------------------------------------------------------------------

    def query(self, question: str, *, timeout_s: float | None = None) -> str:
        """Ask and return the answer; repeated once if the reply fails."""
        return self._line.query(lambda: self._exchange(question, timeout_s=timeout_s))

    def _go(self, statement: str, timeout_s: float) -> float:
        """Both statements are harmless to repeat, so a failed reply to either repeats both."""
        if self._config.pipelined:
            return self._number(self._exchange(statement, "WAVE?", timeout_s=timeout_s))
        self._exchange(statement)
        return self._number(self._exchange("WAVE?", timeout_s=timeout_s))

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
            before = self._known[question] = _first(self.query(question, timeout_s=timeout_s))
        if before == value:
            return False
        self._known.pop(question, None)
        got = self._line.query(lambda: self._set_and_ask(f"{what} {value}", question, timeout_s))
        if got != value:
            raise self._failed(f"was told {what} {value} and reads {got}")
        self._known[question] = got
        return True

    def _set_and_ask(self, statement: str, question: str, timeout_s: float) -> str:
        self._exchange(statement)
        return _first(self._exchange(question, timeout_s=timeout_s))

    def _timeout_s(self, duration_s: float) -> float:
        """Real seconds for a reply that waits for a motion of `duration_s` instrument seconds."""
        return _REAL_REPLY_S + _SLACK * duration_s / self._clock_speed

    def _exchange(self, *statements: str, timeout_s: float | None = None) -> str:
        """Send statements, take their echoes, and return the answer if the last is a question."""
        with self._line.transaction(self._prove):
            return self._ask(*statements, timeout_s=timeout_s)

    def _ask(self, *statements: str, timeout_s: float | None = None) -> str:
        line = self._line
        sent = [statement.encode("ascii") for statement in statements]
        line.send(b"".join(expected + b"\r\n" for expected in sent))
        deadline_s = line.deadline_s(timeout_s)
        for expected in sent:
            self._skip_until(expected.__eq__, deadline_s)
        answer = b""
        if sent[-1].endswith(b"?"):
            answer = self._skip_until(lambda text: text not in (b"", sent[-1]), deadline_s)
        line.answered()
        return answer.decode("ascii", "replace")

    def _skip_until(self, wanted: Callable[[bytes], bool], deadline_s: float) -> bytes:
        while True:
            text = self._line.read_until(b"\n", deadline_s).strip()
            if wanted(text):
                return text
            if text:
                self._line.stale(text)

    def _prove(self) -> None:
        """The echo of a question and the form of its answer, two digits, show that both ends agree."""
        answer = self._ask("STB?")
        if len(answer) != 2:
            raise self._line.damaged(answer.encode("ascii", "replace"), "not a status byte")

    def _number(self, answer: str) -> float:
        try:
            return decimal(answer)
        except ValueError:
            raise self._line.damaged(answer.encode("ascii", "replace"), "not a number") from None

    def _failed(self, what: str) -> DeviceError:
        """Return an error with the reason that the instrument itself gives, if it gives one."""
        reason, remedy = "", "repeat; if it stays, look at the instrument's own display"
        code = self.query("ERROR?")
        if code.isdigit() and len(code) <= 3 and int(code):
            words, remedy = _ERRORS.get(int(code), ("has an unknown error", remedy))
            reason = f": it {words} (error {int(code)})"
        return DeviceError(self._line.device, what + reason, remedy)


def _first(answer: str) -> str:
    """Return the first field: ``GRAT?`` answers ``1,1200,LABEL``."""
    return answer.split(",")[0].strip()


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

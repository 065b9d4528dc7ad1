"""A Stanford Research SR830 lock-in amplifier on RS-232: commands, ranges, status registers, number formats.

A command is four letters (or ``*`` and three), an optional ``?`` and parameters separated by commas; spaces
are ignored.  Several commands stand on a line between semicolons, a line ends with CR or LF, and every
answer ends with CR, as the instrument sends it on RS-232.

What the bench does not have (line filters, currents, steeper filter slopes, the data buffer) is set and
read back but changes nothing, or is an illegal command (the buffer).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from gonio_simulators.bench.bench import Bench

IDENTITY = "Stanford_Research_Systems,SR830,s/n83022,ver1.07"

SENSITIVITY_V = tuple(m * 10.0**e for e in range(-9, 1) for m in (1, 2, 5))[1:28]
"""Full scale by the index of SENS: 2 nV (0) to 1 V (26)."""

TIME_CONSTANT_S = tuple(m * 10.0**e for e in range(-5, 5) for m in (1, 3))
"""Time constant by the index of OFLT: 10 us (0) to 30 ks (19)."""

CHOPPER_HZ = 137.0

# bits of the LIA status register and of the standard event register
INPUT_OVERLOAD, FILTER_OVERLOAD, OUTPUT_OVERLOAD = 1 << 0, 1 << 1, 1 << 2
EXECUTION_ERROR, ILLEGAL_COMMAND, POWER_ON = 1 << 4, 1 << 5, 1 << 7
_NO_SCAN, _IDLE = 1 << 0, 1 << 1


class Illegal(Exception):
    """No such command, or not in this form."""


class OutOfRange(Exception):
    """A parameter the instrument does not take."""


@dataclass(frozen=True, slots=True)
class _Choice:
    """An integer setting with its default and its range."""

    default: int
    low: int
    high: int


_CHOICES = {
    "FMOD": _Choice(0, 0, 1),  # 0: external reference, the chopper
    "RSLP": _Choice(1, 0, 2),
    "HARM": _Choice(1, 1, 19999),
    "ISRC": _Choice(0, 0, 3),
    "IGND": _Choice(0, 0, 1),
    "ICPL": _Choice(0, 0, 1),
    "ILIN": _Choice(0, 0, 3),
    "SENS": _Choice(26, 0, 26),
    "RMOD": _Choice(1, 0, 2),
    "OFLT": _Choice(10, 0, 19),
    "OFSL": _Choice(0, 0, 3),  # the bench's low-pass is 6 dB/oct
    "SYNC": _Choice(0, 0, 1),
    "OUTX": _Choice(0, 0, 1),  # 0: answers go to RS-232
    "LOCL": _Choice(0, 0, 2),
    "OVRM": _Choice(1, 0, 1),
    "KCLK": _Choice(1, 0, 1),
    "ALRM": _Choice(1, 0, 1),
    "SRAT": _Choice(4, 0, 14),
    "SEND": _Choice(1, 0, 1),
    "TSTR": _Choice(0, 0, 1),
    "*PSC": _Choice(1, 0, 1),
}


class Sr830:
    """The instrument; its settings outlive clients."""

    def __init__(self, bench: Bench) -> None:
        self._lockin = bench.lockin
        self._values: dict[str, int] = {}
        self._floats: dict[str, float] = {}
        self._pairs: dict[tuple[str, int], tuple[float, ...]] = {}
        self._enabled = {"*ESE": 0, "*SRE": 0, "ERRE": 0, "LIAE": 0}
        self._events = POWER_ON
        self._lia = 0
        self._reading: tuple[float, float] | None = None
        tau_s = self._lockin.time_constant_s
        self._set_defaults()
        # The rig file's time constant is what the operator dialled in before.
        self._values["OFLT"] = min(range(20), key=lambda i: abs(math.log(TIME_CONSTANT_S[i] / tau_s)))
        self._lockin.time_constant_s = TIME_CONSTANT_S[self._values["OFLT"]]
        self._special: dict[str, Callable[[bool, list[str]], str]] = {
            "SNAP": self._snap,
            "OUTP": self._output,
            "OUTR": self._output,
            "LIAS": self._lia_status,
            "ERRS": self._error_status,
            "*STB": self._status_byte,
            "*ESR": self._event_status,
            "*ESE": lambda q, p: self._enable("*ESE", q, p),
            "*SRE": lambda q, p: self._enable("*SRE", q, p),
            "ERRE": lambda q, p: self._enable("ERRE", q, p),
            "LIAE": lambda q, p: self._enable("LIAE", q, p),
            "*IDN": self._identify,
            "*RST": self._reset,
            "*CLS": self._clear_status,
            "PHAS": self._phase,
            "FREQ": self._frequency,
            "SLVL": self._sine_level,
            "APHS": self._auto_phase,
            "AGAN": self._auto_gain,
            "ARSV": self._auto_nothing,
            "AOFF": self._auto_offset,
            "OEXP": self._offset_expand,
            "DDEF": self._display,
            "FPOP": self._front_output,
            "AUXV": self._aux_output,
            "OAUX": self._aux_input,
        }

    def open(self) -> LockinConversation:
        """Begin a conversation with a new client."""
        return LockinConversation(self)

    def carry_out(self, line: str) -> str:
        """Carry out the commands of one line and return the answers, each with its CR."""
        self._reading = None  # one look at the outputs serves all queries of a line
        answers = []
        for command in line.split(";"):
            text = "".join(command.split()).upper()
            if not text:
                continue
            try:
                answer = self._one(text)
            except Illegal:
                self._events |= ILLEGAL_COMMAND
                continue
            except OutOfRange:
                self._events |= EXECUTION_ERROR
                continue
            if answer and (self._values["OUTX"] == 0 or text == "OUTX?"):
                answers.append(answer)
        return "".join([f"{answer}\r" for answer in answers])

    def _one(self, text: str) -> str:
        name, rest = text[:4], text[4:]
        is_query = rest[:1] == "?"
        if is_query:
            rest = rest[1:]
        parameters = rest.split(",") if rest else []
        special = self._special.get(name)
        if special is not None:
            return special(is_query, parameters)
        choice = _CHOICES.get(name)
        if choice is None or len(parameters) != (0 if is_query else 1):
            raise Illegal
        if is_query:
            return str(self._values[name])
        value = _integer(parameters[0])
        if not choice.low <= value <= choice.high:
            raise OutOfRange
        self._values[name] = value
        self._apply(name, value)
        return ""

    def _apply(self, name: str, value: int) -> None:
        if name == "SENS":
            self._lockin.sensitivity_v = SENSITIVITY_V[value]
            self._reading = None
        elif name == "OFLT":
            self._lockin.time_constant_s = TIME_CONSTANT_S[value]
            self._reading = None

    def _set_defaults(self) -> None:
        self._values = {name: choice.default for name, choice in _CHOICES.items()}
        self._floats = {"FREQ": 1000.0, "SLVL": 1.0}
        self._pairs = {}
        for name in ("SENS", "OFLT"):
            self._apply(name, self._values[name])
        self._lockin.phase_deg = 0.0

    # -- outputs ------------------------------------------------------------------------------------------

    def _xy(self) -> tuple[float, float]:
        if self._reading is None:
            x_v, y_v, input_overload, output_overload = self._lockin.sample()
            if input_overload or output_overload:
                self._lia |= (INPUT_OVERLOAD if input_overload else 0) | (
                    OUTPUT_OVERLOAD if output_overload else 0
                )
            self._reading = (x_v, y_v)
        return self._reading

    def _output(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query or len(parameters) != 1:
            raise Illegal
        which = _integer(parameters[0])
        if not 1 <= which <= 4:
            raise OutOfRange
        return self._quantity(which)

    def _snap(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query or not 2 <= len(parameters) <= 6:
            raise Illegal
        if parameters == ["1", "2"]:  # what a scan asks for, without detours
            return "{:g},{:g}".format(*self._xy())
        return ",".join(self._quantity(_integer(p)) for p in parameters)

    def _quantity(self, which: int) -> str:
        x_v, y_v = self._xy()
        if which in (1, 10):
            return f"{x_v:g}"
        if which in (2, 11):
            return f"{y_v:g}"
        if which == 3:
            return f"{math.hypot(x_v, y_v):g}"
        if which == 4:
            return f"{math.degrees(math.atan2(y_v, x_v)):g}"
        if 5 <= which <= 8:
            return "0"  # nothing is plugged into the auxiliary inputs
        if which == 9:
            return self._reference_hz()
        raise OutOfRange

    # -- status -------------------------------------------------------------------------------------------

    def _lia_status(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        self._xy()  # an overload of this moment counts, too
        answer, self._lia = _register(self._lia, parameters)
        return answer

    def _error_status(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        return _register(0, parameters)[0]

    def _event_status(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        answer, self._events = _register(self._events, parameters)
        return answer

    def _status_byte(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        status = _NO_SCAN | _IDLE
        status |= bool(self._lia & self._enabled["LIAE"]) << 3
        status |= bool(self._events & self._enabled["*ESE"]) << 5
        status |= bool(status & self._enabled["*SRE"] & ~0x40) << 6
        return _register(status, parameters)[0]

    def _enable(self, name: str, is_query: bool, parameters: list[str]) -> str:
        """An enable register: the whole, or bit i of it."""
        value = self._enabled[name]
        numbers = [_integer(p) for p in parameters]
        if is_query:
            return _register(value, parameters)[0]
        if len(numbers) == 1 and 0 <= numbers[0] <= 255:
            self._enabled[name] = numbers[0]
        elif len(numbers) == 2 and 0 <= numbers[0] <= 7 and numbers[1] in (0, 1):
            self._enabled[name] = value & ~(1 << numbers[0]) | numbers[1] << numbers[0]
        else:
            raise OutOfRange
        return ""

    def _clear_status(self, is_query: bool, parameters: list[str]) -> str:
        if is_query or parameters:
            raise Illegal
        self._events = self._lia = 0
        return ""

    def _identify(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query or parameters:
            raise Illegal
        return IDENTITY

    def _reset(self, is_query: bool, parameters: list[str]) -> str:
        if is_query or parameters:
            raise Illegal
        interface = self._values["OUTX"]
        self._set_defaults()
        self._values["OUTX"] = interface  # the choice of interface survives a reset
        return ""

    # -- reference, automatics, displays ------------------------------------------------------------------

    def _phase(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            return f"{self._lockin.phase_deg:.2f}"
        phase_deg = _float(parameters, -360.0, 729.99)
        self._lockin.phase_deg = round((phase_deg + 180.0) % 360.0 - 180.0, 2)
        self._reading = None
        return ""

    def _reference_hz(self) -> str:
        return f"{CHOPPER_HZ if self._values['FMOD'] == 0 else self._floats['FREQ']:g}"

    def _frequency(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            return self._reference_hz()
        value = _float(parameters, 0.001, 102000.0)
        if self._values["FMOD"] == 0:
            raise OutOfRange  # the chopper sets the frequency
        self._floats["FREQ"] = value
        return ""

    def _sine_level(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            return f"{self._floats['SLVL']:.3f}"
        self._floats["SLVL"] = round(_float(parameters, 0.004, 5.0) / 0.002) * 0.002
        return ""

    def _auto_phase(self, is_query: bool, parameters: list[str]) -> str:
        if is_query or parameters:
            raise Illegal
        x_v, y_v = self._xy()
        phase_deg = self._lockin.phase_deg + math.degrees(math.atan2(y_v, x_v))
        self._lockin.phase_deg = round((phase_deg + 180.0) % 360.0 - 180.0, 2)
        self._reading = None
        return ""

    def _auto_gain(self, is_query: bool, parameters: list[str]) -> str:
        """Take the most sensitive range that holds the magnitude; nothing with time constants above 1 s."""
        if is_query or parameters:
            raise Illegal
        if self._values["OFLT"] > 10:
            return ""
        self._lockin.sensitivity_v = SENSITIVITY_V[-1]
        self._reading = None
        magnitude_v = math.hypot(*self._xy())
        self._values["SENS"] = next((i for i, v in enumerate(SENSITIVITY_V) if v >= magnitude_v), 26)
        self._apply("SENS", self._values["SENS"])
        return ""

    def _auto_nothing(self, is_query: bool, parameters: list[str]) -> str:
        if is_query or parameters:
            raise Illegal
        return ""

    def _auto_offset(self, is_query: bool, parameters: list[str]) -> str:
        """Refuse: an offset output would no longer be the voltage that the bench promises."""
        if is_query or len(parameters) != 1:
            raise Illegal
        raise OutOfRange

    def _offset_expand(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            _number_of(parameters, 1, 1, 3)
            return "0,0"
        if len(parameters) != 3:
            raise Illegal
        if [float(p) for p in _floats(parameters[1:])] != [0.0, 0.0]:
            raise OutOfRange  # see _auto_offset
        return ""

    def _display(self, is_query: bool, parameters: list[str]) -> str:
        return self._pair("DDEF", is_query, parameters, 2, ((0, 4), (0, 2)))

    def _front_output(self, is_query: bool, parameters: list[str]) -> str:
        return self._pair("FPOP", is_query, parameters, 2, ((0, 1),))

    def _pair(
        self,
        name: str,
        is_query: bool,
        parameters: list[str],
        items: int,
        ranges: tuple[tuple[int, int], ...],
    ) -> str:
        """A setting with an item number first, such as ``DDEF 1,0,0``."""
        item = _number_of(parameters, 1 if is_query else 1 + len(ranges), 1, items)
        if is_query:
            return ",".join(f"{v:g}" for v in self._pairs.get((name, item), (0.0,) * len(ranges)))
        values = [_integer(p) for p in parameters[1:]]
        if any(not low <= v <= high for v, (low, high) in zip(values, ranges, strict=True)):
            raise OutOfRange
        self._pairs[name, item] = tuple(float(v) for v in values)
        return ""

    def _aux_output(self, is_query: bool, parameters: list[str]) -> str:
        item = _number_of(parameters, 1 if is_query else 2, 1, 4)
        if is_query:
            return f"{self._pairs.get(('AUXV', item), (0.0,))[0]:.3f}"
        self._pairs["AUXV", item] = (round(_float(parameters[1:], -10.5, 10.5), 3),)
        return ""

    def _aux_input(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        _number_of(parameters, 1, 1, 4)
        return "0"


class LockinConversation:
    """Splits what one client sends into lines."""

    wait_s: float | None = None

    def __init__(self, device: Sr830) -> None:
        self._device = device
        self._unfinished = b""

    def feed(self, data: bytes) -> bytes:
        """Take received bytes and return the answers to the lines they complete."""
        lines = (self._unfinished + data).replace(b"\r", b"\n").split(b"\n")
        self._unfinished = lines.pop()[-256:]  # the input buffer of the instrument
        carry_out = self._device.carry_out
        return "".join([carry_out(line.decode("latin-1")) for line in lines if line]).encode("ascii")

    def poll(self) -> bytes:
        """The instrument speaks when it is asked."""
        return b""


def _register(value: int, parameters: list[str]) -> tuple[str, int]:
    """Return a status register, or one bit of it, and what is left in it once that is read."""
    if not parameters:
        return str(value), 0
    bit = _number_of(parameters, 1, 0, 7)
    return str(value >> bit & 1), value & ~(1 << bit)


def _integer(text: str) -> int:
    value = _floats([text])[0]
    if value != int(value):
        raise OutOfRange
    return int(value)


def _floats(texts: list[str]) -> list[float]:
    try:
        values = [float(t) for t in texts]
    except ValueError:
        raise Illegal from None
    if not all(math.isfinite(v) for v in values):
        raise Illegal
    return values


def _float(parameters: list[str], low: float, high: float) -> float:
    if len(parameters) != 1:
        raise Illegal
    value = _floats(parameters)[0]
    if not low <= value <= high:
        raise OutOfRange
    return value


def _number_of(parameters: list[str], count: int, low: int, high: int) -> int:
    """Check the number of parameters and return the first, which names an item."""
    if len(parameters) != count:
        raise Illegal
    item = _integer(parameters[0])
    if not low <= item <= high:
        raise OutOfRange
    return item

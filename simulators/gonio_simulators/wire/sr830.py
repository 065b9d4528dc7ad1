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

from gonio_simulators.bench.bench import Bench
from gonio_simulators.wire.sr830_parameters import (
    CHOICES,
    SENSITIVITY_V,
    TIME_CONSTANT_S,
    Illegal,
    OutOfRange,
    item_of,
    number,
    numbers,
    whole,
)
from gonio_simulators.wire.sr830_status import (
    EXECUTION_ERROR,
    ILLEGAL_COMMAND,
    INPUT_OVERLOAD,
    OUTPUT_OVERLOAD,
    StatusRegisters,
)

IDENTITY = "Stanford_Research_Systems,SR830,s/n83022,ver1.07"
CHOPPER_HZ = 137.0


class Sr830:
    """The instrument; its settings outlive clients."""

    def __init__(self, bench: Bench) -> None:
        self._lockin = bench.lockin
        self._values: dict[str, int] = {}
        self._floats: dict[str, float] = {}
        self._pairs: dict[tuple[str, int], tuple[float, ...]] = {}
        self._status = status = StatusRegisters()
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
            "ERRS": status.read_errors,
            "*STB": status.read_status_byte,
            "*ESR": status.read_events,
            "*ESE": lambda q, p: status.enable("*ESE", q, p),
            "*SRE": lambda q, p: status.enable("*SRE", q, p),
            "ERRE": lambda q, p: status.enable("ERRE", q, p),
            "LIAE": lambda q, p: status.enable("LIAE", q, p),
            "*IDN": self._identify,
            "*RST": self._reset,
            "*CLS": status.clear,
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
                self._status.events |= ILLEGAL_COMMAND
                continue
            except OutOfRange:
                self._status.events |= EXECUTION_ERROR
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
        choice = CHOICES.get(name)
        if choice is None or len(parameters) != (0 if is_query else 1):
            raise Illegal
        if is_query:
            return str(self._values[name])
        value = whole(parameters[0])
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
        self._values = {name: choice.default for name, choice in CHOICES.items()}
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
                self._status.lia |= (INPUT_OVERLOAD if input_overload else 0) | (
                    OUTPUT_OVERLOAD if output_overload else 0
                )
            self._reading = (x_v, y_v)
        return self._reading

    def _output(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query or len(parameters) != 1:
            raise Illegal
        which = whole(parameters[0])
        if not 1 <= which <= 4:
            raise OutOfRange
        return self._quantity(which)

    def _snap(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query or not 2 <= len(parameters) <= 6:
            raise Illegal
        if parameters == ["1", "2"]:  # what a scan asks for, without detours
            return "{:g},{:g}".format(*self._xy())
        return ",".join(self._quantity(whole(p)) for p in parameters)

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

    def _lia_status(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        self._xy()  # an overload of this moment counts, too
        return self._status.read_lia(parameters)

    # -- identity and reset -----------------------------------------------------------------------------

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
        phase_deg = number(parameters, -360.0, 729.99)
        self._lockin.phase_deg = round((phase_deg + 180.0) % 360.0 - 180.0, 2)
        self._reading = None
        return ""

    def _reference_hz(self) -> str:
        return f"{CHOPPER_HZ if self._values['FMOD'] == 0 else self._floats['FREQ']:g}"

    def _frequency(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            return self._reference_hz()
        value = number(parameters, 0.001, 102000.0)
        if self._values["FMOD"] == 0:
            raise OutOfRange  # the chopper sets the frequency
        self._floats["FREQ"] = value
        return ""

    def _sine_level(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            return f"{self._floats['SLVL']:.3f}"
        self._floats["SLVL"] = round(number(parameters, 0.004, 5.0) / 0.002) * 0.002
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
            item_of(parameters, 1, 1, 3)
            return "0,0"
        if len(parameters) != 3:
            raise Illegal
        if [float(p) for p in numbers(parameters[1:])] != [0.0, 0.0]:
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
        item = item_of(parameters, 1 if is_query else 1 + len(ranges), 1, items)
        if is_query:
            return ",".join(f"{v:g}" for v in self._pairs.get((name, item), (0.0,) * len(ranges)))
        values = [whole(p) for p in parameters[1:]]
        if any(not low <= v <= high for v, (low, high) in zip(values, ranges, strict=True)):
            raise OutOfRange
        self._pairs[name, item] = tuple(float(v) for v in values)
        return ""

    def _aux_output(self, is_query: bool, parameters: list[str]) -> str:
        item = item_of(parameters, 1 if is_query else 2, 1, 4)
        if is_query:
            return f"{self._pairs.get(('AUXV', item), (0.0,))[0]:.3f}"
        self._pairs["AUXV", item] = (round(number(parameters[1:], -10.5, 10.5), 3),)
        return ""

    def _aux_input(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        item_of(parameters, 1, 1, 4)
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

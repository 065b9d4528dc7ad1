"""A Stanford Research SR830 lock-in amplifier on RS-232: its commands, and how lines become commands.

A command is four letters (or ``*`` and three), an optional ``?`` and parameters separated by commas; spaces
are ignored.  Several commands stand on a line between semicolons, a line ends with CR or LF, and every
answer ends with CR, as the instrument sends it on RS-232 (a binary transfer has no terminator).

Set and read back, but without effect on the bench: input configuration, line filters, harmonic, synchronous
filter (the chopper is far above it), reserve, reference source (the chopper follows it), keys and alarms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from gonio_simulators.bench.bench import Bench
from gonio_simulators.wire.sr830_buffer import (
    DELAYED_START_S,
    DataBuffer,
    ascii_points,
    ieee_points,
    lia_points,
)
from gonio_simulators.wire.sr830_outputs import (
    EXPAND,
    OFFSET_LIMIT_PERCENT,
    Outputs,
    R,
    Scaling,
    X,
    auxiliary_text,
    frequency_text,
)
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
    wholes,
)
from gonio_simulators.wire.sr830_status import (
    EXECUTION_ERROR,
    IDLE,
    ILLEGAL_COMMAND,
    INPUT_OVERFLOW,
    NO_SCAN,
    TRIGGERED,
    StatusRegisters,
)

IDENTITY = "Stanford_Research_Systems,SR830,s/n83022,ver1.07"
CHOPPER_HZ = 137.0
HIGHEST_HZ = 102_000.0
AUTO_TIME_CONSTANTS = 10.0
"""For so long an automatic function keeps the instrument busy; its effect is there from the beginning."""

_INPUT_BUFFER_BYTES = 256


@dataclass(frozen=True, slots=True)
class _Setup:
    """What ``SSET`` stores."""

    values: dict[str, int]
    floats: dict[str, float]
    aux_v: dict[int, float]
    phase_deg: float
    scaling: dict[int, Scaling]
    display: dict[int, tuple[int, int]]


class Sr830:
    """The instrument; its settings outlive clients."""

    def __init__(self, bench: Bench) -> None:
        self._lockin = bench.lockin
        self._clock = bench.clock
        self._values: dict[str, int] = {}
        self._floats: dict[str, float] = {}
        self._aux_v: dict[int, float] = {}
        self._front = {1: 0, 2: 0}  # what the CH1 and CH2 connectors put out
        self._setups: dict[int, _Setup] = {}
        self._busy_until_s = -math.inf
        self._status = status = StatusRegisters(self._condition)
        self._outputs = Outputs(self._lockin, status)
        self._buffer = DataBuffer(self._lockin, self._outputs)
        tau_s = self._lockin.time_constant_s
        self._set_defaults()
        # What the operator dialled in before: the rig file's time constant, a gentle slope, the chopper.
        nearest = min(range(20), key=lambda i: abs(math.log(TIME_CONSTANT_S[i] / tau_s)))
        self._values.update(OFLT=nearest, OFSL=0, FMOD=0)
        self._apply_all()
        self._special: dict[str, Callable[[bool, list[str]], str | bytes]] = {
            "SNAP": self._snap,
            "OUTP": self._output,
            "OUTR": self._shown,
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
            "SSET": self._save_setup,
            "RSET": self._recall_setup,
            "PHAS": self._phase,
            "FREQ": self._frequency,
            "HARM": self._harmonic,
            "SLVL": self._sine_level,
            "APHS": self._auto_phase,
            "AGAN": self._auto_gain,
            "ARSV": self._auto_reserve,
            "AOFF": self._auto_offset,
            "OEXP": self._offset_expand,
            "DDEF": self._display,
            "FPOP": self._front_output,
            "AUXV": self._aux_output,
            "OAUX": self._aux_input,
            "STRT": lambda q, p: self._command(q, p, self._buffer.start),
            "PAUS": lambda q, p: self._command(q, p, self._buffer.pause),
            "REST": lambda q, p: self._command(q, p, self._buffer.reset),
            "STRD": lambda q, p: self._command(q, p, lambda: self._buffer.start(DELAYED_START_S)),
            "TRIG": lambda q, p: self._command(q, p, self._trigger),
            "SPTS": self._point_count,
            "TRCA": lambda q, p: ascii_points(self._points(q, p)),
            "TRCB": lambda q, p: ieee_points(self._points(q, p)),
            "TRCL": lambda q, p: lia_points(self._points(q, p)),
        }

    def power_cycle(self, *, memory_lost: bool = False) -> None:
        """Switch off and on: settings are kept while the battery lasts; points and averages are not."""
        self._lockin.power_cycle()
        self._buffer.reset()
        self._busy_until_s = -math.inf
        if memory_lost:
            self._set_defaults()
        self._outputs.forget()
        self._status.switch_on(clears_enables=self._values["*PSC"] == 1)

    def open(self) -> LockinConversation:
        """Begin a conversation with a new client."""
        return LockinConversation(self)

    def carry_out(self, line: str) -> bytes:
        """Carry out the commands of one line and return the answers, each with its CR."""
        if self._buffer.in_progress:
            self._lockin.advance()  # what is stored until now knows nothing of these commands
        self._outputs.forget()  # one look at the outputs serves all queries of a line
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
                answers.append(answer if isinstance(answer, bytes) else answer.encode("ascii") + b"\r")
        return b"".join(answers)

    def overflow(self) -> None:
        """Take note that more was sent than the input buffer holds."""
        self._status.events |= INPUT_OVERFLOW

    def _one(self, text: str) -> str | bytes:
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
        """Let the bench and the buffer know of a setting that they have."""
        if name == "SENS":
            self._lockin.sensitivity_v = SENSITIVITY_V[value]
        elif name == "OFLT":
            self._lockin.time_constant_s = TIME_CONSTANT_S[value]
        elif name == "OFSL":
            self._lockin.order = value + 1  # 6 dB/octave each
        elif name == "SRAT":
            self._buffer.rate = value
        elif name == "SEND":
            self._buffer.loops = value == 1
        elif name == "TSTR":
            self._buffer.starts_on_trigger = value == 1
        else:
            return
        self._outputs.forget()

    def _set_defaults(self) -> None:
        self._values = {name: choice.default for name, choice in CHOICES.items()}
        self._floats = {"FREQ": 1000.0, "SLVL": 1.0}
        self._aux_v = {}
        self._front = {1: 0, 2: 0}
        self._lockin.phase_deg = 0.0
        self._buffer.reset()
        self._outputs.reset()
        self._apply_all()

    def _apply_all(self) -> None:
        for name, value in self._values.items():
            self._apply(name, value)

    def _condition(self) -> int:
        busy = self._clock.now_s() < self._busy_until_s
        return (0 if self._buffer.in_progress else NO_SCAN) | (0 if busy else IDLE)

    def _command(self, is_query: bool, parameters: list[str], do: Callable[[], None]) -> str:
        if is_query or parameters:
            raise Illegal
        do()
        return ""

    # -- outputs ------------------------------------------------------------------------------------------

    def _output(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        return self._outputs.text(item_of(parameters, 1, 1, 4), 0.0)

    def _shown(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        return f"{self._outputs.shown(item_of(parameters, 1, 1, 2)):g}"

    def _snap(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query or not 2 <= len(parameters) <= 6:
            raise Illegal
        if parameters == ["1", "2"]:  # what a scan asks for, without detours
            return "{:g},{:g}".format(*self._outputs.look()[:2])
        return ",".join([self._outputs.text(whole(p), self._reference_hz()) for p in parameters])

    def _lia_status(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        self._outputs.look()  # an overload of this moment counts, too
        return self._status.read_lia(parameters)

    # -- data buffer --------------------------------------------------------------------------------------

    def _trigger(self) -> None:
        if self._buffer.trigger():
            self._status.lia |= TRIGGERED

    def _point_count(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query or parameters:
            raise Illegal
        return str(len(self._buffer))

    def _points(self, is_query: bool, parameters: list[str]) -> list[float]:
        if not is_query or len(parameters) != 3:
            raise Illegal
        channel, start, count = wholes(parameters)
        return self._buffer.points(channel, start, count)

    # -- identity, reset, stored setups -------------------------------------------------------------------

    def _identify(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query or parameters:
            raise Illegal
        return IDENTITY

    def _reset(self, is_query: bool, parameters: list[str]) -> str:
        if is_query or parameters:
            raise Illegal
        kept = {name: self._values[name] for name in ("OUTX", "OVRM", "*PSC")}  # the interface's own
        self._set_defaults()
        self._values.update(kept)
        return ""

    def _save_setup(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            raise Illegal
        self._setups[item_of(parameters, 1, 1, 9)] = _Setup(
            dict(self._values),
            dict(self._floats),
            dict(self._aux_v),
            self._lockin.phase_deg,
            dict(self._outputs.scaling),
            dict(self._outputs.display),
        )
        return ""

    def _recall_setup(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            raise Illegal
        setup = self._setups.get(item_of(parameters, 1, 1, 9))
        if setup is None:
            raise OutOfRange
        interface = self._values["OUTX"]
        self._buffer.reset()
        self._values = {**setup.values, "OUTX": interface}
        self._floats, self._aux_v = dict(setup.floats), dict(setup.aux_v)
        self._lockin.phase_deg = setup.phase_deg
        self._outputs.scaling, self._outputs.display = dict(setup.scaling), dict(setup.display)
        self._apply_all()
        return ""

    # -- reference ----------------------------------------------------------------------------------------

    def _phase(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            return f"{self._lockin.phase_deg:.2f}"
        self._turn_to(number(parameters, -360.0, 729.99))
        return ""

    def _turn_to(self, phase_deg: float) -> None:
        self._lockin.phase_deg = round((phase_deg + 180.0) % 360.0 - 180.0, 2)
        self._outputs.forget()

    def _reference_hz(self) -> float:
        return CHOPPER_HZ if self._values["FMOD"] == 0 else self._floats["FREQ"]

    def _frequency(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            return frequency_text(self._reference_hz())
        value = number(parameters, 0.001, HIGHEST_HZ)
        if self._values["FMOD"] == 0 or value * self._values["HARM"] > HIGHEST_HZ:
            raise OutOfRange  # the chopper sets the frequency; the detection has its limit
        self._floats["FREQ"] = value
        return ""

    def _harmonic(self, is_query: bool, parameters: list[str]) -> str:
        """A harmonic beyond the limit of the detection becomes the highest one below it."""
        if is_query:
            return str(self._values["HARM"])
        value = item_of(parameters, 1, CHOICES["HARM"].low, CHOICES["HARM"].high)
        self._values["HARM"] = max(1, min(value, int(HIGHEST_HZ / self._reference_hz())))
        return ""

    def _sine_level(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            return f"{self._floats['SLVL']:.3f}"
        self._floats["SLVL"] = round(number(parameters, 0.004, 5.0) / 0.002) * 0.002
        return ""

    # -- automatics ---------------------------------------------------------------------------------------

    def _keep_busy(self) -> None:
        self._busy_until_s = self._clock.now_s() + AUTO_TIME_CONSTANTS * self._lockin.time_constant_s

    def _auto_phase(self, is_query: bool, parameters: list[str]) -> str:
        if is_query or parameters:
            raise Illegal
        self._turn_to(self._lockin.phase_deg + self._outputs.value(4))
        self._keep_busy()
        return ""

    def _auto_gain(self, is_query: bool, parameters: list[str]) -> str:
        """Take the most sensitive range that holds the magnitude; nothing with time constants above 1 s."""
        if is_query or parameters:
            raise Illegal
        if self._values["OFLT"] > 10:
            return ""
        self._lockin.advance()
        magnitude_v = math.hypot(*self._lockin.demodulated())
        self._values["SENS"] = next((i for i, v in enumerate(SENSITIVITY_V) if v >= magnitude_v), 26)
        self._apply("SENS", self._values["SENS"])
        self._keep_busy()
        return ""

    def _auto_reserve(self, is_query: bool, parameters: list[str]) -> str:
        """Take the least reserve that does not overload: low noise, as the bench has no interference."""
        if is_query or parameters:
            raise Illegal
        self._values["RMOD"] = 2
        self._keep_busy()
        return ""

    def _auto_offset(self, is_query: bool, parameters: list[str]) -> str:
        if is_query:
            raise Illegal
        item = item_of(parameters, 1, X, R)
        self._lockin.advance()
        percent = self._outputs.auto_offset_percent(item)
        self._outputs.scaling[item] = Scaling(percent, self._outputs.scaling[item].expand)
        self._outputs.forget()
        return ""

    def _offset_expand(self, is_query: bool, parameters: list[str]) -> str:
        item = item_of(parameters, 1 if is_query else 3, X, R)
        if is_query:
            scaling = self._outputs.scaling[item]
            return f"{scaling.offset_percent:.2f},{scaling.expand}"
        (percent,), expand = numbers(parameters[1:2]), whole(parameters[2])
        if abs(percent) > OFFSET_LIMIT_PERCENT or not 0 <= expand < len(EXPAND):
            raise OutOfRange
        self._outputs.scaling[item] = Scaling(round(percent, 2), expand)
        self._outputs.forget()
        return ""

    # -- displays and auxiliaries -------------------------------------------------------------------------

    def _display(self, is_query: bool, parameters: list[str]) -> str:
        channel = item_of(parameters, 1 if is_query else 3, 1, 2)
        if is_query:
            return "{},{}".format(*self._outputs.display[channel])
        quantity, ratio = wholes(parameters[1:])
        if not (0 <= quantity <= 4 and 0 <= ratio <= 2):
            raise OutOfRange
        self._outputs.display[channel] = (quantity, ratio)
        return ""

    def _front_output(self, is_query: bool, parameters: list[str]) -> str:
        channel = item_of(parameters, 1 if is_query else 2, 1, 2)
        if is_query:
            return str(self._front[channel])
        self._front[channel] = item_of(parameters[1:], 1, 0, 1)
        return ""

    def _aux_output(self, is_query: bool, parameters: list[str]) -> str:
        item = item_of(parameters, 1 if is_query else 2, 1, 4)
        if is_query:
            return f"{self._aux_v.get(item, 0.0):.3f}"
        self._aux_v[item] = round(number(parameters[1:], -10.5, 10.5), 3)
        return ""

    def _aux_input(self, is_query: bool, parameters: list[str]) -> str:
        if not is_query:
            raise Illegal
        item_of(parameters, 1, 1, 4)
        return auxiliary_text()


class LockinConversation:
    """Splits what one client sends into lines."""

    wait_s: float | None = None

    def __init__(self, device: Sr830) -> None:
        self._device = device
        self._unfinished = b""

    def feed(self, data: bytes) -> bytes:
        """Take received bytes and return the answers to the lines they complete."""
        lines = (self._unfinished + data).replace(b"\r", b"\n").split(b"\n")
        self._unfinished = lines.pop()
        if len(self._unfinished) > _INPUT_BUFFER_BYTES:
            self._device.overflow()
            self._unfinished = b""
        carry_out = self._device.carry_out
        return b"".join([carry_out(line.decode("latin-1")) for line in lines if line])

    def poll(self) -> bytes:
        """The instrument speaks when it is asked."""
        return b""

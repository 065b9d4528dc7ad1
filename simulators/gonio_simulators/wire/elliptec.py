"""A Thorlabs Elliptec ELL14 rotation mount on its multi-drop bus.

A command is an address digit, two lower-case letters and upper-case hexadecimal data of a length that the
letters determine; it has no terminator.  Replies end with CRLF.  A movement is answered when it is over;
until then other commands get the status *busy*.
"""

from __future__ import annotations

import string

from gonio_simulators.bench.bench import Bench
from gonio_simulators.bench.motor import Fault

PULSES_PER_REVOLUTION = 143_360

_DATA_LENGTH = {
    **dict.fromkeys(("in", "gs", "gp", "gj", "go", "gv", "fw", "bw", "st", "us", "i1", "i2", "s1", "s2"), 0),
    **dict.fromkeys(("ho", "ca"), 1),
    **dict.fromkeys(("sv", "is"), 2),
    **dict.fromkeys(("ma", "mr", "sj", "so"), 8),
}
_MOVES = frozenset(("ho", "ma", "mr", "fw", "bw"))

OK, MECHANICAL_TIMEOUT, NOT_SUPPORTED, BAD_VALUE, BUSY, OUT_OF_RANGE = 0x00, 0x02, 0x03, 0x04, 0x09, 0x0C

# Type 0E (ELL14), serial number, year, firmware, thread and hardware issue, travel 0x168 = 360 deg, pulses
_INFORMATION = f"0E{11400051}{2022}17010168{PULSES_PER_REVOLUTION:08X}"
_MOTOR = {"i1": "I110054CFFFFFFFF00930086", "i2": "I210054CFFFFFFFF00930086"}


class Elliptec:
    """The rotator of the polarizer."""

    def __init__(self, bench: Bench, *, address: str = "0") -> None:
        self._motor = bench.polarizer
        self._clock = bench.clock
        self._address = address.upper()
        self._status = OK  # of the last command; reading it clears it
        self._jog = PULSES_PER_REVOLUTION // 8
        self._home_offset = 0
        self._velocity_percent = 100
        self._full_speed_steps_s = self._motor.speed_steps_s

    @property
    def address(self) -> str:
        """The device's digit on the bus."""
        return self._address

    def open(self) -> ElliptecConversation:
        """Begin a conversation with a new client."""
        return ElliptecConversation(self)

    def answer(self, command: str, data: str) -> bytes | None:
        """Carry out a command; None for a movement, whose answer comes when it is over."""
        if self._motor.is_moving() and command != "st":
            return self._status_reply(BUSY)
        if command in _MOVES:
            return self._move(command, data)
        if command in ("in", "gp", "gj", "go", "gv", *_MOTOR):
            return self._get(command)
        if command not in _DATA_LENGTH:
            return self._status_reply(NOT_SUPPORTED)
        if command == "gs":
            status, self._status = self._status, OK
            return self._status_reply(status, keep=False)
        return self._do(command, data)

    def arrival_wait_s(self) -> float | None:
        """Return the real seconds until the movement is over, None if nothing moves."""
        if not self._motor.is_moving():
            return None
        return max(0.0, (self._motor.motion_s[1] - self._clock.now_s()) / self._clock.speed)

    def arrived(self) -> bytes:
        """Return the answer to the movement that is over."""
        if self._motor.fault is not Fault.NONE:
            self._motor.clear_fault()
            return self._status_reply(MECHANICAL_TIMEOUT)
        return self._get("gp")

    def _get(self, command: str) -> bytes:
        if command == "in":
            return self._reply("IN" + _INFORMATION)
        if command in _MOTOR:
            return self._reply(_MOTOR[command])
        if command == "gv":
            return self._reply(f"GV{self._velocity_percent:02X}")
        kind, value = {
            "gp": ("PO", self._motor.position_steps()),
            "gj": ("GJ", self._jog),
            "go": ("HO", self._home_offset),
        }[command]
        return self._reply(f"{kind}{value & 0xFFFF_FFFF:08X}")

    def _move(self, command: str, data: str) -> bytes | None:
        motor = self._motor
        if command == "ho":
            if data not in ("0", "1"):  # clockwise, counter-clockwise
                return self._status_reply(BAD_VALUE)
            motor.home()
            return None
        value = _signed(data) if data else 0
        if value is None:
            return self._status_reply(BAD_VALUE)
        if command == "ma":
            if abs(value) > PULSES_PER_REVOLUTION:
                return self._status_reply(OUT_OF_RANGE)
            target = value
        else:
            target = motor.position_steps() + {"mr": value, "fw": self._jog, "bw": -self._jog}[command]
        motor.move_absolute(target)
        return None

    def _do(self, command: str, data: str) -> bytes:
        value = _signed(data) if data else 0
        if value is None or (command == "sv" and not 25 <= value <= 100):
            return self._status_reply(BAD_VALUE)
        if command == "sv":  # percent; below about a quarter the resonant motor stalls
            self._velocity_percent = value
            self._motor.speed_steps_s = self._full_speed_steps_s * value / 100.0
        elif command == "sj":
            self._jog = value
        elif command == "so":
            self._home_offset = value
        elif command == "ca":
            self._address = data.upper()
        elif command == "st":
            self._motor.stop()
        # us (save), is (isolate) and s1, s2 (search for the resonance) change nothing here
        return self._status_reply(OK)

    def _status_reply(self, status: int, *, keep: bool = True) -> bytes:
        if keep:
            self._status = status
        return self._reply(f"GS{status:02X}")

    def _reply(self, text: str) -> bytes:
        return f"{self._address}{text}\r\n".encode("ascii")


class ElliptecConversation:
    """Splits the bytes of one client into commands by their length."""

    def __init__(self, device: Elliptec) -> None:
        self.wait_s: float | None = None
        self._device = device
        self._buffer = ""
        self._owes_arrival = False

    def feed(self, data: bytes) -> bytes:
        """Take received bytes and return the replies to the commands they complete."""
        replies = self.poll()
        self._buffer += data.decode("latin-1")
        while (command := self._next_command()) is not None:
            address, letters, argument = command
            if address != self._device.address:
                continue  # the bus is shared; somebody else's command
            reply = self._device.answer(letters, argument)
            if reply is None:
                self._owes_arrival = True
            else:
                replies += reply
        return replies + self.poll()

    def poll(self) -> bytes:
        """Return the answer to a movement, if it is over."""
        self.wait_s = None
        if not self._owes_arrival:
            return b""
        self.wait_s = self._device.arrival_wait_s()
        if self.wait_s is not None:
            return b""
        self._owes_arrival = False
        return self._device.arrived()

    def _next_command(self) -> tuple[str, str, str] | None:
        """Take a complete command from the buffer, skipping the line ends that some clients send."""
        self._buffer = self._buffer.lstrip("\r\n \0")
        if len(self._buffer) < 3:
            return None
        address, letters = self._buffer[0].upper(), self._buffer[1:3]
        length = 3 + _DATA_LENGTH.get(letters, 0)
        if letters not in _DATA_LENGTH or address not in string.hexdigits:
            self._buffer, argument = "", ""  # its length cannot be known
            return address, letters, argument
        argument = self._buffer[3:length]
        if len(argument) < length - 3:
            return None
        self._buffer = self._buffer[length:]
        return address, letters, argument


def _signed(data: str) -> int | None:
    """Return hexadecimal data as a number, 32-bit data as two's complement, None if it is none."""
    if not all(c in string.hexdigits for c in data):
        return None
    value = int(data, 16)
    return value - (1 << 32) if len(data) == 8 and value & 0x8000_0000 else value

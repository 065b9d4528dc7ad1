"""One Thorlabs Elliptec ELL14 rotation mount: its commands, its status, and how long each keeps it busy.

A movement is answered when it is over, with the position; until then every other command is answered with
the status *busy*.  A bounded movement cannot be stopped; ``st`` ends continuous turning, optimising and
cleaning.  After Thorlabs' ELLx protocol manual.
"""

from __future__ import annotations

import string
from collections.abc import Callable, Mapping

from gonio_simulators.bench.bench import Bench
from gonio_simulators.bench.motor import Fault

PULSES_PER_REVOLUTION = 143_360

DATA_LENGTH: Mapping[str, int] = {
    **dict.fromkeys(("in", "gs", "us", "gp", "gj", "go", "gv", "fw", "bw", "st", "sk", "om", "cm"), 0),
    **dict.fromkeys(("i1", "i2", "s1", "s2", "c1", "c2"), 0),
    **dict.fromkeys(("ho", "ca", "ga"), 1),
    **dict.fromkeys(("sv", "is"), 2),
    **dict.fromkeys(("f1", "f2", "b1", "b2"), 4),
    **dict.fromkeys(("ma", "mr", "sj", "so"), 8),
}

OK, MECHANICAL_TIMEOUT, NOT_SUPPORTED, BAD_VALUE, BUSY, OUT_OF_RANGE = 0x00, 0x02, 0x03, 0x04, 0x09, 0x0C
THERMAL_ERROR, SENSOR_ERROR = 0x08, 0x0A
_STATUS_OF = {Fault.OVER_TEMPERATURE: THERMAL_ERROR, Fault.ENCODER: SENSOR_ERROR}  # others: time-out

# Type 0E (ELL14), serial number, year, firmware, thread and hardware issue, travel 0x168 = 360 deg, pulses
INFORMATION = f"0E{11400051}{2022}17010168{PULSES_PER_REVOLUTION:08X}"
FACTORY_PERIODS = {"f1": 0x0093, "b1": 0x0086, "f2": 0x0093, "b2": 0x0086}  # 14.74 MHz over the resonance
RESTORE_PERIOD = 0x0FFF  # periods have 12 bits; the highest bit that some clients set means "tuned"
SLOWEST_PERCENT = 25  # below about a quarter of its speed the resonant motor stalls

TASK_S = {"s1": 2.0, "s2": 2.0, "om": 60.0, "cm": 60.0}
"""Bench seconds that frequency search, optimising and cleaning take; they leave no trace on this bench."""

_ENDLESS_PULSES = 1 << 40


class Module:
    """The rotator of the polarizer."""

    def __init__(self, bench: Bench, address: str) -> None:
        self._motor = bench.polarizer
        self._clock = bench.clock
        self.address = address
        self.group_address: str | None = None  # heard beside its own until the next movement ends
        self._status = OK  # of the last command; reading it clears it
        self._jog = PULSES_PER_REVOLUTION // 8
        self._home_offset = 0
        self._zero = 0  # motor count of position 0
        self._velocity_percent = 100
        self._full_speed_steps_s = self._motor.speed_steps_s
        self._periods = dict(FACTORY_PERIODS)
        self._isolated_until_s = 0.0
        self._task_until_s = 0.0
        self._ends_with: Callable[[], bytes | None] | None = None  # what an answer is owed to
        self._turns_endlessly = False
        self._saved = self._settings()

    def _settings(self) -> tuple[str, int, int, int, dict[str, int]]:
        return self.address, self._jog, self._home_offset, self._velocity_percent, dict(self._periods)

    def power_cycle(self) -> None:
        """Switch off and on: the position is unknown, settings are those that ``us`` saved last."""
        self._motor.power_cycle()
        self.address, self._jog, self._home_offset, self._velocity_percent, periods = self._saved
        self._periods = dict(periods)
        self._motor.speed_steps_s = self._full_speed_steps_s * self._velocity_percent / 100.0
        self.group_address, self._ends_with = None, None
        self._status, self._zero, self._turns_endlessly = OK, 0, False
        self._isolated_until_s = self._task_until_s = 0.0

    def hears(self, address: str, command: str) -> bool:
        """Say whether a command is for this module; isolated, it only hears the end of its isolation."""
        if address not in (self.address, self.group_address):
            return False
        return command == "is" or self._clock.now_s() >= self._isolated_until_s

    @property
    def owes_answer(self) -> bool:
        """Whether something is under way whose answer comes at its end."""
        return self._ends_with is not None

    def wait_s(self) -> float | None:
        """Return the real seconds until what is under way is over, None if nothing is."""
        end_s = max(self._task_until_s, self._motor.motion_s[1] if self._motor.is_moving() else 0.0)
        left_s = end_s - self._clock.now_s()
        return left_s / self._clock.speed if left_s > 0 else None

    def answer(self, command: str, data: str) -> bytes | None:
        """Carry out a command; None if the answer comes when it is over."""
        if self._turns_endlessly or self.owes_answer:
            return self._stop() if command == "st" else self._reply(f"GS{BUSY:02X}")
        if command not in DATA_LENGTH or command in ("c1", "c2"):  # a current curve this bench does not have
            return self._result(NOT_SUPPORTED)
        if any(c not in string.digits + "ABCDEF" for c in data):  # the modules tell cases apart
            return self._result(BAD_VALUE)
        if command in ("ho", "ma", "mr", "fw", "bw"):
            return self._move(command, data)
        if command in TASK_S:
            self._task_until_s = self._clock.now_s() + TASK_S[command]
            self._ends_with = lambda: self._result(OK)
            return None
        return self._ask(command) or self._set(command, data)

    def finish(self) -> bytes | None:
        """Return the answer to what is over; None if a further movement follows."""
        assert self._ends_with is not None
        ends_with, self._ends_with = self._ends_with, None
        return ends_with()

    # -- movements ----------------------------------------------------------------------------------------

    def _move(self, command: str, data: str) -> bytes | None:
        if command == "ho":
            if data not in ("0", "1"):  # clockwise, counter-clockwise
                return self._result(BAD_VALUE)
            self._motor.home()
            self._ends_with = self._at_the_index
            return None
        value = {"fw": self._jog, "bw": -self._jog}.get(command, _signed(data) if data else 0)
        if command in ("fw", "bw") and self._jog == 0:
            self._turns_endlessly = True
            self._motor.move_absolute(_ENDLESS_PULSES if command == "fw" else -_ENDLESS_PULSES)
            return self._result(OK)
        if command == "ma" and abs(value) > PULSES_PER_REVOLUTION:
            return self._result(OUT_OF_RANGE)
        start = self._zero if command == "ma" else self._motor.position_steps()
        self._motor.move_absolute(start + value)
        self._ends_with = self._arrived
        return None

    def _at_the_index(self) -> bytes | None:
        """Go on from the index to the home offset, which becomes the new zero."""
        self._zero = self._home_offset
        if self._zero and self._motor.fault is Fault.NONE:
            self._motor.move_absolute(self._zero)
            self._ends_with = self._arrived
            return None
        return self._arrived()

    def _arrived(self) -> bytes:
        self.group_address = None
        if (fault := self._motor.fault) is not Fault.NONE:
            self._motor.clear_fault()
            return self._result(_STATUS_OF.get(fault, MECHANICAL_TIMEOUT))
        return self._position()

    def _stop(self) -> bytes | None:
        if self._turns_endlessly:
            self._turns_endlessly = False
            self._motor.stop()
            self._ends_with = lambda: self._result(OK)
            return None
        if self._task_until_s > self._clock.now_s():
            self._task_until_s = 0.0
            return None  # the end of the task answers
        return self._reply(f"GS{BUSY:02X}")

    def _position(self) -> bytes:
        return self._reply(f"PO{self._motor.position_steps() - self._zero & 0xFFFF_FFFF:08X}")

    # -- queries and settings -----------------------------------------------------------------------------

    def _ask(self, command: str) -> bytes | None:
        if command == "in":
            return self._reply("IN" + INFORMATION)
        if command == "gs":
            status, self._status = self._status, OK
            return self._reply(f"GS{status:02X}")
        if command == "gp":
            return self._position()
        if command == "gv":
            return self._reply(f"GV{self._velocity_percent:02X}")
        if command in ("i1", "i2"):  # loop on, motor at rest, current, ramps (none), periods
            forward, backward = self._periods[f"f{command[1]}"], self._periods[f"b{command[1]}"]
            return self._reply(f"I{command[1]}10054CFFFFFFFF{forward:04X}{backward:04X}")
        if command in ("gj", "go"):
            kind, value = ("GJ", self._jog) if command == "gj" else ("HO", self._home_offset)
            return self._reply(f"{kind}{value & 0xFFFF_FFFF:08X}")
        return None

    def _set(self, command: str, data: str) -> bytes:
        value = _signed(data) if data else 0
        if command == "sv":  # percent
            if not SLOWEST_PERCENT <= value <= 100:
                return self._result(BAD_VALUE)
            self._velocity_percent = value
            self._motor.speed_steps_s = self._full_speed_steps_s * value / 100.0
        elif command == "sj":
            self._jog = value
        elif command == "so":
            self._home_offset = value
        elif command == "ca":
            self.address = data
        elif command == "ga":
            self.group_address = data
            self._status = OK
            return f"{data}GS00\r\n".encode("ascii")
        elif command == "is":  # minutes
            self._isolated_until_s = self._clock.now_s() + 60.0 * value
        elif command in self._periods:
            period = value & 0x0FFF
            self._periods[command] = FACTORY_PERIODS[command] if period == RESTORE_PERIOD else period
        elif command == "us":
            self._saved = self._settings()
        # sk (skip the search at power on) and st (at rest) change nothing here
        return self._result(OK)

    def _result(self, status: int) -> bytes:
        self._status = status
        return self._reply(f"GS{status:02X}")

    def _reply(self, text: str) -> bytes:
        return f"{self.address}{text}\r\n".encode("ascii")


def _signed(data: str) -> int:
    """Return hexadecimal data as a number, 32-bit data as two's complement."""
    value = int(data, 16)
    return value - (1 << 32) if len(data) == 8 and value & 0x8000_0000 else value

"""The polarizer in a Thorlabs Elliptec rotator (ELL14): ``polarizer.driver = "elliptec"``.

Replies carry no number, only the address and the kind: ``PO`` a position, ``GS`` a status.  A move is
answered when it has ended: with its position, by some firmware with status 0; on the way some send the status
busy, or positions that they pass.  So where a move ended is taken from positions asked for afterwards.
Reference: Thorlabs, ELLx modules protocol manual.
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from gonio.config import Count, Positive
from gonio.devices import Polarization
from gonio.errors import DeviceError, MotionError
from gonio.rig import Context, Driver, PolarizerConfig
from gonio_drivers.lines import Line, NoReply, connecting, open_line

_MOVE_S = 5.0  # instrument seconds: a full turn with friction takes 2 to 3
_LOOK_S = 0.05  # instrument seconds between two looks at a module that may still move
_BUSY_ATTEMPTS = 100
_BUSY = "busy"
_REPLY = re.compile(rb"([0-9A-Fa-f])([A-Z]{2})([0-9A-Fa-f]+)")
_FARTHEST_DEG = 3600.0  # ten turns; a flipped bit of the 32 reads as up to five million degrees

_STATUS: Mapping[int, tuple[str, str]] = {
    1: ("communication time-out", "check the cable"),
    2: ("mechanical time-out: it did not arrive", "check that it turns freely, then home it"),
    3: ("command error or not supported", "check that the module is an ELL14"),
    4: ("value out of range", "check s_deg and p_deg in the rig file"),
    5: ("module isolated", "check the bus"),
    6: ("module out of isolation", "check the bus"),
    7: ("initialisation error", "switch it off and on"),
    8: ("too hot", "let it cool"),
    9: ("busy", "wait and repeat"),
    10: ("sensor error", "switch it off and on, then home it"),
    11: ("motor error", "run the motor's frequency search, then home it"),
    12: ("out of range", "check s_deg and p_deg in the rig file, then home it"),
    13: ("over-current", "switch it off and on"),
}


class ElliptecConfig(PolarizerConfig):
    """``[polarizer]`` with ``driver = "elliptec"``."""

    device: Annotated[str, Field(pattern="^[0-9A-Fa-f]$")] = "0"  # address on its bus
    pulses_per_turn: Count = 143360
    tolerance_deg: Positive = 0.1
    home_on_connect: bool = True  # the module counts from wherever it was switched on
    baudrate: Count = 9600


class ElliptecRotator:
    """The rotator; satisfies `gonio.devices.Polarizer`."""

    name = "polarizer"
    parent = None

    def __init__(self, config: ElliptecConfig, context: Context, line: Line) -> None:
        self._config = config
        self._line = line
        self._address = config.device.upper()
        self._clock = context.clock
        self._device = f"{line.device} (Elliptec module {self._address})"
        # The reply to a move comes when it has ended, in the module's own time.
        self._move_timeout_s = line.reply_timeout_s + _MOVE_S / context.clock.speed
        self._stop_asked = threading.Event()
        self._rests_at_deg: float | None = None  # where the last move ended; None: the count is in doubt
        self._description = self._identified()
        if config.home_on_connect:
            self._home()
        else:
            self._rests_at_deg = self.position_deg()

    def select(self, polarization: Polarization) -> float:
        """Turn to S or P, verify, and return the read-back angle in degrees; no move if it stands there.

        Raises
        ------
        MotionError
            The module reported a fault, or stands elsewhere afterwards.
        DeviceError
            The module does not answer.
        """
        self._stop_asked.clear()
        target_deg = self._config.s_deg if polarization == "s" else self._config.p_deg
        here_deg = self.position_deg()
        if self._rests_at_deg is None or not self._is_at(here_deg, self._rests_at_deg):
            self._home()  # turned by hand, or switched off and counting from zero again
            here_deg = self.position_deg()
        if self._is_at(here_deg, target_deg):
            return here_deg
        pulses = round(target_deg * self._config.pulses_per_turn / 360.0)
        if not self._move(f"ma{pulses & 0xFFFFFFFF:08X}"):
            # Without its reply the module may have restarted on the way, and count from there.
            self._home()
            self._exchange(f"ma{pulses & 0xFFFFFFFF:08X}", "PO", self._move_timeout_s)
        here_deg = self._came_to_rest(target_deg)
        if self._stop_asked.is_set():
            raise MotionError(
                self._device, f"was stopped on request at {here_deg:.2f} deg", "select again to go on"
            )
        if not self._is_at(here_deg, target_deg):
            raise MotionError(
                self._device,
                f"is at {here_deg:.2f} deg instead of {target_deg:g} +- {self._config.tolerance_deg:g} deg"
                f" ({polarization.upper()})",
                "check that it turns freely, then repeat",
            )
        self._rests_at_deg = here_deg
        return here_deg

    def verify_still(self, expected_deg: float) -> float:
        """Return the position read back if it is where `select` left it; `MotionError` if not."""
        here_deg = self.position_deg()
        if not self._is_at(here_deg, expected_deg):
            self._rests_at_deg = None
            raise MotionError(
                self._device,
                f"is at {here_deg:.2f} deg although it was left at {expected_deg:.2f} deg",
                "leave the polarizer alone while it measures, then repeat",
            )
        return here_deg

    def recover(self) -> str:
        """Come back to a known state after a failure; say what had to be done for it.

        The line is opened anew if it was lost, the module must be the same one, and it is homed.

        Raises
        ------
        ConnectionFailed
            The line cannot be opened (yet).
        DeviceError
            The module does not answer, is another one, or does not turn.
        """
        done = ["connection opened anew"] if self._line.renew() else []
        self._rests_at_deg = None
        description = self._identified()
        if description != self._description:
            raise DeviceError(
                self._device,
                f"is another module now: {description} instead of {self._description}",
                "restore the bus as it was, or open the rig again",
            )
        self._home()
        return ", ".join([*done, "homed"])

    def position_deg(self) -> float:
        """Return the position read back from the module, degrees."""
        return self._degrees(self._query("gp", "PO"))

    def identify(self) -> str:
        """Return type, serial number and firmware."""
        return self._description

    def stop(self) -> None:
        """Let a `select` in progress end with an error; any thread, any time.

        The module has no command that interrupts an absolute move; the turn ends by itself within seconds and
        touches nothing.
        """
        self._stop_asked.set()

    def close(self) -> None:
        """Release the line."""
        self._line.close()

    def _is_at(self, here_deg: float, target_deg: float) -> bool:
        return abs(here_deg - target_deg) <= self._config.tolerance_deg

    def _degrees(self, digits: str) -> float:
        pulses = int(digits, 16)
        if pulses >= 0x80000000:  # two's complement, 32 bits
            pulses -= 0x100000000
        return pulses * 360.0 / self._config.pulses_per_turn

    def _home(self) -> None:
        self._rests_at_deg = None
        if not self._move("ho0"):  # 0: clockwise
            # A module that restarted says 0 wherever it stands: only a reply to the search itself counts.
            self._exchange("ho0", "PO", self._move_timeout_s)
        here_deg = self._came_to_rest(0.0)
        if not self._is_at(here_deg, 0.0):
            raise MotionError(
                self._device, f"is at {here_deg:.2f} deg after homing", "check that it turns freely"
            )
        self._rests_at_deg = here_deg

    def _move(self, command: str) -> bool:
        """Send a move once and wait for its end; say whether its reply came.

        Where it ended is for the read-back to say.
        """
        try:
            self._exchange(command, "PO", self._move_timeout_s)
        except NoReply:
            return False
        return True

    def _came_to_rest(self, target_deg: float) -> float:
        """Return where the module stands: at the target, or where it is seen twice, degrees."""
        end_s = time.monotonic() + self._move_timeout_s
        before_deg, here_deg = math.nan, self.position_deg()
        while not self._is_at(here_deg, target_deg) and here_deg != before_deg and time.monotonic() < end_s:
            self._clock.sleep(_LOOK_S)
            before_deg, here_deg = here_deg, self.position_deg()
        return here_deg

    def _identified(self) -> str:
        digits = self._query("in", "IN")
        # type (2), serial number (8), year (4), firmware (2), hardware (2), travel (4), pulses per unit (8)
        if len(digits) != 30:
            raise DeviceError(
                self._device, f"identified itself as '{digits}'", "check that the module is an ELL14"
            )
        travel_deg, pulses = int(digits[18:22], 16), int(digits[22:30], 16)
        # Of a turn; some firmware tells those of one degree, rounded down.
        if 0 <= self._config.pulses_per_turn - pulses * travel_deg < travel_deg:
            pulses = self._config.pulses_per_turn
        if pulses != self._config.pulses_per_turn:
            raise DeviceError(
                self._device,
                f"counts {pulses} pulses per turn, the rig file says {self._config.pulses_per_turn}",
                "correct pulses_per_turn in the rig file",
            )
        return f"Thorlabs ELL{int(digits[:2], 16)}, serial {digits[2:10]}, firmware {digits[14]}.{digits[15]}"

    def _query(self, command: str, kind: str) -> str:
        """Ask, and again while a move of whoever was here before makes the module say busy."""
        for attempt in range(_BUSY_ATTEMPTS):
            if attempt:
                self._clock.sleep(_LOOK_S)
            digits = self._line.query(lambda: self._exchange(command, kind))
            if digits != _BUSY:
                return digits
        raise MotionError(self._device, "stays busy (status 9)", "switch it off and on, then home it")

    def _exchange(self, command: str, kind: str, timeout_s: float | None = None) -> str:
        """Send one command and return the hexadecimal digits of its reply."""
        with self._line.transaction(self._prove):
            return self._ask(command, kind, timeout_s)

    def _ask(self, command: str, kind: str, timeout_s: float | None = None) -> str:
        line = self._line
        # A command has no terminator: its letters say how long it is.
        sent = f"{self._address}{command}".encode("ascii")
        line.send(sent)
        deadline_s = line.deadline_s(timeout_s)
        is_move = timeout_s is not None
        while True:
            raw = line.read_line(deadline_s)
            match = _REPLY.fullmatch(raw.removeprefix(sent).strip())  # a one-wire adapter hears itself
            if match is None:
                raise line.damaged(raw, f"not an answer to '{self._address}{command}'")
            address, said, digits = (text.decode() for text in match.groups())
            if address.upper() != self._address:
                line.stale(raw)  # another module of the bus talks
                continue
            if said not in (kind, "GS"):
                raise line.damaged(raw, f"not an answer to '{self._address}{command}'")
            if said == "GS" and len(digits) != 2:
                raise line.damaged(raw, "a status has 2 digits")
            if said == kind:
                if kind == "PO" and not (len(digits) == 8 and abs(self._degrees(digits)) <= _FARTHEST_DEG):
                    raise line.damaged(raw, f"a position has 8 digits and is within {_FARTHEST_DEG:g} deg")
                line.answered()
                return digits.upper()
            status = int(digits, 16)
            if status == 9 and is_move:
                continue  # busy: the move goes on, its own reply follows
            line.answered()
            if status == 9:
                return _BUSY
            if status == 0 and is_move:
                return ""  # it has ended; where, is for the read-back to say
            fault, remedy = _STATUS.get(status, (f"unknown status {status}", "see the module's manual"))
            if status == 0:
                fault, remedy = f"answered '{raw.decode('ascii')}' instead of a position", "repeat"
            raise MotionError(self._device, f"{fault} (status {status})", remedy)

    def _prove(self) -> None:
        """A status cannot be mistaken for the late reply to a move or a position query."""
        self._ask("gs", "GS")


def open_polarizer(config: ElliptecConfig, context: Context) -> ElliptecRotator:
    """Connect, identify and home the rotator.

    Raises
    ------
    ConnectionFailed
        The address cannot be opened.
    DeviceError
        The module does not answer, is another one, or does not turn.
    """
    line = open_line("polarizer", config.address, context, protocol="elliptec", baudrate=config.baudrate)
    with connecting(line):
        return ElliptecRotator(config, context, line)


driver = Driver("polarizer", ElliptecConfig, open_polarizer)

"""The goniometer on two Applied Motion ST/STM/STF drives over Modbus: ``stage.driver = "applied-motion"``.

Register addresses are 0-based; commands are opcodes written to one register.  Eight registers from 0x00 hold
alarm, status, encoder and position, so one read is the state of one instant. Reference: Applied Motion
Products, Host Command Reference, appendix on Modbus/RTU.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Annotated, Self

from pydantic import Field, model_validator

from gonio.config import Count, Positive
from gonio.errors import DeviceError, MotionError, ReplyError
from gonio.rig import SIMULATED, Context, Driver, StageConfig
from gonio_drivers.drive import DriveState, MotorConfig
from gonio_drivers.modbus import Framing, ModbusLine, WordOrder, open_modbus
from gonio_drivers.stage import MotorStage
from gonio_drivers.transport import Parity
from gonio_drivers.two_axes import open_two_axes

ALARM, STATUS, ENCODER, POSITION = 0x00, 0x01, 0x04, 0x06
ACCELERATION, DECELERATION, VELOCITY, TARGET = 0x1B, 0x1C, 0x1D, 0x1E
OPCODE, PARAMETER_1, PARAMETER_5 = 0x7C, 0x7D, 0x81

MOVE_ABSOLUTE = 0x67  # FP
STOP = 0xE1  # SK
FIND_HOME = 0xDB  # FH
SET_POSITION = 0xA5  # SP
RESET_ALARM = 0xBA  # AX
ENABLE = 0x9F  # ME

ENABLED, FAULT, IN_POSITION, ALARMED = (1 << bit for bit in (0, 2, 3, 9))
MOVING, JOGGING, STOPPING, SAVING, HOMING, CHECKING_ENCODER, INITIALIZING = (
    1 << bit for bit in (4, 5, 6, 8, 10, 13, 15)
)
BUSY = MOVING | JOGGING | STOPPING | SAVING | HOMING | CHECKING_ENCODER | INITIALIZING

IN_POSITION_S = 0.5
"""Real seconds that a servo may take to be in position after its profile has ended; only for drives that have
said so before, and for those with an encoder."""

ROUNDING = 0.01  # by which a drive may round a speed
TURNS_AT_MOST = 2.0  # of the axis beyond its limits; a count farther away has its words the wrong way round

MARK = 0x5AA5
"""Written to a register that no command here uses: a drive that was switched off has forgotten it."""

ACCELERATION_UNITS_PER_RPS_S = 6.0
VELOCITY_UNITS_PER_RPS = 240.0

_ALARMS: Mapping[int, tuple[str, str]] = {
    0: (
        "position error: the motor stalled or was pushed",
        "remove what blocks it, then home the axis and repeat",
    ),
    1: (
        "it met the counter-clockwise limit switch",
        "check limits_deg and zero_deg in the rig file, then home the axis",
    ),
    2: (
        "it met the clockwise limit switch",
        "check limits_deg and zero_deg in the rig file, then home the axis",
    ),
    3: ("the drive is too hot", "let it cool"),
    4: ("its internal voltage is out of range", "switch it off and on; if it stays, it needs service"),
    5: ("the supply voltage is too high", "check the power supply, lower acceleration_deg_s2"),
    6: ("the supply voltage is too low", "check the power supply"),
    7: ("the current is too high", "check the motor and its cable"),
    8: ("a motor winding is open", "check the motor's cable"),
    9: ("the encoder's signal is bad", "check the encoder's cable, then home the axis"),
    11: ("its memory is bad", "restore its settings with the manufacturer's software"),
    13: ("the motor's resistance is out of range", "check the motor and its cable"),
    12: ("it was told to move while the motor was disabled", "enable the motor and repeat"),
}


_NOTES = 1 << 10 | 1 << 14
"""Alarm bits that say nothing of the motion: a damaged request, an empty segment of a Q program."""


class AppliedMotionAxisConfig(MotorConfig):
    """One drive."""

    device: Annotated[int, Field(strict=True, ge=1, le=32)]  # Modbus unit
    steps_per_rev: Positive = 20000.0  # the drive's EG setting; speeds are revolutions of the motor
    encoder_counts_per_rev: Positive | None = None  # with an encoder the read-back is where the shaft is


class AppliedMotionStageConfig(StageConfig):
    """``[stage]`` with ``driver = "applied-motion"``."""

    framing: Framing = "rtu"
    word_order: WordOrder = "big"  # big for PR=5, little for PR=133
    baudrate: Count = 115200
    parity: Parity = "none"  # of a serial line; Modbus' own default is even, these drives' is none
    home_on_connect: bool = True  # the drive cannot say whether it has a reference
    theta_i: AppliedMotionAxisConfig
    theta_mes: AppliedMotionAxisConfig

    @model_validator(mode="after")
    def _framing_suits_the_line(self) -> Self:
        if self.framing == "tcp" and self.address != SIMULATED and not self.address.startswith("socket://"):
            raise ValueError(
                f"framing = 'tcp' at {self.address}: a serial port carries RTU frames; "
                "write framing = 'rtu' or an address socket://host:port"
            )
        return self


class AppliedMotionDrive:
    """One Modbus unit; a `gonio_drivers.axis.Drive`."""

    start_latency_s = 0.1  # between the confirmation of the opcode and the first poll that says moving
    reports_reference = False  # no status bit tells of it

    def __init__(
        self, line: ModbusLine, name: str, config: AppliedMotionAxisConfig, *, referenced: bool
    ) -> None:
        self._line = line
        self._unit = config.device
        self._counts_per_step = (
            None
            if config.encoder_counts_per_rev is None
            else config.encoder_counts_per_rev / config.steps_per_rev
        )
        self.device = f"{name} (Applied Motion unit {config.device}) on the {line.line.device}"
        self._farthest_steps = _farthest_steps(config)
        self._has_in_position = False
        self._profile_ended_s: float | None = None
        self._referenced = referenced
        self._jogged = False  # by its inputs or another program, since the last search for home began
        revs_per_deg = abs(config.steps_per_deg) / config.steps_per_rev
        acceleration = self._units(
            "acceleration_deg_s2", config.acceleration_deg_s2 * revs_per_deg * ACCELERATION_UNITS_PER_RPS_S
        )
        velocity = self._units("speed_deg_s", config.speed_deg_s * revs_per_deg * VELOCITY_UNITS_PER_RPS)
        self._profile = [acceleration, acceleration, velocity]
        self._set_speeds()
        self._marks = self._keeps_mark()

    def describe(self) -> str:
        """Return what is known of the drive, which has no register for its model."""
        alarm, status = self._line.read(self._unit, ALARM, 2)
        return f"Applied Motion Modbus unit {self._unit}, status 0x{status:04X}, alarm 0x{alarm:04X}"

    def state(self) -> DriveState:
        """Ask for alarm, status and position in one read."""
        registers = self._line.read(self._unit, ALARM, 8)
        alarm, status = registers[ALARM], registers[STATUS]
        position_steps = self._line.s32(registers[POSITION : POSITION + 2])
        swapped_steps = self._line.s32(registers[POSITION : POSITION + 2][::-1])
        words_swapped = abs(swapped_steps) <= self._farthest_steps < abs(position_steps)
        if self._counts_per_step is not None:
            position_steps = round(self._line.s32(registers[ENCODER : ENCODER + 2]) / self._counts_per_step)
        self._jogged |= bool(status & JOGGING)
        moving = bool(status & BUSY) or self._is_arriving(status)
        fault, remedy = _fault(alarm, status)
        if fault is None and words_swapped:
            fault = f"its position reads {position_steps} steps, and {swapped_steps} in the other word order"
            remedy = (
                "correct word_order in the rig file (big for PR=5, little for PR=133), then home the axis"
            )
        return DriveState(position_steps, moving, self._referenced, fault, remedy)

    def _is_arriving(self, status: int) -> bool:
        """Say whether the profile has just ended and the shaft may still settle."""
        if status & IN_POSITION:
            self._has_in_position = True
        waits = self._has_in_position or self._counts_per_step is not None
        if status & (BUSY | IN_POSITION) or not status & ENABLED or not waits:
            self._profile_ended_s = None
            return False
        now_s = time.monotonic()
        if self._profile_ended_s is None:
            self._profile_ended_s = now_s
        return now_s - self._profile_ended_s < IN_POSITION_S

    def clear_faults(self) -> None:
        """Reset the alarm and enable the motor; what persists comes back with the next poll."""
        self._line.write_one(self._unit, OPCODE, RESET_ALARM)
        self._line.write_one(self._unit, OPCODE, ENABLE)

    def move_to(self, position_steps: int) -> None:
        """Begin an absolute move."""
        self._line.write(self._unit, TARGET, self._line.from_s32(position_steps))
        self._line.write_one(self._unit, OPCODE, MOVE_ABSOLUTE)

    def home(self) -> None:
        """Begin the search for the home switch."""
        self._referenced = self._jogged = False
        self._line.write_one(self._unit, OPCODE, FIND_HOME)

    def finish_home(self) -> None:
        """Call the place of the home switch zero, which the search itself does not.

        A jog ends the search without an alarm, and the drive then stands anywhere.
        """
        if self._jogged:
            raise MotionError(
                self.device,
                "was jogged while it searched for its reference",
                "leave its jog inputs alone, then home the axis",
            )
        self._line.write(self._unit, PARAMETER_1, [0, 0])
        self._line.write_one(self._unit, OPCODE, SET_POSITION)
        self._referenced = True

    def resume(self) -> None:
        """Find out whether the drive was switched off, and if so set its speeds again.

        Otherwise nothing is written: a mark or a profile written to a drive that was switched off just after
        the question would hide that it was.
        """
        if self.confirm(0) is not None:
            self._referenced = False
            self._set_speeds()
            self._marks = self._keeps_mark()

    def confirm(self, position_steps: int) -> str | None:
        """Look for the mark: a drive that was switched off counts from zero again, wherever it stands."""
        if self._marks:
            forgotten = self._line.read(self._unit, PARAMETER_5, 1) != [MARK]
        else:
            forgotten = self._line.read(self._unit, ACCELERATION, 3) != self._profile_kept
        return "it was switched off and on, and has lost its reference" if forgotten else None

    def stop(self) -> None:
        """Decelerate and stop; sent again if the reply fails, a stop can be repeated without harm."""
        self._line.line.query(lambda: self._line.write_one(self._unit, OPCODE, STOP))

    def _set_speeds(self) -> None:
        self._line.write(self._unit, ACCELERATION, self._profile)
        got = self._line.read(self._unit, ACCELERATION, 3)
        if any(abs(g - p) > max(1.0, ROUNDING * p) for g, p in zip(got, self._profile, strict=True)):
            raise DeviceError(
                self.device,
                f"was told acceleration, deceleration, velocity = {self._profile} and reads {got}",
                "correct speed_deg_s and acceleration_deg_s2 in the rig file",
            )
        self._profile_kept = got

    def _keeps_mark(self) -> bool:
        """Leave the mark; False for a drive whose parameter registers do not keep what is written."""
        try:
            self._line.write_one(self._unit, PARAMETER_5, MARK)
            return self._line.read(self._unit, PARAMETER_5, 1) == [MARK]
        except ReplyError:
            raise
        except DeviceError:  # a Modbus exception: it has no such register
            return False

    def _units(self, key: str, value: float) -> int:
        units = round(value)
        if not 1 <= units <= 0xFFFF:
            raise MotionError(
                self.device,
                f"{key} needs {units} in a register that holds 1...65535",
                f"correct {key} or steps_per_rev in the rig file",
            )
        return units


def _farthest_steps(config: AppliedMotionAxisConfig) -> float:
    """Return the largest count, either way, that the axis can have: wherever the search for home begins."""
    ends = (abs(limit_deg - config.zero_deg) for limit_deg in config.limits_deg)
    return (max(ends) + TURNS_AT_MOST * 360.0) * abs(config.steps_per_deg)


def _fault(alarm: int, status: int) -> tuple[str | None, str]:
    """Return the alarm in words, and what to do."""
    if alarm and not alarm & ~_NOTES:
        alarm, status = 0, status & ~ALARMED
    known = [words for bit, words in _ALARMS.items() if alarm & (1 << bit)]
    unknown = [bit for bit in range(16) if alarm & (1 << bit) and bit not in _ALARMS]
    if known or unknown:
        texts = [text for text, _ in known] + [f"alarm bit {bit}" for bit in unknown]
        remedy = known[0][1] if known else "look the bit up in the drive's manual"
        return f"{' and '.join(texts)} (alarm 0x{alarm:04X})", remedy
    if status & (FAULT | ALARMED):
        return (
            f"fault without an alarm bit (status 0x{status:04X})",
            "read the drive's display, then switch it off and on",
        )
    if not status & ENABLED:
        return f"the motor is disabled (status 0x{status:04X})", "enable it; check the drive's enable input"
    return None, ""


def open_stage(config: AppliedMotionStageConfig, context: Context) -> MotorStage:
    """Connect, set speeds, enable the motors and find the references.

    Raises
    ------
    ConnectionFailed
        The address cannot be opened.
    DeviceError
        A drive does not answer, refuses its speed, or does not find its reference.
    """
    line = open_modbus(
        "stage",
        config.address,
        context,
        framing=config.framing,
        word_order=config.word_order,
        baudrate=config.baudrate,
        parity=config.parity,
    )

    def make(name: str, table: AppliedMotionAxisConfig) -> AppliedMotionDrive:
        return AppliedMotionDrive(line, name, table, referenced=not config.home_on_connect)

    return open_two_axes(config, context, line.line, make, shared=line)


driver = Driver("stage", AppliedMotionStageConfig, open_stage)

"""One Applied Motion ST/STM/STF drive: Modbus registers, opcodes, alarm and status bits.

Register addresses count from 0; a 32-bit value takes two registers in the word order of the drive's
parameter PR (5: big endian, 133: little endian).  Speeds are revolutions per second of the motor times 240,
accelerations revolutions per second squared times 6.

Of the opcodes those are refused (exception 3) that need what the bench has not: sensors and outputs, a stored
program, a following encoder, an analogue input.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Literal

from gonio_simulators.bench.motor import RELEASED, Fault, Motor

WordOrder = Literal["big", "little"]

ALARM, STATUS, ENCODER, POSITION, SET_POSITION = 0x00, 0x01, 0x04, 0x06, 0x08
SPEED_NOW, SPEED_WANTED = 0x0A, 0x0B
TEMPERATURE, BUS_VOLTAGE = 0x0C, 0x0D
ACCELERATION, DECELERATION, VELOCITY, DISTANCE = 0x1B, 0x1C, 0x1D, 0x1E
JOG_ACCELERATION, JOG_DECELERATION, JOG_VELOCITY = 0x2E, 0x2F, 0x30
OPCODE, PARAMETER_1 = 0x7C, 0x7D
_REGISTERS = 0x90
_LIVE = 0x10  # registers below this one are made at each reading
_WRITABLE = frozenset([0x08, 0x09, *range(0x1B, 0x23), *range(0x28, _REGISTERS)])
_CEILINGS = {
    **dict.fromkeys((ACCELERATION, DECELERATION, JOG_ACCELERATION, JOG_DECELERATION), 32767),
    **dict.fromkeys((VELOCITY, JOG_VELOCITY), 32000),
}
_ENDLESS_STEPS = 1 << 40

SPEED_UNIT = 240.0  # per rev/s
ACCELERATION_UNIT = 6.0  # per rev/s2

# exception codes
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3

_ALARM_OF = {
    Fault.NONE: 0,
    Fault.STALL: 1 << 0,  # position error
    Fault.LOW_LIMIT: 1 << 1,  # counter-clockwise: falling counts
    Fault.HIGH_LIMIT: 1 << 2,
    Fault.OVER_TEMPERATURE: 1 << 3,
    Fault.ENCODER: 1 << 0,  # counts that are lost make a position error
}
_DRIVE_FAULTS = RELEASED | {Fault.STALL}  # these release the motor
_ALARM_DISABLED = 1 << 12


class ModbusError(Exception):
    """The request is answered with this exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class Drive:
    """One drive with its motor.

    Parameters
    ----------
    motor
        What it turns.
    steps_per_rev
        Microsteps of one revolution of the motor (the drive's parameter EG), which scale speeds.
    word_order
        Which half of a 32-bit value has the lower address.
    """

    def __init__(self, motor: Motor, *, steps_per_rev: float, word_order: WordOrder) -> None:
        self.motor = motor
        self._steps_per_rev = steps_per_rev
        self._high_first = word_order == "big"
        self._offset = 0  # SP renames where the counter stands
        self._encoder_offset = 0
        self._origins = motor.origins_steps
        self._enabled = True  # these drives energise the motor when power comes on
        self._moved_while_disabled = False
        self._stopping = False
        self._jogging = False
        self._registers = [0] * _REGISTERS
        self._registers[JOG_ACCELERATION] = self._registers[JOG_DECELERATION] = round(100 * ACCELERATION_UNIT)
        self._registers[JOG_VELOCITY] = round(10 * SPEED_UNIT)
        acceleration = round(motor.acceleration_steps_s2 / steps_per_rev * ACCELERATION_UNIT)
        self._registers[ACCELERATION] = self._registers[DECELERATION] = min(max(acceleration, 1), 32767)
        self._registers[VELOCITY] = min(
            max(round(motor.speed_steps_s / steps_per_rev * SPEED_UNIT), 1), 32000
        )
        self._power_on = tuple(self._registers)
        self._opcodes: dict[int, Callable[[], None]] = {
            0x66: self._feed_length,  # FL
            0x67: self._feed_position,  # FP
            0x6E: self._seek_home,  # SH
            0xDB: self._seek_home,  # FH
            0xE1: self._stop,  # SK
            0xE2: self._stop,  # SKD
            0xBA: self._reset_alarm,  # AX
            0x9F: self._enable,  # ME
            0x9E: self._disable,  # MD
            0xA5: self._set_position,  # SP
            0x98: self._set_encoder,  # EP
            0x96: self._commence_jogging,  # CJ
            0xD8: self._stop_jogging,  # SJ
            0xA2: lambda: None,  # JE, JD: jog inputs, which nobody presses here
            0xA3: lambda: None,
        }

    def power_cycle(self) -> None:
        """Switch off and on: counter at 0, profile and registers as saved in the drive."""
        self.motor.power_cycle()
        self._offset = self._encoder_offset = 0
        self._origins = self.motor.origins_steps
        self._enabled, self._moved_while_disabled = True, False
        self._stopping = self._jogging = False
        self._registers[:] = self._power_on
        self._take_over_profile()

    def answer(self, pdu: bytes) -> bytes:
        """Carry out a request and return the reply, both without address and checksum."""
        function = pdu[0]
        try:
            if function in (0x03, 0x04):
                return self._read(pdu)
            if function == 0x06:
                return self._write_one(pdu)
            if function == 0x10:
                return self._write_many(pdu)
            raise ModbusError(ILLEGAL_FUNCTION)
        except ModbusError as error:
            return bytes([function | 0x80, error.code])

    # -- the four functions -------------------------------------------------------------------------------

    def _read(self, pdu: bytes) -> bytes:
        if len(pdu) != 5:
            raise ModbusError(ILLEGAL_VALUE)
        start, count = struct.unpack_from(">HH", pdu, 1)
        if not 1 <= count <= 125:
            raise ModbusError(ILLEGAL_VALUE)
        if start + count > _REGISTERS:
            raise ModbusError(ILLEGAL_ADDRESS)
        if start < _LIVE:
            self._refresh()
        return struct.pack(f">BB{count}H", pdu[0], 2 * count, *self._registers[start : start + count])

    def _write_one(self, pdu: bytes) -> bytes:
        if len(pdu) != 5:
            raise ModbusError(ILLEGAL_VALUE)
        address, value = struct.unpack_from(">HH", pdu, 1)
        self._store(address, (value,))
        return pdu

    def _write_many(self, pdu: bytes) -> bytes:
        if len(pdu) < 6:
            raise ModbusError(ILLEGAL_VALUE)
        start, count, size = struct.unpack_from(">HHB", pdu, 1)
        if not 1 <= count <= 123 or size != 2 * count or len(pdu) != 6 + size:
            raise ModbusError(ILLEGAL_VALUE)
        self._store(start, struct.unpack_from(f">{count}H", pdu, 6))
        return pdu[:5]

    def _store(self, start: int, values: tuple[int, ...]) -> None:
        """Check everything, then take everything over, then act: a refused request changes nothing."""
        end = start + len(values)
        for address, value in enumerate(values, start):
            if address not in _WRITABLE:
                raise ModbusError(ILLEGAL_ADDRESS)
            if address in _CEILINGS and not 1 <= value <= _CEILINGS[address]:
                raise ModbusError(ILLEGAL_VALUE)
            if address == OPCODE and value not in self._opcodes:
                raise ModbusError(ILLEGAL_VALUE)
        self._registers[start:end] = values
        if start < DISTANCE and end > ACCELERATION:
            self._take_over_profile()
        if start <= SET_POSITION + 1 < end:
            self._rename_position(self._s32(SET_POSITION))
        if start <= OPCODE < end:
            self._opcodes[self._registers[OPCODE]]()

    # -- opcodes ------------------------------------------------------------------------------------------

    def _feed_length(self) -> None:
        self._go(self.motor.position_steps() + self._s32(DISTANCE))

    def _feed_position(self) -> None:
        self._keep_counting()
        self._go(self._s32(DISTANCE) + self._offset)

    def _go(self, target_steps: int) -> None:
        if self._may_move():
            self.motor.move_absolute(target_steps)

    def _seek_home(self) -> None:
        if self._may_move():
            self._keep_counting()
            self.motor.home()
            self._origins = self.motor.origins_steps

    def _may_move(self) -> bool:
        """Say whether the drive is energised; a stalled motor must be reset first."""
        self._stopping = self._jogging = False
        self._take_over_profile()
        if not self._is_enabled():
            self._moved_while_disabled = True
            return False
        return True

    def _is_enabled(self) -> bool:
        if self.motor.fault in _DRIVE_FAULTS:
            self._enabled = False
        return self._enabled

    def _stop(self) -> None:
        self._stopping = self.motor.is_moving()
        self.motor.stop()

    def _commence_jogging(self) -> None:
        """Turn at the jog speed to the side that the sign of the distance names, until told to stop."""
        if not self._may_move():
            return
        acceleration = min(self._registers[JOG_ACCELERATION], self._registers[JOG_DECELERATION])
        self._set_profile(acceleration, self._registers[JOG_VELOCITY])
        self._jogging = True
        self.motor.move_absolute(-_ENDLESS_STEPS if self._s32(DISTANCE) < 0 else _ENDLESS_STEPS)

    def _stop_jogging(self) -> None:
        if self._jogging:
            self._stop()

    def _reset_alarm(self) -> None:
        self._is_enabled()
        self.motor.clear_fault()
        self._moved_while_disabled = False

    def _enable(self) -> None:
        if self.motor.fault not in _DRIVE_FAULTS:
            self._enabled = True

    def _disable(self) -> None:
        self.motor.stop()
        self._enabled = False

    def _set_position(self) -> None:
        self._rename_position(self._s32(PARAMETER_1))

    def _set_encoder(self) -> None:
        self._keep_counting()
        self._encoder_offset = self.motor.encoder_steps() - self._s32(PARAMETER_1)

    def _rename_position(self, position: int) -> None:
        self._keep_counting()
        self._offset = self.motor.position_steps() - position
        self._encoder_offset = self.motor.encoder_steps() - position

    def _keep_counting(self) -> None:
        """Let the counter run on over a homing: these drives do not call the switch zero, SP does."""
        if self._origins != (0, 0) and not self.motor.is_moving() and self.motor.referenced:
            self._offset += self._origins[0]
            self._encoder_offset += self._origins[1]
            self._origins = (0, 0)

    # -- registers ----------------------------------------------------------------------------------------

    def _take_over_profile(self) -> None:
        acceleration = min(self._registers[ACCELERATION], self._registers[DECELERATION])
        self._set_profile(acceleration, self._registers[VELOCITY])

    def _set_profile(self, acceleration: int, velocity: int) -> None:
        """Set the motor's profile, in units of the registers."""
        self.motor.acceleration_steps_s2 = acceleration / ACCELERATION_UNIT * self._steps_per_rev
        self.motor.speed_steps_s = velocity / SPEED_UNIT * self._steps_per_rev

    def _refresh(self) -> None:
        motor, registers = self.motor, self._registers
        moving = motor.is_moving()
        fault = motor.fault
        self._stopping = self._stopping and moving
        self._jogging = self._jogging and moving
        enabled = self._is_enabled()
        alarm = _ALARM_OF[fault] | (_ALARM_DISABLED if self._moved_while_disabled else 0)
        registers[ALARM] = alarm
        registers[STATUS] = (
            enabled
            | (fault in _DRIVE_FAULTS) << 2
            | (enabled and not moving and fault is Fault.NONE) << 3  # in position
            | moving << 4
            | (self._jogging or motor.is_manual()) << 5  # the jog input is the knob of these drives
            | self._stopping << 6
            | (alarm != 0) << 9
            | motor.is_homing() << 10
        )
        self._keep_counting()
        position = motor.position_steps() - self._offset
        self._put_s32(ENCODER, motor.encoder_steps() - self._encoder_offset)
        self._put_s32(POSITION, position)
        speed = round(motor.speed_now_steps_s() / self._steps_per_rev * SPEED_UNIT)
        registers[SPEED_NOW] = registers[SPEED_WANTED] = speed & 0xFFFF
        registers[TEMPERATURE], registers[BUS_VOLTAGE] = 352, 480  # 0.1 degC, 0.1 V

    def _s32(self, address: int) -> int:
        first, second = self._registers[address : address + 2]
        value = first << 16 | second if self._high_first else second << 16 | first
        return value - (1 << 32) if value & 0x8000_0000 else value

    def _put_s32(self, address: int, value: int) -> None:
        high, low = value >> 16 & 0xFFFF, value & 0xFFFF
        self._registers[address : address + 2] = (high, low) if self._high_first else (low, high)

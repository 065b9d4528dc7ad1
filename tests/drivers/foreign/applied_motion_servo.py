"""Two Applied Motion servo drives on one RS-485 line whose adapter hears itself.

The bits are those of the Host Command Reference, at the times at which a servo sets them: MOVING a while
after the command, IN POSITION a while after the end, an alarm that is only a note, the motor disabled until
ME.
"""

from __future__ import annotations

import struct
import time

from .bench import ForeignBench
from .wires import Glide, Later

STEPS_PER_DEG = 400.0
LAG_S = 0.03
_COMM_ERROR, _NO_MOVE = 0x0400, 0x1000


def crc(body: bytes) -> bytes:
    value = 0xFFFF
    for byte in body:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return struct.pack("<H", value)


class ServoDrive:
    def __init__(self, *, big: bool) -> None:
        self.big = big
        self.glide = Glide(0.0, 300.0 * STEPS_PER_DEG)
        self.count_zero = -5000.0  # where the switch is, on the counter
        self.offset = 0.0  # what SP took from the counter
        self.registers = dict.fromkeys((*range(8), *range(0x1B, 0x20), *range(0x7C, 0x81)), 0)
        self.enabled = False
        self.alarm = _COMM_ERROR
        self.busy_until_s = 0.0
        self.homing = False

    def angle_steps(self) -> float:
        """Steps from the switch."""
        return self.glide.at() - self.count_zero

    def words(self, value: float) -> list[int]:
        high, low = struct.unpack(">HH", struct.pack(">i", round(value)))
        return [high, low] if self.big else [low, high]

    def number(self, address: int) -> int:
        pair = self.registers[address], self.registers[address + 1]
        return int(struct.unpack(">i", struct.pack(">HH", *(pair if self.big else pair[::-1])))[0])

    def look(self) -> None:
        moving = self.glide.is_moving() and self.glide.since_s() > LAG_S
        status = 0x4000 | self.enabled | 0x0200 * bool(self.alarm)
        status |= 0x0010 * moving | 0x0400 * (moving and self.homing)
        if not self.glide.is_moving():
            status |= 0x0008 * (self.glide.rested_s() > LAG_S)
        if self.alarm & _NO_MOVE:
            status |= 0x0004
        settling = 90.0 if not moving and self.glide.rested_s() < LAG_S / 2 else 0.0
        at = self.glide.at() - self.offset - settling
        self.registers.update(enumerate([self.alarm, status, 0, 0, *self.words(at), *self.words(at)]))

    def command(self, opcode: int) -> None:
        if opcode == 0x9F:
            self.enabled = True
        elif opcode == 0xBA:
            self.alarm = _COMM_ERROR
        elif opcode in (0x67, 0xDB) and not self.enabled:
            self.alarm |= _NO_MOVE
        elif opcode == 0x67:
            self.glide.go(self.number(0x1E) + self.offset)
        elif opcode == 0xDB:
            self.homing = True
            self.glide.go(self.count_zero)
        elif opcode == 0xE1:
            self.glide.halt()
        elif opcode == 0xA5:
            self.homing = False
            self.offset = self.glide.at() - self.number(0x7D)
        self.busy_until_s = time.monotonic() + 0.06


class ServoLine:
    """Units 1 and 2; all others are silent."""

    def __init__(
        self,
        bench: ForeignBench,
        *,
        big: bool = True,
        echo: bool = True,
        has_function_16: bool = True,
        write_s: float = 0.01,
    ) -> None:
        self.drives = {1: ServoDrive(big=big), 2: ServoDrive(big=big)}
        self.echo, self.has_function_16, self.write_s = echo, has_function_16, write_s
        self.busy_answers = 0
        self._heard = b""
        self._later = Later()
        bench.theta_i_deg = lambda: self.drives[1].angle_steps() / STEPS_PER_DEG
        bench.theta_mes_deg = lambda: 180.0 - self.drives[2].angle_steps() / STEPS_PER_DEG

    def unasked(self) -> bytes:
        return self._later.due()

    def heard(self, data: bytes) -> bytes:
        self._heard += data
        size = 9 + self._heard[6] if len(self._heard) > 6 and self._heard[1] == 16 else 8
        if len(self._heard) < size:
            return b""
        frame, self._heard = self._heard[:size], b""
        assert crc(frame[:-2]) == frame[-2:]
        drive = self.drives.get(frame[0])
        if drive is not None:
            body = frame[:1] + self._answer(drive, frame[1:-2])
            self._later.say(body + crc(body), self.write_s if frame[1] in (6, 16) else 0.0)
        return frame if self.echo else b""

    def _answer(self, drive: ServoDrive, pdu: bytes) -> bytes:
        function, address, count = struct.unpack(">BHH", pdu[:5])
        if function == 16 and not self.has_function_16:
            return bytes([0x90, 1])
        wanted = range(address, address + (1 if function == 6 else count))
        if any(a not in drive.registers for a in wanted):
            return bytes([function | 0x80, 2])
        if function == 3:
            drive.look()
            return struct.pack(f">BB{count}H", 3, 2 * count, *(drive.registers[a] for a in wanted))
        if function == 6 and address == 0x7C:
            if time.monotonic() < drive.busy_until_s:
                self.busy_answers += 1
                return bytes([0x86, 0x14])
            drive.command(count)
        elif function == 6:
            drive.registers[address] = count
        else:
            values = struct.unpack(f">{count}H", pdu[6:])
            drive.registers.update(zip(wanted, values, strict=True))
            if address == 0x1B:
                drive.registers[0x1D] -= drive.registers[0x1D] % 4  # the velocity is rounded
        return pdu[:5]

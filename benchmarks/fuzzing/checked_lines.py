"""Replies of the protocols with a checksum: Zaber's ASCII lines and Modbus RTU; and Modbus TCP, which trusts
TCP's.

What was accepted is judged by a decoder of our own, which looks for a frame with a right checksum that says
so anywhere in what was sent: CRC16 lets one damaged frame in 65536 pass, Zaber's sum one in 256.
"""

from __future__ import annotations

import re
import struct
from random import Random
from typing import Any

from fuzzing.driver_target import DriverTarget
from fuzzing.outcome import Verdict
from gonio_drivers.lines import Line
from gonio_drivers.modbus import Framing, ModbusLine
from gonio_drivers.zaber import ZaberAxisConfig, ZaberDrive
from gonio_drivers.zaber_protocol import ZaberLine


def crc16(body: bytes) -> bytes:
    """Return CRC-16/MODBUS bit by bit, low byte first (Modbus over Serial Line V1.02, 6.2.2)."""
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return struct.pack("<H", crc)


class ZaberReplies(DriverTarget):
    """Position and flags of one axis, with checksums."""

    name = "zaber, checksums"
    is_numbered = True
    checksums = True

    def connect(self, line: Line) -> None:
        """Make the driver on its line."""
        self.flags: tuple[str, ...] = ()
        self.busy = False
        self.settings: dict[str, str] = {}
        config = ZaberAxisConfig(device=1, steps_per_deg=4266.667, limits_deg=(0.0, 90.0))
        self.drive = ZaberDrive(ZaberLine(line, checksums=self.checksums), "axis", config)

    def prepare(self, rng: Random) -> None:
        """Choose the call and what is true on the device."""
        self.flags = rng.choice(((), (), ("WR",), ("FS", "WR"), ("NI",)))
        self.busy = rng.random() < 0.3

    def call(self) -> Any:
        """Make the call and return what the driver believes."""
        state = self.drive.state()
        return state.position_steps, state.moving, state.referenced, state.fault is not None

    def _device(self, request: bytes) -> bytes:
        words = request.decode("ascii").strip("/\n").partition(":")[0].split()
        command = " ".join(words[3:])
        data = "0"
        if command == "get pos":
            position = self.rng.choice((0, -1, 200_000, self.rng.randint(-(2**31), 2**31 - 1)))
            faulty = any(flag[0] in "FN" for flag in self.flags)
            self.said.append((position, self.busy, "WR" not in self.flags, faulty))
            data = str(position)
        elif command == "warnings":
            data = " ".join((f"{len(self.flags):02d}", *self.flags))
        elif words[3] == "set":
            self.settings[words[4]] = words[5]
        elif words[3] == "get":
            data = self.settings[words[4]]
        busy, flag = "BUSY" if self.busy else "IDLE", self.flags[0] if self.flags else "--"
        return self._line(f"{int(words[0]):02d} {words[1]} {words[2]} OK {busy} {flag} {data}")

    def _line(self, text: str) -> bytes:
        body = text.encode("ascii")
        tail = b":%02X" % (-sum(body) & 0xFF) if self.checksums else b""
        return b"@" + body + tail + b"\r\n"

    def _forge(self, rng: Random, reply: bytes) -> bytes:
        words = reply.strip(b"@\r\n").partition(b":")[0].decode("ascii").split(" ", 6)
        i = rng.randrange(7)
        words[i] = {
            0: f"{rng.randint(0, 99):02d}",
            1: str(rng.randint(0, 9)),
            2: f"{(int(words[2]) - rng.randint(1, 5)) % 100:02d}",
            3: "RJ",
            4: "BUSY" if words[4] == "IDLE" else "IDLE",
            5: rng.choice(("--", "WR", "FE", "FQ")),
            6: rng.choice(("nan", "1e5", "1_000", "", "9" * 5000, str(rng.randint(-(2**40), 2**40)))),
        }[i]
        forged = self._line(" ".join(words))
        return forged + reply if i < 3 and rng.random() < 0.5 else forged

    def is_said(self, value: Any, sent: bytes) -> bool:
        """The position is what another valid line says, or another flag line made the flags differ."""
        valid = [body for body in _zaber_bodies(sent) if body.startswith(b"01 1 ")]
        moving = b"BUSY" if value[1] else b"IDLE"
        shown = (re.search(rb" OK +%s +.. +([+-]?\d+\.?\d*)" % moving, body) for body in valid)
        return any(match is not None and round(float(match[1])) == value[0] for match in shown)


def _zaber_bodies(sent: bytes) -> list[bytes]:
    bodies = []
    for line in re.split(rb"[\r\n]", sent):
        for start in (m.start() for m in re.finditer(b"@", line)):
            body, colon, tail = line[start + 1 :].rpartition(b":")
            if colon and tail.upper() == b"%02X" % (-sum(body) & 0xFF):
                bodies.append(body)
    return bodies


class ZaberRepliesUnchecked(ZaberReplies):
    """The same without checksums."""

    name = "zaber, none"
    checksums = False
    has_checksum = False

    def is_absurd(self, value: Any) -> bool:
        """Whole numbers only; any of them may be a position."""
        return not isinstance(value[0], int)


class ModbusRtuReplies(DriverTarget):
    """Registers read and written."""

    name = "modbus rtu"
    framing: Framing = "rtu"
    unit = 1

    def connect(self, line: Line) -> None:
        """Make the driver on its line."""
        line.reply_timeout_s = 1.0
        self.line = ModbusLine(line, self.framing, "big")
        self.what = 0

    def prepare(self, rng: Random) -> None:
        """Choose the call and what is true on the device."""
        self.what = rng.choice((3, 3, 3, 6, 16))

    def call(self) -> Any:
        """Make the call and return what the driver believes."""
        if self.what == 3:
            return tuple(self.line.read(self.unit, 0, 8))
        if self.what == 6:
            return self.line.write_one(self.unit, 0x7C, 0x67)
        return self.line.write(self.unit, 0x1E, [1, 2])

    def _device(self, request: bytes) -> bytes:
        pdu = self._unframed(request)
        if pdu[0] == 3:
            count = pdu[4]
            values = tuple(self.rng.getrandbits(16) for _ in range(count))
            if count == 8:
                self.said.append(values)
            reply = struct.pack(f">BB{count}H", 3, 2 * count, *values)
        else:
            self.said.append(None)
            reply = pdu[:5]
        return self._framed(request, self.unit, reply)

    def _unframed(self, request: bytes) -> bytes:
        return request[1:-2]

    def _framed(self, request: bytes, unit: int, pdu: bytes) -> bytes:
        body = bytes([unit]) + pdu
        return body + crc16(body)

    def _forge(self, rng: Random, reply: bytes) -> bytes:
        body = bytearray(reply[:-2])
        i = rng.choice((0, 1, 2, rng.randrange(len(body))))
        body[i] = rng.choice((0, 3, 6, 16, 0x83, rng.randrange(256)))
        if rng.random() < 0.2:
            body = body[: rng.randint(1, len(body))]
        return bytes(body) + crc16(bytes(body))

    def is_said(self, value: Any, sent: bytes) -> bool:
        """A frame with a right CRC anywhere in the bytes."""
        if self.what == 3:
            wanted = bytes([self.unit]) + struct.pack(">BB8H", 3, 16, *value)
        elif self.what == 6:
            wanted = bytes([self.unit]) + struct.pack(">BHH", 6, 0x7C, 0x67)
        else:
            wanted = bytes([self.unit]) + struct.pack(">BHH", 16, 0x1E, 2)
        return wanted + crc16(wanted) in sent

    def _verdict(self, value: Any) -> Verdict:
        if self.what != 3 and self.port.changed and not self.is_said(None, self.port.delivered):
            return Verdict.CORRUPT if self.has_checksum else Verdict.UNPROTECTED
        return super()._verdict(value)


class ModbusTcpReplies(ModbusRtuReplies):
    """The same in MBAP frames."""

    name = "modbus tcp"
    framing: Framing = "tcp"
    has_checksum = False

    def _unframed(self, request: bytes) -> bytes:
        return request[7:]

    def _framed(self, request: bytes, unit: int, pdu: bytes) -> bytes:
        return request[:4] + struct.pack(">HB", len(pdu) + 1, unit) + pdu

    def _forge(self, rng: Random, reply: bytes) -> bytes:
        frame = bytearray(reply)
        i = rng.choice((0, 1, 3, 5, 6, 7, 8, rng.randrange(len(frame))))
        frame[i] = rng.choice((0, 3, 6, 16, 0x83, rng.randrange(256)))
        return bytes(frame)

    def is_said(self, value: Any, sent: bytes) -> bool:
        """Nothing but the form protects."""
        return True

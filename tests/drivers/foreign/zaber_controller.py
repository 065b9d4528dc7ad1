"""A two-axis Zaber controller with firmware 6 or 7 as the ASCII protocol manual allows it to be.

One device with both axes; no checksums in replies; positions with decimals; speeds that are rounded; ramps
that are settings of their own; alerts, information and replies of another device between its own.
"""

from __future__ import annotations

import re

from .bench import ForeignBench
from .wires import Glide

STEPS_PER_DEG = 1000.0
_REQUEST = re.compile(rb"/(\d+) (\d) ?(.*?)(?::([0-9A-F]{2}))?$")


class Axis:
    def __init__(self, zero_deg: float, sign: float) -> None:
        self.glide = Glide(7000.0, 400.0 * STEPS_PER_DEG)
        self.zero_deg, self.sign = zero_deg, sign
        self.homing = False
        self.homed = False
        self.settings = {
            "maxspeed": 50000,
            "motion.accelonly": 205,
            "motion.decelonly": 205,
            "limit.min": 0,
            "limit.max": 200000,
            "limit.cycle.dist": 360000,
            "resolution": 64,
        }

    def angle_deg(self) -> float:
        return self.zero_deg + self.sign * self.glide.at() / STEPS_PER_DEG

    def flags(self) -> list[str]:
        if self.homing and not self.glide.is_moving():
            self.homing, self.homed = False, True
        return ([] if self.homed else ["WR"]) + ["NU"]  # a note that never goes away


class ZaberController:
    def __init__(
        self,
        bench: ForeignBench,
        *,
        numbers: bool = True,
        ends: bytes = b"\r\n",
        chatter: bool = True,
        refused: dict[str, str] | None = None,
    ) -> None:
        self.axes = {1: Axis(0.0, 1.0), 2: Axis(180.0, -1.0)}
        self.numbers, self.ends, self.chatter = numbers, ends, chatter
        self.refused = refused or {}
        self.requests: list[bytes] = []
        self._rest = b""
        bench.theta_i_deg = self.axes[1].angle_deg
        bench.theta_mes_deg = self.axes[2].angle_deg

    def unasked(self) -> bytes:
        return b""

    def heard(self, data: bytes) -> bytes:
        *lines, self._rest = re.split(rb"[\r\n]", self._rest + data)
        return b"".join(self._answer(line) for line in lines if line)

    def _answer(self, line: bytes) -> bytes:
        self.requests.append(line)
        match = _REQUEST.match(line)
        if match is None or match[1] != b"1":
            return b""
        if match[4] is not None:
            body = line[1 : line.rfind(b":")]
            assert (sum(body) + int(match[4], 16)) % 256 == 0
        axis, words = int(match[2]), match[3].decode().split()
        number = ""
        if self.numbers and words and words[0].isdigit():
            number = f"{words.pop(0)} "
        busy = any(a.glide.is_moving() for i, a in self.axes.items() if axis in (0, i))
        try:
            accepted, said = "OK", self._do(axis, words)
        except LookupError as error:
            accepted, said = "RJ", str(error.args[0])
        busy |= bool(axis) and self.axes[axis].glide.is_moving()
        flag = self.axes[axis].flags()[0] if axis else "--"
        state = "BUSY" if busy else "IDLE"
        reply = f"@01 {axis} {number}{accepted} {state} {flag} {said}".encode() + self.ends
        if self.chatter:
            reply = (
                b"!01 2 IDLE NU"
                + self.ends
                + b"#01 1 a note to whom it may concern"
                + self.ends
                + b"@03 0 17 OK IDLE -- 12345"
                + self.ends
                + reply
            )
        return reply

    def _do(self, axis: int, words: list[str]) -> str:
        command = " ".join(words[:2]) if words[0] in ("get", "set", "move", "tools") else words[0]
        if command in self.refused:
            raise LookupError(self.refused[command])
        if axis == 0:
            identity = {"get deviceid": "30222", "get system.serial": "63222", "get version": "6.28"}
            if command == "tools echo":
                return " ".join(words[2:])
            if command in identity:
                return identity[command]
            raise LookupError("BADCOMMAND")
        motor = self.axes[axis]
        if command == "get pos":
            return f"{motor.glide.at():.2f}"
        if words[0] in ("get", "set") and words[1] in motor.settings:
            if words[0] == "get":
                return str(motor.settings[words[1]])
            value = int(words[2])
            motor.settings[words[1]] = value - value % 16 if words[1] == "maxspeed" else value
            return "0"
        if command == "move abs":
            if not 0 <= int(words[2]) <= 200000:
                raise LookupError("BADDATA")
            motor.glide.go(int(words[2]))
        elif command == "home":
            motor.homing = True
            motor.glide.go(0.0)
        elif command == "stop":
            motor.glide.halt()
        elif command == "warnings":
            return " ".join([f"{len(motor.flags()):02d}", *motor.flags()])
        else:
            raise LookupError("BADCOMMAND")
        return "0"

"""A bus with an ELL14K at address A and other modules that talk; hex digits in lower case."""

from __future__ import annotations

import re

from .bench import ForeignBench
from .wires import Glide

PULSES_PER_TURN = 143360
_COMMAND = re.compile(rb"([0-9A-Fa-f])(in|gs|gp|ho[01]|ma[0-9A-Fa-f]{8})")


class ElliptecBus:
    """One module that moves, tells of its way, and ends a move with its position or only with a status."""

    def __init__(
        self, bench: ForeignBench, *, ends_with_status: bool = False, pulses_told: int = PULSES_PER_TURN
    ) -> None:
        self.glide = Glide(1000.0, 2.0 * PULSES_PER_TURN)
        self.ends_with_status = ends_with_status
        self.pulses_told = pulses_told
        self._heard = b""
        self._ends: bytes | None = None
        bench.polarizer_deg = lambda: self.glide.at() * 360.0 / PULSES_PER_TURN

    def heard(self, data: bytes) -> bytes:
        self._heard += data
        said = b""
        while match := _COMMAND.match(self._heard):
            self._heard = self._heard[match.end() :]
            if match[1].upper() == b"A":
                said += self._answer(match[2])
        return said

    def unasked(self) -> bytes:
        if self._ends is not None and not self.glide.is_moving():
            said, self._ends = self._ends or self._position(), None
            return said
        return b""

    def _answer(self, command: bytes) -> bytes:
        chatter = b"3PO00000123\r\n"
        if command == b"in":
            return chatter + f"aIN0e1140077220232501016800{self.pulses_told:06x}\r\n".encode()
        if self.glide.is_moving():
            return chatter + b"AGS09\r\n"
        if command == b"gs":
            return b"AGS00\r\n"
        if command == b"gp":
            return chatter + self._position()
        pulses = 0 if command.startswith(b"ho") else int(command[2:], 16)
        self.glide.go(pulses - (1 << 32) * (pulses >> 31))
        self._ends = b"AGS00\r\n" if self.ends_with_status else b""
        return b"AGS09\r\n" + chatter + self._position()  # where it passes

    def _position(self) -> bytes:
        return f"APO{round(self.glide.at()) & 0xFFFFFFFF:08x}\r\n".encode()

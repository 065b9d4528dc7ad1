"""A driver at the end of a bad line: one call with changed replies, and the judgement of what it returned."""

from __future__ import annotations

from random import Random
from typing import Any

from fuzzing.outcome import Result, Verdict
from fuzzing.virtual_time import VirtualClock, VirtualTime
from fuzzing.wire import BadLine
from gonio.errors import DeviceError
from gonio.rig import Context
from gonio_drivers.lines import Line


def _damaged_writes(rng: Random) -> int:
    draw = rng.random()
    return 0 if draw < 0.05 else 1 if draw < 0.75 else 2 if draw < 0.9 else 20


class DriverTarget:
    """A driver on a bad line."""

    name = ""
    has_checksum = True
    is_numbered = False  # replies say which request they answer

    def __init__(self, time: VirtualTime) -> None:
        self.time = time
        self.context = Context("fuzz", VirtualClock(virtual=self.time))
        self.said: list[Any] = []
        self.rng = Random(0)
        self.port = BadLine(self.time, self._device, self._forge)
        self.connect(Line(self.port, "device", "fuzz"))

    def one(self, rng: Random) -> Result:
        """Make one call whose replies are changed, and judge what it returns."""
        self.rng = rng
        self.said = []
        self.port.begin(rng, _damaged_writes(rng))
        self.prepare(rng)
        try:
            value = self.call()
        except DeviceError as error:
            return Result(refused=type(error).__name__, reads=self.port.reads)
        return Result(self._verdict(value), reads=self.port.reads, forged=self.port.forged)

    def _verdict(self, value: Any) -> Verdict:
        if self.said and value == self.said[-1]:
            return Verdict.RIGHT
        if value in self.said:
            return Verdict.EARLIER
        if not self.has_checksum:
            return Verdict.ABSURD if self.is_absurd(value) else Verdict.UNPROTECTED
        if not self.is_numbered and self.is_said(value, self.port.copies):
            return Verdict.UNASKED
        return Verdict.VALID_OTHER if self.is_said(value, self.port.delivered) else Verdict.CORRUPT

    def connect(self, line: Line) -> None:
        """Make the driver on its line."""
        raise NotImplementedError

    def prepare(self, rng: Random) -> None:
        """Choose the call and what is true on the device."""
        raise NotImplementedError

    def call(self) -> Any:
        """Make the call and return what the driver believes."""
        raise NotImplementedError

    def is_said(self, value: Any, sent: bytes) -> bool:
        """Say whether a frame with a right checksum says so."""
        raise NotImplementedError

    def is_absurd(self, value: Any) -> bool:
        """Say whether the instrument could not have shown it."""
        return False

    def _device(self, request: bytes) -> bytes:
        raise NotImplementedError

    def _forge(self, rng: Random, reply: bytes) -> bytes:
        raise NotImplementedError

"""Time that passes only when somebody waits: a stand-in for the module `time` in drivers and simulators.

A timeout of two seconds costs nothing, and the order of events is the same in every run.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

from gonio.clock import Clock
from gonio_simulators.wire.modbus_frames import RtuReceiver

_PACKAGES = ("gonio_drivers", "gonio_simulators")
_UNIX_EPOCH_S = 1.6e9


class VirtualTime:
    """Seconds that are advanced by hand; has the functions of the module `time` that the packages use."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def advance(self, duration_s: float) -> None:
        """Let time pass."""
        self.now_s += max(duration_s, 0.0)

    def monotonic(self) -> float:
        """Return the present, seconds."""
        return self.now_s

    perf_counter = monotonic

    def time(self) -> float:
        """Return the present as Unix time, seconds."""
        return _UNIX_EPOCH_S + self.now_s

    def sleep(self, duration_s: float) -> None:
        """Let time pass, as the caller sleeps."""
        self.advance(duration_s)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Be the module `time` of every module of the drivers and simulators that has been imported."""
        replaced = [
            module
            for name, module in list(sys.modules.items())
            if name.partition(".")[0] in _PACKAGES and getattr(module, "time", None) is time
        ]
        for module in replaced:
            module.__dict__["time"] = self
        receiver = RtuReceiver.__init__  # its clock is a default argument, made when it was imported
        before, receiver.__defaults__ = receiver.__defaults__, (self.monotonic,)
        try:
            yield
        finally:
            receiver.__defaults__ = before
            for module in replaced:
                module.__dict__["time"] = time


@dataclass(frozen=True)
class VirtualClock(Clock):
    """Instrument time that is virtual time."""

    virtual: VirtualTime = field(default_factory=VirtualTime)

    def now_s(self) -> float:
        """Return virtual seconds."""
        return self.virtual.now_s

    def sleep(self, duration_s: float) -> None:
        """Let virtual time pass."""
        self.virtual.sleep(duration_s)

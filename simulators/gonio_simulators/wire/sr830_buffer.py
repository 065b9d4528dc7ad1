"""The data buffer of an SR830: what both displays show, stored at a fixed rate or on triggers.

Up to 16383 points for each display.  Points are taken in bench time, also while nobody asks.
"""

from __future__ import annotations

import math
import struct
from collections import deque

from gonio_simulators.bench.lockin import Lockin
from gonio_simulators.wire.sr830_outputs import Outputs
from gonio_simulators.wire.sr830_parameters import OutOfRange

CAPACITY = 16383
TRIGGERED = 14
DELAYED_START_S = 0.5
"""Between ``STRD`` and the first point."""


class DataBuffer:
    """Stores points; satisfies `gonio_simulators.bench.lockin.Recorder`."""

    def __init__(self, lockin: Lockin, outputs: Outputs) -> None:
        self._lockin = lockin
        self._outputs = outputs
        self.rate = 4  # 1 Hz
        self.loops = True
        self.starts_on_trigger = False
        self.next_s = math.inf
        self._points: deque[tuple[float, float]] = deque(maxlen=CAPACITY)
        self._state = "idle"  # running, paused

    def __len__(self) -> int:
        return len(self._points)

    @property
    def in_progress(self) -> bool:
        """Whether a scan runs or is paused."""
        return self._state != "idle"

    def start(self, delay_s: float = 0.0) -> None:
        """Start or go on; no effect while points are being stored or when one-shot storage is full."""
        if self._state == "running" or (not self.loops and len(self._points) == CAPACITY):
            return
        self._state = "running"
        self._lockin.recorder = self
        if self.rate != TRIGGERED:
            self.next_s = self._lockin.clock.now_s() + delay_s
            self._catch_up()

    def pause(self) -> None:
        """Stop taking points; no effect unless points are being stored."""
        if self._state == "running":
            self._state = "paused"
            self._rest()

    def reset(self) -> None:
        """Forget all points and stop."""
        self._points.clear()
        self._state = "idle"
        self._rest()

    def trigger(self) -> bool:
        """Take a point or start the scan, as the settings say; return whether that did anything."""
        if self._state == "running" and self.rate == TRIGGERED:
            self._store()
            return True
        if self._state != "running" and self.starts_on_trigger:
            self.start()
            if self.rate == TRIGGERED:
                self._store()
            return True
        return False

    def take(self) -> None:
        """Store a point at its instant."""
        self._outputs.forget()
        self._store()
        if self._state == "running":
            self.next_s += self._interval_s()
            self._skip_what_would_be_overwritten()

    def points(self, channel: int, start: int, count: int) -> list[float]:
        """Return some of the points of display 1 or 2, oldest first."""
        if channel not in (1, 2) or start < 0 or count < 1 or start + count > len(self._points):
            raise OutOfRange
        points = list(self._points)[start : start + count]
        return [point[channel - 1] for point in points]

    def _store(self) -> None:
        self._points.append((self._outputs.shown(1), self._outputs.shown(2)))
        if not self.loops and len(self._points) == CAPACITY:
            self._state = "idle"
            self._rest()

    def _interval_s(self) -> float:
        return 16.0 / 2.0**self.rate  # 62.5 mHz, then doubled up to 512 Hz

    def _skip_what_would_be_overwritten(self) -> None:
        """Leave out points that later ones have overwritten by now: a loop may run for bench days."""
        missed = math.floor((self._lockin.clock.now_s() - self.next_s) / self._interval_s())
        if self.loops and missed > CAPACITY:
            self.next_s += (missed - CAPACITY) * self._interval_s()

    def _catch_up(self) -> None:
        self._lockin.advance()
        self._outputs.forget()

    def _rest(self) -> None:
        self.next_s = math.inf
        self._lockin.recorder = None


def ascii_points(points: list[float]) -> str:
    """Return points as ``TRCA?`` does, each followed by a comma: ``-1.234567e-009,+7.654321e-009,``."""
    return "".join([f"{_three_digit_exponent(point)}," for point in points])


def _three_digit_exponent(value: float) -> str:
    mantissa, exponent = f"{value:+.6e}".split("e")
    return f"{mantissa}e{exponent[0]}{int(exponent[1:]):03d}"


def ieee_points(points: list[float]) -> bytes:
    """Return points as ``TRCB?`` does: four bytes each, IEEE single precision, least byte first."""
    return struct.pack(f"<{len(points)}f", *points)


def lia_points(points: list[float]) -> bytes:
    """Return points as ``TRCL?`` does: signed 16-bit mantissa, exponent, zero; ``m 2**(exponent - 124)``."""
    return b"".join([struct.pack("<hBB", *_lia(point), 0) for point in points])


def _lia(value: float) -> tuple[int, int]:
    fraction, exponent = math.frexp(value)
    mantissa = round(fraction * 32768)
    if abs(mantissa) == 32768:
        mantissa, exponent = mantissa // 2, exponent + 1
    exponent += 124 - 15
    return (mantissa, exponent) if mantissa and exponent >= 0 else (0, 0)

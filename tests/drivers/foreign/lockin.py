"""An SR830 after a day on somebody else's bench: offset on, second harmonic, the chopper just started."""

from __future__ import annotations

import re
import time

from .bench import ForeignBench

_RANGES_V = [m * 10.0**e for e in range(-9, 1) for m in (1, 2, 5)][1:-2]


class ForeignLockin:
    def __init__(
        self,
        bench: ForeignBench,
        *,
        end: bytes = b"\n",
        identity: str = "Stanford_Research_Systems,SR830,s/n00111,ver1.000",
        unlocked_s: float = 0.0,
        source: int = 0,
        keeps_offset: bool = False,
        knows_offsets: bool = True,
        takes_two: bool = False,
    ) -> None:
        self._bench = bench
        self.end, self.identity = end, identity
        self.locks_at_s = time.monotonic() + unlocked_s
        self.takes_two = takes_two
        self.keeps_offset, self.knows_offsets = keeps_offset, knows_offsets
        self.values = {"OFLT": 5, "OFSL": 3, "SENS": 26, "OUTX": 1, "HARM": 2, "ISRC": source}
        self.offset_percent = {1: 25.0, 2: 0.0, 3: 0.0}
        self.status = 0
        self._rest = b""

    def unasked(self) -> bytes:
        return b""

    def heard(self, data: bytes) -> bytes:
        *lines, self._rest = re.split(rb"[\r\n]", self._rest + data)
        answers = [self._do(s.strip()) for line in lines for s in line.decode().split(";") if s.strip()]
        if self.values["OUTX"] != 0:
            return b""  # answers go to the other interface
        return b"".join(answer.encode() + self.end for answer in answers if answer)

    def _do(self, statement: str) -> str:
        name, rest = statement[:4], statement[4:].strip()
        if statement == "*IDN?":
            return self.identity
        if name == "OEXP" and self.knows_offsets:
            if rest.startswith("?"):
                return f"{self.offset_percent[int(rest[1:])]:g},0"
            channel, percent, _ = rest.split(",")
            if not self.keeps_offset:
                self.offset_percent[int(channel)] = float(percent)
        elif name == "SNAP":
            return self._snap([int(item) for item in rest[1:].split(",")])
        elif statement == "LIAS?":
            self._look()
            status, self.status = self.status, 0
            return f" {status}"
        elif statement == "PHAS?":
            return "-12.50"
        elif name in self.values:
            if rest == "?":
                return str(self.values[name])
            self.values[name] = int(rest)
        return ""

    def _look(self) -> float:
        signal_v = self._bench.signal_v()
        if time.monotonic() < self.locks_at_s:
            self.status |= 8
            return -0.3 * signal_v
        if self.values["HARM"] != 1:
            return 0.0
        full_v = _RANGES_V[self.values["SENS"]]
        signal_v -= self.offset_percent[1] / 100.0 * full_v
        if abs(signal_v) > 1.09 * full_v:
            self.status |= 4
        return max(-1.09 * full_v, min(1.09 * full_v, signal_v))

    def _snap(self, items: list[int]) -> str:
        x_v = self._look()
        if self.takes_two and len(items) != 2:
            return ""  # a clone
        shown = {1: f" {x_v:+.6E}", 2: "-0", 3: f"{abs(x_v):g}"}
        return ",".join(shown[item] for item in items)

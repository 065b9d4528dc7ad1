"""Replies of the protocols without any checksum: Elliptec, Cornerstone 260, SR830.

Nothing can tell one digit from another that noise put there.  What protects is the form (a fixed length, a
number as instruments print it), the echo, the second look (what was set is read back), and the range.
"""

from __future__ import annotations

import math
import re
from random import Random
from typing import Any

from fuzzing.driver_target import DriverTarget
from gonio_drivers.cs260 import CS260, BandConfig, CS260Config
from gonio_drivers.elliptec import ElliptecConfig, ElliptecRotator
from gonio_drivers.lines import Line
from gonio_drivers.sr830 import FULL_SCALE_V, SR830, SR830Config

PULSES = 143360
_FIXED_ANSWERS = {
    "INFO": "NEWPORT CORP,CORNERSTONE 260",
    "STB": "00",
    "ERROR": "0",
    "UNITS": "NM",
    "HANDSHAKE": "0",
}
LARGEST_SIGNAL_V = 10.0  # the largest range of the SR830 is 1 V


class ElliptecReplies(DriverTarget):
    """Position queries, and turning to S or P."""

    name = "elliptec"
    has_checksum = False

    def connect(self, line: Line) -> None:
        """Make the driver on its line."""
        self.pulses = 0
        self.what = "gp"
        self.rotator = ElliptecRotator(
            ElliptecConfig(driver="elliptec", s_deg=0.0, p_deg=90.0), self.context, line
        )

    def prepare(self, rng: Random) -> None:
        """Choose the call and what is true on the device."""
        self.what = rng.choice(("gp", "s", "p"))
        self.pulses = rng.choice((0, PULSES // 4, -1, rng.randint(-PULSES, PULSES)))

    def call(self) -> Any:
        """Make the call and return what the driver believes."""
        if self.what == "gp":
            return self.rotator.position_deg()
        return self.rotator.select("s" if self.what == "s" else "p")

    def _device(self, request: bytes) -> bytes:
        command = request.decode("ascii")[1:]
        if command == "in":
            return f"0IN0E1140005120221701016800{PULSES:06X}\r\n".encode("ascii")
        if command == "gs":
            return b"0GS00\r\n"
        if command.startswith("ma"):
            self.pulses = int(command[2:], 16)
        elif command.startswith("ho"):
            self.pulses = 0
        self.said.append(self.pulses * 360.0 / PULSES)
        return f"0PO{self.pulses & 0xFFFFFFFF:08X}\r\n".encode("ascii")

    def _forge(self, rng: Random, reply: bytes) -> bytes:
        return rng.choice(
            (
                reply.replace(b"0", b"1", 1),
                b"0GS%02X\r\n" % rng.choice((0, 1, 9, 12, 13, 99, 255)),
                b"0GS" + b"9" * rng.choice((1, 3, 4000)) + b"\r\n",
                b"0PO%08X\r\n" % rng.getrandbits(32),
                b"0PO" + b"F" * rng.choice((7, 9, 4000)) + b"\r\n",
            )
        )

    def is_absurd(self, value: Any) -> bool:
        """A rotator does not stand ten turns away, nor anywhere but at S or P after `select`."""
        if self.what == "gp":
            return not abs(value) <= 3600.0
        return not abs(value - (0.0 if self.what == "s" else 90.0)) <= 0.1


class CS260Replies(DriverTarget):
    """Driving to a wavelength, and the settings that are read back."""

    name = "cs260"
    has_checksum = False
    pipelined = False

    def connect(self, line: Line) -> None:
        """Make the driver on its line."""
        self.state = {"GRAT": "1", "SHUTTER": "C", "OUTPORT": "1", "WAVE": "500.000"}
        self.what = ""
        self.wanted_nm = 500.0
        config = CS260Config(
            driver="cs260",
            gratings=(BandConfig(number=1, range_nm=(200.0, 1600.0)),),
            pipelined=self.pipelined,
        )
        self.instrument = CS260(config, self.context, line)

    def prepare(self, rng: Random) -> None:
        """Choose the call and what is true on the device."""
        self.what = rng.choice(("go", "go", "port", "shutter", "close"))
        self.wanted_nm = round(rng.uniform(200.0, 1600.0), 3)

    def call(self) -> Any:
        """Make the call and return what the driver believes."""
        instrument = self.instrument
        if self.what == "go":
            return instrument.go_to(self.wanted_nm)
        if self.what == "close":
            instrument.close_shutter()
            return self._believed("SHUTTER", "C")
        if self.what == "port":
            wanted = self.rng.choice((1, 2))
            instrument.select_port(wanted)
            return self._believed("OUTPORT", str(wanted))
        is_open = self.rng.random() < 0.5
        instrument.set_shutter(is_open)
        return self._believed("SHUTTER", "O" if is_open else "C")

    def _believed(self, what: str, wanted: str) -> str:
        """Return what the driver now believes and note what is true."""
        self.said.append(f"{what} {self.state[what]}")
        return f"{what} {wanted}"

    def _device(self, request: bytes) -> bytes:
        answers = {**_FIXED_ANSWERS, **self.state}
        out = b""
        for line in request.decode("ascii").splitlines():
            out += line.encode("ascii") + b"\r\n"
            name, _, parameter = line.partition(" ")
            if name.endswith("?"):
                answer = answers[name[:-1]]
                if name == "WAVE?":
                    answer = self.state["WAVE"]
                    self.said.append(float(answer))
                out += (f"{answer},1200,LABEL" if name == "GRAT?" else answer).encode("ascii") + b"\r\n"
            else:
                self.state["WAVE" if name == "GOWAVE" else name] = parameter
        return out

    def _forge(self, rng: Random, reply: bytes) -> bytes:
        lines = reply.split(b"\r\n")
        lines[rng.randrange(len(lines))] = rng.choice(
            (
                b"nan",
                b"inf",
                b"%.3f" % rng.uniform(200, 1600),
                b"9" * 5000,
                b"WAVE?",
                b"00",
                b"20",
                b"O",
                b"2",
            )
        )
        return b"\r\n".join(lines)

    def is_absurd(self, value: Any) -> bool:
        """Whatever is accepted as the wavelength lies within the tolerance of what was asked."""
        if isinstance(value, str):
            return False
        return not abs(value - self.wanted_nm) <= 0.1


class CS260Pipelined(CS260Replies):
    """The same with the read-back query right behind the drive statement."""

    name = "cs260, pipelined"
    pipelined = True


class SR830Replies(DriverTarget):
    """Readings with their overload bits, and ranges that are read back."""

    name = "sr830"
    has_checksum = False

    def connect(self, line: Line) -> None:
        """Make the driver on its line."""
        self.settings = {"OFLT": "8", "OFSL": "0", "SENS": "26"}
        self.what = "read"
        self.instrument = SR830(SR830Config(driver="sr830"), self.context, line)

    def prepare(self, rng: Random) -> None:
        """Choose the call and what is true on the device."""
        self.what = rng.choice(("read", "read", "range"))

    def call(self) -> Any:
        """Make the call and return what the driver believes."""
        if self.what == "read":
            reading = self.instrument.read()
            return reading.x_v, reading.y_v, reading.overload
        self.instrument.set_range(self.rng.randrange(len(FULL_SCALE_V)))
        self.said.append(int(self.settings["SENS"]))
        return self.instrument.range_index

    def _device(self, request: bytes) -> bytes:
        out = b""
        bits = self.rng.choice((0, 0, 0, 4, 1))
        for statement in request.decode("ascii").strip().split(";"):
            name = statement[:4]
            if statement == "*IDN?":
                out += b"Stanford_Research_Systems,SR830,s/n83022,ver1.07\r"
            elif name == "SNAP":
                scale_v = FULL_SCALE_V[int(self.settings["SENS"])]
                x, y = (f"{self.rng.uniform(-0.7, 0.7) * scale_v:g}" for _ in range(2))
                self.said.append((float(x), float(y), bool(bits)))
                shown = {"1": x, "2": y, "3": f"{math.hypot(float(x), float(y)):g}"}
                out += ",".join(shown[which] for which in statement[6:].split(",")).encode("ascii") + b"\r"
            elif statement == "LIAS?":
                out += b"%d\r" % bits
            elif statement.endswith("?"):
                out += self.settings.get(name, "0").encode("ascii") + b"\r"
            else:
                self.settings[name] = statement[5:]
        return out

    def _forge(self, rng: Random, reply: bytes) -> bytes:
        parts = re.split(rb"([,\r])", reply)  # fields, and what stands between them
        parts[2 * rng.randrange((len(parts) + 1) // 2)] = rng.choice(
            (b"nan", b"-inf", b"1e999", b"1_0", b"1e5", b"27", b"-1", b"2.5", b"256", b"9" * 5000, b"")
        )
        return b"".join(parts)

    def is_absurd(self, value: Any) -> bool:
        """Finite, and no more volts than the largest range shows."""
        if self.what == "range":
            return not 0 <= value < len(FULL_SCALE_V)
        return not all(math.isfinite(v) and abs(v) <= LARGEST_SIGNAL_V for v in value[:2])

"""A Cornerstone monochromator, the original or the B model, as another program may have left it."""

from __future__ import annotations

from typing import Literal

from .bench import ForeignBench
from .wires import Glide

Manner = Literal["waits", "early", "deaf"]
_NM_PER_UNIT = {"NM": 1.0, "UM": 1000.0}


class Cornerstone:
    """`manner` is what becomes of a query while something moves: it waits, is answered at once, is lost."""

    def __init__(
        self,
        bench: ForeignBench,
        *,
        echo: bool = True,
        echo_end: bytes | None = None,
        end: bytes = b"\r\n",
        manner: Manner = "waits",
        wave: str = "{:.3f}",
        shutter: tuple[str, str] = ("C", "O"),
        has_wheel: bool = True,
        has_units: bool = True,
        stays_in: str | None = None,
    ) -> None:
        self.echo, self.echo_end, self.end, self.manner = echo, echo_end, end, manner
        self.wave, self.shutter_words, self.has_wheel = wave, shutter, has_wheel
        self.has_units, self.stays_in = has_units, stays_in
        self.drive = Glide(500.0, 8000.0)
        self.turret = Glide(0.0, 1.0)
        self.units, self.handshake, self.error = "UM" if has_units else "NM", True, 1
        self.grating, self.filter, self.port, self.is_open = 1, 1, 1, False
        self._rest = b""
        self._waiting: list[bytes] = []
        self.lost: list[bytes] = []
        bench.wavelength_nm = self.drive.at
        bench.is_open = lambda: self.is_open

    def heard(self, data: bytes) -> bytes:
        *lines, self._rest = (self._rest + data).split(b"\n")
        said = b""
        for line in lines:
            statement = line.strip()
            if self._is_moving() and self.manner == "deaf":
                self.lost.append(statement)
                continue
            if self.echo:
                said += statement + (
                    line[len(statement) :] + b"\n" if self.echo_end is None else self.echo_end
                )
            if self._is_moving() and self.manner == "waits":
                self._waiting.append(statement)
            else:
                said += self._do(statement.decode())
        return said

    def unasked(self) -> bytes:
        said = b""
        while self._waiting and not self._is_moving():
            said += self._do(self._waiting.pop(0).decode())
        return said

    def _is_moving(self) -> bool:
        return self.drive.is_moving() or self.turret.is_moving()

    def _do(self, statement: str) -> bytes:
        name, _, parameter = statement.upper().partition(" ")
        answer = self._query(name) if name.endswith("?") else self._command(name, parameter)
        said = b"" if answer is None else answer.encode() + self.end
        if self.handshake:
            said += (b"20" if self.error else b"00") + self.end
        return said

    def _query(self, name: str) -> str | None:
        answers = {
            "INFO?": "Newport Corp,CS130,9021,V3.1",
            "WAVE?": self.wave.format(round(self.drive.at() / 0.0129) * 0.0129 / _NM_PER_UNIT[self.units]),
            "GRAT?": f" {self.grating}, 1200 , HOLO",
            "OUTPORT?": str(self.port),
            "SHUTTER?": self.shutter_words[self.is_open],
            "STB?": "20" if self.error else "0",
            "ERROR?": str(self.error),
        }
        if self.has_wheel:
            answers["FILTER?"] = f"{self.filter}"
        if self.has_units:
            answers["UNITS?"] = self.stays_in or self.units
        answer = answers.get(name)
        if answer is None:
            self.error = 6 if name == "FILTER?" else 1
        elif name == "ERROR?":
            self.error = 0
        return answer

    def _command(self, name: str, parameter: str) -> None:
        if name == "HANDSHAKE":
            self.handshake = parameter == "1"
        elif name == "UNITS" and self.has_units and not self.stays_in:
            self.units = parameter
        elif name == "GOWAVE":
            self._go(float(parameter) * _NM_PER_UNIT[self.units])
        elif name == "GRAT":
            self.grating = int(parameter)
            self._turn(0.05)
        elif name == "FILTER" and self.has_wheel:
            self.filter = int(parameter)
            self._turn(0.02)
        elif name == "OUTPORT":
            self.port = int(parameter)
            self._turn(0.02)
        elif name == "SHUTTER":
            self.is_open = parameter == "O"
        else:
            self.error = 6 if name == "FILTER" else 1

    def _go(self, nm: float) -> None:
        if (self.grating == 1 and nm > 900.0) or (self.grating == 2 and nm < 600.0):
            self.error = 3
        else:
            self.drive.go(nm + 0.004)  # off by a part of a step

    def _turn(self, duration_s: float) -> None:
        self.turret.jump(0.0)
        self.turret.go(duration_s)

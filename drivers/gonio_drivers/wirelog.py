"""What went over the wires, and when: a text file that a person reads beside the device's manual.

One record per line: real seconds since the rig was opened, role, direction, hexadecimal bytes, printable
text::

    12.345678 stage > 2f3120312030332067657420706f730a  /1 1 03 get pos\\n
    12.345912 stage < 403031203120303320...             @01 1 03 OK IDLE -- 20000\\r\\n
"""

from __future__ import annotations

import contextlib
from datetime import UTC, datetime
from pathlib import Path

from gonio.clock import Clock
from gonio.errors import ConfigError


class WireLog:
    """Appends records of one line to a file that all lines of the rig share.

    Every record is one unbuffered append, so records of different lines do not mix and the last one before a
    crash is in the file.
    """

    def __init__(self, path: Path, role: str, address: str, clock: Clock) -> None:
        try:
            self._file = path.open("ab", buffering=0)
        except OSError as error:
            raise ConfigError(
                f"wire log {path}: cannot be written ({error.strerror}); choose another file"
            ) from None
        self._role = role
        self._clock = clock
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        self.note(f"{address} opened {now}, instrument clock x{clock.speed:g}")

    def sent(self, data: bytes) -> None:
        """Record bytes that were sent."""
        self._write(">", f"{data.hex()}  {_printable(data)}")

    def received(self, data: bytes) -> None:
        """Record bytes as they arrived, which may be part of a reply or several."""
        self._write("<", f"{data.hex()}  {_printable(data)}")

    def note(self, text: str) -> None:
        """Record something that is not bytes."""
        self._write("=", text)

    def _write(self, direction: str, text: str) -> None:
        # Instrument time over its speed: real seconds, with one origin for every line of the rig.
        seconds = self._clock.now_s() / self._clock.speed
        with contextlib.suppress(OSError, ValueError):  # a full disk or a closed log must not stop a stage
            self._file.write(f"{seconds:.6f} {self._role} {direction} {text}\n".encode())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _printable(data: bytes) -> str:
    return data.decode("latin-1").encode("unicode_escape").decode("ascii")

"""What went over the wires, and when: appends to a text file that a person reads beside the device's manual.

The format is `gonio.wirelog`'s; `gonio replay` serves such a file back as a device.
"""

from __future__ import annotations

import contextlib
import os
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from gonio.clock import Clock
from gonio.errors import ConfigError
from gonio.wirelog import BROKEN_OFF, Direction, Opening, format_bytes, format_note


class WireLog:
    """Appends records of one line to a file that all lines of the rig share.

    Every record is one unbuffered append, so records of different lines do not mix and the last one before a
    crash is in the file.
    """

    def __init__(self, path: Path, role: str, address: str, clock: Clock, *, protocol: str) -> None:
        try:
            self._file = path.open("ab", buffering=0)
            unfinished = path.is_file() and _ends_within_a_line(path)
        except OSError as error:
            raise ConfigError(
                f"wire log {path}: cannot be written ({error.strerror}); choose another file"
            ) from None
        self._role = role
        self._clock = clock
        if unfinished:  # a program was killed while it wrote: its last record must not swallow our first
            self._append(BROKEN_OFF)
        self.note(Opening(protocol, address, _session(path, clock), clock.speed).text())

    def sent(self, data: bytes) -> None:
        """Record bytes that were sent."""
        self._bytes(">", data)

    def received(self, data: bytes) -> None:
        """Record bytes as they arrived, which may be part of a reply or several."""
        self._bytes("<", data)

    def note(self, text: str) -> None:
        """Record something that is not bytes."""
        self._append(format_note(self._now_s(), self._role, text))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _bytes(self, direction: Direction, data: bytes) -> None:
        self._append(format_bytes(self._now_s(), self._role, direction, data))

    def _now_s(self) -> float:
        """Instrument time over its speed: real seconds, with one origin for every line of the rig."""
        return self._clock.now_s() / self._clock.speed

    def _append(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # a full disk or a closed log must not stop a stage
            self._file.write(text.encode())


@lru_cache(maxsize=64)
def _session(path: Path, clock: Clock) -> str:
    """The wall clock when the first line of a rig was opened, which all its lines then give; a rig has one
    clock.
    """
    del path, clock
    return datetime.now(UTC).isoformat(timespec="microseconds")


def _ends_within_a_line(path: Path) -> bool:
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return False
        file.seek(-1, os.SEEK_END)
        return file.read(1) != b"\n"

"""A wire log as the other end of a driver's line: in this process, or served by `gonio replay`."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from gonio.wirelog import read_log
from gonio_drivers.lines import Line
from gonio_simulators.replay.conversation import ReplayedLine
from gonio_simulators.replay.tape import LineTape, Tape

LOGS = Path(__file__).parent / "logs"


class ReplayPort:
    """A port whose other end is a line of a log."""

    def __init__(self, line: ReplayedLine) -> None:
        self._line = line
        self._conversation = line.open()
        self._incoming = bytearray()
        self._hung_up = False
        self._due_s: float | None = None
        self._appoint()
        line.hang_up = self._hang_up

    def write(self, data: bytes) -> None:
        self._incoming += self._conversation.feed(data)
        self._appoint()

    def read(self, timeout_s: float) -> bytes:
        end_s = time.monotonic() + timeout_s
        while not self._incoming:
            if self._hung_up:
                raise ConnectionResetError("the log's device hung up")
            if self._due_s is None or self._due_s > end_s:
                time.sleep(max(0.0, end_s - time.monotonic()))
                return b""
            time.sleep(max(0.0, self._due_s - time.monotonic()))
            self._incoming += self._conversation.poll()
            self._appoint()
        data = bytes(self._incoming)
        self._incoming.clear()
        return data

    def close(self) -> None:
        pass

    def _appoint(self) -> None:
        wait_s = self._conversation.wait_s
        self._due_s = None if wait_s is None else time.monotonic() + wait_s

    def _hang_up(self) -> None:
        self._hung_up = True


@contextlib.contextmanager
def replayed_line(name: str, *, speed: float = 100.0, reply_timeout_s: float = 2.0) -> Iterator[Line]:
    """Yield a driver's line at whose other end a log answers; everything asked must be in the log."""
    (log,) = read_log(LOGS / name).sessions[-1].lines.values()
    unexpected: list[str] = []
    replayed = ReplayedLine(LineTape(log, Tape()), speed=speed, on_unexpected=unexpected.append)
    yield Line(ReplayPort(replayed), log.role, name, reply_timeout_s=reply_timeout_s)
    assert unexpected == []


class Replay:
    """A running `gonio replay`."""

    def __init__(self, log: Path, *options: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "gonio.cli", "replay", str(log), "--until-stdin-closes", *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.addresses: dict[str, str] = {}
        for line in self._process.stdout:
            if line.strip() == "ready":
                break
            role, _, address = line.split()
            self.addresses[role] = address

    def end(self) -> tuple[int, str]:
        """Return its exit code and what it reported."""
        _, report = self._process.communicate(timeout=30)  # closes its standard input
        return self._process.returncode, report

    def kill(self) -> None:
        self._process.kill()
        self._process.communicate()


@contextlib.contextmanager
def replay(log: Path, *options: str) -> Iterator[Replay]:
    running = Replay(log, *options)
    try:
        yield running
    finally:
        running.kill()

"""Logs written in the test, and a client without a socket."""

from __future__ import annotations

from pathlib import Path

import pytest

from gonio.wirelog import read_log
from gonio_simulators.replay.conversation import ReplayedLine
from gonio_simulators.replay.exchanges import joined
from gonio_simulators.replay.tape import LineTape, Tape, Unexpected


class Player:
    """Asks the lines of a log and gives back all bytes of each answer at once, None for an unexpected one."""

    def __init__(self, path: Path) -> None:
        tape = Tape()
        lines = read_log(path).sessions[-1].lines
        self.tapes = {role: LineTape(line, tape) for role, line in lines.items()}
        self.unexpected: list[str] = []
        self._splitters = {role: t.dialect.splitter(t.known) for role, t in self.tapes.items()}

    def ask(self, role: str, data: bytes) -> bytes | None:
        out = b""
        for request in self._splitters[role].feed(data):
            try:
                out += joined(self.tapes[role].answer(request).chunks)
            except Unexpected as why:
                self.unexpected.append(str(why))
                return None
        return out


def write(path: Path, text: str) -> Path:
    """Write a log in the short form ``ROLE > TEXT``, each line 10 ms after the one before."""
    lines = []
    for number, line in enumerate(text.strip().splitlines()):
        role, direction, rest = line.strip().split(" ", 2)
        gap = "" if direction == "=" else "-  "
        lines.append(f"{number / 100:.2f} {role} {direction} {gap}{rest}\n")
    path.write_text("".join(lines), encoding="utf-8")
    return path


@pytest.fixture
def played(tmp_path: Path):
    """Return a player of a log in the short form."""
    return lambda text: Player(write(tmp_path / "wire.log", text))


@pytest.fixture
def replayed_line(tmp_path: Path):
    """Return the instrument of a log with one line, and the list of what it could not answer."""

    def make(text: str, *, speed: float = 1.0) -> tuple[ReplayedLine, list[str]]:
        (line,) = read_log(write(tmp_path / "wire.log", text)).sessions[-1].lines.values()
        unexpected: list[str] = []
        return ReplayedLine(LineTape(line, Tape()), speed=speed, on_unexpected=unexpected.append), unexpected

    return make

"""A bench whose time stands still until told, and the simulator as a process of its own."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import threading
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gonio.rig import default_rig_text
from gonio_simulators.bench.bench import Bench
from gonio_simulators.bench.config import BenchConfig
from gonio_simulators.clock import ManualClock
from gonio_simulators.wire.lines import Conversation


def rig_text(*, stage: str = "zaber", framing: str = "rtu", **stage_keys: str) -> str:
    """The built-in rig with another stage driver."""
    keys = "".join(f'{key} = "{value}"\n' for key, value in stage_keys.items())
    if stage == "applied-motion":
        keys += f'framing = "{framing}"\n'
    text = default_rig_text()
    assert 'driver = "zaber"' in text
    head, _, rest = text.partition('driver = "zaber"')
    line_end = rest.index("\n") + 1
    return f'{head}driver = "{stage}"{rest[:line_end]}{keys}{rest[line_end:]}'


class StillBench(Bench):
    """A bench with a clock that tests advance; no noise, so that voltages are known."""

    clock: ManualClock

    @classmethod
    def of(cls, text: str) -> StillBench:
        tables = tomllib.loads(text)
        tables["simulation"]["noise"] = {}
        return cls(BenchConfig.from_tables(tables), ManualClock())


@pytest.fixture
def bench() -> StillBench:
    return StillBench.of(default_rig_text())


def advance_until_answered(
    bench: StillBench, talk: Conversation, step_s: float = 0.05, limit_s: float = 60.0
) -> bytes:
    """Let bench time pass until the conversation has something to say."""
    waited_s = 0.0
    while waited_s < limit_s:
        bench.clock.advance(step_s)
        waited_s += step_s
        if reply := talk.poll():
            return reply
    raise AssertionError(f"no answer within {limit_s} bench seconds")


class Client:
    """A plain socket with a deadline."""

    def __init__(self, address: str) -> None:
        host, port = address.removeprefix("socket://").split(":")
        self.socket = socket.create_connection((host, int(port)), timeout=5)

    def ask(self, data: bytes, end: bytes = b"\r\n", count: int = 1) -> bytes:
        self.socket.sendall(data)
        return self.read_until(end, count)

    def read_until(self, end: bytes, count: int = 1) -> bytes:
        received = b""
        while received.count(end) < count:
            more = self.socket.recv(4096)
            assert more, f"the simulator hung up after {received!r}"
            received += more
        return received

    def close(self) -> None:
        self.socket.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass
class Simulator:
    """A running simulator process."""

    process: subprocess.Popen[str]
    lines: list[str]

    def address(self, role: str, *, pty: bool = False) -> str:
        found = [line.split() for line in self.lines]
        return next(a for r, _, a in found if r == role and a.startswith("socket://") is not pty)

    def protocol(self, role: str) -> str:
        return next(line.split()[1] for line in self.lines if line.split()[0] == role)

    def client(self, role: str) -> Client:
        return Client(self.address(role))

    def port(self, role: str) -> int:
        return int(self.address(role).rsplit(":", 1)[1])


@contextlib.contextmanager
def running(*options: str) -> Iterator[Simulator]:
    process = subprocess.Popen(
        [sys.executable, "-m", "gonio_simulators", *options, "--until-stdin-closes"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    watchdog = threading.Timer(60, process.kill)
    watchdog.start()
    try:
        lines: list[str] = []
        for line in process.stdout:
            if line == "ready\n":
                break
            lines.append(line.rstrip("\n"))
        yield Simulator(process, lines)
    finally:
        process.stdin.close()
        process.wait(timeout=10)
        process.stdout.close()
        watchdog.cancel()


@pytest.fixture
def simulator() -> Callable[..., contextlib.AbstractContextManager[Simulator]]:
    """Start a simulator: ``with simulator("--pty") as sim``."""
    return running


@pytest.fixture
def rig_file(tmp_path: Path) -> Callable[..., Path]:
    """Write a rig file made by `rig_text`."""

    def write(**keys: Any) -> Path:
        path = tmp_path / "rig.toml"
        path.write_text(rig_text(**keys), encoding="utf-8")
        return path

    return write

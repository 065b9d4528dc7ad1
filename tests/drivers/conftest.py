"""A line whose other end follows a script, and the simulated bench as a process."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from gonio.clock import Clock
from gonio.rig import Context, Rig, RigConfig, default_rig_text, load_rig, open_rig, with_addresses
from gonio_drivers.lines import Line

SILENCE = None
"""In a script's reply: one read that ends by its timeout before the next chunk arrives."""

Chunk = bytes | None


class ScriptedPort:
    """A port that asserts the exact bytes of each request and answers as written; no real time passes."""

    def __init__(self, *exchanges: tuple[bytes, bytes | list[Chunk]]) -> None:
        self._exchanges = deque(exchanges)
        self._incoming: deque[Chunk] = deque()
        self.closed = False

    def write(self, data: bytes) -> None:
        assert self._exchanges, f"nothing more was expected, but {data!r} was sent"
        expected, reply = self._exchanges.popleft()
        assert data == expected
        self._incoming.extend([reply] if isinstance(reply, bytes) else reply)

    def read(self, timeout_s: float) -> bytes:
        if not self._incoming or (timeout_s <= 0 and self._incoming[0] is SILENCE):
            return b""
        return self._incoming.popleft() or b""

    def close(self) -> None:
        self.closed = True

    def assert_finished(self) -> None:
        assert not self._exchanges, f"never sent: {[request for request, _ in self._exchanges]}"


@pytest.fixture
def context() -> Context:
    """A clock so fast that instrument time costs nothing."""
    return Context("test", Clock(speed=1e6))


@pytest.fixture
def scripted() -> Iterator[Callable[..., Line]]:
    """Make lines from scripts; at the end every script must have been followed to its last request."""
    ports: list[ScriptedPort] = []

    def make(*exchanges: tuple[bytes, bytes | list[Chunk]], role: str = "stage") -> Line:
        port = ScriptedPort(*exchanges)
        ports.append(port)
        return Line(port, role, "scripted")

    yield make
    for port in ports:
        port.assert_finished()


@dataclass(frozen=True)
class Bench:
    """A running simulator process."""

    config: RigConfig  # with the addresses it printed
    text: str
    ptys: Mapping[str, str]

    def open(self, config: RigConfig | None = None, *, wire_log: Path | None = None) -> Rig:
        return open_rig(config or self.config, wire_log=wire_log)


def rig_text(*, clock_speed: float = 2000.0, stage: str | None = None, extra: str = "") -> str:
    """Return the built-in rig with another clock, stage table head or simulation tables."""
    text = re.sub(r"clock_speed = [\d.]+", f"clock_speed = {clock_speed}", default_rig_text())
    if stage is not None:
        text = text.replace('driver = "zaber"', stage, 1)
    return text + extra


@contextlib.contextmanager
def running_bench(path: Path, text: str, *options: str) -> Iterator[Bench]:
    """Start the simulator for a rig, yield it, and stop it by closing its standard input."""
    rig = path / "rig.toml"
    rig.write_text(text, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "gonio_simulators", str(rig), "--until-stdin-closes", *options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        addresses: dict[str, str] = {}
        ptys: dict[str, str] = {}
        for line in process.stdout:
            if line.strip() == "ready":
                break
            role, _, address = line.split()
            (addresses if address.startswith("socket://") else ptys)[role] = address
        assert addresses, "the simulator did not start"
        yield Bench(with_addresses(load_rig(rig), addresses), text, ptys)
    finally:
        process.stdin.close()
        try:
            process.wait(10)
        finally:
            process.kill()
            process.stdout.close()
            process.wait()


STAGES = {
    "zaber": None,
    "modbus-rtu": 'driver = "applied-motion"\nframing = "rtu"',
    "modbus-tcp": 'driver = "applied-motion"\nframing = "tcp"\nword_order = "little"',
}


@pytest.fixture(scope="session", params=list(STAGES))
def any_stage_bench(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Bench]:
    """A bench with each kind of stage in turn; its state is whatever the test before left."""
    text = rig_text(stage=STAGES[request.param])
    with running_bench(tmp_path_factory.mktemp("bench"), text) as bench:
        yield bench


@pytest.fixture(scope="session", params=list(STAGES))
def instant_stage_bench(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Bench]:
    """A bench with each kind of stage, on a clock so fast that a short move is over before the first poll."""
    text = rig_text(clock_speed=20_000.0, stage=STAGES[request.param])
    with running_bench(tmp_path_factory.mktemp("bench"), text) as bench:
        yield bench


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """A bench with Zaber stages."""
    with running_bench(tmp_path_factory.mktemp("bench"), rig_text()) as running:
        yield running

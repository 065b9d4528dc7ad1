"""Ports: who talks to whom, what a new client finds, and bytes that a filter holds back."""

import asyncio
import contextlib
import os
import socket
import sys
import time
from collections.abc import Iterator

import pytest

from gonio.rig import default_rig_text
from gonio_simulators.bench.bench import Bench
from gonio_simulators.bench.config import BenchConfig
from gonio_simulators.clock import BenchClock
from gonio_simulators.wire.lines import PtyPort, TcpPort, new_event_loop
from gonio_simulators.wire.sr830 import Sr830
from gonio_simulators.wire.zaber import ZaberChain
from tests.simulators.wire.conftest import Client, Simulator, StillBench, running


@pytest.fixture(scope="module")
def sim() -> Iterator[Simulator]:
    """One process for all tests that leave it as they found it."""
    with running(*(["--pty"] if PtyPort.is_available() else [])) as simulator:
        yield simulator


def test_a_new_client_does_not_inherit_half_a_command(sim) -> None:
    for role, half, whole, answer in (
        ("stage", b"/1 1 mov", b"/1 1 03 get pos\n", b"@01 1 03 OK IDLE WR 0\r\n"),
        ("polarizer", b"0m", b"0gs", b"0GS00\r\n"),
        ("monochromator", b"GOWAVE 6", b"STB?\n", b"STB?\n00\r\n"),
    ):
        with sim.client(role) as first:
            first.socket.sendall(half)
        with sim.client(role) as second:
            assert second.ask(whole) == answer
    with sim.client("lockin") as first:
        first.socket.sendall(b"SENS 1")
    with sim.client("lockin") as second:
        assert second.ask(b"SENS?\r", b"\r") == b"26\r"


def test_a_newer_client_takes_the_line_over(sim) -> None:
    with sim.client("stage") as first:
        assert first.ask(b"/1 1 01\n") == b"@01 1 01 OK IDLE WR 0\r\n"
        with sim.client("stage") as second:
            assert second.ask(b"/1 1 02\n") == b"@01 1 02 OK IDLE WR 0\r\n"
            with contextlib.suppress(ConnectionResetError):  # a hang-up without a farewell is one, too
                assert first.socket.recv(10) == b""


def test_settings_outlive_clients(sim) -> None:
    with sim.client("lockin") as first:
        assert first.ask(b"SENS 20;SENS?\r", b"\r") == b"20\r"
    with sim.client("lockin") as second:
        assert second.ask(b"SENS?;*RST\r", b"\r") == b"20\r"


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")
def test_a_pty_speaks_the_same_bytes(sim) -> None:
    for role, question, answer in (
        ("stage", b"/1 1 03 get pos\n", b"@01 1 03 OK IDLE WR 0\r\n"),
        ("polarizer", b"0gs", b"0GS00\r\n"),
        ("monochromator", b"WAVE?\r\n", b"WAVE?\r\n500.000\r\n"),
        ("lockin", b"OUTX?\r", b"0\r"),
    ):
        line = os.open(sim.address(role, pty=True), os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(line, question)
            received = b""
            while len(received) < len(answer):
                received += os.read(line, 100)
            assert received == answer
        finally:
            os.close(line)


def test_a_pipelined_burst_is_answered_in_full(sim) -> None:
    with sim.client("stage") as client:
        burst = b"".join(b"/1 1 %02d get pos\n" % (i % 100) for i in range(2000))
        received = client.ask(burst, count=2000)
        assert [int(line.split()[2]) for line in received.splitlines()] == [i % 100 for i in range(2000)]


class Splitter:
    """Loses the first reply and sends later ones in two parts."""

    def __init__(self) -> None:
        self.replies = 0

    def received(self, data, deliver) -> None:
        deliver(data.replace(b"!", b""))

    def sending(self, data, transmit) -> None:
        self.replies += 1
        if self.replies > 1:
            transmit(data[:1])
            asyncio.get_running_loop().call_later(0.01, transmit, data[1:])


def test_a_filter_sits_between_instrument_and_stream(bench: StillBench) -> None:
    async def talk() -> bytes:
        port = TcpPort(Sr830(bench), bench.clock, filter_=Splitter())
        await port.start()
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", int(port.address.rsplit(":", 1)[1]))
            writer.write(b"SE!NS?\r")
            await asyncio.sleep(0.02)
            writer.write(b"OFLT?\r")
            received = await reader.readexactly(2)
            writer.close()
            await writer.wait_closed()
            return received
        finally:
            port.close()

    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        assert runner.run(talk()) == b"8\r"


def test_a_reply_speaks_of_one_instant() -> None:
    """On a bench so fast that a move ends while a reply is put together, idle still means arrived."""
    fast = Bench(BenchConfig.from_text(default_rig_text()), BenchClock(3000.0))

    async def talk() -> list[tuple[int, int]]:
        port = TcpPort(ZaberChain(fast, theta_i=1, theta_mes=2), fast.clock)
        await port.start()
        idle: list[tuple[int, int]] = []
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", int(port.address.rsplit(":", 1)[1]))

            async def ask(command: str) -> list[str]:
                writer.write(command.encode() + b"\n")
                return (await reader.readline()).decode().split()

            await ask("/1 1 home")
            for k in range(400):
                target = 100_000 + 13_000 * (k % 2)
                while "BUSY" in (reply := await ask("/1 1 get pos")):
                    continue
                if k:
                    idle.append((int(reply[-1]), 100_000 + 13_000 * ((k - 1) % 2)))
                await ask(f"/1 1 move abs {target}")
            writer.close()
            await writer.wait_closed()
            return idle
        finally:
            port.close()

    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        assert [pair for pair in runner.run(talk()) if pair[0] != pair[1]] == []


def test_timers_are_finer_than_a_millisecond() -> None:
    async def wait() -> float:
        start_s = time.perf_counter()
        for _ in range(20):
            await asyncio.sleep(1e-4)
        return (time.perf_counter() - start_s) / 20

    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        # `epoll` would sleep 1.1 ms; on a busy machine take the best of a few
        assert min(runner.run(wait()) for _ in range(10)) < 0.7e-3


def test_the_port_of_the_rig_file_is_served(simulator, tmp_path) -> None:
    from gonio.rig import default_rig_text

    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    text = default_rig_text().replace('address = "simulated"', f'address = "socket://127.0.0.1:{port}"', 1)
    rig = tmp_path / "rig.toml"
    rig.write_text(text, encoding="utf-8")
    for _ in range(2):  # the port is free again at once
        with simulator(str(rig)) as sim:
            assert sim.address("stage") == f"socket://127.0.0.1:{port}"
            with Client(sim.address("stage")) as client:
                assert client.ask(b"/1 1 01\n") == b"@01 1 01 OK IDLE WR 0\r\n"

"""Faults of a simulator in a process of its own, through plain sockets and a terminal."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from gonio.rig import default_rig_text
from gonio_simulators.cli import main
from gonio_simulators.faults import read_fault_log
from tests.simulators.wire.conftest import Client

DEADLINE_S = 20.0


@dataclass
class Faulty:
    """A running simulator; `err` is what it printed to standard error, once it has ended."""

    addresses: dict[tuple[str, bool], str] = field(default_factory=dict)
    err: str = ""

    def client(self, role: str) -> Client:
        return Client(self.addresses[role, False])


@contextlib.contextmanager
def running(*options: str) -> Iterator[Faulty]:
    command = [sys.executable, "-m", "gonio_simulators", *options, "--until-stdin-closes"]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    watchdog = threading.Timer(60, process.kill)
    watchdog.start()
    simulator = Faulty()
    try:
        for line in process.stdout:
            if line == "ready\n":
                break
            role, _, address = line.split()
            simulator.addresses[role, not address.startswith("socket://")] = address
        yield simulator
    finally:
        process.stdin.close()
        process.wait(timeout=10)
        simulator.err = process.stderr.read()
        process.stdout.close()
        process.stderr.close()
        watchdog.cancel()


def wait_until(condition) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, "it did not happen in time"
        time.sleep(0.01)


def reply(number: int) -> bytes:
    return b"@01 1 %02d OK IDLE WR 0\r\n" % number


def test_replies_log_and_counts(tmp_path: Path) -> None:
    log = tmp_path / "faults.log"
    with running(
        *("--fault", "late-reply@stage:nth=2", "--fault", "doubled-reply@stage:nth=3"),
        *("--fault", "slow-reply@lockin:nth=1:delay_s=0.05", "--fault", "hang@polarizer:0"),
        *("--fault-log", str(log)),
    ) as simulator:
        with simulator.client("stage") as client:
            assert client.ask(b"/1 1 01\n") == reply(1)
            client.socket.sendall(b"/1 1 02\n")
            wait_until(lambda: len(read_fault_log(log)) == 1)  # written as it happens
            assert client.ask(b"/1 1 03\n", count=3) == reply(2) + reply(3) + reply(3)
            assert client.ask(b"/1 1 04\n") == reply(4)
        with simulator.client("lockin") as client:
            assert client.ask(b"SENS?\r", b"\r") == b"26\r"
    assert simulator.err.splitlines() == [
        "fault late-reply injected 1 x",
        "fault doubled-reply injected 1 x",
        "fault slow-reply injected 1 x",
        "fault hang injected 0 x",
    ]
    injected = read_fault_log(log)
    assert [(i.name, i.target) for i in injected] == [
        ("late-reply", "stage"),
        ("doubled-reply", "stage"),
        ("slow-reply", "lockin"),
    ]
    assert injected[0].details == "reply=b'@01 1 02 OK IDLE WR 0\\r\\n'"
    assert 0 < injected[0].bench_s <= injected[2].bench_s


def test_a_disconnect_refuses_for_a_while_on_the_same_port() -> None:
    with running("--fault", "disconnect@stage:nth=1:executed=yes:refuse_s=0.4") as simulator:
        with simulator.client("stage") as client:
            client.socket.sendall(b"/1 1 01\n")
            received = b""
            with contextlib.suppress(ConnectionResetError):
                while more := client.socket.recv(100):
                    received += more
            assert received in (b"", reply(1)[: len(reply(1)) // 2])
        with pytest.raises(ConnectionRefusedError):
            simulator.client("stage")

        def connects() -> bool:
            with contextlib.suppress(ConnectionRefusedError), simulator.client("stage") as client:
                return client.ask(b"/1 1 02\n") == reply(2)
            return False

        wait_until(connects)
        with simulator.client("lockin") as other:
            assert other.ask(b"SENS?\r", b"\r") == b"26\r"


def test_faults_of_the_rig_file_and_by_bench_time(tmp_path: Path) -> None:
    log, rig = tmp_path / "faults.log", tmp_path / "rig.toml"
    faults = '["power-cycle@stage:at=100:boot_s=0.05", "lamp-drift:rate=3600"]'
    text = default_rig_text().replace(
        "clock_speed = 4000.0", f"clock_speed = 1000.0\nfaults = {faults}\nfault_log = '{log}'"
    )
    rig.write_text(text, encoding="utf-8")
    with running(str(rig)) as simulator:
        wait_until(lambda: {i.name for i in read_fault_log(log)} == {"power-cycle", "lamp-drift"})
        with simulator.client("stage") as client:

            def answers() -> bool:
                client.socket.settimeout(0.1)
                with contextlib.suppress(TimeoutError):
                    return client.ask(b"/1 1 02\n") == reply(2)
                return False

            wait_until(answers)
    (restart,) = [i for i in read_fault_log(log) if i.name == "power-cycle"]
    assert restart.bench_s >= 100.0


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")
def test_the_cable_of_a_terminal_is_pulled() -> None:
    with running("--pty", "--fault", "disconnect@stage:nth=1:executed=no:refuse_s=0.3") as simulator:
        line = os.open(simulator.addresses["stage", True], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            os.write(line, b"/1 1 01\n")
            received = bytearray()

            def answered() -> bool:
                os.write(line, b"/1 1 02\n")
                with contextlib.suppress(BlockingIOError):
                    received.extend(os.read(line, 100))
                return reply(2) in received

            wait_until(answered)
            assert reply(1) not in received
        finally:
            os.close(line)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--fault", "lat-reply:0.1"), ["arta.toml", "did you mean 'late-reply'"]),
        (("--fault", "stall@lockin:0.1"), ["does not apply to 'lockin'"]),
        (("--fault", "stall:0.1", "--fault-log", "no/such/folder/log"), ["fault log cannot be written"]),
    ],
)
def test_a_wrong_fault_is_one_message(capsys, options: tuple[str, ...], words: list[str]) -> None:
    assert main([*options, "--seconds", "1"]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    for word in words:
        assert word in captured.err


def test_a_list_of_faults_that_is_none(tmp_path: Path, capsys) -> None:
    rig = tmp_path / "rig.toml"
    text = default_rig_text().replace("clock_speed = 4000.0", 'clock_speed = 4000.0\nfaults = "stall:0.1"')
    rig.write_text(text, encoding="utf-8")
    assert main([str(rig), "--fault", "hang:0.1", "--seconds", "1"]) == 1
    assert "simulation.faults" in capsys.readouterr().err


def test_list_faults(capsys) -> None:
    assert main(["--list-faults"]) == 0
    assert "late-reply: " in capsys.readouterr().out


def test_a_client_that_leaves_does_not_get_what_was_held_back() -> None:
    with running("--fault", "slow-reply@stage:nth=1:delay_s=0.2") as simulator:
        with simulator.client("stage") as first:
            first.socket.sendall(b"/1 1 01\n")
            time.sleep(0.02)
        with simulator.client("stage") as second:
            assert second.ask(b"/1 1 02\n") == reply(2)
            second.socket.settimeout(0.3)
            with pytest.raises(TimeoutError):
                second.socket.recv(10)


def test_a_port_keeps_its_number_while_it_refuses() -> None:
    with running("--fault", "disconnect@lockin:nth=1:refuse_s=30") as simulator:
        with simulator.client("lockin") as client:
            client.socket.sendall(b"SENS?\r")
            with contextlib.suppress(ConnectionResetError):
                while client.socket.recv(10):
                    continue
        host, port = simulator.addresses["lockin", False].removeprefix("socket://").split(":")
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((host, int(port)), timeout=5)

"""`gonio replay`: what it prints, how it ends, how it fails."""

from __future__ import annotations

import contextlib
import io
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from gonio_simulators.replay.cli import main
from gonio_simulators.wire.lines import PtyPort

from .conftest import write

LOG = r"""
stage = wire-log 1: zaber
lockin = wire-log 1: sr830
stage > /1 1 01 get pos\n
stage < @01 1 01 OK IDLE -- 7\r\n
lockin > SENS?\r
lockin < 26\r
stage > /1 1 02 home\n
stage < @01 1 02 OK BUSY -- 7\r\n
stage > /1 1 03 get pos\n
stage = gave up: no complete reply within 2 s
stage < late
lockin > OUTX 0\r
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write(tmp_path / "wire.log", LOG)


@dataclass(frozen=True)
class Done:
    code: int
    out: str
    err: str


@pytest.fixture
def run(capfd):
    """Run the command in this process, which is faster than to start one."""

    def call(*options: object) -> Done:
        try:
            code = main([str(option) for option in options])
        except SystemExit as leave:  # argparse's way out
            code = int(leave.code or 0)
        captured = capfd.readouterr()
        return Done(code, captured.out, captured.err)

    return call


class Running:
    """A replay in a process of its own."""

    def __init__(self, log: Path, *options: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "gonio.cli", "replay", str(log), "--until-stdin-closes", *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        self.lines = list(iter(lambda: self.process.stdout.readline().strip(), "ready"))  # type: ignore[union-attr]

    def ask(self, role: str, data: bytes, *, ends: bytes = b"\n") -> bytes:
        (address,) = (line.split()[2] for line in self.lines if line.startswith(f"{role} ") and ":" in line)
        got = b""
        with socket.create_connection(("127.0.0.1", int(address.rpartition(":")[2])), timeout=10) as client:
            client.sendall(data)
            while not got.endswith(ends) and (more := client.recv(4096)):
                got += more
        return got

    def end(self) -> Done:
        out, err = self.process.communicate(timeout=30)  # closes its standard input
        return Done(self.process.returncode, out, err)


@contextlib.contextmanager
def running(log: Path, *options: str) -> Iterator[Running]:
    replay = Running(log, *options)
    try:
        yield replay
    finally:
        replay.process.kill()
        for stream in (replay.process.stdin, replay.process.stdout, replay.process.stderr):
            assert isinstance(stream, io.TextIOBase)
            stream.close()
        replay.process.wait()


def test_lines_and_ready_then_seconds(run, log):
    done = run(log, "--seconds", 0.02)
    assert done.code == 0
    *lines, ready = done.out.splitlines()
    assert ready == "ready"
    assert [line.split()[:2] for line in lines] == [["stage", "zaber"], ["lockin", "sr830"]]
    assert all(line.split()[2].startswith("socket://127.0.0.1:") for line in lines)
    asked = "0 requests, 0 answered with an earlier reply, 0 not answered"
    assert done.err.splitlines() == [
        f"stage: {asked}; commands of the log not given: 1, the first is '1 1 home' (line 7)",
        f"lockin: {asked}; commands of the log not given: 1, the first is 'OUTX 0' (line 12)",
    ]
    assert run(log, "--seconds", 0.01, "--role", "lockin").out.splitlines()[0].startswith("lockin sr830 ")
    assert run(log, "--seconds", 0.01, "--role", "lockin", "--strict").code == 1


def test_a_client_that_does_what_the_log_says(log):
    with running(log, "--strict", "--speed", "100") as replay:
        assert replay.ask("stage", b"/1 1 44 get pos\n") == b"@01 1 44 OK IDLE -- 7\r\n"
        assert replay.ask("stage", b"/1 1 45 home\n/1 1 46 get pos\n", ends=b"late") == (
            b"@01 1 45 OK BUSY -- 7\r\nlate"
        )
        assert replay.ask("lockin", b"SENS?\rOUTX 0\rSENS?\r", ends=b"26\r26\r") == b"26\r26\r"
        done = replay.end()
    assert done.code == 0
    # the first SENS? was asked before the stage was homed, which has happened meanwhile
    assert done.err.splitlines()[1] == "lockin: 3 requests, 2 answered with an earlier reply, 0 not answered"


def test_a_client_that_does_something_else(log):
    with running(log) as replay:
        assert replay.ask("stage", b"/1 1 move abs 3\n/1 1 move abs 3\n/1 1 get pos\n").endswith(b" 7\r\n")
        done = replay.end()
    assert done.code == 1
    first, *rest = done.err.splitlines()
    assert first == (
        "stage: the command '1 1 move abs 3' is not in the log; the next command there is '1 1 home' (line 7)"
    )
    assert rest[0].startswith("stage: 3 requests, 0 answered with an earlier reply, 2 not answered; commands")
    assert len(rest) == 2


def test_strict_hangs_up_and_ends(log):
    with running(log, "--strict") as replay:
        with contextlib.suppress(ConnectionResetError):
            assert replay.ask("stage", b"/1 1 move abs 3\n") == b""
        assert replay.process.wait(10) == 1


@pytest.mark.skipif(not PtyPort.is_available(), reason="no pseudo-terminals on this system")
def test_pseudo_terminals(log):
    with running(log, "--pty") as replay:
        (path,) = (
            words[2] for line in replay.lines if (words := line.split())[2][0] == "/" and words[0] == "stage"
        )
        terminal = os.open(path, os.O_RDWR | os.O_NOCTTY)
        os.write(terminal, b"/1 1 01 get pos\n")
        assert os.read(terminal, 100) == b"@01 1 01 OK IDLE -- 7\r\n"
        os.close(terminal)
        assert replay.end().code == 0


def test_print(run, log):
    done = run(log, "--print")
    assert (done.code, done.err) == (0, "")
    *records, empty, head, stage, lockin = done.out.splitlines()
    assert empty == ""
    assert len(records) == 12
    assert records[2] == (
        r"    0.020000            stage  > /1 1 01 get pos\n          "
        "2f 31 20 31 20 30 31 20 67 65 74 20 70 6f 73 0a"
    )
    assert records[3].startswith(r"    0.030000    +10.000 stage  < @01 1 01 OK IDLE -- 7\r\n  40 30")
    # the hexadecimal bytes stand in one column
    assert len({line.rindex("  ") for line in records if " = " not in line}) == 1
    assert head.split()[:4] == ["role", "protocol", "requests", "commands"]
    assert stage.split() == ["stage", "zaber", "3", "1", "2", "10.000", "10.000", "1", "4", "-"]
    assert lockin.split() == ["lockin", "sr830", "2", "1", "1", "10.000", "10.000", "0", "0", "-"]
    assert len(run(log, "--print", "--role", "lockin").out.splitlines()) == 4 + 3


def test_sessions(run, tmp_path):
    log = tmp_path / "wire.log"
    first = write(tmp_path / "a", "stage = wire-log 1: zaber").read_text()
    log.write_text(first + first.replace("zaber", "modbus-rtu"))
    assert "modbus-rtu" in run(log, "--print").out
    assert "zaber" in run(log, "--print", "--session", 1).out
    done = run(log, "--print", "--session", 3)
    assert (done.code, done.out) == (1, "")
    assert "has no session 3; it has 1: undated, 2: undated" in done.err


def test_a_torn_log_is_served_with_a_warning(run, log):
    with log.open("a") as file:
        file.write("9.5 stage > 2f")
    done = run(log, "--print")
    assert done.code == 0
    assert "line 13: left out, as it breaks off" in done.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["none.log"], "none.log: cannot be read"),
        (["{log}", "--role", "polarizer"], "has no line 'polarizer' in this session; it has stage, lockin"),
    ],
)
def test_errors_are_one_message(run, log, options, words):
    done = run(*[option.format(log=log) for option in options])
    assert (done.code, done.out) == (1, "")
    assert words in done.err
    assert len(done.err.splitlines()) == 1


@pytest.mark.parametrize("options", [[], ["a", "b"], ["a", "--speed", "0"], ["a", "--seconds", "-1"]])
def test_bad_usage(run, options):
    done = run(*options)
    assert done.code == 2
    assert "usage: gonio replay" in done.err

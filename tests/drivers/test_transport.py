"""Addresses open or say clearly why not; sockets and pseudo terminals carry bytes both ways."""

from __future__ import annotations

import os
import socket
import threading
from pathlib import Path

import pytest

from gonio.clock import Clock
from gonio.errors import ConfigError, ConnectionFailed
from gonio.rig import Context
from gonio_drivers.lines import open_line
from gonio_drivers.transport import open_port

pty = pytest.importorskip("pty", reason="no pseudo terminals on this system") if os.name == "posix" else None
needs_pty = pytest.mark.skipif(pty is None, reason="no pseudo terminals on this system")


@pytest.fixture
def server():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener


def address_of(listener: socket.socket) -> str:
    return f"socket://127.0.0.1:{listener.getsockname()[1]}"


def test_socket_both_ways_and_without_delay(server):
    port = open_port("stage", address_of(server), baudrate=9600)
    other, _ = server.accept()
    with other:
        assert port._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        port.write(b"ping")
        assert other.recv(10) == b"ping"
        assert port.read(0.0) == b""
        other.sendall(b"pong")
        assert port.read(5.0) == b"pong"
        port.close()
        assert other.recv(10) == b""
        port.close()


def test_a_closed_socket_is_an_error_not_silence(server):
    port = open_port("stage", address_of(server), baudrate=9600)
    server.accept()[0].close()
    with pytest.raises(OSError, match="closed the connection"):
        port.read(5.0)
    port.close()


def test_refused_connection_is_one_message(server):
    address = address_of(server)
    server.close()
    with pytest.raises(
        ConnectionFailed, match=rf"^lockin at {address}: the connection was refused; check .* host and port"
    ):
        open_port("lockin", address, baudrate=9600)


@pytest.mark.parametrize(
    "address", ["socket://localhost", "socket://:0x", "socket://127.0.0.1:99999", "nonsense://x"]
)
def test_malformed_address(address):
    with pytest.raises(ConnectionFailed, match=r"malformed .* write it as"):
        open_port("stage", address, baudrate=9600)


def test_missing_port_names_the_cable():
    with pytest.raises(ConnectionFailed, match=r"stage at .*nowhere: .*; check the cable"):
        open_port("stage", "/dev/nowhere" if os.name == "posix" else "COM999nowhere", baudrate=9600)


def test_a_simulated_address_that_nobody_serves():
    with pytest.raises(ConnectionFailed, match="gonio simulate"):
        open_port("stage", "simulated", baudrate=9600)


@needs_pty
def test_pty_both_ways_and_exclusive():
    leader, follower = pty.openpty()
    try:
        address = os.ttyname(follower)
        port = open_port("polarizer", address, baudrate=9600)
        port.write(b"0in")
        assert os.read(leader, 10) == b"0in"
        assert port.read(0.0) == b""
        threading.Timer(0.01, os.write, (leader, b"0GS00\r\n")).start()
        got = b""
        while len(got) < 7:
            got += port.read(5.0)
        assert got == b"0GS00\r\n"
        with pytest.raises(ConnectionFailed, match="close the other program"):
            open_port("polarizer", address, baudrate=9600)
        port.close()
        open_port("polarizer", address, baudrate=9600).close()
    finally:
        os.close(leader)
        os.close(follower)


def test_wire_log_tells_time_role_direction_and_bytes(server, tmp_path: Path):
    log = tmp_path / "wire.log"
    line = open_line("stage", address_of(server), Context("test", Clock(speed=1000.0), log))
    other, _ = server.accept()
    with other:
        with line.transaction():
            line.send(b"/1 1 03 get pos\n")
            other.sendall(b"@01 1 03 OK IDLE -- 7\r\n")
            line.read_until(b"\r\n", line.deadline_s())
            line.answered()
        line.close()
    records = log.read_text().splitlines()
    assert [record.split(" ", 3)[1:3] for record in records] == [["stage", d] for d in "=><="]
    assert records[1].endswith("> 2f3120312030332067657420706f730a  /1 1 03 get pos\\n")
    assert records[2].endswith("  @01 1 03 OK IDLE -- 7\\r\\n")
    assert "closed after 1 replies" in records[3]
    assert (
        0 <= float(records[1].split()[0]) <= float(records[2].split()[0]) < 60
    )  # real, not instrument seconds


def test_wire_log_that_cannot_be_written(server, tmp_path: Path):
    with pytest.raises(ConfigError, match="cannot be written"):
        open_line("stage", address_of(server), Context("test", Clock(), tmp_path / "no" / "wire.log"))


@needs_pty
def test_parity_of_a_serial_line():
    master, slave = os.openpty()
    try:
        port = open_port("stage", os.ttyname(slave), baudrate=19200, parity="even")
        assert (port._serial.parity, port._serial.bytesize, port._serial.stopbits) == ("E", 8, 1)
        port.close()
    finally:
        os.close(master)
        os.close(slave)

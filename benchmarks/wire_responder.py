"""The quickest device there is: looks each request up and sends its reply; for `benchmarks/wire.py`.

    python benchmarks/wire_responder.py PROTOCOL

Serves one protocol on a loopback port and on a pseudo-terminal, prints their addresses, and ends when its
standard input closes.
"""

from __future__ import annotations

import os
import pty
import select
import socket
import sys
import time
import tty
from collections.abc import Callable

LOOK_S = 1e-3  # like the simulator: looks for a while before it sleeps
LIVES_S = 600.0

_IDENTITY = "0IN0E114008212023016800023000023000"


def _zaber_replies() -> dict[bytes, bytes]:
    """Every message number of ``get pos``, with the checksums of both sides."""

    def summed(head: bytes, body: bytes, tail: bytes) -> bytes:
        return head + body + b":%02X" % (-sum(body) & 0xFF) + tail

    return {
        summed(b"/", b"1 1 %02d get pos" % n, b"\n"): summed(
            b"@", b"01 1 %02d OK IDLE -- 1234567" % n, b"\r\n"
        )
        for n in range(100)
    }


def _crc(body: bytes) -> bytes:
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc.to_bytes(2, "little")


_READ = bytes.fromhex("01 03 0000 0008")
_REGISTERS = bytes.fromhex("01 03 10 0000 0009 0000 0000 0001 86A0 0001 86A0")


def _modbus_tcp(request: bytes) -> bytes:
    assert request[6:] == _READ
    return request[:5] + bytes([len(_REGISTERS)]) + _REGISTERS  # the request's own transaction number


def _from(table: dict[bytes, bytes]) -> Callable[[bytes], bytes]:
    return table.__getitem__


ANSWERS: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "zaber": ("stage", _from(_zaber_replies())),
    "modbus-rtu": ("stage", _from({_READ + _crc(_READ): _REGISTERS + _crc(_REGISTERS)})),
    "modbus-tcp": ("stage", _modbus_tcp),
    "elliptec": ("polarizer", _from({b"0gp": b"0PO00004600\r\n"})),
    "cs260": ("monochromator", _from({b"WAVE?\r\n": b"WAVE?\r\n623.500\r\n"})),
    "sr830": (
        "lockin",
        _from(
            {
                b"SNAP? 1,2,3;LIAS?\r": b"0.123456,-0.00012,0.123456\r0\r",
                b"LIAS?;SNAP? 1,2,3\r": b"0\r0.123456,-0.00012,0.123456\r",
            }
        ),
    ),
}


def main() -> None:
    """Serve until standard input closes."""
    role, answer = ANSWERS[sys.argv[1]]
    listener = socket.create_server(("127.0.0.1", 0))
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    print(f"{role} {sys.argv[1]} socket://127.0.0.1:{listener.getsockname()[1]}")
    print(f"{role} {sys.argv[1]} {os.ttyname(slave)}")
    print("ready", flush=True)
    connection: socket.socket | None = None
    ends_s = time.monotonic() + LIVES_S
    looked_s = time.perf_counter()
    while time.monotonic() < ends_s:
        try:
            if request := os.read(master, 4096):
                os.write(master, answer(request))
                looked_s = time.perf_counter()
        except BlockingIOError:
            pass
        if connection is not None:
            try:
                if request := connection.recv(4096):
                    connection.send(answer(request))
                    looked_s = time.perf_counter()
                else:
                    connection.close()
                    connection = None
            except BlockingIOError:
                pass
        if time.perf_counter() - looked_s < LOOK_S:
            continue
        watched = [listener, master, sys.stdin, *([] if connection is None else [connection])]
        ready = select.select(watched, [], [], 1.0)[0]
        if sys.stdin in ready:
            return
        if listener in ready:
            if connection is not None:
                connection.close()
            connection, _ = listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setblocking(False)
        looked_s = time.perf_counter()


if __name__ == "__main__":
    main()

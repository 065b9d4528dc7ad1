"""A foreign device at the end of a TCP port: a thread that ends by itself, and motion in real time."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from typing import Protocol

LONGEST_S = 100.0  # a server ends by itself after this time
_LOOK_S = 0.001


class ForeignDevice(Protocol):
    """Bytes in, bytes out; written from the manual and not from gonio's simulators."""

    def heard(self, data: bytes) -> bytes:
        """Take what came and return what is said at once."""
        ...

    def unasked(self) -> bytes:
        """Return what has become due meanwhile."""
        ...


@contextlib.contextmanager
def served(device: ForeignDevice, *, chunk: int = 4096) -> Iterator[str]:
    """Serve a device, one client after another, in pieces of at most `chunk` bytes; yield its address."""
    stop = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.05)
    end_s = time.monotonic() + LONGEST_S

    def talk(client: socket.socket) -> None:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.settimeout(_LOOK_S)
        while not stop.is_set() and time.monotonic() < end_s:
            said = b""
            try:
                data = client.recv(4096)
                if not data:
                    return
                said = device.heard(data)
            except TimeoutError:
                pass
            said += device.unasked()
            for start in range(0, len(said), chunk):
                client.sendall(said[start : start + chunk])

    def serve() -> None:
        while not stop.is_set() and time.monotonic() < end_s:
            with contextlib.suppress(TimeoutError, ConnectionError):
                client, _ = listener.accept()
                with client:
                    talk(client)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        stop.set()
        thread.join(5)
        listener.close()


class Later:
    """What is said after a while, in order."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, bytes]] = []

    def say(self, data: bytes, after_s: float) -> None:
        self._waiting.append((time.monotonic() + after_s, data))

    def due(self) -> bytes:
        said = b""
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            said += self._waiting.pop(0)[1]
        return said


class Glide:
    """Something that moves at one speed, in real time."""

    def __init__(self, at: float, speed: float) -> None:
        self.speed = speed
        self._from = self._to = at
        self._began_s = self._ends_s = 0.0

    def go(self, to: float) -> None:
        self._from, self._to = self.at(), to
        self._began_s = time.monotonic()
        self._ends_s = self._began_s + abs(self._to - self._from) / self.speed

    def halt(self) -> None:
        self.jump(self.at())

    def jump(self, to: float) -> None:
        self._from = self._to = to
        self._ends_s = time.monotonic()

    def is_moving(self) -> bool:
        return time.monotonic() < self._ends_s

    def since_s(self) -> float:
        """Seconds since the motion began."""
        return time.monotonic() - self._began_s

    def rested_s(self) -> float:
        """Seconds since the motion ended."""
        return time.monotonic() - self._ends_s

    def at(self) -> float:
        if not self.is_moving():
            return self._to
        done = (time.monotonic() - self._began_s) / (self._ends_s - self._began_s)
        return self._from + done * (self._to - self._from)

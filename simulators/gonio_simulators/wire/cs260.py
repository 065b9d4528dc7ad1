"""An Oriel Cornerstone 260 monochromator on RS-232: echo, responses, and the order of things.

Every received character is echoed as it comes, terminators included.  A statement ends with LF (CRLF also
does).  Statements are carried out one after another: a query behind a movement is answered when the movement
is over, and with ``HANDSHAKE 1`` the status byte follows each statement at its completion.  ``ABORT`` is
the exception: it acts at once.
"""

from __future__ import annotations

from collections import deque

from gonio_simulators.bench.bench import Bench
from gonio_simulators.wire.cs260_statements import Controller

_INPUT_BUFFER_BYTES = 256


class Cornerstone260:
    """The instrument; its settings outlive clients."""

    def __init__(self, bench: Bench) -> None:
        self._controller = Controller(bench)

    def power_cycle(self, *, memory_lost: bool = False) -> None:
        """Switch off and on; labels and calibration are in a memory that needs no battery."""
        self._controller.power_cycle()

    def open(self) -> CornerstoneConversation:
        """Begin a conversation with a new client."""
        return CornerstoneConversation(self._controller)


class CornerstoneConversation:
    """Echo, and the queue of statements that wait for the mechanics."""

    def __init__(self, device: Controller) -> None:
        self.wait_s: float | None = None
        self._device = device
        self._unfinished = b""
        self._waiting: deque[str] = deque()  # statements; an empty one stands for a handshake that is owed

    def feed(self, data: bytes) -> bytes:
        """Take received bytes, echo them, and return the responses that are due."""
        out = []
        lines = data.split(b"\n")
        for line in lines[:-1]:
            out.append(line + b"\n")  # the echo
            statement = (self._unfinished + line).decode("ascii", "replace").strip()
            self._unfinished = b""
            if statement:
                out.append(self._accept(statement))
        if lines[-1]:
            out.append(lines[-1])
            self._unfinished = (self._unfinished + lines[-1])[-_INPUT_BUFFER_BYTES:]
        return b"".join(out)

    def poll(self) -> bytes:
        """Return the responses that have become due."""
        out = []
        device = self._device
        while self._waiting and not device.monochromator.is_busy():
            statement = self._waiting.popleft()
            if statement:
                out.append(self._begin(statement))
            else:
                out.append(device.take_handshake())
        self.wait_s = None
        if self._waiting:
            left_s = device.monochromator.busy_until_s - device.clock.now_s()
            self.wait_s = max(0.0, left_s / device.clock.speed)
        return b"".join(out)

    def _accept(self, statement: str) -> bytes:
        if statement.upper() == "ABORT":
            self._device.carry_out(statement)
            return self.poll()
        depends = statement.endswith("?") or statement.upper().startswith(("STEP", "CALIBRATE"))
        if not self._waiting and not depends:
            # A command behind commands: the mechanics line them up themselves, without waiting for our timer.
            reply = self._begin(statement)
        else:
            self._waiting.append(statement)
            reply = b""
        return reply + self.poll() if self._waiting else reply

    def _begin(self, statement: str) -> bytes:
        device = self._device
        response = device.carry_out(statement)
        reply = f"{response}\r\n".encode("ascii", "replace") if response else b""
        if device.handshake:
            if device.has_error:
                return reply + device.take_handshake()  # reported at once, without waiting for the mechanics
            self._waiting.appendleft("")
        return reply

"""The bus of Elliptec modules: how bytes become commands, and who answers.

A command is an address digit, two lower-case letters and upper-case hexadecimal data of a length that the
letters determine; it has no terminator.  Replies end with CRLF.  The beginning of a command is forgotten
after 2 s without a character, and at a line end, which many clients send behind each command.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from gonio_simulators.bench.bench import Bench
from gonio_simulators.wire.elliptec_module import DATA_LENGTH, Module

HALF_COMMAND_S = 2.0
"""Real seconds without a character after which the beginning of a command is forgotten."""

_ADDRESSES = "0123456789ABCDEF"


class Elliptec:
    """The polarizer's bus, with one module."""

    def __init__(
        self, bench: Bench, *, address: str = "0", now: Callable[[], float] = time.monotonic
    ) -> None:
        self._module = Module(bench, address.upper())
        self._now = now

    @property
    def address(self) -> str:
        """The module's digit on the bus."""
        return self._module.address

    def power_cycle(self, *, memory_lost: bool = False) -> None:
        """Switch the module off and on; what ``us`` saved needs no battery."""
        self._module.power_cycle()

    def open(self) -> ElliptecConversation:
        """Begin a conversation with a new client."""
        return ElliptecConversation(self._module, self._now)


class ElliptecConversation:
    """Splits the bytes of one client into commands by their length."""

    def __init__(self, module: Module, now: Callable[[], float]) -> None:
        self.wait_s: float | None = None
        self._module = module
        self._now = now
        self._last_s = now()
        self._buffer = ""

    def feed(self, data: bytes) -> bytes:
        """Take received bytes and return the replies to the commands they complete."""
        replies = self.poll()
        now_s = self._now()
        if now_s - self._last_s > HALF_COMMAND_S:
            self._buffer = ""
        self._last_s = now_s
        self._buffer += data.decode("latin-1")
        while (command := self._next_command()) is not None:
            address, letters, argument = command
            if self._module.hears(address, letters):
                replies += self._module.answer(letters, argument) or b""
        return replies + self.poll()

    def poll(self) -> bytes:
        """Return the answer to a movement, if it is over."""
        module = self._module
        replies = b""
        self.wait_s = None
        while module.owes_answer:
            self.wait_s = module.wait_s()
            if self.wait_s is not None:
                break
            replies += module.finish() or b""
        return replies

    def _next_command(self) -> tuple[str, str, str] | None:
        """Take a complete command from the buffer."""
        while self._buffer and self._buffer[0] not in _ADDRESSES:
            self._buffer = self._buffer[1:]  # no command begins so; line ends are such
        if len(self._buffer) < 3:
            return self._cut_short()
        address, letters = self._buffer[0], self._buffer[1:3]
        if letters not in DATA_LENGTH:
            self._buffer = ""  # its length cannot be known
            return address, letters, ""
        length = 3 + DATA_LENGTH[letters]
        argument = self._buffer[3:length]
        if "\r" in argument or "\n" in argument or len(argument) < length - 3:
            return self._cut_short()
        self._buffer = self._buffer[length:]
        return address, letters, argument

    def _cut_short(self) -> tuple[str, str, str] | None:
        """Forget a beginning that a line end cuts off, and go on behind it."""
        for i, character in enumerate(self._buffer):
            if character in "\r\n":
                self._buffer = self._buffer[i + 1 :]
                return self._next_command()
        return None

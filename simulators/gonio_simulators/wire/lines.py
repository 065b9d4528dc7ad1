"""How an instrument's bytes reach a client: TCP ports and pseudo-terminals on one asyncio loop.

An `Instrument` is the state that outlives clients; a `Conversation` is what one client has begun to say and
is still owed.  Every accepted TCP connection starts a new conversation, so that nobody inherits half a
command.  Between the two sits an optional `Filter`, which may hold back, damage, split or repeat bytes in
either direction.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import selectors
import socket
import sys
import time
from collections.abc import Callable
from typing import Protocol

from gonio.errors import ConfigError
from gonio_simulators.clock import BenchClock

HOST = "127.0.0.1"
_RECEIVE_BYTES = 16384
_LOOK_S = 1e-3
_LONGEST_DISTANCE = 256
_LISTEN_AGAIN_S = 0.1


class Conversation(Protocol):
    """One client's talk with an instrument."""

    wait_s: float | None
    """Real seconds after which `poll` wants to be called; None when nothing is pending."""

    def feed(self, data: bytes) -> bytes:
        """Take received bytes and return what to send at once."""
        ...

    def poll(self) -> bytes:
        """Return what has become due since the last call."""
        ...


class Instrument(Protocol):
    """Something that talks."""

    def open(self) -> Conversation:
        """Begin a conversation with a new client."""
        ...


class Filter(Protocol):
    """What may happen to bytes on their way; each method decides when, and with which bytes, to call on."""

    def received(self, data: bytes, deliver: Callable[[bytes], None]) -> None:
        """Pass bytes from the client on to the instrument."""
        ...

    def sending(self, data: bytes, transmit: Callable[[bytes], None]) -> None:
        """Pass bytes from the instrument on to the client."""
        ...


def new_event_loop() -> asyncio.AbstractEventLoop:
    """Return a loop whose timers are finer than a millisecond.

    A bench second may last a microsecond-scale real time.  `epoll` and `poll` count timeouts in whole
    milliseconds, which would add half a minute to a scan; `select` takes microseconds and also works on
    Windows and on macOS ptys.
    """
    return asyncio.SelectorEventLoop(_WakefulSelector())


class _WakefulSelector(selectors.SelectSelector):
    """Looks for a while before it sleeps.

    The next command of a client on this machine comes within 0.1 ms, which is less than it takes the kernel
    to put this process to sleep and to wake it; on a virtual machine the difference is fivefold.  Where it
    does not come while we look (the client needs this very core, or nobody is there), looking is left out for
    1, 2, 4 ... times after each attempt.
    """

    def __init__(self) -> None:
        super().__init__()
        self._distance = 1  # sleeps from one look in vain to the next
        self._sleeps_to_look = 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if ready or (timeout is not None and timeout <= 0):
            return ready
        start_s = time.perf_counter()
        if self._sleeps_to_look:
            self._sleeps_to_look -= 1
        else:
            look_s = _LOOK_S if timeout is None else min(timeout, _LOOK_S)
            while time.perf_counter() - start_s < look_s:
                if ready := super().select(0):
                    self._distance = 1
                    return ready
            if timeout is None or timeout >= _LOOK_S:  # a shorter appointment was kept, not missed
                self._sleeps_to_look = self._distance
                self._distance = min(2 * self._distance, _LONGEST_DISTANCE)
        if timeout is None:
            return super().select(None)
        left_s = timeout - (time.perf_counter() - start_s)
        return super().select(left_s) if left_s > 0 else []


class _Pump:
    """Moves bytes between a transport and a conversation and keeps the conversation's appointment."""

    def __init__(
        self,
        conversation: Conversation,
        transmit: Callable[[bytes], None],
        filter_: Filter | None,
        clock: BenchClock,
    ) -> None:
        self._conversation = conversation
        self._clock = clock
        self._transmit = transmit
        self._filter = filter_
        self._timer: asyncio.TimerHandle | None = None
        self._closed = False
        self._loop = asyncio.get_running_loop()
        self._appoint()  # some devices speak first

    def received(self, data: bytes) -> None:
        if self._filter is None:
            self._deliver(data)
        else:
            self._filter.received(data, self._deliver)

    def close(self) -> None:
        self._cancel()
        self._closed = True

    def restart(self, conversation: Conversation) -> None:
        """Begin anew: what was half received or is owed is forgotten, as by an instrument that restarts."""
        self._cancel()
        self._conversation = conversation

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _deliver(self, data: bytes) -> None:
        if self._closed:  # a fault held the bytes back until the client had gone
            return
        self._clock.hold()
        try:
            reply = self._conversation.feed(data)
        finally:
            self._clock.release()
        if reply:
            self._send(reply)
        if self._conversation.wait_s is not None or self._timer is not None:
            self._appoint()

    def _send(self, data: bytes) -> None:
        if self._filter is None:
            self._transmit(data)
        else:
            self._filter.sending(data, self._transmit_if_open)

    def _transmit_if_open(self, data: bytes) -> None:
        if not self._closed:
            self._transmit(data)

    def _appoint(self) -> None:
        self._cancel()
        wait_s = self._conversation.wait_s
        if wait_s is not None:
            self._timer = self._loop.call_later(wait_s, self._due)

    def _due(self) -> None:
        self._timer = None
        self._clock.hold()
        try:
            reply = self._conversation.poll()
        finally:
            self._clock.release()
        if reply:
            self._send(reply)
        self._appoint()


class _TcpClient(asyncio.BufferedProtocol):
    """One accepted connection; a newer one on the same port takes the line over.

    Buffered, because a plain protocol is handed a fresh 256 KiB buffer for each command of a dozen bytes.
    """

    def __init__(self, port: TcpPort) -> None:
        self._port = port
        self._transport: asyncio.Transport | None = None
        self._pump: _Pump | None = None
        self._buffer = memoryview(bytearray(_RECEIVE_BYTES))

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        if self._pump is not None:
            self._pump.received(bytes(self._buffer[:nbytes]))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        sock = transport.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._transport = transport
        self._pump = _Pump(self._port.instrument.open(), transport.write, self._port.filter, self._port.clock)
        self._port.taken_over_by(self)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._pump is not None:
            self._pump.close()
        self._port.left_by(self)

    def hang_up(self) -> None:
        if self._pump is not None:
            self._pump.close()
        if self._transport is not None:
            self._transport.abort()

    def restart(self) -> None:
        if self._pump is not None:
            self._pump.restart(self._port.instrument.open())


class TcpPort:
    """A listening port of one instrument on the loopback interface.

    A terminal server lets one client talk at a time.  A second connection replaces the first: the first is
    usually a client that died without saying so.
    """

    def __init__(
        self, instrument: Instrument, clock: BenchClock, *, port: int = 0, filter_: Filter | None = None
    ) -> None:
        self.instrument = instrument
        self.clock = clock
        self.filter = filter_
        self._wanted_port = port
        self._port = port
        self._server: asyncio.Server | None = None
        self._listening: asyncio.Future[None] | None = None
        self._closed = False
        self._client: _TcpClient | None = None

    @property
    def address(self) -> str:
        """The address in the form that drivers take, once started."""
        assert self._server is not None
        return f"socket://{HOST}:{self._port}"

    async def start(self) -> None:
        """Listen; `ConfigError` if the port is taken or not allowed."""
        loop = asyncio.get_running_loop()
        try:
            self._server = await loop.create_server(lambda: _TcpClient(self), HOST, self._wanted_port)
        except OSError as error:
            reason = "it is already taken" if error.errno == errno.EADDRINUSE else str(error)
            raise ConfigError(
                f"port {self._wanted_port} on {HOST} cannot be served: {reason}; end the program that uses "
                'it, or write address = "simulated" for any free port'
            ) from None
        self._port = self._server.sockets[0].getsockname()[1]

    def close(self) -> None:
        """Stop listening and hang up."""
        self._closed = True
        if self._server is not None:
            self._server.close()
        self.hang_up()

    def hang_up(self) -> None:
        """Break the connection to the present client, if there is one."""
        if self._client is not None:
            self._client.hang_up()

    def refuse(self, duration_s: float) -> None:
        """Let nobody connect for real seconds; the port stays the same."""
        if self._server is not None:
            self._server.close()
        asyncio.get_running_loop().call_later(duration_s, self._begin_to_listen_again)

    def _begin_to_listen_again(self) -> None:
        if not self._closed and self._server is not None and not self._server.is_serving():
            self._wanted_port = self._port
            self._listening = asyncio.ensure_future(self._listen_again())

    async def _listen_again(self) -> None:
        try:
            await self.start()
        except ConfigError:  # somebody has the number meanwhile
            asyncio.get_running_loop().call_later(_LISTEN_AGAIN_S, self._begin_to_listen_again)

    def restart(self) -> None:
        """Forget what the client has half said and is owed."""
        if self._client is not None:
            self._client.restart()

    def taken_over_by(self, client: _TcpClient) -> None:
        """Hang up on the former client."""
        former, self._client = self._client, client
        if former is not None:
            former.hang_up()

    def left_by(self, client: _TcpClient) -> None:
        """Forget a client that has gone."""
        if self._client is client:
            self._client = None


class PtyPort:
    """A pseudo-terminal of one instrument, in raw mode, for clients that want a serial port (POSIX only).

    As on a serial cable, the instrument cannot see clients come and go: they share one conversation.
    """

    def __init__(self, instrument: Instrument, clock: BenchClock, *, filter_: Filter | None = None) -> None:
        self.instrument = instrument
        self.clock = clock
        self.filter = filter_
        self._master = -1
        self._slave = -1
        self._pump: _Pump | None = None
        self._unsent = b""

    @staticmethod
    def is_available() -> bool:
        """Say whether this system has pseudo-terminals."""
        return sys.platform != "win32"

    @property
    def address(self) -> str:
        """The path of the terminal, once started."""
        return os.ttyname(self._slave)

    async def start(self) -> None:
        """Open the terminal; `ConfigError` where there is none."""
        if sys.platform == "win32":
            raise ConfigError("--pty: this system has no pseudo-terminals; use the TCP addresses")
        import pty
        import tty

        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)  # no echo and no newline translation: the bytes are the instrument's
        os.set_blocking(self._master, False)
        self._pump = _Pump(self.instrument.open(), self._write, self.filter, self.clock)
        asyncio.get_running_loop().add_reader(self._master, self._readable)

    def close(self) -> None:
        """Close both ends."""
        if self._master < 0:
            return
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._master)
        loop.remove_writer(self._master)
        if self._pump is not None:
            self._pump.close()
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1

    def restart(self) -> None:
        """Forget what was half said and is owed."""
        if self._pump is not None:
            self._pump.restart(self.instrument.open())

    def hang_up(self) -> None:
        """Lose what is under way, as when the cable is pulled; the terminal itself cannot go away."""
        self._unsent = b""
        self.restart()

    def refuse(self, duration_s: float) -> None:
        """Take no bytes for real seconds: the cable is out, and what a client sends is lost."""
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._master)
        loop.call_later(duration_s, self._plugged_in_again)

    def _plugged_in_again(self) -> None:
        if self._master < 0:
            return
        with contextlib.suppress(BlockingIOError):
            while os.read(self._master, 65536):
                continue
        asyncio.get_running_loop().add_reader(self._master, self._readable)

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._master, 65536)
            if data and self._pump is not None:
                self._pump.received(data)

    def _write(self, data: bytes) -> None:
        if not self._unsent:
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self._master, data) :]
        if data:  # the client does not read: what the kernel does not hold waits here
            self._unsent += data
            asyncio.get_running_loop().add_writer(self._master, self._writable)

    def _writable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._unsent = self._unsent[os.write(self._master, self._unsent) :]
        if not self._unsent:
            asyncio.get_running_loop().remove_writer(self._master)

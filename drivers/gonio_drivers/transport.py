"""How do bytes get to an address and back: a serial port through pyserial, or a TCP socket of our own.

An address is ``/dev/ttyUSB0``, ``COM3``, ``usb://VID:PID/SERIAL`` (an adapter, at whatever port it sits),
``socket://host:port`` (a serial server, a Modbus gateway, the simulated bench) or anything else that
`serial.serial_for_url` understands, such as ``rfc2217://host:port``.

``socket://`` does not go through pyserial: its `in_waiting` is only 0 or 1, which makes every reply a read
per byte, and its `close` sleeps 0.3 s (see `docs/decisions/raw-socket.md`).
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
from typing import Literal, Protocol
from urllib.parse import urlsplit

import serial

from gonio.errors import ConnectionFailed
from gonio.rig import SIMULATED
from gonio_drivers.usb import SCHEME as USB
from gonio_drivers.usb import UsbIdentity, device_of, identity_of, parse_usb_address

Parity = Literal["none", "even", "odd"]
_PARITY = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}

CONNECT_TIMEOUT_S = 5.0
WRITE_TIMEOUT_S = 2.0
LOOK_S = 5e-4  # for so long a socket is looked at again and again before the thread sleeps
_LONGEST_DISTANCE = 256  # reads between two looks where looking is in vain
_SERIAL_SLICE_S = 0.05  # pyserial's own timeout: setting it per read would reconfigure the port each time


class Port(Protocol):
    """A stream of bytes; every method raises `OSError` when the other end is gone."""

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Return what arrives first, at least one byte, or ``b""`` after `timeout_s` real seconds."""
        ...

    def close(self) -> None:
        """Release the line; never raises."""
        ...


class SocketPort:
    """A TCP connection; one system call per reply instead of one per byte.

    A reply from this machine or its network is often there within 0.1 ms, less than it takes to put this
    thread to sleep and to wake it: so the first moments are spent looking, with the interpreter free for
    other threads at each look (see `docs/decisions/raw-socket.md` for the figures).

    Where looking is in vain (a device that takes its time, or a core that the other end needs), it is left
    out for 1, 2, 4 ... reads after each attempt, until one succeeds again.
    """

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=CONNECT_TIMEOUT_S)
        # A command is one small packet: waiting for more of them (Nagle) would cost up to 40 ms each.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)
        self._distance = 1  # reads from one look in vain to the next
        self._reads_to_look = 0
        self._poll: select.poll | None = None
        if hasattr(
            select, "poll"
        ):  # not on Windows; a third of the time of select, and any number of open files
            self._poll = select.poll()
            self._poll.register(self._socket, select.POLLIN)

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        left = memoryview(data)
        while left:
            try:
                left = left[self._socket.send(left) :]
            except BlockingIOError:
                if not select.select([], [self._socket], [], WRITE_TIMEOUT_S)[1]:
                    raise TimeoutError(
                        f"the other end has taken no bytes for {WRITE_TIMEOUT_S:g} s"
                    ) from None

    def read(self, timeout_s: float) -> bytes:
        """Return what arrives first, or ``b""`` after `timeout_s`."""
        with contextlib.suppress(BlockingIOError):
            return self._receive()
        if timeout_s <= 0:
            return b""
        looked_s = 0.0
        if self._reads_to_look:
            self._reads_to_look -= 1
        else:
            looked_s = min(timeout_s, LOOK_S)
            if data := self._look(looked_s):
                self._distance = 1
                return data
            self._reads_to_look = self._distance
            self._distance = min(2 * self._distance, _LONGEST_DISTANCE)
        if timeout_s <= looked_s or not self._wait(timeout_s - looked_s):
            return b""
        with contextlib.suppress(BlockingIOError):  # a checksum error in the kernel can take it back
            return self._receive()
        return b""

    def _look(self, duration_s: float) -> bytes:
        until_s = time.perf_counter() + duration_s
        while time.perf_counter() < until_s:
            with contextlib.suppress(BlockingIOError):
                return self._receive()
        return b""

    def _receive(self) -> bytes:
        data = self._socket.recv(4096)
        if not data:
            raise ConnectionResetError("the other end closed the connection")
        return data

    def _wait(self, timeout_s: float) -> bool:
        if self._poll is not None:
            return bool(self._poll.poll(math.ceil(timeout_s * 1e3)))
        return bool(select.select([self._socket], [], [], timeout_s)[0])

    def close(self) -> None:
        """Release the connection."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


class SerialPort:
    """A serial port, opened exclusively; 8 data bits, 1 stop bit, and no parity unless it is asked for."""

    def __init__(self, address: str, baudrate: int, parity: Parity = "none") -> None:
        self._serial = serial.serial_for_url(
            address,
            baudrate=baudrate,
            bytesize=serial.EIGHTBITS,
            parity=_PARITY[parity],
            stopbits=serial.STOPBITS_ONE,
            timeout=_SERIAL_SLICE_S,
            write_timeout=WRITE_TIMEOUT_S,
            exclusive=True,  # two programs on one port would read each other's replies
        )

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        self._serial.write(data)

    def read(self, timeout_s: float) -> bytes:
        """Return what arrives first, or ``b""`` after `timeout_s` (rounded up to the port's 50 ms slices)."""
        if timeout_s <= 0:
            return self._serial.read(self._serial.in_waiting or 0)
        end_s = time.monotonic() + timeout_s
        while True:
            first = self._serial.read(1)
            if first:
                waiting = self._serial.in_waiting
                return first + self._serial.read(waiting) if waiting else first
            if time.monotonic() >= end_s:
                return b""

    def close(self) -> None:
        """Release the port."""
        with contextlib.suppress(OSError):
            self._serial.close()


def open_port(role: str, address: str, *, baudrate: int, parity: Parity = "none") -> Port:
    """Open an address.

    Parameters
    ----------
    role
        What the device is to the user (``stage``, ``lockin``); named in messages.
    address
        Device path, COM port or URL.
    baudrate
        Bits per second of a serial port; a socket has none.
    parity
        Of a serial port.

    Raises
    ------
    ConnectionFailed
        The address is malformed, does not exist, is in use, or refuses.
    """
    device = f"{role} at {address}"
    if address == SIMULATED:
        raise ConnectionFailed(
            device,
            "the simulated bench has not been started for this rig",
            "start it with `gonio simulate` and write the addresses it prints into the rig file",
        )
    try:
        if address.startswith("socket://"):
            host, port = _host_and_port(address)
            return SocketPort(host, port)
        return SerialPort(address, baudrate, parity)
    except ValueError as error:
        raise ConnectionFailed(
            device,
            f"the address is malformed ({error})",
            "write it as /dev/ttyUSB0, COM3, usb://VID:PID/SERIAL or socket://host:port",
        ) from None
    except OSError as error:
        raise ConnectionFailed(device, _reason(error), _remedy(address, error)) from None


class Opener:
    """Opens one address, as often as it is lost; a USB adapter is found again under its new name.

    Parameters
    ----------
    role, address, baudrate, parity
        As for `open_port`.
    """

    def __init__(self, role: str, address: str, baudrate: int, parity: Parity = "none") -> None:
        self._role = role
        self._address = address
        self._baudrate = baudrate
        self._parity: Parity = parity
        self._identity: UsbIdentity | None = None

    def __call__(self) -> Port:
        """Open the address; raises as `open_port`."""
        address = self._address
        if self._identity is not None or address.startswith(USB):
            address = self._found()
        port = open_port(self._role, address, baudrate=self._baudrate, parity=self._parity)
        if self._identity is None and "://" not in address:
            self._identity = identity_of(address)
        return port

    def _found(self) -> str:
        try:
            return device_of(self._identity or parse_usb_address(self._address))
        except (OSError, ValueError) as error:
            raise ConnectionFailed(
                f"{self._role} at {self._address}",
                str(error),
                "plug it in, or correct the address in the rig file (`gonio devices --ports` lists them)",
            ) from None


def _host_and_port(address: str) -> tuple[str, int]:
    parts = urlsplit(address)
    if parts.hostname is None or parts.port is None:
        raise ValueError("host or port is missing")
    return parts.hostname, parts.port


def _reason(error: OSError) -> str:
    if isinstance(error, TimeoutError):
        return f"nobody answered within {CONNECT_TIMEOUT_S:g} s"
    if isinstance(error, ConnectionRefusedError):
        return "the connection was refused"
    if isinstance(error, socket.gaierror):
        return "the host name is unknown"
    return f"cannot be opened ({error.strerror or error})"


def _remedy(address: str, error: OSError) -> str:
    if "://" in address:
        return (
            "check that the device or server is switched on and that host and port in the rig file are right"
        )
    text = str(error).lower()
    if "permission" in text:
        return "give this user access to the port (on Linux: the group 'dialout') or choose another address"
    if "lock" in text or "busy" in text or "denied" in text:
        return "close the other program that uses the port"
    return "check the cable, the power and the address in the rig file"

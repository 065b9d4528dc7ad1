"""Which serial port is an adapter plugged into, whatever name it got this time?

A USB serial adapter that is unplugged and plugged in again, or whose hub restarts, may come back as another
``/dev/ttyUSB`` or ``COM``.  What stays is its identity: vendor and product number, and the serial number if
its maker gave it one, else the socket it sits in.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from serial.tools.list_ports import comports

SCHEME = "usb://"
_ADDRESS = re.compile(r"usb://([0-9a-fA-F]{4}):([0-9a-fA-F]{4})(?:/(.+))?")


class _PortInfo(Protocol):
    """What of pyserial's `ListPortInfo` is used here."""

    device: str
    vid: int | None
    pid: int | None
    serial_number: str | None
    location: str | None


@dataclass(frozen=True, slots=True)
class UsbIdentity:
    """Identity of an adapter; fields that are None are not asked for."""

    vendor: int
    product: int
    serial_number: str | None = None
    location: str | None = None

    def __str__(self) -> str:
        tail = f"/{self.serial_number}" if self.serial_number else ""
        return f"{SCHEME}{self.vendor:04x}:{self.product:04x}{tail}"

    def matches(self, port: _PortInfo) -> bool:
        """Say whether a port of this machine is that adapter."""
        return (
            (port.vid, port.pid) == (self.vendor, self.product)
            and (self.serial_number is None or port.serial_number == self.serial_number)
            and (self.location is None or port.location == self.location)
        )


def parse_usb_address(address: str) -> UsbIdentity:
    """Return the identity that ``usb://VID:PID[/SERIAL]`` names (hexadecimal); `ValueError` else."""
    match = _ADDRESS.fullmatch(address)
    if match is None:
        raise ValueError("write it as usb://VID:PID or usb://VID:PID/SERIAL, hexadecimal as lsusb shows it")
    return UsbIdentity(int(match[1], 16), int(match[2], 16), match[3])


def identity_of(device: str, ports: Iterable[_PortInfo] | None = None) -> UsbIdentity | None:
    """Return the identity of the adapter behind a port name, None for a port that is no USB adapter.

    An adapter without a serial number is known by the socket it sits in.
    """
    for port in comports() if ports is None else ports:
        if port.device == device and port.vid is not None and port.pid is not None:
            location = None if port.serial_number else port.location
            return UsbIdentity(port.vid, port.pid, port.serial_number or None, location)
    return None


def device_of(identity: UsbIdentity, ports: Iterable[_PortInfo] | None = None) -> str:
    """Return the name of the port at which the adapter is now.

    Raises
    ------
    OSError
        It is not plugged in, or several are and nothing tells them apart.
    """
    found = sorted(port.device for port in (comports() if ports is None else ports) if identity.matches(port))
    if not found:
        raise OSError(f"no USB adapter {identity} is plugged in")
    if len(found) > 1:
        raise OSError(
            f"{len(found)} USB adapters are {identity} ({', '.join(found)}); add the serial number of one"
        )
    return found[0]


def main(argv: Sequence[str]) -> int:
    """Print every serial port of this machine with the address that stays (`gonio devices --ports`)."""
    del argv
    ports = sorted(comports(), key=lambda port: port.device)
    for port in ports:
        identity = identity_of(port.device, ports)
        print(f"{port.device:<20}{'' if identity is None else identity!s:<36}{port.description}")
    if not ports:
        print("no serial port on this machine")
    return 0

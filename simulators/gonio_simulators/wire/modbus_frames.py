"""How a Modbus request is found in a stream and a reply is framed: RTU with CRC16, TCP with MBAP.

Written from the Modbus application protocol and serial line specifications, without the library that the
drivers use.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable

SILENCE_S = 0.02
"""Real seconds without a byte after which the beginning of an RTU frame is forgotten.

The serial rule is 3.5 characters (4 ms at 9600 baud); on TCP the pauses inside a frame are the network's,
so this is wider.
"""

_MAX_RTU_BYTES = 256
_MAX_MBAP_LENGTH = 254  # unit id and protocol data unit


def _make_crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
        table.append(crc)
    return tuple(table)


_CRC_TABLE = _make_crc_table()


def crc16(data: bytes) -> int:
    """Return the Modbus CRC (polynomial 0xA001 reflected, start 0xFFFF); it is sent low byte first."""
    crc = 0xFFFF
    table = _CRC_TABLE
    for byte in data:
        crc = (crc >> 8) ^ table[(crc ^ byte) & 0xFF]
    return crc


def rtu_frame(unit: int, pdu: bytes) -> bytes:
    """Return unit id, protocol data unit and CRC."""
    body = bytes([unit]) + pdu
    return body + struct.pack("<H", crc16(body))


def mbap_frame(transaction: int, unit: int, pdu: bytes) -> bytes:
    """Return the MBAP header, which repeats the request's transaction number, and the protocol data unit."""
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


class RtuReceiver:
    """Finds RTU requests by their length, which function code and byte count tell, and by silence."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._buffer = b""
        self._last_s = now()

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Return the complete requests as (unit id, protocol data unit); damaged ones are dropped."""
        now_s = self._now()
        if now_s - self._last_s > SILENCE_S:
            self._buffer = b""
        self._last_s = now_s
        self._buffer += data
        requests: list[tuple[int, bytes]] = []
        while len(self._buffer) >= 4:
            length = _request_length(self._buffer)
            if length is None and crc16(self._buffer) == 0:
                length = len(self._buffer)  # of a function whose length is not known, the frame is complete
            if length is None or len(self._buffer) < length:
                break
            frame, self._buffer = self._buffer[:length], self._buffer[length:]
            if crc16(frame) != 0:  # the CRC over a whole frame, its own CRC included, is zero
                self._buffer = b""  # out of step: a slave listens again after the next silence
                break
            requests.append((frame[0], frame[1:-2]))
        if len(self._buffer) > _MAX_RTU_BYTES:
            self._buffer = b""
        return requests


_LENGTHS = {
    **dict.fromkeys((1, 2, 3, 4, 5, 6, 8), 8),
    **dict.fromkeys((7, 11, 12, 17), 4),
    22: 10,
    24: 6,
    43: 7,
}
"""Bytes of the requests of fixed length, unit id and CRC included."""

_COUNTED = {15: (6, 9), 16: (6, 9), 20: (2, 5), 21: (2, 5), 23: (10, 13)}
"""Where the byte count of a longer request stands, and the bytes beside those that it counts."""


def _request_length(buffer: bytes) -> int | None:
    """Bytes of the request that `buffer` begins with, CRC included; None if that cannot be told (yet).

    The length of every public function is known, as a drive must find the end also of what it refuses.
    """
    function = buffer[1]
    if function in _COUNTED:
        place, beside = _COUNTED[function]
        return buffer[place] + beside if len(buffer) > place else _MAX_RTU_BYTES
    return _LENGTHS.get(function)


class MbapReceiver:
    """Finds Modbus TCP requests."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[tuple[int, int, bytes]]:
        """Return complete requests as (transaction number, unit id, protocol data unit).

        A header that is not Modbus's cannot be resynchronised; what was received is dropped.
        """
        self._buffer += data
        requests: list[tuple[int, int, bytes]] = []
        while len(self._buffer) >= 8:
            transaction, protocol, length, unit = struct.unpack_from(">HHHB", self._buffer)
            if protocol != 0 or not 2 <= length <= _MAX_MBAP_LENGTH:
                self._buffer = b""
                break
            end = 6 + length
            if len(self._buffer) < end:
                break
            requests.append((transaction, unit, self._buffer[7:end]))
            self._buffer = self._buffer[end:]
        return requests

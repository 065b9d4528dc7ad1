"""Modbus in a replay, and protocols of which nothing is known."""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping, Sequence

from gonio.wirelog import printable
from gonio_simulators.replay.dialect import Request, Splitter, all_to_the_last
from gonio_simulators.replay.exchanges import Chunk, edited, joined
from gonio_simulators.wire.modbus_frames import MbapReceiver, RtuReceiver, mbap_frame, rtu_frame

_READS = frozenset((1, 2, 3, 4, 7, 11, 12, 17, 20, 24, 43))  # function codes that change nothing


_LOOPBACK = bytes((8, 0, 0))  # diagnostics: the unit returns the data, which a client may count up


def _request(raw: bytes, unit: int, pdu: bytes, number: int | None = None) -> Request:
    broadcast = unit == 0
    if pdu.startswith(_LOOPBACK):
        return Request(raw, str(unit), f"unit {unit}: loopback", False, not broadcast, number)
    return Request(
        raw, str(unit), f"unit {unit}: {pdu.hex(' ')}", pdu[0] not in _READS, not broadcast, number
    )


class _RtuFrames:
    def __init__(self) -> None:
        self._receiver = RtuReceiver()

    def feed(self, data: bytes) -> list[Request]:
        return [_request(rtu_frame(unit, pdu), unit, pdu) for unit, pdu in self._receiver.feed(data)]


class _MbapFrames:
    def __init__(self) -> None:
        self._receiver = MbapReceiver()

    def feed(self, data: bytes) -> list[Request]:
        return [
            _request(mbap_frame(number, unit, pdu), unit, pdu, number)
            for number, unit, pdu in self._receiver.feed(data)
        ]


class ModbusRtu:
    """The dialect ``modbus-rtu``."""

    def splitter(self, known: Collection[bytes] | None) -> Splitter:
        """Return a splitter by length and CRC."""
        return _RtuFrames()

    def share(self, requests: Sequence[Request], chunks: Sequence[Chunk]) -> list[tuple[Chunk, ...]]:
        """A master waits for each reply."""
        return all_to_the_last(requests, chunks)

    def reworded(
        self, chunks: Sequence[Chunk], recorded: Request, asked: Request, numbers: Mapping[int, int]
    ) -> tuple[Chunk, ...]:
        """Return the reply as it is, but for the data of a loopback."""
        return edited(chunks, _echo_edits(joined(chunks), recorded, asked, start=0))


class ModbusTcp(ModbusRtu):
    """The dialect ``modbus-tcp``: the same with transaction numbers, which are the client's."""

    def splitter(self, known: Collection[bytes] | None) -> Splitter:
        """Return a splitter by the header's length."""
        return _MbapFrames()

    def reworded(
        self, chunks: Sequence[Chunk], recorded: Request, asked: Request, numbers: Mapping[int, int]
    ) -> tuple[Chunk, ...]:
        """Put the client's transaction number into every whole frame."""
        data = joined(chunks)
        edits: list[tuple[int, int, bytes]] = []
        at = 0
        while len(data) >= at + 8:
            number, protocol, length = struct.unpack_from(">HHH", data, at)
            if protocol or len(data) < at + 6 + length:
                break
            shift = (asked.number or 0) - (recorded.number or 0)
            edits.append((at, at + 2, struct.pack(">H", numbers.get(number, number + shift) & 0xFFFF)))
            at += 6 + length
        return edited(chunks, edits + _echo_edits(data, recorded, asked, start=7))


def _echo_edits(
    data: bytes, recorded: Request, asked: Request, *, start: int
) -> list[tuple[int, int, bytes]]:
    """Return the edit that makes a loopback return the client's data; no other requests differ in bytes."""
    was, now = recorded.raw[start:], asked.raw[start:]
    at = data.find(was)
    return [] if was == now or len(was) != len(now) or at < 0 else [(at, at + len(was), now)]


class _Writes:
    """What was written at once is a request; in a stream, the longest that the log knows."""

    def __init__(self, known: Collection[bytes] | None) -> None:
        self._known = known if known is None else sorted(known, key=len, reverse=True)
        self._unfinished = b""

    def feed(self, data: bytes) -> list[Request]:
        if self._known is None:
            return [self._request(data)]
        self._unfinished += data
        requests = []
        while self._unfinished:
            whole = next((known for known in self._known if self._unfinished.startswith(known)), None)
            if whole is None:
                if any(known.startswith(self._unfinished) for known in self._known):
                    break  # the rest may still come
                whole = self._unfinished
            requests.append(self._request(whole))
            self._unfinished = self._unfinished[len(whole) :]
        return requests

    @staticmethod
    def _request(data: bytes) -> Request:
        return Request(data, "", printable(data), changes=b"?" not in data)


class Raw(ModbusRtu):
    """The dialect of any other protocol: bytes are equal or not, and a question mark makes a query."""

    def splitter(self, known: Collection[bytes] | None) -> Splitter:
        """Return a splitter that knows the log's requests."""
        return _Writes(known)

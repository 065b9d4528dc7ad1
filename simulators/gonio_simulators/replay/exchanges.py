"""Which bytes followed which request, and after how long: the records of one line as exchanges."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from gonio.wirelog import GAVE_UP, LOST, THREW_AWAY, LineLog


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes that the host received together."""

    delay_s: float  # since its request, real seconds
    data: bytes
    late: bool = False  # the host had given up before


@dataclass(frozen=True, slots=True)
class Exchange:
    """What the host sent at once, and what came until it sent something else."""

    number: int  # of the request's line in the file
    time_s: float
    request: bytes  # empty: what came before anything was asked
    chunks: tuple[Chunk, ...] = ()
    gave_up: bool = False
    lost: bool = False  # the connection broke

    @property
    def reply_s(self) -> float:
        """Time to the last byte that came in time; NaN if none did."""
        return max((c.delay_s for c in self.chunks if not c.late), default=math.nan)


def exchanges_of(line: LineLog) -> list[Exchange]:
    """Return the exchanges of a line in their order.

    Bytes that arrived when nothing was asked belong to the request before them: that is when a client that
    repeats the requests sees them again.
    """
    exchanges: list[Exchange] = []
    number, time_s, request = line.records[0].number if line.records else 0, 0.0, b""
    chunks: list[Chunk] = []
    gave_up = lost = False
    before = ""

    def end() -> None:
        if request or chunks or lost:
            exchanges.append(Exchange(number, time_s, request, tuple(chunks), gave_up, lost))

    for record in line.records:
        if record.direction == ">":
            end()
            number, time_s, request = record.number, record.time_s, record.data
            chunks, gave_up, lost = [], False, False
        elif record.direction == "<":
            chunks.append(Chunk(max(0.0, record.time_s - time_s), record.data, gave_up))
        else:
            gave_up |= record.text.startswith(GAVE_UP)
            lost |= record.text.startswith(LOST)
            if record.text.startswith(THREW_AWAY) and before == "<" and len(chunks) > 1 and not gave_up:
                # Nobody had listened since the reply: found, not just arrived.
                chunks[-1] = Chunk(chunks[-2].delay_s, chunks[-1].data)
        before = record.direction
    end()
    return exchanges


def joined(chunks: Iterable[Chunk]) -> bytes:
    """Return all bytes."""
    return b"".join(chunk.data for chunk in chunks)


def shared_out(
    chunks: Iterable[Chunk], runs: Iterable[tuple[int, int]], count: int
) -> list[tuple[Chunk, ...]]:
    """Give all bytes to `count` requests; chunks stay together as far as they are one request's.

    Parameters
    ----------
    chunks
        What came.
    runs
        (request, number of bytes) in the order of the bytes; together as many as there are.
    count
        How many requests there are.
    """
    shares: list[list[Chunk]] = [[] for _ in range(count)]
    left = iter(runs)
    owner, run = 0, 0
    for chunk in chunks:
        at = 0
        while at < len(chunk.data):
            while run == 0:
                owner, run = next(left)
            taken = min(run, len(chunk.data) - at)
            data = chunk.data[at : at + taken]
            share = shares[owner]
            if share and share[-1].delay_s == chunk.delay_s and at and share[-1].late == chunk.late:
                data = share.pop().data + data
            share.append(Chunk(chunk.delay_s, data, chunk.late))
            at += taken
            run -= taken
    return [tuple(share) for share in shares]


def edited(chunks: Iterable[Chunk], edits: Iterable[tuple[int, int, bytes]]) -> tuple[Chunk, ...]:
    """Replace ``joined(chunks)[start:end]`` by other bytes, for each edit; the chunks stay divided as they
    were.
    """
    chunks = tuple(chunks)
    out = [bytes([byte]) for byte in joined(chunks)]
    if not out:
        return chunks
    for start, end, new in edits:
        if len(new) == end - start:
            out[start:end] = [bytes([byte]) for byte in new]
        elif start < end:
            out[start:end] = [new] + [b""] * (end - start - 1)
        else:
            out[start] = new + out[start]
    result = []
    begin = 0
    for chunk in chunks:
        data = b"".join(out[begin : begin + len(chunk.data)])
        begin += len(chunk.data)
        if data:
            result.append(Chunk(chunk.delay_s, data, chunk.late))
    return tuple(result)

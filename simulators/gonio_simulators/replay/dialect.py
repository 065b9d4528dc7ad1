"""When are two requests the same, which of them change something, and whose is a reply: one answer per
protocol.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from gonio_simulators.replay.exchanges import Chunk


@dataclass(frozen=True, slots=True)
class Request:
    """One request, told apart from how a client happened to write it."""

    raw: bytes
    unit: str  # whose it is, on a line that several devices share
    what: str  # equal for requests that ask the same
    changes: bool  # a command: it may change what later requests are answered
    answered: bool = True  # the device says something to it
    number: int | None = None  # that the reply repeats
    checked: bool = False  # carries a checksum that a client may leave out


class Splitter(Protocol):
    """Finds requests in a stream of bytes."""

    def feed(self, data: bytes) -> list[Request]:
        """Return the requests that these bytes complete."""
        ...


class Dialect(Protocol):
    """What a replay must know of a protocol."""

    def splitter(self, known: Collection[bytes] | None) -> Splitter:
        """Return a splitter for a new stream.

        Parameters
        ----------
        known
            The requests of the log, for protocols that show in no other way where a request ends; None while
            the log itself is read.
        """
        ...

    def share(self, requests: Sequence[Request], chunks: Sequence[Chunk]) -> list[tuple[Chunk, ...]]:
        """Say which bytes answered which of the requests that were sent together."""
        ...

    def reworded(
        self, chunks: Sequence[Chunk], recorded: Request, asked: Request, numbers: Mapping[int, int]
    ) -> tuple[Chunk, ...]:
        """Return the reply to `recorded` as it would have been to `asked`.

        Parameters
        ----------
        numbers
            The client's message numbers by those of the log, so that a late reply carries its own.
        """
        ...


def all_to_the_last(requests: Sequence[Request], chunks: Sequence[Chunk]) -> list[tuple[Chunk, ...]]:
    """Share for protocols in which nobody sends a request before the last is answered."""
    return [()] * (len(requests) - 1) + [tuple(chunks)]

"""The instruments that take statements in a replay: Cornerstone 260, SR830, and Elliptec modules."""

from __future__ import annotations

import re
import string
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache

from gonio_simulators.replay.dialect import Request, all_to_the_last
from gonio_simulators.replay.exchanges import Chunk, edited, joined, shared_out

_NUMBER = re.compile(r"(?<![\w.])[+-]?\d*\.?\d+(?:E[+-]?\d+)?(?![\w.])")


_ANSWER = re.compile(rb"[^\r]*\r\n?|[^\r]+")  # a line feed behind the CR is of the same answer


def _normal(text: str) -> str:
    """Return a statement with its spaces, case and numbers as everybody writes them."""
    words = " ".join(text.upper().split())
    return _NUMBER.sub(lambda match: f"{float(match[0]):.12g}", words)


class _Statements:
    """Splits at line ends, and lines at semicolons."""

    def __init__(self, ends: bytes, separator: bytes) -> None:
        self._ends = re.compile(b"([%b]+)" % ends)
        self._separator = separator
        self._unfinished = b""

    def feed(self, data: bytes) -> list[Request]:
        parts = self._ends.split(self._unfinished + data)
        self._unfinished = parts.pop()
        requests = []
        for line, end in zip(parts[::2], parts[1::2], strict=True):
            statements = line.split(self._separator) if self._separator else [line + end]
            requests += [_statement(raw) for raw in statements if raw.strip()]
        return requests


@lru_cache(maxsize=4096)  # a scan asks the same things again and again
def _statement(raw: bytes) -> Request:
    what = _normal(raw.decode("latin-1"))
    is_query = "?" in what
    return Request(raw, "", what, changes=not is_query, answered=is_query)


class Cornerstone:
    """The dialect ``cs260``: the echo of each statement shows whose the bytes behind it are."""

    def splitter(self, known: Collection[bytes] | None) -> _Statements:
        """Return a splitter at line feeds; the terminator belongs to the statement, as it is echoed."""
        return _Statements(b"\n", b"")

    def share(self, requests: Sequence[Request], chunks: Sequence[Chunk]) -> list[tuple[Chunk, ...]]:
        """Give each statement its echo and what came before the next one's."""
        runs: list[tuple[int, int]] = []
        current = 0
        for line in joined(chunks).splitlines(keepends=True):
            for later in range(current, len(requests)):
                if line.strip() == requests[later].raw.strip():
                    current = later
                    break
            runs.append((current, len(line)))
        return shared_out(chunks, runs, len(requests))

    def reworded(
        self, chunks: Sequence[Chunk], recorded: Request, asked: Request, numbers: Mapping[int, int]
    ) -> tuple[Chunk, ...]:
        """Echo what the client wrote."""
        if recorded.raw == asked.raw:
            return tuple(chunks)
        edits = [
            (match.start(), match.end(), asked.raw)
            for match in re.finditer(b"^" + re.escape(recorded.raw), joined(chunks), re.MULTILINE)
        ]
        return edited(chunks, edits)


class LockIn:
    """The dialect ``sr830``: each question of a line has one answer, which ends with CR."""

    def splitter(self, known: Collection[bytes] | None) -> _Statements:
        """Return a splitter at line ends and semicolons."""
        return _Statements(b"\r\n", b";")

    def share(self, requests: Sequence[Request], chunks: Sequence[Chunk]) -> list[tuple[Chunk, ...]]:
        """Give each question one answer in turn, the last one what is left."""
        questions = [index for index, request in enumerate(requests) if not request.changes]
        if not questions:
            return all_to_the_last(requests, chunks)
        answers = _ANSWER.findall(joined(chunks))
        last = len(questions) - 1
        runs = [(questions[min(turn, last)], len(answer)) for turn, answer in enumerate(answers)]
        return shared_out(chunks, runs, len(requests))

    def reworded(
        self, chunks: Sequence[Chunk], recorded: Request, asked: Request, numbers: Mapping[int, int]
    ) -> tuple[Chunk, ...]:
        """Return the answer as it is: it carries nothing of the question."""
        return tuple(chunks)


# Letters of a command by the number of characters behind them (ELLx modules protocol manual).
_ELLIPTEC_LENGTHS = {
    **dict.fromkeys(("ho", "ca", "om", "cm"), 1),
    **dict.fromkeys(("sv", "is", "ts"), 2),
    **dict.fromkeys(("f1", "b1", "f2", "b2", "f3", "b3"), 4),
    **dict.fromkeys(("ma", "mr", "sj", "so", "ah", "af"), 8),
}
_ELLIPTEC_QUERIES = frozenset(("in", "gs", "gp", "gj", "go", "gv", "i1", "i2", "i3"))


class _Commands:
    def __init__(self) -> None:
        self._text = ""

    def feed(self, data: bytes) -> list[Request]:
        self._text += data.decode("latin-1")
        requests = []
        while len(text := self._text.lstrip("\r\n \0")) >= 3:
            letters = text[1:3]
            length = 3 + _ELLIPTEC_LENGTHS.get(letters, 0)
            if text[0] not in string.hexdigits:  # noise: look for a command behind it
                length = 1
            if len(text) < length:
                break
            self._text = text[length:]
            unit, what = text[0].upper(), text[:length]
            changes = letters not in _ELLIPTEC_QUERIES
            if length > 1:
                requests.append(Request(what.encode("latin-1"), unit, unit + what[1:], changes))
        return requests


class Elliptec:
    """The dialect ``elliptec``: an address, two letters, and as many characters as the letters say."""

    def splitter(self, known: Collection[bytes] | None) -> _Commands:
        """Return a splitter by length."""
        return _Commands()

    def share(self, requests: Sequence[Request], chunks: Sequence[Chunk]) -> list[tuple[Chunk, ...]]:
        """Nobody talks before the bus is quiet."""
        return all_to_the_last(requests, chunks)

    def reworded(
        self, chunks: Sequence[Chunk], recorded: Request, asked: Request, numbers: Mapping[int, int]
    ) -> tuple[Chunk, ...]:
        """Return the reply as it is: it carries only the address."""
        return tuple(chunks)

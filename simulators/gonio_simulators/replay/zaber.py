"""Zaber's ASCII protocol in a replay: message numbers and checksums are the client's, the rest is the
log's.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

from gonio_simulators.replay.dialect import Request
from gonio_simulators.replay.exchanges import Chunk, edited, joined, shared_out
from gonio_simulators.wire.zaber_message import checksum, parse_request

# Address, axis, and the number, which stands there only if the request had one.
_REPLY = re.compile(
    rb"[@#](?P<head>(?P<address>\d\d) \d)(?P<number> \d\d)?(?P<rest> [^:\r\n]*)(?P<check>:..)?\r?\n"
)


class _Lines:
    def __init__(self) -> None:
        self._unfinished = b""

    def feed(self, data: bytes) -> list[Request]:
        *lines, self._unfinished = re.split(rb"[\r\n]", self._unfinished + data)
        return [_request(line) for line in lines if line.strip()]


def _request(line: bytes) -> Request:
    parsed = parse_request(line)
    if parsed is None:  # noise, or a wrong checksum: the device ignores it
        return Request(line, "", line.decode("latin-1"), changes=False, answered=False)
    text = " ".join(parsed.words)
    is_query = not text or parsed.words[0] == "get" or text == "warnings"
    return Request(
        line,
        unit=str(parsed.address),
        what=f"{parsed.address} {parsed.axis} {text}".strip(),
        changes=not is_query,
        number=int(parsed.message_id) if parsed.message_id else None,
        checked=parsed.has_checksum,
    )


class Zaber:
    """The dialect ``zaber``."""

    def splitter(self, known: Collection[bytes] | None) -> _Lines:
        """Return a splitter at line ends."""
        return _Lines()

    def share(self, requests: Sequence[Request], chunks: Sequence[Chunk]) -> list[tuple[Chunk, ...]]:
        """Give each reply to the request with its address and number."""
        data = joined(chunks)
        last = len(requests) - 1
        runs: list[tuple[int, int]] = []
        at = 0
        for match in _REPLY.finditer(data) if last else ():
            number = None if match["number"] is None else int(match["number"])
            for index, request in enumerate(requests):
                if number == request.number and int(match["address"]) == int(request.unit or 0):
                    runs += [(last, match.start() - at), (index, len(match[0]))]
                    at = match.end()
                    break
        return shared_out(chunks, [*runs, (last, len(data) - at)], len(requests))

    def reworded(
        self, chunks: Sequence[Chunk], recorded: Request, asked: Request, numbers: Mapping[int, int]
    ) -> tuple[Chunk, ...]:
        """Put the client's number and, if it sends them, checksums into every reply."""
        if recorded.raw == asked.raw:
            return tuple(chunks)
        data = joined(chunks)
        edits: list[tuple[int, int, bytes]] = []
        for match in _REPLY.finditer(data):
            number = match["number"] or b""
            if asked.number is None or recorded.number is None:
                new = b"" if asked.number is None else b" %02d" % asked.number
            elif number:  # a late reply has the number of its own request
                new = b" %02d" % numbers.get(
                    int(number), (int(number) - recorded.number + asked.number) % 100
                )
            else:
                new = b""
            if recorded.number is None and number:  # it is not a number, then
                continue
            at = match.end("head")
            edits.append((at, at + len(number), new))
            edits += _check(match, match["head"] + new + match["rest"], recorded, asked)
        return edited(chunks, edits)


def _check(
    match: re.Match[bytes], body: bytes, recorded: Request, asked: Request
) -> list[tuple[int, int, bytes]]:
    """Return the edit of the checksum: one that was wrong on the wire stays as wrong as it was."""
    end = match.end("rest")
    was = match["check"]
    right = checksum(body.decode("latin-1"))
    if was is not None:
        if asked.checked < recorded.checked:
            return [(end, end + 3, b"")]
        before = checksum((match["head"] + (match["number"] or b"") + match["rest"]).decode("latin-1"))
        try:
            error = int(was[1:], 16) - before
        except ValueError:  # damaged
            return []
        return [(end, end + 3, b":%02X" % ((right + error) & 0xFF))]
    if asked.checked > recorded.checked:
        return [(end, end, b":%02X" % right)]
    return []

"""What a line of Zaber's ASCII protocol (version 7) says, and how a reply is written.

    /ADDRESS AXIS ID command...[:CC]     from the host; trailing numbers of the head may be left out
    @AA X ID OK|RJ BUSY|IDLE FLAG data   reply
    !AA X BUSY|IDLE FLAG data            alert, sent unasked

The checksum CC is the two's complement of the byte sum between the lead character and the colon.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache


@dataclass(frozen=True, slots=True)
class Request:
    """One command line; `address` and `axis` are 0 for all."""

    address: int
    axis: int
    message_id: str  # two digits, or empty
    words: tuple[str, ...]
    has_checksum: bool


def checksum(text: str) -> int:
    """Return the byte that makes the sum of `text` and itself zero modulo 256."""
    return -sum(text.encode("ascii", "replace")) & 0xFF


@lru_cache(maxsize=1024)  # a poll is the same line again and again, with one of 100 message ids
def parse_request(line: bytes) -> Request | None:
    """Return the command in a received line (without its terminator), or None if a device would ignore it.

    Ignored are lines without ``/``, characters outside printable ASCII, and a checksum that does not match.
    """
    start = line.rfind(b"/")
    if start < 0 or not line.isascii():
        return None
    text = line[start + 1 :].decode("ascii")
    has_checksum = False
    colon = text.rfind(":")
    if colon >= 0 and len(text) == colon + 3:
        try:
            given = int(text[colon + 1 :], 16)
        except ValueError:
            return None
        text = text[:colon]
        if given != checksum(text):
            return None
        has_checksum = True
    words = text.split()
    head: list[str] = []
    for word in words[:3]:
        if not word.isdigit():
            break
        head.append(word)
    if any(len(word) > 2 for word in head):
        return None
    return Request(
        address=int(head[0]) if head else 0,
        axis=int(head[1]) if len(head) > 1 else 0,
        message_id=f"{int(head[2]):02d}" if len(head) > 2 else "",
        words=tuple(words[len(head) :]),
        has_checksum=has_checksum,
    )


def format_reply(
    address: int,
    axis: int,
    message_id: str,
    *,
    accepted: bool,
    busy: bool,
    flag: str,
    data: str,
    with_checksum: bool,
) -> bytes:
    """Return a reply line with its CRLF."""
    head = f"{address:02d} {axis} {message_id} " if message_id else f"{address:02d} {axis} "
    text = f"{head}{'OK' if accepted else 'RJ'} {'BUSY' if busy else 'IDLE'} {flag} {data}"
    return _line("@", text, with_checksum)


def format_alert(address: int, axis: int, *, busy: bool, flag: str, with_checksum: bool) -> bytes:
    """Return the alert line that announces the end of a movement."""
    return _line("!", f"{address:02d} {axis} {'BUSY' if busy else 'IDLE'} {flag}", with_checksum)


def _line(lead: str, text: str, with_checksum: bool) -> bytes:
    if with_checksum:
        text = f"{text}:{checksum(text):02X}"
    return f"{lead}{text}\r\n".encode("ascii")

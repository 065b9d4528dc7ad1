"""What a line of Zaber's ASCII protocol (version 7) says, and how a reply is written.

    /ADDRESS AXIS ID command...[:CC]     from the host; trailing numbers of the head may be left out
    @AA X ID OK|RJ BUSY|IDLE FLAG data   reply
    !AA X BUSY|IDLE FLAG data            alert, sent unasked

    #AA X [ID] data                     further information that belongs to a reply

The checksum CC is the two's complement of the byte sum between the lead character and the colon.  A command
with the ID ``--`` gets no reply.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

NO_REPLY = "--"
"""The message id of a command that wants no reply."""

_LONGEST_TEXT = 73
"""Characters of a reply beside its lead, checksum and line end, which make a packet of 80."""

BAD_ID = "bad"
"""Stands for a message id above 99."""


class Rejected(Exception):
    """The command is answered ``RJ`` with this reason."""


@dataclass(frozen=True, slots=True)
class Request:
    """One command line; `address` and `axis` are 0 for all."""

    address: int
    axis: int
    message_id: str  # two digits, empty, `NO_REPLY` or `BAD_ID`
    words: tuple[str, ...]
    has_checksum: bool
    packets: int = 1  # how many lines it came in


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
        if not word.isdigit() and not (len(head) == 2 and word == NO_REPLY):
            break
        head.append(word)
    if any(len(word) > 2 for word in head[:2]):
        return None  # no device has such an address
    return Request(
        address=int(head[0]) if head else 0,
        axis=int(head[1]) if len(head) > 1 else 0,
        message_id=_message_id(head[2]) if len(head) > 2 else "",
        words=tuple(words[len(head) :]),
        has_checksum=has_checksum,
    )


def _message_id(word: str) -> str:
    if word == NO_REPLY:
        return word
    return f"{int(word):02d}" if len(word.lstrip("0")) <= 2 else BAD_ID


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
    if len(text) <= _LONGEST_TEXT:
        return _line("@", text, with_checksum)
    packets = _packets(text, f"{head}cont ")
    return b"".join([_line("#" if i else "@", p, with_checksum) for i, p in enumerate(packets)])


def _packets(text: str, head: str) -> list[str]:
    """Cut a long reply between words; a packet ends with a backslash if another follows."""
    packets: list[str] = []
    packet = ""
    for word in text.split(" "):
        longer = f"{packet} {word}" if packet else word
        if len(longer) < _LONGEST_TEXT:
            packet = longer
        else:
            packets.append(packet + "\\")
            packet = head + word
    return [*packets, packet]


def format_alert(address: int, axis: int, *, busy: bool, flag: str, with_checksum: bool) -> bytes:
    """Return the alert line that announces the end of a movement."""
    return _line("!", f"{address:02d} {axis} {'BUSY' if busy else 'IDLE'} {flag}", with_checksum)


def format_info(address: int, axis: int, message_id: str, text: str, *, with_checksum: bool) -> bytes:
    """Return a line of information behind a reply."""
    head = f"{address:02d} {axis} {message_id} " if message_id else f"{address:02d} {axis} "
    return _line("#", head + text, with_checksum)


def _line(lead: str, text: str, with_checksum: bool) -> bytes:
    if with_checksum:
        text = f"{text}:{checksum(text):02X}"
    return f"{lead}{text}\r\n".encode("ascii")

r"""What is a wire log: the text in which drivers keep every byte, and how it is read back.

One record per line: real seconds, role, direction, then for ``>`` (sent) and ``<`` (received) the bytes in
hexadecimal and as printable text, and for ``=`` a note::

    0.000143 stage = wire-log 1: zaber at socket://127.0.0.1:4001, session of 2026-07-30T12:00:00.000+00:00
    0.000811 stage > 2f3120312030332067657420706f730a  /1 1 03 get pos\n
    0.001190 stage < 403031203120303320...  @01 1 03 OK IDLE -- 20000\r\n

The first note of a line says which protocol is spoken there.  Lines of one rig share the session; a file to
which several programs were pointed one after the other holds several.  See `docs/wire-log.md`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from gonio.errors import ConfigError

VERSION = 1

GAVE_UP = "gave up"
"""Begins the note that the host waits no longer; what comes behind it came too late."""

LOST = "connection lost"
"""Begins the note that the connection broke."""

THREW_AWAY = "threw away"
"""Begins the note that the bytes just received answer nothing; they may have come long before."""

BROKEN_OFF = "  ... broken off\n"
"""Ends a record that another program left unfinished, so that half of its bytes are not taken for all."""

Direction = Literal[">", "<", "="]

_OPENING = re.compile(
    r"wire-log (?P<version>\d{1,9}): (?P<protocol>[^\s,]+)(?: at (?P<address>\S+?))?"
    r"(?:, session of (?P<session>[^\s,]+))?(?:, instrument clock x(?P<speed>\S+))?$"
)
_PRINTED = re.compile(r"(?:[^\\]|\\(?:[nrt\\]|x[0-9a-fA-F]{2}))*")
_BACK_S = 0.01  # two threads may write their records in the other order than they took their times


@dataclass(frozen=True, slots=True)
class Opening:
    """The note with which a line begins."""

    protocol: str
    address: str = ""
    session: str = ""  # ISO 8601; lines that were opened by one program share it
    clock_speed: float = 1.0  # instrument seconds per real second

    def text(self) -> str:
        """Return the note."""
        where = f" at {self.address}" if self.address else ""
        session = f", session of {self.session}" if self.session else ""
        return f"wire-log {VERSION}: {self.protocol}{where}{session}, instrument clock x{self.clock_speed:g}"


@dataclass(frozen=True, slots=True)
class Record:
    """One line of the file."""

    number: int  # of the line, from 1
    time_s: float  # real seconds
    role: str
    direction: Direction
    data: bytes = b""  # of > and <
    text: str = ""  # of =


@dataclass(slots=True)
class LineLog:
    """What went over one line of the bench in one session."""

    role: str
    opening: Opening
    records: list[Record] = field(default_factory=list)

    @property
    def protocol(self) -> str:
        """What is spoken on the line."""
        return self.opening.protocol


@dataclass(slots=True)
class Session:
    """One program's use of the bench: its lines by role, in the order in which they were opened."""

    start: str
    lines: dict[str, LineLog] = field(default_factory=dict)


@dataclass(slots=True)
class WireLogFile:
    """A log that was read: its sessions in file order, and what was left out."""

    path: Path
    sessions: list[Session]
    warnings: list[str]


class _Malformed(Exception):
    """A line is not a record; the text says why and what to do."""


def printable(data: bytes) -> str:
    r"""Return bytes as ASCII text with Python's escapes; `from_printable` is the inverse."""
    return data.decode("latin-1").encode("unicode_escape").decode("ascii")


def from_printable(text: str) -> bytes:
    """Return the bytes of a printable text; `ValueError` if it is not ASCII or an escape is wrong."""
    if _PRINTED.fullmatch(text) is None:  # Python itself takes unknown escapes, with a warning
        raise ValueError("an escape is wrong")
    return text.encode("ascii").decode("unicode_escape").encode("latin-1")


def format_bytes(time_s: float, role: str, direction: Direction, data: bytes) -> str:
    """Return the line for bytes that were sent (``>``) or received (``<``)."""
    return f"{time_s:.6f} {role} {direction} {data.hex()}  {printable(data)}\n"


def format_note(time_s: float, role: str, text: str) -> str:
    """Return the line for something that is not bytes."""
    return f"{time_s:.6f} {role} = {' '.join(text.split())}\n"


def read_log(path: Path) -> WireLogFile:
    """Read a wire log.

    A record that a kill or a power cut left unfinished, at the end of the file or of one of its sessions, is
    left out with a warning.  Empty lines and lines that begin with ``#`` are for people.

    Raises
    ------
    ConfigError
        The file cannot be read, is not a wire log, or was damaged; with the number of the line.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"wire log {path}: cannot be read ({error.strerror}); check the file name"
        ) from None
    log = WireLogFile(path, [], [])
    now: dict[str, LineLog] = {}  # where the next record of a role belongs
    torn: tuple[int, str] | None = None
    for number, text, is_whole in _lines(content, path):
        try:
            record = _parse(number, text, is_whole=is_whole)
            opening = _opening(record)
        except _Malformed as why:
            if torn is None:
                torn = (number, str(why))
                continue
            raise _wrong(path, *torn) from None
        if torn is not None:
            if opening is None:
                raise _wrong(path, *torn)
            log.warnings.append(_torn(path, torn[0]))
            torn = None
        try:
            if opening is not None:
                now[record.role] = _begin(log, record.role, opening)
            _append(now, record)
        except _Malformed as why:
            raise _wrong(path, number, str(why)) from None
    if torn is not None:
        if not log.sessions:  # not a log whose end is missing, but no log
            raise _wrong(path, *torn)
        log.warnings.append(_torn(path, torn[0]))
    if not log.sessions:
        raise ConfigError(f"wire log {path}: holds no record; record one with --wire-log FILE")
    return log


def _lines(content: bytes, path: Path) -> Iterator[tuple[int, str, bool]]:
    """Yield number, text and whether a line end was written, of each line that is not for people alone."""
    lines = content.removeprefix(b"\xef\xbb\xbf").split(b"\n")
    for number, raw in enumerate(lines, 1):
        try:
            text = raw.rstrip(b"\r").decode("utf-8")
        except UnicodeDecodeError:
            raise _wrong(path, number, "is not text; give a file that was written with --wire-log") from None
        if text.strip() and not text.lstrip().startswith("#"):
            yield number, text, number < len(lines)


def _parse(number: int, text: str, *, is_whole: bool) -> Record:
    words = text.strip().split(" ", 3)
    if len(words) < 3 or words[2] not in (">", "<", "="):
        raise _Malformed("is not a record; write SECONDS ROLE > HEX  TEXT, with < or = in place of >")
    try:
        time_s = float(words[0])
    except ValueError:
        time_s = math.nan
    if not 0.0 <= time_s < math.inf:
        raise _Malformed(f"'{words[0]}' is not a time in seconds, zero or above")
    rest = words[3] if len(words) > 3 else ""
    if words[2] == "=":
        return Record(number, time_s, words[1], "=", text=rest)
    direction: Direction = ">" if words[2] == ">" else "<"
    return Record(number, time_s, words[1], direction, data=_data(rest, is_whole=is_whole))


def _data(text: str, *, is_whole: bool) -> bytes:
    """Return the bytes of a record; hexadecimal and text must agree, ``-`` in place of the first trusts the
    second.
    """
    digits, separator, shown = text.partition("  ")
    try:
        from_text = from_printable(shown)
    except ValueError:
        raise _Malformed(f"the text '{shown}' is not ASCII; write \\n, \\r or \\xNN for others") from None
    if digits.strip() == "-":
        if not shown:
            raise _Malformed("'-' needs the text behind it, after two spaces")
        return from_text
    try:
        data = bytes.fromhex(digits)
    except ValueError:
        raise _Malformed(f"'{digits}' are not hexadecimal bytes") from None
    if not data:
        raise _Malformed("holds no bytes; delete the line, or write them in hexadecimal")
    # an editor may have taken the spaces at the end of the text away, or the text may never have been written
    if (shown or not is_whole) and printable(data).rstrip() != printable(from_text).rstrip():
        raise _Malformed(
            f"the hexadecimal bytes say '{printable(data)}' and the text '{shown}'; correct one, or delete "
            "the text, or write - for the hexadecimal"
        )
    if separator == "" and not is_whole:
        raise _Malformed("breaks off")
    return data


def _opening(record: Record) -> Opening | None:
    if record.direction != "=" or not record.text.startswith("wire-log "):
        return None
    match = _OPENING.match(record.text)
    if match is None:
        raise _Malformed(f"'{record.text}' should be like 'wire-log {VERSION}: zaber at socket://HOST:PORT'")
    if int(match["version"]) != VERSION:
        raise _Malformed(
            f"the log has format {match['version']}, this gonio reads format {VERSION}; use the gonio that "
            "wrote it"
        )
    try:
        speed = float(match["speed"] or 1.0)
    except ValueError:
        raise _Malformed(f"instrument clock x{match['speed']} is not a number") from None
    return Opening(match["protocol"], match["address"] or "", match["session"] or "", speed)


def _begin(log: WireLogFile, role: str, opening: Opening) -> LineLog:
    """Return where the records behind an opening go: a line opened again in its session goes on."""
    for session in log.sessions:
        if opening.session and session.start == opening.session:
            break
    else:
        last = log.sessions[-1] if log.sessions else None
        if last is None or opening.session or last.start or role in last.lines:
            session = Session(opening.session)
            log.sessions.append(session)
        else:  # written by hand, without a session
            session = last
    line = session.lines.setdefault(role, LineLog(role, opening))
    if line.protocol != opening.protocol:
        raise _Malformed(
            f"{role} speaks {opening.protocol} here and {line.protocol} before, in the same session; correct "
            "one"
        )
    return line


def _append(now: dict[str, LineLog], record: Record) -> None:
    line = now.get(record.role)
    if line is None:
        raise _Malformed(
            f"nothing says yet what {record.role} speaks; put '0 {record.role} = wire-log {VERSION}: "
            "PROTOCOL' before it"
        )
    if line.records and record.time_s < line.records[-1].time_s - _BACK_S:
        raise _Malformed(
            f"the time of {record.role} goes back from {line.records[-1].time_s:g} to {record.time_s:g} s; "
            "correct it, or begin a session with a 'wire-log' note"
        )
    line.records.append(record)


def _wrong(path: Path, number: int, why: str) -> ConfigError:
    return ConfigError(f"wire log {path}, line {number}: {why}")


def _torn(path: Path, number: int) -> str:
    return (
        f"wire log {path}, line {number}: left out, as it breaks off (its program was killed, or wrote still)"
    )

"""What is in a log, for a person with the device's manual: each record in columns, and figures per line."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from gonio.wirelog import LineLog, Record, Session, printable
from gonio_simulators.replay.dialect import Request
from gonio_simulators.replay.exchanges import Exchange, exchanges_of
from gonio_simulators.replay.tape import dialect_of

_WIDEST_TEXT = 48  # a longer one pushes its hexadecimal bytes to the right
_BINARY = ("modbus-rtu", "modbus-tcp")


@dataclass(frozen=True, slots=True)
class LineFigures:
    """Figures of one line; times in real seconds, NaN without a reply."""

    requests: int
    replies: int
    mean_s: float
    longest_s: float
    timeouts: int  # requests that the device should have answered and did not, in time
    unasked: int  # bytes that came before any request, or after the host had given up
    commands: int


def figures(line: LineLog) -> LineFigures:
    """Return the figures of one line of a log."""
    dialect = dialect_of(line)
    splitter = dialect.splitter(None)
    exchanges = exchanges_of(line)
    asked: list[tuple[Exchange, list[Request]]] = [
        (e, splitter.feed(e.request)) for e in exchanges if e.request
    ]
    times_s = [e.reply_s for e, _ in asked if not math.isnan(e.reply_s) and not e.gave_up]
    silent = [e for e, requests in asked if not e.chunks and any(r.answered for r in requests)]
    return LineFigures(
        requests=len(asked),
        replies=len(times_s),
        mean_s=sum(times_s) / len(times_s) if times_s else math.nan,
        longest_s=max(times_s, default=math.nan),
        timeouts=len(silent) + sum(e.gave_up and bool(e.chunks) for e, _ in asked),
        unasked=sum(len(c.data) for e in exchanges for c in e.chunks if c.late or not e.request),
        commands=sum(request.changes for _, requests in asked for request in requests),
    )


def listing(lines: Sequence[LineLog]) -> Iterator[str]:
    """Yield the records of some lines in file order: time, reply time, role, direction, text, bytes."""
    records = sorted((record for line in lines for record in line.records), key=lambda record: record.number)
    protocols = {line.role: line.protocol for line in lines}
    width = max((len(line.role) for line in lines), default=0)
    texts = [_text(record, protocols[record.role]) for record in records]
    shown = [len(text) for text, record in zip(texts, records, strict=True) if record.direction != "="]
    column = min(max(shown, default=0), _WIDEST_TEXT)
    sent_s: dict[str, float] = {}
    for record, text in zip(records, texts, strict=True):
        after = ""
        if record.direction == ">":
            sent_s[record.role] = record.time_s
        elif record.direction == "<" and record.role in sent_s:
            after = f"+{(record.time_s - sent_s[record.role]) * 1e3:.3f}"
        head = f"{record.time_s:12.6f} {after:>10} {record.role:<{width}} {record.direction} "
        if record.direction == "=" or record.data.hex(" ") == text:
            yield head + text
        else:
            yield f"{head}{text:<{column}}  {record.data.hex(' ')}"


def _text(record: Record, protocol: str) -> str:
    if record.direction == "=":
        return record.text
    return record.data.hex(" ") if protocol in _BINARY else printable(record.data)


def table(session: Session, roles: Iterable[str]) -> Iterator[str]:
    """Yield the figures of some lines of a session as a table."""
    yield (
        f"{'role':<14}{'protocol':<12}{'requests':>9}{'commands':>9}{'replies':>9}{'mean ms':>10}"
        f"{'longest ms':>12}{'timeouts':>9}{'unasked B':>10}  address"
    )
    for role in roles:
        line = session.lines[role]
        f = figures(line)
        yield (
            f"{role:<14}{line.protocol:<12}{f.requests:>9}{f.commands:>9}{f.replies:>9}{_ms(f.mean_s):>10}"
            f"{_ms(f.longest_s):>12}{f.timeouts:>9}{f.unasked:>10}  {line.opening.address or '-'}"
        )


def _ms(seconds: float) -> str:
    return "-" if math.isnan(seconds) else f"{seconds * 1e3:.3f}"

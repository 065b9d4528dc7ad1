"""What does the log's device answer next: a cursor per device of each line, and one time for all of them.

A client polls more or less often than the recorded one.  So a query is looked for forwards, past other
queries but never past a command, since a command is what changes the answers; if there is none, the last
answer to it holds still.  A command must be the next one of the log.  A command that is met moves the other
cursors on past what was asked before it in the recording: time does not go back, on no line.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gonio.errors import ConfigError
from gonio.wirelog import LineLog
from gonio_simulators.replay.dialect import Dialect, Request
from gonio_simulators.replay.exchanges import Chunk, Exchange, exchanges_of
from gonio_simulators.replay.modbus import ModbusRtu, ModbusTcp, Raw
from gonio_simulators.replay.statements import Cornerstone, Elliptec, LockIn
from gonio_simulators.replay.zaber import Zaber

DIALECTS: dict[str, Dialect] = {
    "zaber": Zaber(),
    "modbus-rtu": ModbusRtu(),
    "modbus-tcp": ModbusTcp(),
    "elliptec": Elliptec(),
    "cs260": Cornerstone(),
    "sr830": LockIn(),
    "raw": Raw(),
}


@dataclass(frozen=True, slots=True)
class Entry:
    """One request of the log and what followed it."""

    number: int  # of its line in the file
    request: Request
    chunks: tuple[Chunk, ...]
    answers: bool  # the reply is good to be given again: it came, and in time
    lost: bool  # the connection broke


def entries_of(line: LineLog) -> tuple[tuple[Chunk, ...], list[Entry]]:
    """Return what the device said unasked at the beginning, and the requests of the log in their order."""
    dialect = dialect_of(line)
    splitter = dialect.splitter(None)
    greeting: tuple[Chunk, ...] = ()
    entries: list[Entry] = []
    for exchange in exchanges_of(line):
        requests = splitter.feed(exchange.request) if exchange.request else []
        if requests:
            entries += _entries(exchange, requests, dialect)
        elif entries:  # bytes that are no request: what came behind them goes with the request before
            last = entries[-1]
            chunks = last.chunks + exchange.chunks
            entries[-1] = Entry(last.number, last.request, chunks, last.answers, last.lost or exchange.lost)
        else:
            greeting += exchange.chunks
    return greeting, entries


def dialect_of(line: LineLog) -> Dialect:
    """Return what to know of a line's protocol; `ConfigError` if that is nothing."""
    dialect = DIALECTS.get(line.protocol)
    if dialect is None:
        raise ConfigError(
            f"{line.role} speaks {line.protocol}, which cannot be replayed; known are {', '.join(DIALECTS)}; "
            "write 'raw' in the log's 'wire-log' note to compare bytes alone"
        )
    return dialect


def _entries(exchange: Exchange, requests: Sequence[Request], dialect: Dialect) -> Iterable[Entry]:
    shares = dialect.share(requests, exchange.chunks)
    for index, (request, chunks) in enumerate(zip(requests, shares, strict=True)):
        in_time = bool(chunks) and not chunks[0].late and not exchange.gave_up
        lost = exchange.lost and index == len(requests) - 1
        yield Entry(exchange.number, request, chunks, in_time, lost)


class Unexpected(Exception):
    """A request that the log does not have next; the text says what it has."""


class _Strand:
    """The requests to one device of a line, and how far they have been asked."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self.at = 0
        self._places: dict[str, list[int]] = {}
        self._commands: list[int] = []
        self._beside: dict[str, int] = {}  # skipped questions that were asked together with the last one

    def add(self, entry: Entry) -> None:
        index = len(self.entries)
        self.entries.append(entry)
        self._places.setdefault(entry.request.what, []).append(index)
        if entry.request.changes:
            self._commands.append(index)

    def next_command(self) -> int:
        """Index of the next command, or the end."""
        place = bisect_left(self._commands, self.at)
        return self._commands[place] if place < len(self._commands) else len(self.entries)

    def catch_up(self, number: int) -> None:
        """Go past the queries that were made before a line of the file."""
        end = self.next_command()
        while self.at < end and self.entries[self.at].number < number:
            self.at += 1
            self._beside.clear()

    def meet(self, index: int) -> Entry:
        """Go on behind an entry and return it."""
        entry = self.entries[index]
        if index >= self.at:
            if index == 0 or self.at == 0 or self.entries[self.at - 1].number != entry.number:
                self._beside.clear()
            for skipped in range(index - 1, self.at - 1, -1):
                if self.entries[skipped].number != entry.number:
                    break
                self._beside[self.entries[skipped].request.what] = skipped
            self.at = index + 1
        else:
            del self._beside[entry.request.what]
        return entry

    def beside(self, what: str) -> int | None:
        """Index of such a question that was skipped in the exchange in which the cursor stands.

        Questions on one line are asked at one instant, whatever their order.
        """
        return self._beside.get(what)

    def ahead(self, what: str) -> int | None:
        """Index of the next such request, however far."""
        places = self._places.get(what, [])
        place = bisect_left(places, self.at)
        return places[place] if place < len(places) else None

    def behind(self, what: str) -> Entry | None:
        """The last such request before the cursor, the last answered one if there is any."""
        places = self._places.get(what, [])
        last = bisect_left(places, self.at) - 1
        past = (self.entries[places[place]] for place in range(last, -1, -1))
        return next(
            (entry for entry in past if entry.answers), self.entries[places[last]] if last >= 0 else None
        )

    def commands_left(self) -> int:
        return len(self._commands) - bisect_left(self._commands, self.at)


@dataclass(slots=True)
class Counts:
    """What a client did with one line."""

    asked: int = 0
    repeated: int = 0  # answered as the time before
    unexpected: int = 0


class Tape:
    """The time that all lines of a replay share: the line of the file where the latest command stands."""

    def __init__(self) -> None:
        self.number = 0


class LineTape:
    """One line of the bench as recorded.

    Parameters
    ----------
    line
        What the log has of it.
    tape
        Shared with the other lines.
    """

    def __init__(self, line: LineLog, tape: Tape) -> None:
        self.role = line.role
        self.protocol = line.protocol
        self.dialect = dialect_of(line)
        self.counts = Counts()
        self.greeting, entries = entries_of(line)
        self.known = frozenset(entry.request.raw for entry in entries)
        self._tape = tape
        self._strands: dict[str, _Strand] = {}
        self._numbers: dict[int, int] = {}  # the client's by the log's
        for entry in entries:
            self._strands.setdefault(entry.request.unit, _Strand()).add(entry)

    def answer(self, asked: Request) -> Entry:
        """Return what the log's device answered, worded for this request.

        Raises
        ------
        Unexpected
            The log does not tell.
        """
        self.counts.asked += 1
        strand = self._strands.get(asked.unit) or _Strand()
        strand.catch_up(self._tape.number)
        try:
            entry = self._met(strand, asked)
        except Unexpected:
            self.counts.unexpected += 1
            raise
        recorded = entry.request
        if recorded.number is not None and asked.number is not None:
            self._numbers[recorded.number] = asked.number
        chunks = self.dialect.reworded(entry.chunks, recorded, asked, self._numbers)
        return Entry(entry.number, asked, chunks, entry.answers, entry.lost)

    def _met(self, strand: _Strand, asked: Request) -> Entry:
        barrier = strand.next_command()
        found = strand.beside(asked.what)
        if found is None:
            found = strand.ahead(asked.what)
        if found is not None and found <= barrier:
            entry = strand.meet(found)
            if entry.request.changes:
                self._tape.number = max(self._tape.number, entry.number)
            return entry
        before = None if asked.changes else strand.behind(asked.what)
        if before is not None:
            self.counts.repeated += 1
            return before if before.answers else Entry(before.number, before.request, (), False, False)
        raise Unexpected(self._unexpected(strand, asked, barrier, found))

    def _unexpected(self, strand: _Strand, asked: Request, barrier: int, found: int | None) -> str:
        kind = "command" if asked.changes else "query"
        where = "is not in the log"
        if found is not None:
            where = f"comes later in the log (line {strand.entries[found].number})"
        text = f"{self.role}: the {kind} '{asked.what}' {where}"
        if not strand.entries:
            return f"{text}; the log has nothing for this device"
        if barrier < len(strand.entries):
            expected = strand.entries[barrier]
            return f"{text}; the next command there is '{expected.request.what}' (line {expected.number})"
        return f"{text}; no command is left there"

    def commands_left(self) -> int:
        """Return how many commands of the log have not been given."""
        return sum(strand.commands_left() for strand in self._strands.values())

    def next_left(self) -> Entry | None:
        """Return the first command that has not been given."""
        left = (s.entries[s.next_command()] for s in self._strands.values() if s.commands_left())
        return min(left, key=lambda entry: entry.number, default=None)

"""When do the recorded bytes go out: the talk of one client with a line of a replay."""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable

from gonio_simulators.replay.tape import Entry, LineTape, Unexpected

_AT_ONCE_S = 1e-4  # less than a timer is worth


class ReplayedLine:
    """A line of the log as an `Instrument`; how far it has been asked outlives its clients.

    Parameters
    ----------
    tape
        What was recorded.
    speed
        Recorded seconds per real second.
    on_unexpected
        Called with the reason when the log does not answer a request.
    """

    def __init__(self, tape: LineTape, *, speed: float, on_unexpected: Callable[[str], None]) -> None:
        self.tape = tape
        self.speed = speed
        self.on_unexpected = on_unexpected
        self.hang_up: Callable[[], None] | None = None
        self.greeted = False

    def open(self) -> ReplayConversation:
        """Begin a conversation with a new client."""
        return ReplayConversation(self)


class ReplayConversation:
    """Answers requests, each chunk of a reply as long after its request as it was recorded."""

    def __init__(self, line: ReplayedLine) -> None:
        self._line = line
        self._splitter = line.tape.dialect.splitter(line.tape.known)
        self._due: list[tuple[float, int, bytes | None]] = []  # None: the connection breaks
        self._order = itertools.count()
        self._answered_until_s = 0.0
        self.wait_s: float | None = None
        if not line.greeted:
            line.greeted = True
            now_s = time.monotonic()
            for chunk in line.tape.greeting:
                self._put(now_s + chunk.delay_s / line.speed, chunk.data)
        self._appoint()

    def feed(self, data: bytes) -> bytes:
        """Take received bytes and return what is due at once."""
        for request in self._splitter.feed(data):
            try:
                self._schedule(self._line.tape.answer(request))
            except Unexpected as why:
                self._line.on_unexpected(str(why))
        return self._take()

    def poll(self) -> bytes:
        """Return the chunk that is due."""
        return self._take()

    def _schedule(self, entry: Entry) -> None:
        """Put a reply behind the one before it; what came too late in the recording is not hurried."""
        now_s = time.monotonic()
        for chunk in entry.chunks:
            if chunk.late:
                self._put(now_s + chunk.delay_s, chunk.data)
            else:
                self._answered_until_s = max(self._answered_until_s, now_s + chunk.delay_s / self._line.speed)
                self._put(self._answered_until_s, chunk.data)
        if entry.lost:
            self._put(max([now_s, *(due_s for due_s, _, _ in self._due)]), None)

    def _put(self, due_s: float, data: bytes | None) -> None:
        heapq.heappush(self._due, (due_s, next(self._order), data))

    def _take(self) -> bytes:
        data = b""
        if self._due and self._due[0][0] <= time.monotonic() + _AT_ONCE_S:
            _, _, chunk = heapq.heappop(self._due)
            if chunk is not None:
                data = chunk
            elif self._line.hang_up is not None:
                self._line.hang_up()
        self._appoint()
        return data

    def _appoint(self) -> None:
        self.wait_s = max(0.0, self._due[0][0] - time.monotonic()) if self._due else None

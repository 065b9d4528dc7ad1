"""How is one request matched with its own reply: deadlines, framing, and what is done when a reply fails to
come.

A late reply must never be taken for the answer to the next request.  After any timeout, damaged reply or
bytes that nobody asked for, a line is *in doubt*: before the next request it is read until it is quiet, and
the protocol then proves by a request whose answer cannot be mistaken that both ends are in step again
(`Line.transaction`).

A *lost* connection stays lost until `Line.renew`: the device behind it may have been switched off meanwhile,
so nothing goes on by itself before its driver has read its state again (`gonio.devices.Recoverable`).
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeVar

from gonio.errors import ConnectionFailed, DeviceError, ReplyError
from gonio.rig import Context
from gonio.wirelog import GAVE_UP, LOST, THREW_AWAY
from gonio_drivers.transport import Opener, Parity, Port
from gonio_drivers.wirelog import WireLog

REPLY_TIMEOUT_S = 2.0
"""Real seconds a device may take for the whole of a reply, if its protocol says nothing else."""

QUIET_S = (
    0.1  # longer than the gap between characters of one reply at 9600 baud, with a USB adapter's latency
)
_DRAIN_LIMIT_S = 3.0
_LONGEST_REPLY = 4096  # bytes; more without a terminator is noise
_LINE = re.compile(rb"[\r\n]*([^\r\n]+)[\r\n]")

Answer = TypeVar("Answer")


class NoReply(ReplyError):
    """The deadline passed before the whole reply was there."""


@dataclass(slots=True)
class ReplyStatistics:
    """Counts and reply times of one line, real seconds."""

    replies: int = 0
    total_s: float = 0.0
    longest_s: float = 0.0
    timeouts: int = 0
    damaged: int = 0
    stale_bytes: int = 0  # arrived when nothing was asked, or belonged to another request; thrown away
    retries: int = 0
    reconnects: int = 0

    @property
    def mean_s(self) -> float:
        """Mean reply time; NaN before the first reply."""
        return self.total_s / self.replies if self.replies else float("nan")


@dataclass
class Line:
    """A port with its lock, its buffer, its log and its statistics.

    Methods other than `transaction` and `close` are for the thread that is inside `transaction`.
    """

    port: Port
    role: str
    address: str
    log: WireLog | None = None
    reply_timeout_s: float = REPLY_TIMEOUT_S
    statistics: ReplyStatistics = field(default_factory=ReplyStatistics)
    reopen: Callable[[], Port] | None = None  # how `renew` gets a new port; without it there is only this one

    def __post_init__(self) -> None:
        self._lock = threading.RLock()
        self._buffer = bytearray()
        self._in_doubt = False
        self._lost_by: str | None = None  # what ended the connection
        self._users = 1
        self._closed = False
        self._sent_s = 0.0

    @property
    def device(self) -> str:
        """Name of the device for messages."""
        return f"{self.role} at {self.address}"

    @contextmanager
    def transaction(self, prove: Callable[[], None] | None = None) -> Iterator[None]:
        """Hold the line for one request and its reply; one thread at a time.

        Parameters
        ----------
        prove
            Makes a request whose answer cannot be mistaken for another's and raises `ReplyError` unless it
            gets it; called only if the line is in doubt, after it has been read until quiet.  Without it,
            being quiet is enough (protocols whose replies carry the request's number).

        Raises
        ------
        ReplyError
            The line did not become quiet, or `prove` failed; the line stays in doubt.
        ConnectionFailed
            The connection has been lost, and `renew` has not been called since.
        """
        with self._lock:
            if self._lost_by is not None:
                raise self._connection_lost()
            if not self._in_doubt:
                self._look_for_unasked(in_doubt=prove is not None)
            if self._in_doubt:
                self._drain_until_quiet()
                if prove is not None:
                    self._prove(prove)
                self._look_for_unasked(in_doubt=False)
                self._in_doubt = False
            try:
                yield
            except DeviceError:
                raise  # whoever made it knows whether the reply was complete
            except BaseException:  # Ctrl-C between request and reply: the reply is still to come
                self._in_doubt = True
                raise

    def send(self, data: bytes) -> None:
        """Send a request; what is left of earlier replies is thrown away."""
        self._buffer.clear()
        self._sent_s = time.monotonic()
        try:
            self.port.write(data)
        except (OSError, TypeError) as error:  # TypeError: pyserial on a port that another thread just closed
            raise self._lost(error) from None
        if self.log is not None:
            self.log.sent(data)

    def receive(self, timeout_s: float) -> bytes:
        """Return the bytes that arrive first within `timeout_s`; ``b""`` if none do."""
        try:
            data = self.port.read(timeout_s)
        except (OSError, TypeError, ValueError) as error:
            raise self._lost(error) from None
        if data and self.log is not None:
            self.log.received(data)
        return data

    def deadline_s(self, timeout_s: float | None = None) -> float:
        """Return the `time.monotonic` by which the whole reply to the request just sent must be there."""
        return self._sent_s + (self.reply_timeout_s if timeout_s is None else timeout_s)

    def read_until(self, terminator: bytes, deadline_s: float) -> bytes:
        """Return the next reply without its terminator, however many reads it takes.

        Raises
        ------
        NoReply
            The deadline passed; what came so far is in the message.
        ReplyError
            Noise: thousands of bytes without a terminator.
        """
        buffer = self._buffer
        searched = 0
        while True:
            end = buffer.find(terminator, searched)
            if end >= 0:
                reply = bytes(buffer[:end])
                del buffer[: end + len(terminator)]
                return reply
            searched = max(0, len(buffer) - len(terminator) + 1)
            self._receive_more(deadline_s)

    def read_line(self, deadline_s: float) -> bytes:
        """Return the next line that is not blank, ended by CR, LF or both; raises as `read_until`.

        Firmware and adapters differ in what ends a line, and the second of two characters may come later.
        """
        while (line := _LINE.match(self._buffer)) is None:
            self._receive_more(deadline_s)
        text = bytes(line[1])
        del self._buffer[: line.end()]
        return text

    def _receive_more(self, deadline_s: float) -> None:
        if len(self._buffer) > _LONGEST_REPLY:
            raise self.damaged(bytes(self._buffer[:40]), f"{len(self._buffer)} bytes without an end of line")
        left_s = deadline_s - time.monotonic()
        data = self.receive(left_s) if left_s > 0 else b""
        if not data:
            raise self.timed_out(deadline_s - self._sent_s, bytes(self._buffer))
        self._buffer += data

    def answered(self) -> None:
        """Count the reply to the last request as good."""
        elapsed_s = time.monotonic() - self._sent_s
        statistics = self.statistics
        statistics.replies += 1
        statistics.total_s += elapsed_s
        if elapsed_s > statistics.longest_s:
            statistics.longest_s = elapsed_s

    def timed_out(self, timeout_s: float, so_far: bytes = b"") -> NoReply:
        """Return the error for a reply that did not come; the line is in doubt from here."""
        self._in_doubt = True
        self.statistics.timeouts += 1
        if self.log is not None:
            self.log.note(f"{GAVE_UP}: no complete reply within {timeout_s:.3g} s")
        got = f" (only {so_far!r} came)" if so_far else ""
        return NoReply(
            self.device,
            f"gave no complete reply within {timeout_s:.3g} s{got}",
            "check its power, its cable and the address, then repeat",
        )

    def damaged(self, reply: bytes, why: str) -> ReplyError:
        """Return the error for a reply that answers nothing that was asked; the line is in doubt now."""
        self._in_doubt = True
        self.statistics.damaged += 1
        return ReplyError(
            self.device,
            f"replied {reply!r}: {why}",
            "check the cable and that no other program talks to it, then repeat",
        )

    def stale(self, reply: bytes) -> None:
        """Count a reply that belonged to another request and was thrown away."""
        self._discard(reply)

    def query(self, ask: Callable[[], Answer], *, attempts: int = 2) -> Answer:
        """Return `ask()`, repeated after a failed reply; only for requests that are harmless to repeat."""
        for attempt in range(1, attempts + 1):
            try:
                return ask()
            except ReplyError:
                if attempt == attempts:
                    raise
                self.statistics.retries += 1
        raise AssertionError("attempts must be positive")

    def renew(self) -> bool:
        """Open the port anew if the connection is lost or in doubt, in one attempt; say whether it was.

        The caller must then read the device's state again: it may have been switched off, or be another one.

        Raises
        ------
        ConnectionFailed
            It cannot be opened (yet), or the line has been closed for good.
        """
        with self._lock:
            if not self._users:
                raise ConnectionFailed(self.device, "the line has been closed", "open the rig again")
            if self._lost_by is None and not self._in_doubt:
                return False
            self._in_doubt = True
            if self.reopen is None:
                if self._lost_by is not None:
                    raise self._connection_lost()
                return True
            self._lost_by = self._lost_by or "it was closed to be opened anew"
            self.port.close()
            self.port = self.reopen()
            self._buffer.clear()
            self._lost_by = None
            self.statistics.reconnects += 1
            if self.log is not None:
                self.log.note("connection opened anew")
            return True

    def share(self) -> bool:
        """Count one user more, who closes the line as well; False if it has been closed."""
        with self._lock:
            self._users += not self._closed
            return not self._closed

    def close(self) -> None:
        """Release the port when its last user has; any number of times after that."""
        with self._lock:
            self._users = max(0, self._users - 1)
            if self._users or self._closed:
                return
            self._closed = True
            self.port.close()
            if self.log is not None:
                s = self.statistics
                self.log.note(
                    f"closed after {s.replies} replies, mean {s.mean_s * 1e3:.3f} ms, longest "
                    f"{s.longest_s * 1e3:.3f} ms, {s.timeouts} timeouts, {s.damaged} damaged, "
                    f"{s.stale_bytes} stale bytes, {s.retries} retries, {s.reconnects} reconnections"
                )
                self.log.close()

    def _look_for_unasked(self, *, in_doubt: bool) -> None:
        """Throw away what came since the last reply, and say so if more of it may be on its way.

        A reply that came twice, or an answer to nothing: the next bytes may again be those of another
        request, which only a number in the reply or a proof can tell.  Line ends are no bytes to doubt.
        """
        if unasked := bytes(self._buffer) + self.receive(0.0):
            self._buffer.clear()
            if unasked.strip(b"\r\n \0"):
                self._discard(unasked)
                self._in_doubt = in_doubt

    def _prove(self, prove: Callable[[], None]) -> None:
        """Prove that both ends are in step, once more if it was a late reply that spoiled the first proof."""
        try:
            prove()
        except NoReply:
            raise
        except ReplyError:
            self._drain_until_quiet()
            prove()

    def _drain_until_quiet(self) -> None:
        self._discard(bytes(self._buffer))
        self._buffer.clear()
        end_s = time.monotonic() + _DRAIN_LIMIT_S
        while data := self.receive(QUIET_S):
            self._discard(data)
            if time.monotonic() > end_s:
                raise ReplyError(
                    self.device,
                    f"keeps sending unasked for {_DRAIN_LIMIT_S:g} s",
                    "check the baud rate and what is connected there",
                )

    def _discard(self, data: bytes) -> None:
        if data:
            self.statistics.stale_bytes += len(data)
            if self.log is not None:
                self.log.note(f"{THREW_AWAY} {data!r}")

    def _lost(self, error: Exception) -> ConnectionFailed:
        self._in_doubt = True
        self._lost_by = str(error)
        if self.log is not None:
            self.log.note(f"{LOST} ({error})")
        return self._connection_lost()

    def _connection_lost(self) -> ConnectionFailed:
        return ConnectionFailed(
            self.device,
            f"the connection was lost ({self._lost_by})",
            "check cable and power, then repeat (a running scan tries by itself)",
        )


@contextmanager
def connecting(line: Line) -> Iterator[None]:
    """Close the line if making the first contact fails; silence or nonsense there is a `ConnectionFailed`."""
    try:
        yield
    except ReplyError as error:
        line.close()
        raise ConnectionFailed(
            error.device,
            error.fault,
            "check that the right device is at this address, switched on, and set to this baud rate",
        ) from None
    except BaseException:
        line.close()
        raise


def open_line(
    role: str,
    address: str,
    context: Context,
    *,
    protocol: str = "raw",
    baudrate: int = 9600,
    parity: Parity = "none",
    reply_timeout_s: float = REPLY_TIMEOUT_S,
) -> Line:
    """Open an address as a `Line`, logged if the context asks for it.

    Devices of one rig that give the same address share one line: one port, one lock.

    Raises
    ------
    ConnectionFailed
        The address cannot be opened, or a device of the rig that speaks otherwise is connected there.
    ConfigError
        The log cannot be written.
    """
    key = f"line {address}"
    shared: Line | None
    shared, speech = context.shared.get(key, (None, None))
    if shared is not None and shared.share():
        if speech != (protocol, baudrate):
            shared.close()
            raise ConnectionFailed(
                f"{role} at {address}",
                f"the {shared.role} is connected there already ({speech[0]} at {speech[1]} baud, not "
                f"{protocol} at {baudrate})",
                "correct the addresses in the rig file",
            )
        return shared
    log = None
    if context.wire_log is not None:
        log = WireLog(context.wire_log, role, address, context.clock, protocol=protocol)
    opener = Opener(role, address, baudrate, parity)
    try:
        port = opener()
    except BaseException as error:
        if log is not None:
            log.note(str(error))
            log.close()
        raise
    timeout_s = context.reply_timeout_s or reply_timeout_s
    line = Line(port, role, address, log, timeout_s, reopen=opener)
    context.shared[key] = line, (protocol, baudrate)
    return line

"""What did a Cornerstone say to a statement: with an echo or without, ended by CR or LF, with a handshake?

Over RS-232 the instrument echoes what it receives; the echo of a question is what tells its answer from
another. The B model can be told not to echo, and never does over USB; adapters may end lines otherwise or
remove the echo.  Which it is shows itself in the first exchange.  Without echo a failed reply is followed by
the identity, which no other answer looks like.  Reference: Newport, Cornerstone 260 and 260B manuals,
appendix on commands and queries.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable

from gonio.errors import DeviceError
from gonio_drivers.lines import Line, NoReply

_STATUS_BYTE = re.compile(rb"[0-9A-Fa-f]{1,3}")  # 0, 00, 20; also what ERROR? answers
_UNITS = {b"NM", b"UM", b"WN"}
_IDENTITY = re.compile(rb"(?=.*[A-Za-z])[\x20-\x7e]{3,}")

GREETING = ("HANDSHAKE 0", "UNITS NM", "UNITS?", "ERROR?", "INFO?")
"""Sent together to an instrument of unknown state: what it does not know it leaves out, without a wait."""


class CS260Line:
    """Statements and answers of one monochromator."""

    def __init__(self, line: Line) -> None:
        self.line = line
        self.echoes = True
        self._identity: str | None = None

    def greet(self) -> str:
        """Bring the instrument to nanometres and out of handshake mode, and return its identity.

        Another program may have left it otherwise, and every wavelength would be a wrong one.

        Raises
        ------
        ReplyError
            It does not answer.
        DeviceError
            It stays in another unit.
        """
        return self.line.query(self._greet)

    def _greet(self) -> str:
        self._identity = unit = None
        try:
            with self.line.transaction():
                identity, unit = self._greeted(GREETING)
        except NoReply:  # statements behind one another may be too many for it
            with self.line.transaction():
                identity, _ = self._greeted(("INFO?",))
            self._identity = identity
            for statement in GREETING[:2]:
                self.exchange(statement)
            with contextlib.suppress(NoReply):
                unit = self.query("UNITS?").upper().encode("ascii", "replace")
        if not self.echoes:
            with self.line.transaction():
                again = self._ask("INFO?")
            if again != identity:  # noise that looked like one
                raise self.line.damaged(identity.encode("ascii"), "not its identity")
        if unit is not None and unit != b"NM":
            raise DeviceError(
                self.line.device,
                f"works in {unit.decode('ascii', 'replace')} although it was told UNITS NM",
                "set it to nanometres at its hand controller",
            )
        self._identity = identity
        return identity

    def query(self, question: str, *, timeout_s: float | None = None) -> str:
        """Ask and return the answer; repeated once if the reply fails."""
        return self.line.query(lambda: self.exchange(question, timeout_s=timeout_s))

    def exchange(self, *statements: str, timeout_s: float | None = None) -> str:
        """Send statements, take their echoes, and return the answer if the last is a question."""
        with self.line.transaction(self._prove):
            return self._ask(*statements, timeout_s=timeout_s)

    def _greeted(self, statements: tuple[str, ...]) -> tuple[str, bytes | None]:
        """Return identity and unit; which lines are echoes and handshakes tells their form."""
        self._send(statements)
        sent = tuple(statement.encode("ascii") for statement in statements)
        deadline_s = self.line.deadline_s()
        self.echoes = asked = False
        unit: bytes | None = None
        while True:
            text = self.line.read_line(deadline_s).strip()
            if text.upper().endswith(sent):
                self.echoes, asked = True, text.upper().endswith(b"INFO?")
            elif text.upper() in _UNITS:
                unit = text.upper()
            elif _STATUS_BYTE.fullmatch(text):
                continue
            elif _IDENTITY.fullmatch(text) and (asked or not self.echoes):
                self.line.answered()
                return text.decode("ascii"), unit
            else:
                self.line.stale(text)

    def _ask(self, *statements: str, timeout_s: float | None = None) -> str:
        sent = self._send(statements)
        deadline_s = self.line.deadline_s(timeout_s)
        if self.echoes:
            for expected in sent:
                self._skip_until(expected.__eq__, deadline_s)
        answer = b""
        if sent[-1].endswith(b"?"):
            answer = self._skip_until(lambda text: not self._is_echo(text, sent), deadline_s)
        self.line.answered()
        return answer.decode("ascii", "replace")

    def _is_echo(self, text: bytes, sent: list[bytes]) -> bool:
        """Say whether a line is an echo; one after a start without shows that they had only got lost."""
        if text in sent:
            self.echoes = True
        return text in (b"", *sent)

    def _send(self, statements: tuple[str, ...]) -> list[bytes]:
        sent = [statement.encode("ascii") for statement in statements]
        self.line.send(b"".join(statement + b"\r\n" for statement in sent))
        return sent

    def _skip_until(self, wanted: Callable[[bytes], bool], deadline_s: float) -> bytes:
        while True:
            text = self.line.read_line(deadline_s).strip()
            if wanted(text):
                return text
            if text:
                self.line.stale(text)

    def _prove(self) -> None:
        """The echo of a question and the form of its answer, or the identity: both ends agree."""
        if not self.echoes and self._identity is not None:
            answer, good = self._ask("INFO?"), self._identity
            if answer != good:
                raise self.line.damaged(answer.encode("ascii", "replace"), "not its identity")
            return
        answer = self._ask("STB?")
        if not _STATUS_BYTE.fullmatch(answer.encode("ascii", "replace")):
            raise self.line.damaged(answer.encode("ascii", "replace"), "not a status byte")

"""Zaber ASCII protocol, version 7: one request and the reply that carries its number.

    /1 1 03 get pos          @01 1 03 OK IDLE WR 20000

Request: device, axis, message number, command.  Reply: device, axis, number, OK or RJ (rejected), BUSY or
IDLE, the most important warning flag, data.  ``!`` begins an alert, ``#`` an information line; nobody asked
for those. A checksum (two's complement of the sum of the bytes after the first) may follow ``:``.
Reference: Zaber, ASCII Protocol Manual, firmware 7.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from gonio.errors import DeviceError, ReplyError
from gonio_drivers.lines import Line

_REPLY = re.compile(r"@(\d\d) (\d) (\d\d) (OK|RJ) (IDLE|BUSY) (--|[A-Z0-9]{2})(?: (.*))?$")

_REJECTIONS = {
    "AGAIN": "cannot do this now",
    "BADAXIS": "has no such axis",
    "BADCOMMAND": "does not know this command or setting",
    "BADDATA": "refused the value: it is out of range",
    "BADMESSAGEID": "refused the message number",
    "DEVICEONLY": "takes this command for the whole device only",
    "DRIVERDISABLED": "has its motor driver disabled",
    "FULL": "has its command queue full",
    "LOCKSTEP": "has this axis locked to another",
    "NOACCESS": "does not give access to this setting",
    "PARKED": "is parked",
    "STATUSBUSY": "is moving",
}


@dataclass(frozen=True, slots=True)
class Reply:
    """One `@` reply that has been matched with its request."""

    busy: bool
    flag: str  # the warning of highest precedence, "--" for none
    data: str


def checksum(body: bytes) -> int:
    """Return the checksum of the bytes between the first character and the ``:``."""
    return -sum(body) & 0xFF


class ZaberLine:
    """Requests and replies on a chain of devices."""

    def __init__(self, line: Line, *, checksums: bool = True) -> None:
        self.line = line
        self._send_checksums = checksums
        self._expect_checksums = (
            False  # from the first reply that has one: a reply without is then a damaged one
        )
        self._number = 0

    def renew(self) -> bool:
        """Open the line anew if it was lost or is in doubt; say whether it was."""
        return self.line.renew()

    def query(self, device: int, axis: int, command: str) -> Reply:
        """Send a command that changes nothing and return its reply; repeated once if the reply fails."""
        return self.line.query(lambda: self.command(device, axis, command))

    def command(self, device: int, axis: int, command: str) -> Reply:
        """Send a command once and return its reply.

        Raises
        ------
        ReplyError
            No reply, or one that is damaged.
        DeviceError
            The device rejected the command.
        """
        with self.line.transaction():
            self._number = (self._number + 1) % 100
            body = f"{device} {axis} {self._number:02d} {command}".rstrip().encode("ascii")
            tail = b":%02X" % checksum(body) if self._send_checksums else b""
            self.line.send(b"/" + body + tail + b"\n")
            deadline_s = self.line.deadline_s()
            while True:
                raw = self.line.read_until(b"\n", deadline_s).rstrip(b"\r")
                match = self._parse(raw)
                if match is None:
                    self.line.stale(raw)
                    continue
                address, reply_axis, number, accepted, busy, flag, data = match.groups()
                # The number tells a late reply from this one; it comes round only after 100 requests.
                if (int(address), int(reply_axis), int(number)) != (device, axis, self._number):
                    self.line.stale(raw)
                    continue
                break
            self.line.answered()
        if accepted == "RJ":
            reason = _REJECTIONS.get(data or "", "rejected the command")
            raise DeviceError(
                f"{self.line.device} device {device}",
                f"{reason} (command '{command}', {data})",
                "check model, firmware and the stage's table in the rig file",
            )
        return Reply(busy == "BUSY", flag, data or "")

    def _parse(self, raw: bytes) -> re.Match[str] | None:
        """Return the fields of a reply, None for an alert or information line; damaged text is an error."""
        start = raw.rfind(b"@")  # noise before a reply is harmless: the number and the checksum are checked
        if start < 0:
            if raw[:1] in (b"!", b"#") or not raw:
                return None
            raise self._damaged(raw, "is not a reply")
        raw = raw[start:]
        body = raw
        if raw[-3:-2] == b":":
            body = raw[:-3]
            if raw[-2:] != b"%02X" % checksum(body[1:]):
                raise self._damaged(raw, "the checksum is wrong")
            self._expect_checksums = True
        elif self._expect_checksums:
            raise self._damaged(raw, "the checksum is missing")
        match = _REPLY.match(body.decode("latin-1"))
        if match is None:
            raise self._damaged(raw, "is not a reply")
        return match

    def _damaged(self, raw: bytes, why: str) -> ReplyError:
        return self.line.damaged(raw, why)

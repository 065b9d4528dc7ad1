"""Zaber ASCII protocol, version 7: one request and the reply that carries its number.

    /1 1 03 get pos          @01 1 03 OK IDLE WR 20000

Request: device, axis, message number, command.  Reply: device, axis, number, OK or RJ (rejected), BUSY or
IDLE, the most important warning flag, data.  ``!`` begins an alert, ``#`` an information line; nobody asked
for those. A checksum (two's complement of the sum of the bytes after the first) may follow ``:``; a device
that is asked with one need not answer with one, and early firmware 6 neither knows nor repeats numbers.
Reference: Zaber, ASCII Protocol Manual, firmware 6 and 7.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from gonio.errors import DeviceError, ReplyError
from gonio_drivers.lines import Line

_REPLY = re.compile(r"@(\d\d?) +(\d) +(?:(\d\d|--) +)?(OK|RJ) +(IDLE|BUSY) +(--|[A-Z0-9]{2})(?: +(.*?))? *$")

_CHECK = "check model, firmware and the stage's table in the rig file"
_REJECTIONS = {
    "AGAIN": ("cannot do this now", "repeat"),
    "BADAXIS": ("has no such axis", "correct device and axis in the rig file"),
    "BADCOMMAND": ("does not know this command or setting", _CHECK),
    "BADDATA": ("refused the value: it is out of range", _CHECK),
    "BADMESSAGEID": ("refused the message number", _CHECK),
    "DEVICEONLY": ("takes this command for the whole device only", _CHECK),
    "DRIVERDISABLED": (
        "has its motor driver disabled",
        "find out why (heat, voltage, emergency stop), then send it 'driver enable'",
    ),
    "FULL": ("has its command queue full", "repeat"),
    "LOCKSTEP": ("has this axis locked to another", "send it 'lockstep 1 setup disable'"),
    "NOACCESS": ("does not give access to this setting", _CHECK),
    "PARKED": ("is parked", "send it 'tools parking unpark'"),
    "STATUSBUSY": ("is moving", "stop what else drives it (knob, joystick, another program), then repeat"),
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
        # From the first reply of a device that has a checksum, or a number, one without it is not its reply.
        self._with_checksum: set[int] = set()
        self._numbered: set[int] = set()
        self._unnumbered: set[int] = set()
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
        prove = (lambda: self._prove(device)) if device in self._unnumbered else None
        with self.line.transaction(prove):
            number = self._send(device, axis, command)
            accepted, reply = self._answer(device, axis, number)
            took_number_for_command = number is not None and device in self._unnumbered
            if not accepted and took_number_for_command and reply.data in ("BADCOMMAND", "BADMESSAGEID"):
                accepted, reply = self._answer(device, axis, self._send(device, axis, command))
            self.line.answered()
        if not accepted:
            reason, remedy = _REJECTIONS.get(reply.data, ("rejected the command", _CHECK))
            raise DeviceError(
                f"{self.line.device} device {device}",
                f"{reason} (command '{command}', {reply.data})",
                remedy,
            )
        return reply

    def _send(self, device: int, axis: int, command: str) -> int | None:
        """Send a command and return its number, None for a device that does not take one."""
        self._number = (self._number + 1) % 100
        number = None if device in self._unnumbered else self._number
        words = f"{device} {axis} {command}" if number is None else f"{device} {axis} {number:02d} {command}"
        body = words.rstrip().encode("ascii")
        tail = b":%02X" % checksum(body) if self._send_checksums else b""
        self.line.send(b"/" + body + tail + b"\n")
        return number

    def _answer(self, device: int, axis: int, number: int | None) -> tuple[bool, Reply]:
        """Return whether the command was accepted, and its reply."""
        deadline_s = self.line.deadline_s()
        while True:
            raw = self.line.read_line(deadline_s)
            match = self._parse(raw)
            if match is None:
                self.line.stale(raw)
                continue
            address, reply_axis, reply_number, accepted, busy, flag, data = match.groups()
            if (int(address), int(reply_axis)) != (device, axis):
                self.line.stale(raw)
                continue
            if reply_number in (None, "--"):
                if device in self._numbered:
                    self.line.stale(raw)
                    continue
                self._unnumbered.add(device)
            # The number tells a late reply from this one; it comes round only after 100 requests.
            elif number is None or int(reply_number) != number:
                self.line.stale(raw)
                continue
            else:
                self._numbered.add(device)
            return accepted == "OK", Reply(busy == "BUSY", flag, data or "")

    def _prove(self, device: int) -> None:
        """Ask for an echo that no other reply can be taken for; a refusal belongs to no query either."""
        self._number = (self._number + 1) % 100
        token = f"gonio{self._number:02d}"
        self._send(device, 0, f"tools echo {token}")
        while True:
            accepted, reply = self._answer(device, 0, None)
            if reply.data == token or not accepted:
                return

    def _parse(self, raw: bytes) -> re.Match[str] | None:
        """Return the fields of a reply; damaged text is an error.

        None for an alert, an information line, or our own request from an adapter that hears itself.
        """
        start = raw.rfind(b"@")  # noise before a reply is harmless: the number and the checksum are checked
        if start < 0:
            if raw[:1] in (b"!", b"#", b"/"):
                return None
            raise self._damaged(raw, "is not a reply")
        raw = raw[start:]
        body = raw
        has_checksum = raw[-3:-2] == b":"
        if has_checksum:
            body = raw[:-3]
            if raw[-2:].upper() != b"%02X" % checksum(body[1:]):
                raise self._damaged(raw, "the checksum is wrong")
        match = _REPLY.match(body.decode("latin-1"))
        if match is None:
            raise self._damaged(raw, "is not a reply")
        device = int(match[1])
        if has_checksum:
            self._with_checksum.add(device)
        elif device in self._with_checksum:
            raise self._damaged(raw, "the checksum is missing")
        return match

    def _damaged(self, raw: bytes, why: str) -> ReplyError:
        return self.line.damaged(raw, why)

"""Two Applied Motion drives on one Modbus line, by unit id, in RTU or TCP frames.

An unknown unit id is met with silence, a broadcast is obeyed in silence.
"""

from __future__ import annotations

from typing import Literal

from gonio_simulators.bench.bench import Bench
from gonio_simulators.wire.applied_motion_drive import Drive, WordOrder
from gonio_simulators.wire.modbus_frames import MbapReceiver, RtuReceiver, mbap_frame, rtu_frame

Framing = Literal["rtu", "tcp"]


class AppliedMotionLine:
    """The drives on one line, by unit id."""

    def __init__(
        self,
        bench: Bench,
        *,
        theta_i: int,
        theta_mes: int,
        steps_per_rev: tuple[float, float],
        framing: Framing,
        word_order: WordOrder,
    ) -> None:
        motors = (bench.theta_i, bench.theta_mes)
        self._framing = framing
        self._drives = {
            unit: Drive(motor, steps_per_rev=steps, word_order=word_order)
            for unit, motor, steps in zip((theta_i, theta_mes), motors, steps_per_rev, strict=True)
        }

    def open(self) -> RtuConversation | MbapConversation:
        """Begin a conversation with a new client."""
        return RtuConversation(self) if self._framing == "rtu" else MbapConversation(self)

    def power_cycle(self, *, memory_lost: bool = False) -> None:
        """Switch the drives off and on; what the host wrote was never saved."""
        for drive in self._drives.values():
            drive.power_cycle()

    def answer(self, unit: int, pdu: bytes) -> bytes | None:
        """Return the reply of a unit, or None for the silence of other ids and of a broadcast."""
        if unit == 0:
            if pdu[0] in (0x06, 0x10):
                for drive in self._drives.values():
                    drive.answer(pdu)
            return None
        drive_of_unit = self._drives.get(unit)
        return None if drive_of_unit is None else drive_of_unit.answer(pdu)


class RtuConversation:
    """RTU frames, over a serial line or TCP."""

    wait_s: float | None = None

    def __init__(self, line: AppliedMotionLine) -> None:
        self._line = line
        self._receiver = RtuReceiver()

    def feed(self, data: bytes) -> bytes:
        """Take received bytes and return the replies to the requests they complete."""
        replies = b""
        for unit, pdu in self._receiver.feed(data):
            reply = self._line.answer(unit, pdu)
            if reply is not None:
                replies += rtu_frame(unit, reply)
        return replies

    def poll(self) -> bytes:
        """A slave speaks when it is asked."""
        return b""


class MbapConversation:
    """Modbus TCP."""

    wait_s: float | None = None

    def __init__(self, line: AppliedMotionLine) -> None:
        self._line = line
        self._receiver = MbapReceiver()

    def feed(self, data: bytes) -> bytes:
        """Take received bytes and return the replies to the requests they complete."""
        replies = b""
        for transaction, unit, pdu in self._receiver.feed(data):
            reply = self._line.answer(unit, pdu)
            if reply is not None:
                replies += mbap_frame(transaction, unit, reply)
        return replies

    def poll(self) -> bytes:
        """A slave speaks when it is asked."""
        return b""

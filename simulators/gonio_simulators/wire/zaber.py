"""A chain of Zaber rotary stages on one line: which devices answer, and in which order."""

from __future__ import annotations

from dataclasses import replace

from gonio_simulators.bench.bench import Bench
from gonio_simulators.wire.zaber_message import Request, parse_request
from gonio_simulators.wire.zaber_settings import COMMAND_PACKETS, PACKET_SIZE
from gonio_simulators.wire.zaber_stage import RotaryStage

_ALERT_POLL_S = 1e-3  # real seconds between looks at a moving axis that must announce its end


class ZaberChain:
    """The two stages on one line: device numbers from the rig file, theta_i first."""

    def __init__(self, bench: Bench, *, theta_i: int, theta_mes: int) -> None:
        limits = bench.config.stage
        self._begun: Request | None = None  # a command whose packets are not complete
        self.stages = (
            RotaryStage(theta_i, bench.theta_i, serial=120_001, limits_deg=limits.theta_i.limits_deg),
            RotaryStage(theta_mes, bench.theta_mes, serial=120_002, limits_deg=limits.theta_mes.limits_deg),
        )

    def open(self) -> ZaberConversation:
        """Begin a conversation with a new client."""
        return ZaberConversation(self)

    def power_cycle(self, *, memory_lost: bool = False) -> None:
        """Switch the chain off and on; its settings are in memories that need no battery."""
        for stage in self.stages:
            stage.power_cycle()

    def answer(self, line: bytes) -> bytes:
        """Return the replies of every device that a line concerns."""
        request = parse_request(line)
        if request is None:
            return b""
        if len(line) >= PACKET_SIZE:
            request = Request(request.address, request.axis, request.message_id, ("",), request.has_checksum)
        if request.words[:1] == ("cont",) or (request.words and request.words[-1].endswith("\\")):
            joined = self._join(request)
            if joined is None:
                return b""
            request = joined
        if request.words[:1] == ("renumber",):
            return self._renumber(request)
        address = request.address
        return b"".join([s.answer(request) for s in self.stages if address in (0, s.address)])

    def _join(self, packet: Request) -> Request | None:
        """Add a packet to the command it goes on with; None until the last one, and if it belongs to none.

        A packet that is not the last ends with a backslash; those behind the first begin with ``cont N``.
        """
        words = packet.words
        begun, self._begun = self._begun, None
        packets = 1
        if words[0] == "cont":
            if begun is None or (begun.address, begun.axis, begun.message_id) != (
                packet.address,
                packet.axis,
                packet.message_id,
            ):
                return packet  # a device does not know the command `cont`
            packets = begun.packets + 1
            if words[1:2] != (str(packets - 1),) or packets > COMMAND_PACKETS:
                return packet
            words = begun.words + words[2:]
        if not words[-1].endswith("\\"):
            return replace(packet, words=words)
        last = words[-1][:-1]
        self._begun = replace(packet, words=words[:-1] + ((last,) if last else ()), packets=packets)
        return None

    def _renumber(self, request: Request) -> bytes:
        """Number the addressed devices upwards along the chain, from 1 or from the number given."""
        stages = [s for s in self.stages if request.address in (0, s.address)]
        first = request.words[1] if len(request.words) > 1 else "1"
        if request.axis == 0 and first.isdigit() and 1 <= int(first) <= 99 - len(stages):
            for number, stage in enumerate(stages, int(first)):
                stage.address = number
            accepted = Request(0, 0, request.message_id, (), request.has_checksum)
            return b"".join(stage.answer(accepted) for stage in stages)
        bad = Request(0, 0, request.message_id, ("set", "comm.address", "0"), request.has_checksum)
        return b"".join(stage.answer(bad) for stage in stages)  # BADDATA


class ZaberConversation:
    """Splits what one client sends into lines."""

    def __init__(self, chain: ZaberChain) -> None:
        self.wait_s: float | None = None
        self._chain = chain
        self._unfinished = b""

    def feed(self, data: bytes) -> bytes:
        """Take received bytes and return the replies to the commands they complete."""
        if self._unfinished:
            data = self._unfinished + data
        lines = data.replace(b"\r", b"\n").split(b"\n")
        self._unfinished = lines.pop()[-PACKET_SIZE:]
        answer = self._chain.answer
        replies = b"".join([answer(line) for line in lines if line])
        self._appoint()
        return replies

    def poll(self) -> bytes:
        """Return the alerts that have become due."""
        alerts = b"".join(stage.alert() for stage in self._chain.stages)
        self._appoint()
        return alerts

    def _appoint(self) -> None:
        waits = any(stage.has_to_announce() for stage in self._chain.stages)
        self.wait_s = _ALERT_POLL_S if waits else None

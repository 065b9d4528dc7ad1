"""Faults between an instrument and its port: bytes lost, late, damaged, and devices that fall silent.

A `WireFaults` is the `gonio_simulators.wire.lines.Filter` of one port.  A reply is a line of a text protocol,
and what an echoing or binary device sends at once; a request likewise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from gonio_simulators.faults.active import ActiveFault
from gonio_simulators.faults.catalogue import REPLY
from gonio_simulators.faults.damage import changed, lines, pieces, shown, with_noise
from gonio_simulators.faults.outbox import Deliver, Later, Outbox, loop_later

_LINES_OUT = frozenset(("zaber", "elliptec", "sr830"))
_LINES_IN = frozenset(("zaber", "cs260", "sr830"))  # Elliptec and Modbus requests have no terminator


class Plug(Protocol):
    """What a fault can do to a port."""

    def hang_up(self) -> None:
        """Close the connection."""
        ...

    def refuse(self, duration_s: float) -> None:
        """Let nobody connect for real seconds."""
        ...

    def restart(self) -> None:
        """Forget half-received commands and owed answers, as an instrument that restarts does."""
        ...


class WireFaults:
    """The faults of one port.

    Parameters
    ----------
    faults
        Those of the port's role.
    protocol
        Of the port, as `gonio simulate` prints it.
    restart_device
        Called when power fails at a request; tells the instrument and all its ports.
    later
        For tests; by default timers of the running loop.
    """

    def __init__(
        self,
        faults: Sequence[ActiveFault],
        protocol: str,
        restart_device: Callable[[ActiveFault], None],
        later: Later = loop_later,
    ) -> None:
        self.port: Plug | None = None
        self._protocol = protocol
        self._restart_device = restart_device
        self._later = later
        echoes = [f for f in faults if f.name.startswith("echo-")]
        self._on_echo = echoes
        self._on_reply = [f for f in faults if f.on == REPLY]
        self._on_request = [f for f in faults if f not in self._on_reply and f not in echoes]
        self._echo = b""  # what the instrument still has to echo
        self._outbox = Outbox(later)
        self._requests = 0
        self._client: Deliver | None = None
        self._silences = 0
        self._kept: list[tuple[bytes, Deliver]] = []
        self._cutting = False

    # -- the two directions ---------------------------------------------------------------------------------

    def received(self, data: bytes, deliver: Deliver) -> None:
        """Pass bytes from the client on to the instrument."""
        if deliver != self._client:  # a new connection inherits nothing
            self._client = deliver
            self._echo = b""
            self._outbox.forget()
        self._requests += 1
        requests = lines(data) if self._on_request and self._protocol in _LINES_IN else [data]
        for request in requests:
            whole = self._protocol not in _LINES_IN or request[-1:] in (b"\r", b"\n")
            if self._silences:
                self._kept.append((request, deliver))
            elif whole:
                self._request(request, deliver)
            else:
                self._pass_on(request, deliver)

    def sending(self, data: bytes, transmit: Deliver) -> None:
        """Pass bytes from the instrument on to the client."""
        if self._silences:
            return
        if self._cutting:
            transmit(data[: len(data) // 2])
            return
        if self._echo:
            data = self._with_echo_faults(data)
        for reply in lines(data) if self._protocol in _LINES_OUT else [data]:
            if reply:
                self._reply(reply, transmit)

    # -- requests -------------------------------------------------------------------------------------------

    def _request(self, request: bytes, deliver: Deliver) -> None:
        for fault in [f for f in self._on_request if f.strikes()]:  # each counts, whatever becomes of it
            if fault.name == "corrupt-request":
                damaged = changed(request, fault.text("unit"), fault.rng)
                fault.record(f"request={shown(request)} became={shown(damaged)}")
                request = damaged
                continue
            if fault.name == "dropped-request":
                fault.record(f"request={shown(request)}")
            elif fault.name == "hang":
                hang_s = fault.number("hang_s")
                fault.record(f"hang_s={hang_s:g} request={shown(request)}")
                self.fall_silent(hang_s, buffers=fault.flag("buffers"))
                self._kept.append((request, deliver))
            elif fault.name == "disconnect":
                self._disconnect(fault, request, deliver)
            else:
                self._restart_device(fault)
            return
        self._pass_on(request, deliver)

    def _pass_on(self, data: bytes, deliver: Deliver) -> None:
        if self._on_echo:
            self._echo += data
        deliver(data)

    def _disconnect(self, fault: ActiveFault, request: bytes, deliver: Deliver) -> None:
        executed = fault.text("executed") == "yes"
        refuse_s = fault.number("refuse_s")
        fault.record(f"executed={executed} refuse_s={refuse_s:g} request={shown(request)}")
        if executed:
            self._cutting = True
            try:
                deliver(request)
            finally:
                self._cutting = False
        if self.port is not None:
            self.port.hang_up()
            if refuse_s > 0:
                self.port.refuse(refuse_s)

    # -- silence --------------------------------------------------------------------------------------------

    def fall_silent(self, duration_s: float, *, buffers: bool = False) -> None:
        """Answer nothing for real seconds; requests of that time are lost, or carried out at its end."""
        self._silences += 1
        self._outbox.forget()
        self._later(duration_s, lambda: self._wake(buffers=buffers))

    def restart(self, boot_s: float) -> None:
        """Take part in the restart of the instrument: half commands are forgotten, it boots in silence."""
        if self.port is not None:
            self.port.restart()
        self._echo = b""
        self.fall_silent(boot_s)

    def _wake(self, *, buffers: bool) -> None:
        self._silences -= 1
        if self._silences:
            return
        kept, self._kept = self._kept, []
        if buffers:
            for request, deliver in kept:
                self._pass_on(request, deliver)

    # -- replies --------------------------------------------------------------------------------------------

    def _reply(self, reply: bytes, transmit: Deliver) -> None:
        chunks = [(0.0, reply)]
        for fault in [f for f in self._on_reply if f.strikes()]:  # each counts, whatever becomes of it
            if chunks:
                chunks = self._damaged(fault, reply, chunks, transmit)
        if chunks and (held := self._outbox.take_held(self._requests)):
            (delay_s, first), *rest = chunks
            chunks = [(delay_s, held + first), *rest]
        for delay_s, chunk in chunks:
            self._outbox.send(delay_s, chunk, transmit)

    def _damaged(
        self, fault: ActiveFault, reply: bytes, chunks: list[tuple[float, bytes]], transmit: Deliver
    ) -> list[tuple[float, bytes]]:
        """Return what becomes of a reply: pieces, each with the real seconds it waits for."""
        delay_s, data = chunks[0][0], b"".join(chunk for _, chunk in chunks)
        details = f"reply={shown(reply)}"
        rng = fault.rng
        if fault.name == "slow-reply":
            delay_s += fault.number("delay_s")
            details = f"delay_s={delay_s:g} {details}"
            result = [(delay_s, data)]
        elif fault.name == "dropped-reply":
            result = []
        elif fault.name == "late-reply":
            self._outbox.hold(data, self._requests, fault.number("delay_s"), transmit)
            result = []
        elif fault.name == "garbage":
            noisy = with_noise(data, int(fault.number("size")), fault.text("place"), rng)
            details = f"{details} became={shown(noisy)}"
            result = [(delay_s, noisy)]
        elif fault.name == "corrupt-reply":
            damaged = changed(data, fault.text("unit"), rng)
            details = f"{details} became={shown(damaged)}"
            result = [(delay_s, damaged)]
        elif fault.name == "split-reply":
            first, *rest = pieces(data, int(fault.number("size")))
            result = [(delay_s, first), *((fault.number("gap_s"), piece) for piece in rest)]
        else:
            result = [(delay_s, data + data)]  # doubled-reply
        fault.record(details)
        return result

    def _with_echo_faults(self, data: bytes) -> bytes:
        """Lose or double the lines that are echoes of what was received."""
        out = []
        for line in data.splitlines(keepends=True):
            if not self._echo.startswith(line):
                out.append(line)
                continue
            self._echo = self._echo[len(line) :]
            striking = [f for f in self._on_echo if f.strikes()] if line.endswith(b"\n") else []
            for fault in striking:
                if line:
                    fault.record(f"echo={shown(line)}")
                    line = b"" if fault.name == "echo-missing" else line + line
            out.append(line)
        return b"".join(out)

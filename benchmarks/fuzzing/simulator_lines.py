"""Requests to the simulated instruments: damaged, random, to other addresses on the bus.

Whatever comes, a simulator does not raise, does not take long, and does not answer for a device that it is
not: a reply carries an address of its own and, where the protocol has one, a right checksum.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import cache
from random import Random

from fuzzing.checked_lines import crc16
from fuzzing.mutations import WORDS, mutate
from fuzzing.outcome import Result, Verdict
from fuzzing.virtual_time import VirtualTime
from gonio.config import parse_toml
from gonio.rig import default_rig_text
from gonio_simulators.bench.bench import Bench
from gonio_simulators.bench.config import BenchConfig
from gonio_simulators.clock import ManualClock
from gonio_simulators.wire.applied_motion import AppliedMotionLine
from gonio_simulators.wire.cs260 import Cornerstone260
from gonio_simulators.wire.elliptec import Elliptec
from gonio_simulators.wire.lines import Instrument
from gonio_simulators.wire.sr830 import Sr830
from gonio_simulators.wire.zaber import ZaberChain

LONGEST_ANSWER = 200_000
_MOST_POLLS = 200


@cache
def _config() -> BenchConfig:
    return BenchConfig.from_tables(parse_toml(default_rig_text(), source="built in"))


class SimulatorTarget:
    """One simulated instrument with a client that sends anything."""

    name = ""
    valid: Sequence[bytes] = ()
    """Requests of the protocol, to be damaged."""

    def __init__(self, time: VirtualTime) -> None:
        self.time = time
        self.clock = ManualClock()
        self.bench = Bench(_config(), self.clock)
        self.instrument = self.instrument_on(self.bench)
        self.talk = self.instrument.open()

    def instrument_on(self, bench: Bench) -> Instrument:
        """Return the instrument."""
        raise NotImplementedError

    def is_foreign(self, answer: bytes, sent: bytes) -> bool:
        """Say whether an answer is another device's, or damaged."""
        return False

    def one(self, rng: Random) -> Result:
        """Send one damaged request, let time pass, and take what is answered."""
        if rng.random() < 0.02:
            self.talk = self.instrument.open()
        data = self._request(rng)
        answer = self.talk.feed(data)
        polls = 0
        while self.talk.wait_s is not None and polls < _MOST_POLLS and rng.random() < 0.8:
            self.clock.advance(self.talk.wait_s + 1e-6)
            answer += self.talk.poll()
            polls += 1
        passed_s = rng.choice((0.0, 0.0, 0.03, 1.0, 100.0))
        self.clock.advance(passed_s)
        self.time.advance(passed_s)
        if len(answer) > LONGEST_ANSWER:
            raise AssertionError(f"{len(answer)} bytes in answer to {data[:80]!r}")
        if self.is_foreign(answer, data):
            return Result(Verdict.CORRUPT, reads=polls)
        return Result(Verdict.RIGHT, reads=polls) if answer else Result(refused="silence", reads=polls)

    def _request(self, rng: Random) -> bytes:
        draw = rng.random()
        if draw < 0.1:
            return rng.randbytes(rng.randint(1, 60))
        valid = self.complete(rng, rng.choice(self.valid))
        if draw < 0.3:
            return valid
        if draw < 0.4:
            valid = b"".join(self.complete(rng, rng.choice(self.valid)) for _ in range(3))
        return mutate(rng, valid, self.valid)

    def complete(self, rng: Random, request: bytes) -> bytes:
        """Return a request with numbers in its gaps (``%n``)."""
        while b"%n" in request:
            number = (
                str(rng.choice((0, 1, -1, 3, 27, 500, 2**31, -(2**40), 1e300, rng.uniform(-1e3, 1e3))))
                if rng.random() < 0.8
                else rng.choice(WORDS).decode("utf-8")
            )
            request = request.replace(b"%n", number.encode("utf-8"), 1)
        return request


class ZaberRequests(SimulatorTarget):
    """A chain of two stages, 1 and 2."""

    name = "simulated zaber"
    valid = (
        *(b"/1 1 07 get pos\n", b"/2 1 08 get pos\n", b"/0 0 01\n", b"/3 1 09 get pos\n", b"/12 1 09\n"),
        *(b"/1 1 02 move abs %n\n", b"/2 1 02 move rel %n\n", b"/1 move vel %n\n", b"/1 1 home\n"),
        *(b"/1 1 set pos %n\n", b"/1 1 set maxspeed %n\n", b"/1 set accel %n\n", b"/1 1 stop\n", b"/estop\n"),
        *(
            b"/2 1 55 warnings clear\n",
            b"/1 0 set comm.alert 1\n",
            b"/1 1 02 get pos:2A\n",
            b"/tools echo %n\n",
        ),
        *(b"/1 0 system restore\n", b"/1 1 set limit.max %n\n", b"/1 1 move max\n", b"/2 1 move min\r\n"),
    )

    def instrument_on(self, bench: Bench) -> Instrument:
        """Return the chain."""
        return ZaberChain(bench, theta_i=1, theta_mes=2)

    def is_foreign(self, answer: bytes, sent: bytes) -> bool:
        """Replies and alerts of 1 and 2 alone, unless the client has renumbered them."""
        if b"comm.address" in sent or b"renumber" in sent:
            self.instrument = self.instrument_on(self.bench)
            self.talk = self.instrument.open()
            return False
        lines = answer.split(b"\r\n")
        return lines[-1] != b"" or any(
            line[:3] not in (b"@01", b"@02", b"!01", b"!02") or not line.isascii() for line in lines[:-1]
        )


class _Drives(SimulatorTarget):
    """Two drives, units 1 and 2."""

    framing = ""
    pdus = tuple(
        bytes.fromhex(text)
        for text in (
            *(
                "0300000008",
                "0300010001",
                "0400000002",
                "03007C0005",
                "0300900001",
                "030000FFFF",
                "0300000000",
            ),
            *(
                "06007C0067",
                "06007C00E1",
                "06007C00DB",
                "06007C00BA",
                "06007C009F",
                "06007C009E",
                "06007C1234",
            ),
            *(
                "10001B00050A0258025800F000030D40",
                "10001E000204FFFF0000",
                "10007D0002040000000A",
                "10001B0000",
            ),
            *("0800001234", "2B0E0100", "01000000FF", "0500010FF0", "83", "03", "0F000000080101", "1600"),
        )
    )
    valid = pdus

    def instrument_on(self, bench: Bench) -> Instrument:
        """Return the line with both drives."""
        return AppliedMotionLine(
            bench,
            theta_i=1,
            theta_mes=2,
            steps_per_rev=(2e4, 2e4),
            framing=self.framing,  # type: ignore[arg-type]
            word_order="big",
        )

    def complete(self, rng: Random, request: bytes) -> bytes:
        """Frame a request for a unit, often one that is not here; the frame is right, whatever is in it."""
        if rng.random() < 0.3:
            request = mutate(rng, request, self.pdus)[:250] or b"\x03"
        return self.framed(rng, rng.choice((1, 2, 2, 3, 0, 247, 255)), request)

    def framed(self, rng: Random, unit: int, pdu: bytes) -> bytes:
        """Return the frame."""
        raise NotImplementedError


class RtuRequests(_Drives):
    """In RTU frames."""

    name = "simulated modbus rtu"
    framing = "rtu"

    def framed(self, rng: Random, unit: int, pdu: bytes) -> bytes:
        """Return unit, request and CRC."""
        body = bytes([unit]) + pdu
        return body + crc16(body)

    def is_foreign(self, answer: bytes, sent: bytes) -> bool:
        """Each reply is one of unit 1 or 2 with a right CRC."""
        while answer:
            if answer[0] not in (1, 2) or len(answer) < 5:
                return True
            n = 5 if answer[1] & 0x80 else 5 + answer[2] if answer[1] in (3, 4) else 8
            if answer[1] == 8:
                n = len(answer)
            if crc16(answer[: n - 2]) != answer[n - 2 : n]:
                return True
            answer = answer[n:]
        return False


class TcpRequests(_Drives):
    """In MBAP frames."""

    name = "simulated modbus tcp"
    framing = "tcp"

    def framed(self, rng: Random, unit: int, pdu: bytes) -> bytes:
        """Return MBAP header and request."""
        return struct.pack(">HHHB", rng.getrandbits(16), 0, len(pdu) + 1, unit) + pdu

    def is_foreign(self, answer: bytes, sent: bytes) -> bool:
        """Each reply is one of unit 1 or 2, complete."""
        while answer:
            if len(answer) < 9:
                return True
            _, protocol, length, unit = struct.unpack_from(">HHHB", answer)
            if protocol != 0 or unit not in (1, 2) or len(answer) < 6 + length:
                return True
            answer = answer[6 + length :]
        return False


class ElliptecRequests(SimulatorTarget):
    """A rotator with address 2."""

    name = "simulated elliptec"
    valid = (
        *(b"2in", b"2gs", b"2gp", b"2ho0", b"2ma00004600", b"2mr00000100", b"2fw", b"2bw", b"2st", b"2sv32"),
        *(
            b"2sj00000010",
            b"2gj",
            b"2go",
            b"2so00000001",
            b"2us",
            b"0in",
            b"3gp",
            b"Fma00004600",
            b"2i1",
            b"2s1",
        ),
    )

    def instrument_on(self, bench: Bench) -> Instrument:
        """Return the rotator."""
        return Elliptec(bench, address="2")

    def is_foreign(self, answer: bytes, sent: bytes) -> bool:
        """Lines that begin with its address, unless the client has changed that or made a group."""
        device = self.instrument
        assert isinstance(device, Elliptec)
        if device.address != "2" or b"ga" in sent:
            self.instrument = self.instrument_on(self.bench)
            self.talk = self.instrument.open()
            return False
        lines = answer.split(b"\r\n")
        return lines[-1] != b"" or any(line[:1] != b"2" or not line.isascii() for line in lines[:-1])


class CornerstoneRequests(SimulatorTarget):
    """A monochromator."""

    name = "simulated cs260"
    valid = (
        *(
            b"GOWAVE %n\r\n",
            b"WAVE?\r\n",
            b"GRAT?\n",
            b"GRAT %n\n",
            b"FILTER %n\n",
            b"FILTER?\n",
            b"SHUTTER O\n",
        ),
        *(b"SHUTTER C\n", b"OUTPORT %n\n", b"SLIT1MICRONS %n\n", b"STEP %n\n", b"UNITS UM\n", b"UNITS NM\n"),
        *(
            b"HANDSHAKE 1\n",
            b"HANDSHAKE 0\n",
            b"STB?\n",
            b"ERROR?\n",
            b"ABORT\n",
            b"INFO?\n",
            b"BANDPASS %n\n",
        ),
        *(b"GRAT1LABEL X\n", b"GRAT1FACTOR %n\n", b"FILTER2LABEL?\n", b"CALIBRATE %n\n", b"GRAT1LINES?\n"),
    )

    def instrument_on(self, bench: Bench) -> Instrument:
        """Return the monochromator."""
        return Cornerstone260(bench)


class LockinRequests(SimulatorTarget):
    """A lock-in."""

    name = "simulated sr830"
    valid = (
        *(
            b"OUTX 0\r",
            b"*IDN?\r",
            b"SNAP?1,2\r",
            b"SNAP? 1,2,3,4,9\r",
            b"OUTP? %n\r",
            b"SENS %n\r",
            b"SENS?\r",
        ),
        *(
            b"OFLT %n\r",
            b"OFLT?;OFSL?\r",
            b"LIAS?\r",
            b"LIAS? %n\r",
            b"PHAS %n\r",
            b"APHS\r",
            b"AGAN\r",
            b"*RST\r",
        ),
        *(
            b"*ESR?\r",
            b"*STB? %n\r",
            b"ERRE %n,%n\r",
            b"FREQ %n\r",
            b"DDEF 1,%n,%n\r",
            b"AUXV %n,%n\r",
            b"OEXP?%n\r",
        ),
        *(
            b"TRCA?1,0,%n\r",
            b"SPTS?\r",
            b"STRT\r",
            b"PAUS\r",
            b"SRAT %n\r",
            b"REST\r",
            b"*CLS\r",
            b"AOFF %n\r",
        ),
    )

    def instrument_on(self, bench: Bench) -> Instrument:
        """Return the lock-in."""
        return Sr830(bench)

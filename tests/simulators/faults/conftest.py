"""A bench whose bench time and real time stand still until told, with faults in its lines."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from gonio.rig import default_rig_text
from gonio_simulators.faults import FaultLog, parse_fault, read_fault_log
from gonio_simulators.faults.injector import Injector
from gonio_simulators.faults.log import Injected
from gonio_simulators.wire.applied_motion import AppliedMotionLine
from gonio_simulators.wire.cs260 import Cornerstone260
from gonio_simulators.wire.elliptec import Elliptec
from gonio_simulators.wire.sr830 import Sr830
from gonio_simulators.wire.zaber import ZaberChain
from tests.simulators.wire.conftest import StillBench


class Timers:
    """Real time that passes when told."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self._waiting: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def later(self, delay_s: float, action: Callable[[], None]) -> object:
        heapq.heappush(self._waiting, (self.now_s + delay_s, next(self._order), action))
        return None

    def pass_(self, duration_s: float) -> None:
        end_s = self.now_s + duration_s
        while self._waiting and self._waiting[0][0] <= end_s + 1e-12:
            self.now_s, _, action = heapq.heappop(self._waiting)
            action()
        self.now_s = end_s


class Wire:
    """One instrument, its filter, and a client; also what a port does for faults."""

    def __init__(self, faulty: FaultyBench, role: str, protocol: str, instrument) -> None:
        self._instrument = instrument
        self.filter = faulty.injector.filter_for(role, protocol, instrument)
        if self.filter is not None:
            self.filter.port = self
        self.talk = instrument.open()
        self.chunks: list[bytes] = []
        self.hung_up = 0
        self.refused_s = 0.0

    def send(self, data: bytes) -> None:
        if self.filter is None:
            self._deliver(data)
        else:
            self.filter.received(data, self._deliver)

    def _deliver(self, data: bytes) -> None:
        self._out(self.talk.feed(data))

    def _out(self, reply: bytes) -> None:
        if reply and self.filter is not None:
            self.filter.sending(reply, self._transmit)
        elif reply:
            self._transmit(reply)

    def _transmit(self, data: bytes) -> None:
        self.chunks.append(data)

    def ask(self, data: bytes) -> bytes:
        """Send, and take what has come since the last time."""
        self.send(data)
        return self.take()

    def take(self) -> bytes:
        self._out(self.talk.poll())
        got, self.chunks = b"".join(self.chunks), []
        return got

    def hang_up(self) -> None:
        self.hung_up += 1

    def refuse(self, duration_s: float) -> None:
        self.refused_s = duration_s

    def restart(self) -> None:
        self.talk = self._instrument.open()


class FaultyBench:
    """A still bench with faults."""

    def __init__(self, log: Path, *specs: str, text: str | None = None) -> None:
        self.bench = StillBench.of(text or default_rig_text())
        self.clock = self.bench.clock
        self.timers = Timers()
        self._path = log
        fixed = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
        self._log = FaultLog(log, now=lambda: fixed)
        self.injector = Injector(
            [parse_fault(spec) for spec in specs], self.bench, self._log, self.timers.later
        )

    def advance(self, duration_s: float, steps: int = 1) -> None:
        for _ in range(steps):
            self.clock.advance(duration_s / steps)
            self.injector.tick()

    @property
    def injected(self) -> list[Injected]:
        return read_fault_log(self._path)

    @property
    def names(self) -> list[str]:
        return [i.name for i in self.injected]

    def zaber(self) -> Wire:
        return Wire(self, "stage", "zaber", ZaberChain(self.bench, theta_i=1, theta_mes=2))

    def drives(self, framing: str = "rtu") -> Wire:
        line = AppliedMotionLine(
            self.bench,
            theta_i=1,
            theta_mes=2,
            steps_per_rev=(20000.0, 20000.0),
            framing=framing,
            word_order="big",
        )
        return Wire(self, "stage", f"modbus-{framing}", line)

    def rotator(self) -> Wire:
        return Wire(self, "polarizer", "elliptec", Elliptec(self.bench, now=lambda: self.timers.now_s))

    def monochromator(self) -> Wire:
        return Wire(self, "monochromator", "cs260", Cornerstone260(self.bench))

    def lockin(self) -> Wire:
        return Wire(self, "lockin", "sr830", Sr830(self.bench))


@pytest.fixture
def faulty(tmp_path: Path) -> Iterator[Callable[..., FaultyBench]]:
    """Make a bench with faults: ``faulty("late-reply@stage:nth=1")``."""
    made: list[FaultyBench] = []

    def make(*specs: str, text: str | None = None) -> FaultyBench:
        made.append(FaultyBench(tmp_path / f"faults-{len(made)}.log", *specs, text=text))
        return made[-1]

    yield make
    for bench in made:
        bench.injector.log.close()

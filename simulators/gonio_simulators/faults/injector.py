"""All faults of one bench: plugged into its motors, its light, its lines, and its time."""

from __future__ import annotations

import asyncio
import heapq
import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Protocol

from gonio_simulators.bench.bench import Bench
from gonio_simulators.faults.active import ActiveFault
from gonio_simulators.faults.axes import AxisFaults
from gonio_simulators.faults.catalogue import MOVE
from gonio_simulators.faults.log import FaultLog
from gonio_simulators.faults.optics import LightFaults, StuckFaults
from gonio_simulators.faults.outbox import Later, loop_later
from gonio_simulators.faults.places import ROLES, places_of
from gonio_simulators.faults.spec import FaultSpec
from gonio_simulators.faults.wire import WireFaults


class PowerCycled(Protocol):
    """An instrument that can be switched off and on."""

    def power_cycle(self, *, memory_lost: bool = False) -> None:
        """Forget what the real one forgets."""
        ...


class Injector:
    """The faults of one bench.

    Parameters
    ----------
    specs
        What was asked for.
    bench
        Gets its hooks; one without faults gets none, and its numbers stay what they are.
    log
        Where injections are noted.
    later
        Calls a function after real seconds; for tests.

    Raises
    ------
    ConfigError
        If a fault does not apply at its target.
    """

    def __init__(
        self, specs: Sequence[FaultSpec], bench: Bench, log: FaultLog, later: Later = loop_later
    ) -> None:
        self.log = log
        self._clock = bench.clock
        self._real_later = later
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._filters: dict[str, list[WireFaults]] = {role: [] for role in ROLES}
        self._instruments: dict[str, PowerCycled] = {}
        self.faults = self._activate(specs, bench, log)
        self._plug_in(bench)

    def _activate(self, specs: Sequence[FaultSpec], bench: Bench, log: FaultLog) -> list[ActiveFault]:
        active: list[ActiveFault] = []
        seen: Counter[str] = Counter()
        for spec in specs:
            for place in places_of(spec, bench.detector_names):
                # the same fault asked for twice strikes twice, at different moments
                seed = f"{bench.config.simulation.seed} {spec.text} {place} {seen[spec.text]}"
                active.append(ActiveFault(spec, place, seed, bench.clock, log))
            log.counts[spec.kind.name] += 0
            seen[spec.text] += 1
        return active

    def _plug_in(self, bench: Bench) -> None:
        self._axes: dict[str, AxisFaults] = {}
        for name, motor in (
            ("theta_i", bench.theta_i),
            ("theta_mes", bench.theta_mes),
            ("polarizer", bench.polarizer),
        ):
            own = [f for f in self.faults if f.place == name and f.on == MOVE]
            if own:
                self._axes[name] = AxisFaults(motor, own, self.schedule)
        lights = [f for f in self.faults if f.name.startswith(("lamp-", "detector-", "lockin-"))]
        self._light = LightFaults(bench, lights)
        StuckFaults(bench, [f for f in self.faults if f.name.endswith("-stuck")])
        for fault in self.faults:
            self._wait_for(fault)

    def filter_for(self, role: str, protocol: str, instrument: PowerCycled) -> WireFaults | None:
        """Return what sits between an instrument and one of its ports; None if no fault does."""
        self._instruments[role] = instrument
        own = [f for f in self.faults if f.place == role and f.on_the_line]
        if not own:
            return None
        filter_ = WireFaults(own, protocol, self._restart, self._real_later)
        self._filters[role].append(filter_)
        return filter_

    def schedule(self, time_s: float, action: Callable[[], None]) -> None:
        """Call a function at a bench time, or at the next `tick` after it."""
        if math.isfinite(time_s):
            heapq.heappush(self._events, (time_s, next(self._order), action))
            self._set_timer()

    def start(self) -> None:
        """Keep bench time with a timer of the running loop."""
        self._loop = asyncio.get_running_loop()
        self._set_timer()

    def stop(self) -> None:
        """Stop the timer."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def tick(self) -> None:
        """Let everything happen that has become due."""
        while self._events and self._events[0][0] <= self._clock.now_s():
            heapq.heappop(self._events)[2]()
        self._set_timer()

    def _set_timer(self) -> None:
        if self._loop is None:
            return
        self.stop()
        if self._events:
            left_s = (self._events[0][0] - self._clock.now_s()) / self._clock.speed
            self._timer = self._loop.call_later(max(0.0, left_s), self.tick)

    def _wait_for(self, fault: ActiveFault) -> None:
        due_s = fault.due_s()
        if due_s is not None:
            self.schedule(due_s, lambda: self._strike_by_itself(fault))

    def _strike_by_itself(self, fault: ActiveFault) -> None:
        if fault.take_due():
            if fault.name == "power-cycle":
                self._restart(fault)
            elif fault.place in self._axes and fault.name == "knob":
                self._axes[fault.place].strike_now(fault)
            else:
                self._light.strike_now(fault)
        self._wait_for(fault)

    def _restart(self, fault: ActiveFault) -> None:
        boot_s = fault.number("boot_s")
        memory = fault.text("memory")
        self._instruments[fault.place].power_cycle(memory_lost=memory == "lost")
        for filter_ in self._filters[fault.place]:
            filter_.restart(boot_s)
        fault.record(f"boot_s={boot_s:g} memory={memory}")

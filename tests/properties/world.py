"""A rig whose drivers talk to the simulated bench in this process, in one time that both share.

No socket, no thread, no real second: a move of minutes and a timeout of seconds cost what it costs to compute
them, and a failing example is the same at every repetition.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import tomllib
from collections import deque
from collections.abc import Callable, Iterator
from random import Random
from unittest import mock

from fuzzing.virtual_time import VirtualClock, VirtualTime

from gonio.config import parse_toml
from gonio.rig import Context, Rig, RigConfig, default_rig_text, find_driver, parse_rig, with_addresses
from gonio_drivers import transport
from gonio_drivers.transport import Port
from gonio_simulators.bench.bench import Bench
from gonio_simulators.bench.config import BenchConfig
from gonio_simulators.bench.motor import Motor
from gonio_simulators.clock import ManualClock
from gonio_simulators.wire.lines import Conversation, Instrument
from gonio_simulators.wire.serve import plan_ports

from .path_watch import PathWatch

STAGES = {
    "zaber": 'driver = "zaber"',
    "modbus-rtu": 'driver = "applied-motion"\nframing = "rtu"',
    "modbus-tcp": 'driver = "applied-motion"\nframing = "tcp"\nword_order = "little"',
}

ROLES = ("stage", "polarizer", "monochromator", "lockin")

_LATENCY_S = 1e-3


def rig_text(*, stage: str, backlash_deg: float) -> str:
    """Return the built-in rig with another stage, real lost motion in its gears, and no noise."""
    head, _, rest = default_rig_text().partition("[simulation.noise]")
    noise, _, tail = rest.partition("[simulation.detectors.pmt]")
    del noise
    gears = "".join(  # near home, so that homing, which is polled often, is short
        f"[simulation.{axis}]\nbacklash_deg = {backlash_deg}\npower_on_deg = {here_deg}\n"
        for axis, here_deg in (("theta_i", 3.0), ("theta_mes", 177.0))
    )
    text = f"{head}{gears}[simulation.detectors.pmt]{tail}"
    return text.replace('driver = "zaber"', STAGES[stage], 1).replace(
        "clock_speed = 4000.0", "clock_speed = 1.0"
    )


class BenchTime(VirtualTime):
    """Virtual time in which things happen at appointed times, and in which paths are watched."""

    def __init__(self) -> None:
        super().__init__()
        self.watches: list[PathWatch] = []
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._commands: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()

    def at(self, delay_s: float, action: Callable[[], None]) -> None:
        """Let something happen on the bench after some time."""
        heapq.heappush(self._events, (self.now_s + delay_s, next(self._count), action))

    def command_at(self, delay_s: float, action: Callable[[], None]) -> None:
        """Let another thread call a driver after some time; it gets its turn while this one sleeps."""
        heapq.heappush(self._commands, (self.now_s + delay_s, next(self._count), action))

    def advance(self, duration_s: float) -> None:
        """Let time pass, with everything that happens in it."""
        end_s = self.now_s + max(duration_s, 0.0)
        while self._events and self._events[0][0] <= end_s:
            time_s, _, action = heapq.heappop(self._events)
            self._go_to(time_s)
            action()
        self._go_to(end_s)

    def sleep(self, duration_s: float) -> None:
        """Sleep, and let the other threads do what is due."""
        self.advance(duration_s)
        while self._commands and self._commands[0][0] <= self.now_s:
            heapq.heappop(self._commands)[2]()

    def forget(self) -> None:
        """Cancel what other threads were about to do."""
        self._commands.clear()

    def _go_to(self, time_s: float) -> None:
        if time_s > self.now_s:
            for watch in self.watches:
                watch.passed(self.now_s, time_s)
            self.now_s = time_s


class SharedClock(ManualClock):
    """The bench's clock, which is the drivers' time."""

    def __init__(self, time: BenchTime) -> None:
        super().__init__()
        self._time = time

    def now_s(self) -> float:
        """Return bench seconds."""
        return self._time.now_s

    def advance(self, duration_s: float) -> None:
        """Let bench seconds pass."""
        self._time.advance(duration_s)


class Cable:
    """The line of one instrument: what happens to the replies to come, and whether it is plugged in."""

    def __init__(self, world: World, role: str, instrument: Instrument) -> None:
        self.world = world
        self.role = role
        self.instrument = instrument
        self.troubles: deque[str] = deque()
        self.unplugged_until_s = 0.0
        self.said_at_deg: deque[dict[str, float]] = deque(maxlen=5000)
        self.writes = 0
        self.port: BenchPort | None = None

    def open(self) -> BenchPort:
        """Connect."""
        if self.world.time.now_s < self.unplugged_until_s:
            raise ConnectionRefusedError("unplugged")
        self.port = BenchPort(self)
        return self.port

    def unplug(self, duration_s: float) -> None:
        """Break the connection, and let nobody connect for a while."""
        self.unplugged_until_s = self.world.time.now_s + duration_s
        if self.port is not None:
            self.port.broken = True
            self.port = None

    def restart(self) -> None:
        """Let a new conversation begin on the old connection, as an instrument that was switched off does."""
        if self.port is not None:
            self.port.talk = self.instrument.open()
            self.port.incoming.clear()


class BenchPort:
    """A `gonio_drivers.transport.Port` to an instrument in this process."""

    def __init__(self, cable: Cable) -> None:
        self._cable = cable
        self._time = cable.world.time
        self.talk: Conversation = cable.instrument.open()
        self.incoming: deque[tuple[float, bytes]] = deque()
        self.broken = False

    def write(self, data: bytes) -> None:
        """Send a request; what becomes of it and of its reply is the first of the cable's troubles."""
        self._check()
        cable, time = self._cable, self._time
        cable.writes += 1
        trouble = cable.troubles.popleft() if cable.troubles else ""
        time.advance(_LATENCY_S)
        if trouble == "lost request":
            return
        cable.said_at_deg.append(cable.world.angles_deg())
        reply = self.talk.feed(data)
        self._send(reply, trouble)

    def _send(self, reply: bytes, trouble: str) -> None:
        if not reply or trouble == "lost reply":
            return
        rng = self._cable.world.rng
        due_s = self._time.now_s + _LATENCY_S
        if trouble.startswith("late "):
            due_s += float(trouble.removeprefix("late "))
        elif trouble == "noise before":
            reply = bytes(rng.randrange(0x80, 0x100) for _ in range(rng.randint(1, 6))) + reply
        elif trouble == "bit":  # only where a checksum finds it
            place = rng.randrange(len(reply))
            reply = reply[:place] + bytes([reply[place] ^ 1 << rng.randrange(8)]) + reply[place + 1 :]
        elif trouble == "cut":
            reply = reply[: rng.randrange(len(reply))]
        elif trouble == "twice":
            reply += reply
        if self.incoming:
            due_s = max(due_s, self.incoming[-1][0])  # bytes on a wire do not overtake each other
        if trouble == "split" and len(reply) > 1:
            place = rng.randrange(1, len(reply))
            self.incoming.append((due_s, reply[:place]))
            reply, due_s = reply[place:], due_s + 0.05
        self.incoming.append((due_s, reply))

    def read(self, timeout_s: float) -> bytes:
        """Return what comes first; the instrument may speak by itself meanwhile."""
        self._check()
        time = self._time
        end_s = time.now_s + max(timeout_s, 0.0)
        while True:
            if self.incoming and self.incoming[0][0] <= time.now_s:
                return self.incoming.popleft()[1]
            next_s = end_s
            if self.incoming:
                next_s = min(next_s, self.incoming[0][0])
            if self.talk.wait_s is not None:
                next_s = min(next_s, time.now_s + max(self.talk.wait_s, 1e-4))
            if next_s >= end_s and time.now_s >= end_s:
                return b""
            time.advance(min(next_s, end_s) - time.now_s)
            self._check()
            if self.talk.wait_s is not None:
                self._cable.said_at_deg.append(self._cable.world.angles_deg())
                self._send(self.talk.poll(), "")

    def close(self) -> None:
        """Hang up."""
        self.broken = True

    def _check(self) -> None:
        if self.broken:
            raise ConnectionResetError("unplugged")


class World:
    """Bench, cables and, once opened, the rig."""

    def __init__(self, *, stage: str = "zaber", backlash_deg: float = 0.0, seed: int = 0) -> None:
        text = rig_text(stage=stage, backlash_deg=backlash_deg)
        self.rng = Random(seed)
        self.time = BenchTime()
        self.backlash_deg = backlash_deg
        self.has_checksum = stage in ("zaber", "modbus-rtu")
        self.config: RigConfig = with_addresses(
            parse_rig(text), {role: f"socket://127.0.0.1:{port}" for port, role in enumerate(ROLES, 1)}
        )
        tables = parse_toml(text, source="rig.toml")
        self.bench = Bench(BenchConfig.from_tables(tomllib.loads(text)), SharedClock(self.time))
        served = plan_ports(self.bench, tables, with_pty=False, source="rig.toml")
        self.cables = {s.role: Cable(self, s.role, s.port.instrument) for s in served}
        self.motors: dict[str, Motor] = {"theta_i": self.bench.theta_i, "theta_mes": self.bench.theta_mes}
        self.watches = {
            name: PathWatch(motor, legal_deg=axis.limits_deg, blind_zone_deg=axis.blind_zone_deg)
            for (name, motor), axis in zip(
                self.motors.items(), (self.config.stage.theta_i, self.config.stage.theta_mes), strict=True
            )
        }
        self.time.watches = list(self.watches.values())

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Let drivers and simulators live in this world's time and on its cables."""
        with self.time.installed(), mock.patch.object(transport, "open_port", self._open_port):
            yield

    def open_rig(self) -> Rig:
        """Connect every device; call it, and everything after it, inside `installed`."""
        config = self.config
        context = Context(config.name, VirtualClock(virtual=self.time))
        opened: list[object] = []
        try:
            for role, table in (
                ("stage", config.stage),
                ("polarizer", config.polarizer),
                ("spectrometer", config.spectrometer),
            ):
                driver = find_driver(role, table.driver, source="world")  # type: ignore[arg-type]
                opened.append(driver.open(table, context))
        except BaseException:
            for device in opened:
                device.close()  # type: ignore[attr-defined]
            raise
        return Rig(config, *opened, clock=context.clock)  # type: ignore[arg-type]

    def angles_deg(self) -> dict[str, float]:
        """Return where the arms truly are."""
        return {name: motor.angle_deg() for name, motor in self.motors.items()} | {
            "polarizer": self.bench.polarizer.angle_deg()
        }

    def broken(self) -> list[str]:
        """Return everything that must never have happened."""
        return [what for watch in self.watches.values() for what in watch.broken]

    def _open_port(self, role: str, address: str, **_settings: object) -> Port:
        try:
            return self.cables[role].open()
        except OSError as error:
            raise transport.ConnectionFailed(f"{role} at {address}", str(error), "plug it in") from None

"""What does a driver add to each command, beside plain pyserial and pymodbus on the same line?

The same request goes out in turns, in blocks: by gonio's driver; by pyserial (write, `read_until` for each
line of the reply) or pymodbus' client; and bare, by the operating system's own calls.  Two kinds of device
answer: `gonio simulate`, and a responder that only looks a reply up, so that the device's own time can be
seen apart.  Both serve TCP and a pseudo-terminal.  Every reply is checked, outside the timed part; a wrong
one ends the run with exit code 1.

    python benchmarks/wire.py [--commands 100] [--blocks 12] [--only zaber] [--load 0] [--profile]

Times are microseconds per command, medians over blocks with half the distance of their quartiles.  The ratio
is the median of the blocks' own ratios, so that a slower minute of the machine hits both sides.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import re
import socket
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

import numpy as np
import serial
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.framer import FramerType

from gonio.clock import Clock
from gonio.rig import Context, default_rig_text
from gonio_drivers.cs260_line import CS260Line
from gonio_drivers.elliptec import ElliptecConfig, ElliptecRotator
from gonio_drivers.lines import Line, open_line
from gonio_drivers.modbus import ModbusLine, open_modbus
from gonio_drivers.sr830 import SR830, SR830Config
from gonio_drivers.transport import open_port
from gonio_drivers.zaber_protocol import ZaberLine

TARGET_RATIO = 1.3
RESPONDER = Path(__file__).with_name("wire_responder.py")
MODBUS = 'driver = "applied-motion"\nframing = "{}"'


@dataclass(frozen=True)
class Command:
    """One protocol's command, and how it is given by each side."""

    protocol: str
    title: str
    role: str
    stage: str | None  # head of the rig's stage table, if it is not the built-in one
    lines: int  # of the reply; 0: Modbus, asked by pymodbus
    open: Callable[[str, Context], tuple[Line, Callable[[], object]]]


def open_zaber(address: str, context: Context) -> tuple[Line, Callable[[], object]]:
    chain = ZaberLine(open_line("stage", address, context, baudrate=115200))
    return chain.line, lambda: chain.query(1, 1, "get pos").data


def open_registers(framing: Literal["rtu", "tcp"]) -> Any:
    def opened(address: str, context: Context) -> tuple[Line, Callable[[], object]]:
        line: ModbusLine = open_modbus(
            "stage", address, context, framing=framing, word_order="big", baudrate=115200
        )
        return line.line, lambda: line.read(1, 0, 8)

    return opened


def open_elliptec(address: str, context: Context) -> tuple[Line, Callable[[], object]]:
    line = open_line("polarizer", address, context)
    config = ElliptecConfig(driver="elliptec", s_deg=0.0, p_deg=90.0, home_on_connect=False)
    rotator = ElliptecRotator(config, context, line)
    return line, rotator.position_deg


def open_cs260(address: str, context: Context) -> tuple[Line, Callable[[], object]]:
    statements = CS260Line(open_line("monochromator", address, context))
    statements.greet()
    return statements.line, lambda: float(statements.query("WAVE?"))


def open_sr830(address: str, context: Context) -> tuple[Line, Callable[[], object]]:
    line = open_line("lockin", address, context)
    lockin = SR830(SR830Config(driver="sr830"), context, line)
    return line, lockin.read


COMMANDS = (
    Command("zaber", "zaber get pos", "stage", None, 1, open_zaber),
    Command("modbus-rtu", "modbus rtu read 8", "stage", MODBUS.format("rtu"), 0, open_registers("rtu")),
    Command("modbus-tcp", "modbus tcp read 8", "stage", MODBUS.format("tcp"), 0, open_registers("tcp")),
    Command("elliptec", "elliptec gp", "polarizer", None, 1, open_elliptec),
    Command("cs260", "cs260 WAVE?", "monochromator", None, 2, open_cs260),
    Command("sr830", "sr830 SNAP?;LIAS?", "lockin", None, 2, open_sr830),
)


# -- devices -----------------------------------------------------------------------------


@contextmanager
def serving(*command: str) -> Iterator[dict[tuple[str, str], str]]:
    """Run a process that prints ``ROLE PROTOCOL ADDRESS`` lines; addresses by role and kind of line."""
    process = subprocess.Popen(
        [sys.executable, *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        found = {}
        for line in process.stdout:
            if line.strip() == "ready":
                break
            role, _, address = line.split()
            found[role, "tcp" if "://" in address else "pty"] = address
        yield found
    finally:
        process.stdin.close()
        process.wait(10)
        process.stdout.close()


@contextmanager
def busy(n: int) -> Iterator[None]:
    """Keep `n` cores busy, as on a machine that fits or simulates beside the scan."""
    command = [sys.executable, "-c", "import time\nend = time.time() + 600\nwhile time.time() < end: pass"]
    processes = [subprocess.Popen(command) for _ in range(n)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def rig_text(stage: str | None) -> str:
    text = re.sub(r"^clock_speed = \S+", "clock_speed = 1000.0", default_rig_text(), flags=re.MULTILINE)
    return text if stage is None else text.replace('driver = "zaber"', stage, 1)


# -- three ways to ask ---------------------------------------------------------------------


class Recorder:
    """A port that remembers what went through it."""

    def __init__(self, port: Any) -> None:
        self.port = port
        self.sent = self.got = b""

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        self.sent += data
        self.port.write(data)

    def read(self, timeout_s: float) -> bytes:
        """Return what arrives first."""
        data: bytes = self.port.read(timeout_s)
        self.got += data
        return data

    def close(self) -> None:
        """Release the line."""
        self.port.close()


def host_and_port(address: str) -> tuple[str, int]:
    parts = urlsplit(address)
    assert parts.hostname is not None
    assert parts.port is not None
    return parts.hostname, parts.port


def raw_pyserial(address: str, request: bytes, terminator: bytes, lines: int) -> Any:
    port = serial.serial_for_url(address, baudrate=115200, timeout=2.0)

    def ask() -> bytes:
        port.write(request)
        return b"".join(port.read_until(terminator) for _ in range(lines))

    return ask, port.close


def raw_pymodbus(address: str, framing: str) -> Any:
    framer = FramerType.RTU if framing == "rtu" else FramerType.SOCKET
    client: Any
    if "://" in address:
        host, number = host_and_port(address)
        client = ModbusTcpClient(host, port=number, framer=framer, retries=0)
    else:
        client = ModbusSerialClient(address, baudrate=115200, retries=0)
    assert client.connect()
    return lambda: client.read_holding_registers(0, count=8, device_id=1).registers, client.close


def bare(address: str, request: bytes, is_complete: Callable[[bytes], bool]) -> Any:
    """The system's own calls: a write, and reads until the reply is there."""
    send: Callable[[bytes], object]
    receive: Callable[[int], bytes]
    if "://" in address:
        connection = socket.create_connection(host_and_port(address), timeout=2.0)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        send, receive, close = connection.sendall, connection.recv, connection.close
    else:
        descriptor = os.open(address, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(descriptor)
        send, receive = partial(os.write, descriptor), partial(os.read, descriptor)
        close = partial(os.close, descriptor)

    def ask() -> bytes:
        send(request)
        reply = b""
        while not is_complete(reply):
            reply += receive(4096)
        return reply

    return ask, close


# -- measuring -----------------------------------------------------------------------------


@dataclass
class Times:
    """Microseconds per command of each block."""

    wall: list[float]
    cpu: list[float]

    def block(self, ask: Callable[[], object], n: int) -> list[object]:
        """Give a command `n` times and return the replies, to be checked outside the timed part."""
        replies = []
        for _ in range(3):
            ask()  # the first on a new connection pays for what later ones do not
        cpu, wall = time.process_time(), time.perf_counter()
        for _ in range(n):
            replies.append(ask())  # noqa: PERF401  a comprehension is not what a driver's user writes
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        self.wall.append(1e6 * wall / n)
        self.cpu.append(1e6 * cpu / n)
        return replies


def spread(values: list[float]) -> float:
    low, high = np.percentile(values, [25, 75])
    return float(high - low) / 2.0


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    title: str
    ours: Times
    raw: Times
    bare: Times
    wrong: int

    @property
    def ratio(self) -> float:
        """How many times as long the driver takes as the library."""
        return float(np.median(np.divide(self.ours.wall, self.raw.wall)))

    def __str__(self) -> str:
        sides = (self.ours, self.raw, self.bare)
        cells = [f"{np.median(times.wall):8.0f} ±{spread(times.wall):4.0f}" for times in sides]
        cpu = [f"{np.median(times.cpu):6.0f}" for times in (self.ours, self.raw)]
        over = " " if self.ratio <= TARGET_RATIO else "*"
        return f"{self.title:<36}{''.join(cells)}{self.ratio:7.2f}{over}{''.join(cpu)}{self.wrong:7d}"


HEAD = (
    f"{'':<36}{'gonio us':>14}{'library us':>14}{'bare us':>14}{'ratio':>7} {'cpu us':>6}{'lib.':>6}"
    f"{'wrong':>7}"
)


@dataclass(frozen=True)
class Expected:
    """What a right reply is: the driver's value, and the reply's bytes; a noisy one need only look so."""

    value: object
    sent: bytes
    got: bytes
    is_noisy: bool

    def wrong(self, replies: list[object], expected: object) -> int:
        """Count the replies that are not right."""
        if not self.is_noisy:
            return sum(reply != expected for reply in replies)
        between = re.split(r"[-+]?\d[-+.e\d]*", str(expected))
        shape = r"[-+.e\d]+".join(re.escape(text) for text in between)
        return sum(re.fullmatch(shape, str(reply)) is None for reply in replies)


def look(line: Line, ask: Callable[[], object], is_noisy: bool) -> Expected:
    """Give the command once and keep what went over the line."""
    line.port = recorder = Recorder(line.port)
    value = ask()
    line.port = recorder.port
    if is_noisy:
        ask()  # the SR830's questions change their order by turns
    return Expected(value, recorder.sent, recorder.got, is_noisy)


def measure(command: Command, title: str, address: str, line: Line, ask: Any, options: Any) -> Row:
    """Ask the same thing in three ways, block by block in turns."""

    def connect() -> None:
        line.port.close()
        line.port = open_port(command.role, address, baudrate=115200)

    connect()
    right = look(line, ask, command.protocol == "sr830")
    terminator = b"\r" if right.is_noisy else b"\n"

    def is_complete(reply: bytes) -> bool:
        return reply.count(terminator) >= command.lines if command.lines else len(reply) >= len(right.got)

    ours, raw, floor = Times([], []), Times([], []), Times([], [])
    wrong = 0
    for _ in range(options.blocks):
        connect()
        wrong += right.wrong(ours.block(ask, options.commands), right.value)
        line.port.close()
        if command.lines:
            raw_ask, close = raw_pyserial(address, right.sent, terminator, command.lines)
        else:
            raw_ask, close = raw_pymodbus(address, command.protocol.removeprefix("modbus-"))
        wrong += right.wrong(
            raw.block(raw_ask, options.commands), right.got if command.lines else right.value
        )
        close()
        bare_ask, close = bare(address, right.sent, is_complete)
        wrong += right.wrong(floor.block(bare_ask, options.commands), right.got)
        close()
    connect()
    return Row(title, ours, raw, floor, wrong)


def profile(title: str, ask: Callable[[], object]) -> None:
    profiler = cProfile.Profile()
    profiler.enable()
    for _ in range(1000):
        ask()
    profiler.disable()
    print(f"\n{title}: 1000 commands under the profiler")
    pstats.Stats(profiler).sort_stats("tottime").print_stats(12)


def rows(command: Command, folder: Path, options: Any) -> Iterator[Row]:
    """Measure one protocol on both devices and both kinds of line."""
    rig = folder / f"{command.protocol}.toml"
    rig.write_text(rig_text(command.stage), encoding="utf-8")
    simulator = ("-m", "gonio_simulators", str(rig), "--until-stdin-closes", "--pty")
    with serving(*simulator) as simulated:
        kinds = [kind for kind in ("tcp", "pty") if (command.role, kind) in simulated]
        line, ask = command.open(simulated[command.role, "tcp"], Context("benchmark", Clock(speed=1000.0)))
        for kind in kinds:
            title = f"{command.title}, {kind}, simulated"
            yield measure(command, title, simulated[command.role, kind], line, ask, options)
    with serving(str(RESPONDER), command.protocol) as responder:
        for kind in kinds:
            title = f"{command.title}, {kind}, responder"
            yield measure(command, title, responder[command.role, kind], line, ask, options)
            if options.profile:
                profile(title, ask)
    line.close()


def round_trips(folder: Path) -> None:
    """Print how many requests a move and a reading take, from the lines' own statistics."""
    from gonio.rig import load_rig, open_rig, with_addresses

    print(f"\n{'round trips':<36}{'one leg':>10}{'two legs':>10}{'poll':>8}")
    maps = Path(__file__).parents[1] / "examples" / "rigs" / "arta-modbus-registers.toml"
    texts = {
        "move, zaber": rig_text(None),
        "move, applied-motion": rig_text(MODBUS.format("rtu")),
        "move, modbus-registers": maps.read_text(encoding="utf-8"),
    }
    for title, text in texts.items():
        path = folder / "rig.toml"
        path.write_text(re.sub(r"(?m)^clock_speed = \S+", "clock_speed = 1e5", text), encoding="utf-8")
        with serving("-m", "gonio_simulators", str(path), "--until-stdin-closes") as found:
            config = with_addresses(load_rig(path), {role: at for (role, _), at in found.items()})
            with open_rig(config) as rig:
                counts = moves(rig)
                print(f"{title:<36}{counts[0]:>10.2f}{counts[1]:>10.2f}{counts[2]:>8.2f}")
                if title == "move, zaber":
                    reading = readings(rig)
    print(f"{'reading, cs260 + sr830':<36}{reading[0]:>10.2f} + {reading[1]:.2f} per wavelength, pass of 100")


def moves(rig: Any) -> tuple[float, float, float]:
    """Return the replies of a move that comes from outside, of one that goes beyond first, and of a poll."""
    line = getattr(rig.stage._line, "line", rig.stage._line)

    def cost(action: Callable[[], object]) -> int:
        before = line.statistics.replies
        action()
        return int(line.statistics.replies - before)

    def go(target_deg: float) -> None:
        rig.stage.theta_i.start(target_deg)
        rig.stage.theta_i.wait()

    go(80.0)
    inward = [cost(lambda deg=deg: go(deg)) for deg in np.arange(75.0, 25.0, -5.0)]  # type: ignore[misc]
    outward = [cost(lambda deg=deg: go(deg)) for deg in np.arange(35.0, 85.0, 5.0)]  # type: ignore[misc]
    return float(np.mean(inward)), float(np.mean(outward)), float(cost(rig.stage.theta_i._drive.state))


def readings(rig: Any) -> tuple[float, float]:
    """Return the replies per wavelength of monochromator and lock-in, in a pass of one grating and filter."""
    spectrometer = rig.spectrometer
    wavelength_nm = np.linspace(450.0, 549.0, 100)
    detectors = np.zeros(100, dtype=np.uint8)
    spectrometer.measure_spectrum(wavelength_nm, detectors, beam="direct")  # finds band, port and range
    lines = spectrometer._monochromator.line, spectrometer._lockin.line
    before = [line.statistics.replies for line in lines]
    spectrometer.measure_spectrum(wavelength_nm[::-1].copy(), detectors, beam="direct")
    first, second = (line.statistics.replies - count for line, count in zip(lines, before, strict=True))
    return first / 100.0, second / 100.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--commands", type=int, default=100, help="per block (default 100)")
    parser.add_argument("--blocks", type=int, default=12, help="of each side (default 12)")
    parser.add_argument("--only", default="", help="protocols whose name contains this")
    parser.add_argument("--load", type=int, default=0, help="so many processes that keep the cores busy")
    parser.add_argument("--profile", action="store_true", help="show where the driver's time goes")
    options = parser.parse_args()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    print(
        f"{options.blocks} blocks of {options.commands} commands; * ratio above {TARGET_RATIO}; "
        f"{os.cpu_count()} cores, load {load:.1f} at the start, {options.load} more"
    )
    print(HEAD)
    wrong = 0
    with busy(options.load), tempfile.TemporaryDirectory() as name:
        for command in COMMANDS:
            if options.only in command.protocol:
                for row in rows(command, Path(name), options):
                    print(row, flush=True)
                    wrong += row.wrong
        if not options.only:
            round_trips(Path(name))
    if wrong:
        sys.exit(f"{wrong} replies were wrong")


if __name__ == "__main__":
    main()

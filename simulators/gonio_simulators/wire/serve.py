"""Which ports a rig file asks for, and serving them: one bench, one loop, one process."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field

from gonio.config import Positive, validate
from gonio.errors import ConfigError
from gonio_simulators.bench.bench import Bench
from gonio_simulators.faults.injector import Injector, PowerCycled
from gonio_simulators.wire.applied_motion import AppliedMotionLine, Framing
from gonio_simulators.wire.applied_motion_drive import WordOrder
from gonio_simulators.wire.cs260 import Cornerstone260
from gonio_simulators.wire.elliptec import Elliptec
from gonio_simulators.wire.lines import Instrument, PtyPort, TcpPort
from gonio_simulators.wire.sr830 import Sr830
from gonio_simulators.wire.zaber import ZaberChain

LOOPBACK = {"127.0.0.1", "localhost"}


class BenchInstrument(Instrument, PowerCycled, Protocol):
    """An instrument of the bench."""


class _Table(BaseModel):
    """A table shared with the drivers and the bench, whose other keys are none of our business."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class _AxisTable(_Table):
    device: Annotated[int, Field(strict=True, ge=1, le=99)]
    steps_per_rev: Positive = 20000.0


class _StageTable(_Table):
    driver: str
    address: str = "simulated"
    framing: Framing = "rtu"
    word_order: WordOrder = "big"
    theta_i: _AxisTable
    theta_mes: _AxisTable


class _DeviceTable(_Table):
    driver: str
    address: str = "simulated"


class _PolarizerTable(_DeviceTable):
    device: Annotated[str, Field(pattern="^[0-9A-F]$")] = "0"


class _SpectrometerTable(_Table):
    monochromator: _DeviceTable
    lockin: _DeviceTable


class RigPorts(_Table):
    """What the rig file says of lines."""

    stage: _StageTable
    polarizer: _PolarizerTable
    spectrometer: _SpectrometerTable


@dataclass(frozen=True, slots=True)
class Served:
    """One printed line: a port of a role and the protocol spoken there."""

    role: Literal["stage", "polarizer", "monochromator", "lockin"]
    protocol: str
    port: TcpPort | PtyPort

    def __str__(self) -> str:
        return f"{self.role} {self.protocol} {self.port.address}"


def plan_ports(
    bench: Bench,
    tables: Mapping[str, Any],
    *,
    with_pty: bool,
    source: str,
    injector: Injector | None = None,
) -> list[Served]:
    """Return the ports to be started for the rig file's raw tables, with the faults of `injector` in them.

    Raises
    ------
    ConfigError
        If a table is missing or wrong, or names a driver whose instrument has no simulator.
    """
    rig = validate(RigPorts, tables, source=source)
    spectrometer = rig.spectrometer
    wanted: list[tuple[Any, str, BenchInstrument, str]] = [
        ("stage", *_stage(bench, rig.stage, source), rig.stage.address),
        (
            "polarizer",
            *_instrument(
                {"elliptec": lambda: Elliptec(bench, address=rig.polarizer.device)},
                rig.polarizer.driver,
                f"{source}: polarizer",
            ),
            rig.polarizer.address,
        ),
        (
            "monochromator",
            *_instrument(
                {"cs260": lambda: Cornerstone260(bench)},
                spectrometer.monochromator.driver,
                f"{source}: spectrometer.monochromator",
            ),
            spectrometer.monochromator.address,
        ),
        (
            "lockin",
            *_instrument(
                {"sr830": lambda: Sr830(bench)}, spectrometer.lockin.driver, f"{source}: spectrometer.lockin"
            ),
            spectrometer.lockin.address,
        ),
    ]
    served: list[Served] = []
    for role, protocol, instrument, address in wanted:
        number = wanted_port(address, source=source)
        ports: list[TcpPort | PtyPort] = [TcpPort(instrument, bench.clock, port=number)]
        if with_pty and protocol != "modbus-tcp":
            ports.append(PtyPort(instrument, bench.clock))
        for port in ports:
            filter_ = injector.filter_for(role, protocol, instrument) if injector is not None else None
            if filter_ is not None:
                filter_.port, port.filter = port, filter_
            served.append(Served(role, protocol, port))
    return served


def wanted_port(address: str, *, source: str) -> int:
    """Return the port that an address of the rig file asks for, 0 for any free one.

    Only a TCP address of this machine can be served; a serial port or another machine stands for the real
    instrument, whose simulator gets a free port.
    """
    if "://" not in address:
        return 0
    try:
        parts = urlsplit(address)
        port = parts.port or 0
    except ValueError as error:
        raise ConfigError(
            f"{source}: address = '{address}': {error}; write it as socket://127.0.0.1:40001"
        ) from None
    return port if parts.hostname in LOOPBACK else 0


async def serve(
    ports: list[Served], stop: asyncio.Event, *, announce: Callable[[list[Served]], None]
) -> None:
    """Serve until `stop` is set; `announce` is called once everything listens.

    Raises
    ------
    ConfigError
        If a port cannot be opened; nothing stays open then.
    """
    try:
        for served in ports:
            try:
                await served.port.start()
            except ConfigError as error:
                raise ConfigError(f"{served.role}: {error}") from None
        announce(ports)
        await stop.wait()
    finally:
        for served in ports:
            served.port.close()
        await asyncio.sleep(0)  # one turn of the loop, in which the transports let go of their sockets


def _stage(bench: Bench, table: _StageTable, source: str) -> tuple[str, BenchInstrument]:
    if table.theta_i.device == table.theta_mes.device:
        raise ConfigError(
            f"{source}: stage.theta_i.device and stage.theta_mes.device are both {table.theta_i.device}; "
            "two devices on one line need two numbers"
        )
    numbers = {"theta_i": table.theta_i.device, "theta_mes": table.theta_mes.device}

    def applied_motion() -> BenchInstrument:
        return AppliedMotionLine(
            bench,
            **numbers,
            steps_per_rev=(table.theta_i.steps_per_rev, table.theta_mes.steps_per_rev),
            framing=table.framing,
            word_order=table.word_order,
        )

    makers: dict[str, Callable[[], BenchInstrument]] = {
        "zaber": lambda: ZaberChain(bench, **numbers),
        "applied-motion": applied_motion,
        "modbus-registers": applied_motion,  # a register map is tried out on the drives there are
    }
    name, instrument = _instrument(makers, table.driver, f"{source}: stage")
    return (f"modbus-{table.framing}" if name in ("applied-motion", "modbus-registers") else name), instrument


def _instrument(
    makers: Mapping[str, Callable[[], BenchInstrument]], driver: str, where: str
) -> tuple[str, BenchInstrument]:
    if driver not in makers:
        raise ConfigError(
            f"{where}.driver = '{driver}' has no simulator; simulated here: {', '.join(makers)}; "
            "use one of these in the rig file of the simulated bench"
        )
    return driver, makers[driver]()

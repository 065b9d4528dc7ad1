"""Reading a rig file: each device's table with the model of its driver, found by entry point."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from gonio.clock import Clock
from gonio.config import parse_toml, read_toml, validate
from gonio.errors import ConfigError
from gonio.rig.config import RigConfig
from gonio.rig.tables import SIMULATED, PolarizerConfig, SpectrometerConfig, StageConfig

Role = Literal["stage", "polarizer", "spectrometer"]


@dataclass(frozen=True, slots=True)
class Context:
    """What a driver is given besides its own table."""

    rig_name: str
    clock: Clock
    wire_log: Path | None = None
    reply_timeout_s: float | None = None  # real seconds; None: each driver knows what its device may take
    shared: dict[str, Any] = field(default_factory=dict)  # what the rig's drivers share: open lines


@dataclass(frozen=True, slots=True)
class Driver:
    """What the entry point ``gonio.drivers: ROLE.NAME`` must lead to."""

    role: Role
    config: type[StageConfig] | type[PolarizerConfig] | type[SpectrometerConfig]
    open: Callable[[Any, Context], Any]  # (validated config, context) -> Stage, Polarizer or Spectrometer


def find_driver(role: Role, name: str, *, source: str) -> Driver:
    """Return the installed driver; `ConfigError` lists those there are."""
    points = {p.name: p for p in importlib.metadata.entry_points(group="gonio.drivers")}
    point = points.get(f"{role}.{name}")
    if point is None:
        known = sorted(n.removeprefix(f"{role}.") for n in points if n.startswith(f"{role}."))
        raise ConfigError(
            f"{source}: {role}.driver = '{name}' is not installed; installed {role} drivers: "
            f"{', '.join(known) or 'none'}"
        )
    driver = point.load()
    if not isinstance(driver, Driver) or driver.role != role:
        raise ConfigError(
            f"{source}: the entry point {point.name} = {point.value} is not a gonio {role} driver; correct it"
        )
    return driver


def default_rig_text() -> str:
    """Return the text of the built-in rig file, the simulated ARTA."""
    return resources.files("gonio").joinpath("data/arta.toml").read_text(encoding="utf-8")


def load_rig(path: str | Path | None = None) -> RigConfig:
    """Return the validated rig file, or the simulated ARTA without one; `ConfigError` lists every mistake."""
    if path is None:
        return parse_rig(default_rig_text(), source="arta.toml (built in)")
    path = Path(path)
    read_toml(path)  # for its message if the file cannot be read
    return parse_rig(path.read_text(encoding="utf-8"), source=str(path))


def parse_rig(text: str, *, source: str = "rig.toml") -> RigConfig:
    """Return validated rig text; `ConfigError` lists every mistake."""
    tables = parse_toml(text, source=source)
    if "text" in tables:
        raise ConfigError(f"{source}: text is an unknown key; remove it")
    devices: dict[str, Any] = {}
    for role in ("stage", "polarizer", "spectrometer"):
        table = tables.get(role)
        if isinstance(table, dict) and isinstance(table.get("driver"), str):
            driver = find_driver(role, table["driver"], source=source)
            devices[role] = validate(driver.config, table, source=source, prefix=role)
    return validate(RigConfig, {**tables, **devices, "text": text}, source=source)


def with_addresses(config: RigConfig, addresses: Mapping[str, str]) -> RigConfig:
    """Return the rig with its simulated addresses replaced by those the simulator printed, by role.

    `text` is left as the user wrote it: the port of a simulator is of no use in a stored file.
    """
    # each with its own model: dumped from the rig they would lose what the driver's model adds
    tables = {role: getattr(config, role).model_dump() for role in ("stage", "polarizer", "spectrometer")}

    def replace(table: dict[str, Any], role: str) -> None:
        for key, value in table.items():
            if key == "address" and value == SIMULATED and role in addresses:
                table[key] = addresses[role]
            elif isinstance(value, dict):
                replace(value, key if key in addresses else role)

    for role in ("stage", "polarizer", "spectrometer"):
        replace(tables[role], role)
    return config.model_copy(
        update={
            "stage": type(config.stage).model_validate(tables["stage"]),
            "polarizer": type(config.polarizer).model_validate(tables["polarizer"]),
            "spectrometer": type(config.spectrometer).model_validate(tables["spectrometer"]),
        }
    )

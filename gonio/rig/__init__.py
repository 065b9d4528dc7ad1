"""The rig: what `rig.toml` says, the checks made before anything moves, and the devices put together.

`load_rig` reads and validates the file (each device's table with the model of its driver), `RigConfig`
answers every question that needs no hardware, `open_rig` connects.  The default file is the simulated ARTA,
`gonio/data/arta.toml`.
"""

from __future__ import annotations

from gonio.rig.config import RigConfig
from gonio.rig.connected import Rig, open_rig
from gonio.rig.limits import check_path, check_target
from gonio.rig.loading import (
    Context,
    Driver,
    Role,
    default_rig_text,
    find_driver,
    load_rig,
    parse_rig,
    with_addresses,
)
from gonio.rig.tables import (
    SIMULATED,
    ApertureConfig,
    AxisConfig,
    BaselineConfig,
    BeamConfig,
    DetectorConfig,
    DeviceConfig,
    PolarizerConfig,
    SpectrometerConfig,
    StageConfig,
    WireConfig,
)

__all__ = [
    "SIMULATED",
    "ApertureConfig",
    "AxisConfig",
    "BaselineConfig",
    "BeamConfig",
    "Context",
    "DetectorConfig",
    "DeviceConfig",
    "Driver",
    "PolarizerConfig",
    "Rig",
    "RigConfig",
    "Role",
    "SpectrometerConfig",
    "StageConfig",
    "WireConfig",
    "check_path",
    "check_target",
    "default_rig_text",
    "find_driver",
    "load_rig",
    "open_rig",
    "parse_rig",
    "with_addresses",
]

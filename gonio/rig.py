"""The rig: what `rig.toml` says, the checks made before anything moves, and the devices put together.

`load_rig` reads and validates the file (each device's table with the model of its driver), `RigConfig`
answers every question that needs no hardware, `open_rig` connects.  The default file is the simulated ARTA,
`gonio/data/arta.toml`.
"""

from __future__ import annotations

import importlib.metadata
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gonio.clock import Clock
from gonio.config import NotNegative, Number, Positive, Strict, parse_toml, read_toml, validate
from gonio.devices import (
    Beam,
    FloatArray,
    Polarizer,
    Recoverable,
    Spectrometer,
    Stage,
    StillPolarizer,
    StillStage,
)
from gonio.errors import ConfigError, DeviceError, RefusedError
from gonio.latency import LatencyConfig, PassTime

Role = Literal["stage", "polarizer", "spectrometer"]

SIMULATED = "simulated"
"""Address of a device that `gonio` serves itself, by starting the simulated bench."""


class ApertureConfig(Strict):
    """The detector's rectangular aperture, as measured with a ruler."""

    width_mm: Positive  # in the plane of incidence
    height_mm: Positive
    distance_mm: Positive  # from the sample's axis


class AxisConfig(Strict):
    """What the program must know of an axis, whoever made it; a driver's model adds its own keys."""

    limits_deg: tuple[Number, Number]
    speed_deg_s: Positive = 20.0
    acceleration_deg_s2: Positive = 100.0
    tolerance_deg: Positive = 0.01
    backlash_deg: NotNegative = 0.0  # overshoot by which every target is approached from the same side
    settle_s: NotNegative = 0.0
    blind_zone_deg: NotNegative = 0.0  # |angle| below this is forbidden

    @model_validator(mode="after")
    def _limits_in_order(self) -> Self:
        low, high = self.limits_deg
        if not low < high:
            raise ValueError(
                f"limits_deg = [{low}, {high}] deg: the first must be below the second; swap or correct them"
            )
        return self

    def move_duration_s(self, distance_deg: float) -> float:
        """Return the time of a trapezoidal (or triangular) velocity profile, settling included, seconds."""
        distance = abs(distance_deg)
        ramp = self.speed_deg_s**2 / self.acceleration_deg_s2
        if distance <= ramp:
            return float(2.0 * np.sqrt(distance / self.acceleration_deg_s2)) + self.settle_s
        return distance / self.speed_deg_s + self.speed_deg_s / self.acceleration_deg_s2 + self.settle_s


class DeviceConfig(Strict):
    """Keys every device table has."""

    driver: str
    address: str = SIMULATED


class StageConfig(DeviceConfig):
    """The goniometer; a driver's model narrows the axis types."""

    theta_i: AxisConfig
    theta_mes: AxisConfig


class PolarizerConfig(DeviceConfig):
    """The polarizer rotator and its two working angles."""

    s_deg: Number
    p_deg: Number
    turn_s: NotNegative = 0.32  # from one to the other, for the estimate; an ELL14 turns 90 deg in that


class DetectorConfig(Strict):
    """One detector and the wavelengths it is used for; `range_nm` is closed below and open above, but for
    the last.
    """

    name: str
    type: str  # PMT, InGaAs, PbS, Si
    range_nm: tuple[Positive, Positive]


class SpectrometerConfig(Strict):
    """The spectrometer; a driver's model adds its parts and their addresses."""

    driver: str
    detectors: tuple[DetectorConfig, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _ranges_meet(self) -> Self:
        for detector in self.detectors:
            low, high = detector.range_nm
            if not low < high:
                raise ValueError(
                    f"detector '{detector.name}': range_nm = [{low}, {high}] nm must ascend; correct it"
                )
        for first, second in zip(self.detectors, self.detectors[1:], strict=False):
            if second.range_nm[0] < first.range_nm[1]:
                raise ValueError(
                    f"detectors '{first.name}' and '{second.name}' overlap between {second.range_nm[0]} and "
                    f"{first.range_nm[1]} nm; list them in ascending order with ranges that meet"
                )
        return self

    def addresses(self) -> dict[str, str]:
        """Return the addresses by role, such as ``{"monochromator": ..., "lockin": ...}``; a driver's
        model overrides.
        """
        return {}

    def averages_for(self, integration_s: float) -> int:
        """Return how many readings, averaged, fill an integration time; a driver's model overrides."""
        return max(1, int(np.ceil(integration_s - 1e-9)))

    def reading_duration_s(self, wavelength_nm: FloatArray, averages: int | NDArray[np.integer]) -> float:
        """Return the estimated instrument time of one pass, seconds; a driver's model overrides."""
        return float(np.sum(np.broadcast_to(averages, np.shape(wavelength_nm))))

    def pass_time(
        self,
        wavelength_nm: FloatArray,
        detector_index: NDArray[np.uint8],
        averages: int | NDArray[np.integer],
        *,
        beam: Beam = "sample",
        after: tuple[float, int] | None = None,
        first: bool = False,
    ) -> PassTime:
        """Return what one pass takes, for estimates; a driver's model overrides.

        Parameters
        ----------
        wavelength_nm, detector_index, averages
            As in `Spectrometer.measure_spectrum`.
        after
            Wavelength in nm and detector of the reading before; None if it is not known.
        first
            Whether it is the first pass of this beam, when the amplifier's range must still be found.
        """
        del detector_index, beam, after, first
        return PassTime(self.reading_duration_s(wavelength_nm, averages))


class WireConfig(Strict):
    """``[wire]``: what holds for every line of the rig."""

    reply_timeout_s: Positive | None = None  # real seconds for a whole reply; by default 1 (Modbus) or 2


class BaselineConfig(Strict):
    """Where the direct beam is measured: the sample edge-on, out of the beam, the arm facing the source."""

    theta_i_deg: Number = 90.0
    theta_mes_deg: Number = 180.0


class RigConfig(Strict):
    """A validated `rig.toml`; `text` is the file itself, which every scan stores."""

    name: str
    aperture: ApertureConfig
    baseline: BaselineConfig = BaselineConfig()
    stage: StageConfig
    polarizer: PolarizerConfig
    spectrometer: SpectrometerConfig
    latency: LatencyConfig = LatencyConfig()
    wire: WireConfig = WireConfig()
    simulation: Mapping[str, Any] | None = None
    text: str = ""

    # -- questions that need no hardware
    # -------------------------------------------------------------------------

    def check_axis_target(self, axis: Literal["theta_i", "theta_mes"], target_deg: float) -> None:
        """Raise `RefusedError` if the axis must not stand at `target_deg`."""
        config = self.stage.theta_i if axis == "theta_i" else self.stage.theta_mes
        check_target(axis, config, target_deg, rig_name=self.name)

    def check_position(self, theta_i_deg: float, theta_mes_deg: float) -> None:
        """Raise `RefusedError` if the rig must not stand at this pair of angles."""
        self.check_axis_target("theta_i", theta_i_deg)
        self.check_axis_target("theta_mes", theta_mes_deg)

    def detector_for(self, wavelength_nm: FloatArray) -> NDArray[np.uint8]:
        """Return the index of the detector that covers each wavelength; `RefusedError` where none does."""
        detectors = self.spectrometer.detectors
        wavelength_nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=np.float64))
        index = np.full(wavelength_nm.shape, 255, dtype=np.uint8)
        for i in reversed(range(len(detectors))):
            low, high = detectors[i].range_nm
            last = i == len(detectors) - 1 or detectors[i + 1].range_nm[0] > high
            index[(wavelength_nm >= low) & ((wavelength_nm <= high) if last else (wavelength_nm < high))] = i
        if np.any(index == 255):
            bad = float(wavelength_nm[index == 255][0])
            covered = ", ".join(f"{d.name} {d.range_nm[0]:g}-{d.range_nm[1]:g} nm" for d in detectors)
            raise RefusedError(
                f"wavelength = {bad:g} nm is covered by no detector of rig '{self.name}' ({covered}); "
                "choose wavelengths in these ranges"
            )
        return index

    def addresses(self) -> dict[str, str]:
        """Return every address by the role it plays on the wire."""
        return {
            "stage": self.stage.address,
            "polarizer": self.polarizer.address,
            **self.spectrometer.addresses(),
        }

    def is_simulated(self) -> bool:
        """Say whether every device is to be served by the simulated bench that the program starts itself."""
        return all(address == SIMULATED for address in self.addresses().values())

    def clock_speed(self) -> float:
        """Return how fast instrument time runs; only a simulated bench may differ from 1.0."""
        speed = float((self.simulation or {}).get("clock_speed", 1.0))
        if speed != 1.0:
            for role, address in self.addresses().items():
                if not _may_be_simulated(address):
                    raise ConfigError(
                        f"rig '{self.name}': [simulation] clock_speed = {speed:g} but the {role} at "
                        f"{address} is real hardware, whose settling would be cut short; remove [simulation] "
                        "from the file"
                    )
        return speed


def _may_be_simulated(address: str) -> bool:
    return (
        address == SIMULATED
        or address.startswith("/dev/pts/")
        or urlsplit(address).hostname in {"127.0.0.1", "localhost", "::1"}
    )


def check_target(axis: str, config: AxisConfig, target_deg: float, *, rig_name: str) -> None:
    """Raise `RefusedError` if `target_deg` is not a number, beyond the limits or inside the blind zone."""
    low, high = config.limits_deg
    if not np.isfinite(target_deg):
        raise RefusedError(f"{axis} = {target_deg} deg is not an angle; give a finite number of degrees")
    zone = config.blind_zone_deg
    if abs(target_deg) < zone:
        edge = zone if high >= zone else -zone
        raise RefusedError(
            f"{axis} = {target_deg:g} deg is inside the blind zone (|{axis}| < {zone:g} deg) of rig "
            f"'{rig_name}'; start the sweep at {edge:g}"
        )
    if not low <= target_deg <= high:
        raise RefusedError(
            f"{axis} = {target_deg:g} deg is outside the limits {low:g}...{high:g} deg of rig '{rig_name}'; "
            "choose an angle between them"
        )


def check_path(axis: str, config: AxisConfig, from_deg: float, target_deg: float, *, rig_name: str) -> None:
    """Raise `RefusedError` if the straight way between two angles sweeps through the blind zone.

    An axis that stands inside the zone (after a limit switch or by hand) may leave it on its own side.
    """
    zone = config.blind_zone_deg
    crosses = from_deg * target_deg < 0
    if zone > 0 and crosses:
        raise RefusedError(
            f"{axis}: the way from {from_deg:g} to {target_deg:g} deg sweeps through the blind zone "
            f"(|{axis}| < {zone:g} deg) of rig '{rig_name}'; measure the two sides "
            "in separate scans, or turn the sample instead"
        )


# -- drivers
# ------------------------------------------------------------------------------------------------------


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


# -- the connected rig
# --------------------------------------------------------------------------------------------


@dataclass
class Rig:
    """Connected devices; use as a context manager, which stops the motors and closes the shutter on every
    exit.  A rig that is forgotten, or alive when the program ends, does the same then.
    """

    config: RigConfig
    stage: Stage
    polarizer: Polarizer
    spectrometer: Spectrometer
    clock: Clock = field(default_factory=Clock)

    def __post_init__(self) -> None:
        self._closer = weakref.finalize(self, _close_all, self.stage, self.polarizer, self.spectrometer)

    def move_to(self, theta_i_deg: float, theta_mes_deg: float) -> tuple[float, float]:
        """Move both axes at once and return their verified read-backs in degrees.

        `RefusedError` before a byte is sent if either target is not allowed, and before anything moves if a
        path is not; `MotionError` if a move does not end where it should.
        """
        self.begin_move(theta_i_deg, theta_mes_deg)
        return self.finish_move()

    def begin_move(self, theta_i_deg: float, theta_mes_deg: float) -> None:
        """Begin the motion of both axes; `finish_move` completes it.  Raises as `move_to`."""
        self.config.check_position(theta_i_deg, theta_mes_deg)
        arm = self.config.stage.theta_mes
        if arm.blind_zone_deg > 0 and arm.limits_deg[0] < 0 < arm.limits_deg[1]:
            # The sample must not turn for an arm that then may not: it could have to pass the zone.
            here_deg = self.stage.theta_mes.position_deg()
            check_path("theta_mes", arm, here_deg, theta_mes_deg, rig_name=self.config.name)
        try:
            self.stage.theta_i.start(theta_i_deg)
            self.stage.theta_mes.start(theta_mes_deg)
        except BaseException:
            self.stage.stop()
            raise

    def finish_move(self) -> tuple[float, float]:
        """Wait for both axes and return their verified read-backs in degrees."""
        try:
            return self.stage.theta_i.wait(), self.stage.theta_mes.wait()
        except BaseException:
            self.stage.stop()
            raise

    def verify_still(self, theta_i_deg: float, theta_mes_deg: float, polarizer_deg: float | None) -> None:
        """Make sure that nothing has turned since these read-backs; None leaves the polarizer out.

        A reading belongs to its angles only if they are still true at its end: a hand on a knob, or a drive
        that restarted, is found out here.  Devices that cannot say are believed.

        Raises
        ------
        MotionError
            An axis or the polarizer stands elsewhere than it did.
        """
        if isinstance(self.stage, StillStage):
            self.stage.verify_still(theta_i_deg, theta_mes_deg)
        if polarizer_deg is not None and isinstance(self.polarizer, StillPolarizer):
            self.polarizer.verify_still(polarizer_deg)

    def recover(self) -> list[str]:
        """Bring every device back to a known state after a failure; return what had to be done, for events.

        One attempt, in the order in which nothing can be hurt: shutter, motors, polarizer.  A device whose
        driver cannot recover is left as it is.

        Raises
        ------
        DeviceError
            A device does not answer (yet), is another one, or keeps its fault.
        """
        done = []
        for name, device in (
            ("spectrometer", self.spectrometer),
            ("stage", self.stage),
            ("polarizer", self.polarizer),
        ):
            if isinstance(device, Recoverable) and (what := device.recover()):
                done.append(f"{name}: {what}")
        return done

    def stop(self) -> None:
        """Stop all motion; callable from any thread, at any time, any number of times."""
        self.stage.stop()
        self.polarizer.stop()
        self.spectrometer.stop()

    def close(self) -> None:
        """Stop the motors, close the shutter and release every line, whatever fails on the way."""
        self._closer()  # at most once

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _close_all(stage: Stage, polarizer: Polarizer, spectrometer: Spectrometer) -> None:
    for action in (
        stage.stop,
        spectrometer.close_shutter,
        stage.close,
        polarizer.close,
        spectrometer.close,
    ):
        try:
            action()
        except DeviceError:
            continue  # a dead line must not keep the others open


def open_rig(config: RigConfig, *, wire_log: Path | None = None) -> Rig:
    """Connect every device of the rig; `ConnectionFailed` names the one that does not answer.

    Addresses that are still ``simulated`` must have been replaced first (`with_addresses`).
    """
    context = Context(
        rig_name=config.name,
        clock=Clock(config.clock_speed()),
        wire_log=wire_log,
        reply_timeout_s=config.wire.reply_timeout_s,
    )
    opened: list[Any] = []
    try:
        for role, table in (
            ("stage", config.stage),
            ("polarizer", config.polarizer),
            ("spectrometer", config.spectrometer),
        ):
            driver = find_driver(role, table.driver, source=f"rig '{config.name}'")  # type: ignore[arg-type]
            opened.append(driver.open(table, context))
    except BaseException:
        for device in reversed(opened):
            device.close()
        raise
    stage, polarizer, spectrometer = opened
    return Rig(config, stage, polarizer, spectrometer, clock=context.clock)

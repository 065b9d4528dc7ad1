"""The goniometer on two Zaber X-RST rotary stages: ``stage.driver = "zaber"``.

Both stages share one chain, so one line.  Every reply carries BUSY or IDLE and the most important warning
flag, so a single ``get pos`` is position, motion and fault of the same instant.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from gonio.config import Count, Number
from gonio.errors import DeviceError
from gonio.rig import Context, Driver, StageConfig
from gonio_drivers.axis import MotorAxis
from gonio_drivers.drive import DriveState, MotorConfig
from gonio_drivers.lines import connecting, open_line
from gonio_drivers.stage import MotorStage
from gonio_drivers.zaber_protocol import ZaberLine

# Units of the settings maxspeed and accel (ASCII Protocol Manual): 1.6384 per microstep/s, and that over 10
# 000 per # microstep/s2, from the controller's 10 kHz loop and 14 fractional bits.
SPEED_UNITS_PER_STEP_S = 1.6384
ACCELERATION_UNITS_PER_STEP_S2 = 1.6384e-4

_NO_REFERENCE = {"WR", "WH"}

_FAULTS: Mapping[str, tuple[str, str]] = {
    "FF": ("critical system error", "switch the stage off and on; if it stays, call the manufacturer"),
    "FN": ("its peripheral is not supported", "check what is plugged into the controller"),
    "FZ": ("its peripheral is inactive", "activate it with the manufacturer's software"),
    "FH": ("the hardware emergency stop was pressed", "release the emergency stop, then home and repeat"),
    "FV": ("the supply voltage is out of range and the driver was switched off", "check the power supply"),
    "FO": ("the driver is off", "check the power supply and enable the driver"),
    "FD": ("the motor driver is disabled", "let it cool, check the power supply, then enable the driver"),
    "FC": (
        "the current is too high and the driver was switched off",
        "check the motor for a short or a block",
    ),
    "FM": ("the motor is too hot", "let it cool"),
    "FT": ("the driver is too hot", "let it cool"),
    "FQ": ("the encoder failed", "check the encoder's cable, then home the axis"),
    "FI": ("the index was not found", "home the axis"),
    "FS": ("it stalled and stopped", "remove what blocks it, then home the axis and repeat"),
    "FE": ("it met a limit switch", "check limits_deg and zero_deg in the rig file, then home the axis"),
    "FB": ("it was moved by an interfering load", "remove what pushes it, then home the axis"),
    "FP": ("a motion limit was exceeded", "lower speed_deg_s and acceleration_deg_s2 in the rig file"),
    "NC": ("it is moved by its manual control", "leave the knob alone, then repeat"),
    "NI": ("the move was interrupted by its knob or another program", "leave the stage alone, then repeat"),
    "WM": ("it was displaced while it stood", "find out what pushed it, then home the axis"),
}


class ZaberAxisConfig(MotorConfig):
    """One stage of the chain."""

    device: Annotated[int, Field(strict=True, ge=1, le=99)]
    axis: Annotated[int, Field(strict=True, ge=1, le=9)] = 1
    steps_per_deg: Number  # microsteps; X-RST at its default resolution: 4266.67


class ZaberStageConfig(StageConfig):
    """``[stage]`` with ``driver = "zaber"``."""

    baudrate: Count = 115200
    checksums: bool = True
    theta_i: ZaberAxisConfig
    theta_mes: ZaberAxisConfig


class ZaberDrive:
    """One axis of one device on the chain; a `gonio_drivers.axis.Drive`."""

    start_latency_s = 0.0  # the reply to a move command says BUSY already
    reports_reference = True  # flag WR

    def __init__(self, line: ZaberLine, name: str, config: ZaberAxisConfig) -> None:
        self._line = line
        self._device = config.device
        self._axis = config.axis
        self.device = f"{name} (Zaber device {config.device}) on the {line.line.device}"
        self._config = config
        self._identity: tuple[str, str, str] | None = None
        self._set_speeds()

    def describe(self) -> str:
        """Return model number, serial number and firmware."""
        self._identity = model, serial, firmware = self._identify()
        return f"Zaber device {self._device}, id {model}, serial {serial}, firmware {firmware}"

    def resume(self) -> None:
        """Check that the same device answers, and set its speeds again; a lost reference is its flag WR."""
        before, now = self._identity, self._identify()
        if before is not None and now != before:
            raise DeviceError(
                self.device,
                f"is another device now: id {now[0]}, serial {now[1]} instead of id {before[0]}, "
                f"serial {before[1]}",
                "restore the chain as it was, or open the rig again",
            )
        self._set_speeds()

    def confirm(self) -> str | None:
        """Nothing to ask: every reply carries the flags that tell of a lost reference."""
        return None

    def state(self) -> DriveState:
        """Ask for position, motion and faults in one reply, and for all flags if one might hide a fault."""
        reply = self._line.query(self._device, self._axis, "get pos")
        try:
            position_steps = int(reply.data)
        except ValueError:
            raise DeviceError(
                self.device, f"gave '{reply.data}' as its position", "check the stage's firmware"
            ) from None
        if reply.flag == "--":
            return DriveState(position_steps, reply.busy, True, None)
        flags = self._flags()
        referenced = not _NO_REFERENCE.intersection(flags)
        for flag in flags:
            if flag in _FAULTS or flag.startswith("F"):
                fault, remedy = _FAULTS.get(
                    flag, ("an unknown fault", "look the flag up in the manufacturer's manual")
                )
                return DriveState(position_steps, reply.busy, referenced, f"{fault} (flag {flag})", remedy)
        return DriveState(position_steps, reply.busy, referenced, None)

    def clear_faults(self) -> None:
        """Clear the flags that wait to be acknowledged; those that persist come back with the next poll."""
        self._line.query(self._device, self._axis, "warnings clear")

    def move_to(self, position_steps: int) -> None:
        """Begin an absolute move."""
        self._line.command(self._device, self._axis, f"move abs {position_steps}")

    def home(self) -> None:
        """Begin the search for the home switch."""
        self._line.command(self._device, self._axis, "home")

    def finish_home(self) -> None:
        """Acknowledge the flags that the search may have raised; the controller sets its own zero."""
        self.clear_faults()

    def stop(self) -> None:
        """Decelerate and stop; harmless when idle, so repeated if the reply fails."""
        self._line.query(self._device, self._axis, "stop")

    def _flags(self) -> list[str]:
        """Return all active flags, most important first (``warnings`` answers ``02 FS WR``)."""
        return self._line.query(self._device, self._axis, "warnings").data.split()[1:]

    def _identify(self) -> tuple[str, str, str]:
        model, serial, firmware = (
            self._line.query(self._device, 0, f"get {setting}").data
            for setting in ("deviceid", "system.serial", "version")
        )
        return model, serial, firmware

    def _set_speeds(self) -> None:
        config = self._config
        steps_per_deg = abs(config.steps_per_deg)
        self._set("maxspeed", config.speed_deg_s * steps_per_deg * SPEED_UNITS_PER_STEP_S)
        self._set("accel", config.acceleration_deg_s2 * steps_per_deg * ACCELERATION_UNITS_PER_STEP_S2)

    def _set(self, setting: str, value: float) -> None:
        wanted = max(1, round(value))
        self._line.query(self._device, self._axis, f"set {setting} {wanted}")
        got = self._line.query(self._device, self._axis, f"get {setting}").data
        if got != str(wanted):
            raise DeviceError(
                self.device,
                f"was told {setting} = {wanted} and reads {got}",
                "lower speed_deg_s and acceleration_deg_s2 in the rig file",
            )


def open_stage(config: ZaberStageConfig, context: Context) -> MotorStage:
    """Connect, set speeds, and home the axes that have no reference.

    Raises
    ------
    ConnectionFailed
        The address cannot be opened.
    DeviceError
        A device does not answer, refuses its speed, or does not find its reference.
    """
    line = ZaberLine(
        open_line("stage", config.address, context, protocol="zaber", baudrate=config.baudrate),
        checksums=config.checksums,
    )
    with connecting(line.line):
        drives = {
            name: ZaberDrive(line, name, table)
            for name, table in (("theta_i", config.theta_i), ("theta_mes", config.theta_mes))
        }
        stage = MotorStage(
            MotorAxis("theta_i", config.theta_i, drives["theta_i"], context),
            MotorAxis("theta_mes", config.theta_mes, drives["theta_mes"], context),
            line=line.line,
            descriptions={name: drive.describe() for name, drive in drives.items()},
        )
        stage.home_where_needed()
    return stage


driver = Driver("stage", ZaberStageConfig, open_stage)

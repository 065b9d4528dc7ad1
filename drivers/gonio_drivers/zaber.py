"""The goniometer on two Zaber X-RST rotary stages: ``stage.driver = "zaber"``.

Both stages share one chain, so one line.  Every reply carries BUSY or IDLE and the most important warning
flag, so a single ``get pos`` is position, motion and fault of the same instant.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from gonio.config import Count, Number, Positive
from gonio.errors import DeviceError, ReplyError
from gonio.rig import Context, Driver, StageConfig
from gonio_drivers.decimals import fixed
from gonio_drivers.drive import DriveState, MotorConfig
from gonio_drivers.lines import open_line
from gonio_drivers.stage import MotorStage
from gonio_drivers.two_axes import open_two_axes
from gonio_drivers.zaber_flags import fault_of, is_referenced
from gonio_drivers.zaber_protocol import ZaberLine

# Units of the settings maxspeed and accel (ASCII Protocol Manual): 1.6384 per microstep/s, and that over 10
# 000 per # microstep/s2, from the controller's 10 kHz loop and 14 fractional bits.
SPEED_UNITS_PER_STEP_S = 1.6384
ACCELERATION_UNITS_PER_STEP_S2 = 1.6384e-4
_ROUNDING = 0.01  # by which a device may round a speed

_ENCODER_TOLERANCES = 3.0  # how far encoder and counter may differ, in tolerances of the axis


class ZaberAxisConfig(MotorConfig):
    """One stage of the chain."""

    device: Annotated[int, Field(strict=True, ge=1, le=99)]
    axis: Annotated[int, Field(strict=True, ge=1, le=9)] = 1
    steps_per_deg: Number  # microsteps; X-RST at its default resolution: 4266.67
    stage_turn_deg: Positive = 360.0  # of the axis in one turn of the stage; another number behind a gear


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
        self._has_encoder: bool | None = None  # not asked yet
        self._encoder_agrees = False  # it has, somewhere else than at zero
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

    def confirm(self, position_steps: int) -> str | None:
        """Ask the encoder, if there is one: a controller that counts steps does not notice those it lost.

        A lost reference needs no asking, every reply carries its flag.
        """
        if self._has_encoder is False:
            return None
        try:
            encoder_steps = round(fixed(self._line.query(self._device, self._axis, "get encoder.pos").data))
        except ReplyError:
            raise
        except (DeviceError, ValueError):  # it does not know the setting: an open-loop stage
            self._has_encoder = False
            return None
        self._has_encoder = True
        lost_steps = encoder_steps - position_steps
        # A stepping motor loses whole electrical turns: four full steps, 0.06 deg of an X-RST.
        allowed_steps = _ENCODER_TOLERANCES * self._config.tolerance_deg * abs(self._config.steps_per_deg)
        if abs(lost_steps) <= allowed_steps:
            self._encoder_agrees |= abs(position_steps) > allowed_steps
            return None
        if encoder_steps == 0 and not self._encoder_agrees:  # it never did: a zero where there is no encoder
            self._has_encoder = False
            return None
        return f"its encoder is {lost_steps} steps off its counter: it lost steps on its way"

    def state(self) -> DriveState:
        """Ask for position, motion and faults in one reply, and for all flags if one might hide a fault."""
        reply = self._line.query(self._device, self._axis, "get pos")
        position = _number(reply.data)
        if position is None:
            raise DeviceError(
                self.device, f"gave '{reply.data}' as its position", "check the stage's firmware"
            )
        position_steps = round(position)
        if reply.flag == "--":
            return DriveState(position_steps, reply.busy, True, None)
        flags = self._flags(reply.flag)
        fault, remedy = fault_of(flags)
        return DriveState(position_steps, reply.busy, is_referenced(flags), fault, remedy)

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

    def _flags(self, seen: str) -> list[str]:
        """Return all active flags, most important first, and the one just seen, which may have gone since.

        ``warnings`` answers ``02 FS WR``, or ``00`` without any.
        """
        words = self._line.query(self._device, self._axis, "warnings").data.split()
        flags = [word for word in words if len(word) == 2 and word[0].isalpha()]
        return flags if seen in flags else [seen, *flags]

    def check_travel(self) -> None:
        """Compare scale and limits of the rig file with the stage's own, as far as its firmware tells them.

        Raises
        ------
        DeviceError
            One turn of the stage is another number of microsteps than `steps_per_deg` says, so that every
            angle would be wrong; or the stage does not travel as far as `limits_deg`.
        """
        scale = abs(self._config.steps_per_deg)
        turn = self._setting("limit.cycle.dist")
        expected = scale * self._config.stage_turn_deg
        if turn is not None and turn > 0 and abs(turn - expected) > 1e-3 * expected:
            resolution = self._setting("resolution")
            told = "" if resolution is None else f" at a resolution of {resolution:g}"
            raise DeviceError(
                self.device,
                f"turns once in {turn:g} microsteps{told}, the rig file says {expected:g} "
                f"({scale:g} steps/deg x {self._config.stage_turn_deg:g} deg)",
                f"write steps_per_deg = +-{turn / self._config.stage_turn_deg:.6g}, set the stage's "
                "resolution, or give stage_turn_deg of a gear",
            )
        low, high = self._setting("limit.min"), self._setting("limit.max")
        if low is None or high is None or not low < high:
            return
        ends = [self._config.zero_deg + steps / self._config.steps_per_deg for steps in (low, high)]
        near_deg, far_deg = min(ends), max(ends)
        slack_deg = self._config.tolerance_deg
        asked = self._config.limits_deg
        if asked[0] < near_deg - slack_deg or asked[1] > far_deg + slack_deg:
            raise DeviceError(
                self.device,
                f"travels from {near_deg:.6g} to {far_deg:.6g} deg (limit.min {low:g}, limit.max {high:g}), "
                f"less than limits_deg = [{asked[0]:g}, {asked[1]:g}]",
                "narrow limits_deg in the rig file, correct zero_deg, or widen the stage's limits",
            )

    def _setting(self, name: str) -> float | None:
        """Return a setting, None if the firmware does not have it."""
        try:
            return _number(self._line.query(self._device, self._axis, f"get {name}").data)
        except ReplyError:
            raise
        except DeviceError:
            return None

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
        acceleration = config.acceleration_deg_s2 * steps_per_deg * ACCELERATION_UNITS_PER_STEP_S2
        try:
            self._set("accel", acceleration)
        except ReplyError:
            raise
        except DeviceError:
            # Where the two ramps are settings of their own, the common one may be missing or read NA.
            if self._setting("motion.accelonly") is None:
                raise
            for setting in ("motion.accelonly", "motion.decelonly"):
                self._set(setting, acceleration)

    def _set(self, setting: str, value: float) -> None:
        wanted = max(1, round(value))
        self._line.query(self._device, self._axis, f"set {setting} {wanted}")
        got = self._line.query(self._device, self._axis, f"get {setting}").data
        number = _number(got)
        # Devices round to what their clock can do: estimates bear that, a limit of the device they do not.
        if number is None or abs(number - wanted) > max(1.0, _ROUNDING * wanted):
            raise DeviceError(
                self.device,
                f"was told {setting} = {wanted} and reads {got}",
                "lower speed_deg_s and acceleration_deg_s2 in the rig file",
            )


def _number(data: str) -> float | None:
    """Return a reply's first number (a whole one, or with decimals), None if it is none."""
    try:
        return fixed(data.split()[0])
    except (ValueError, IndexError):
        return None


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

    def make(name: str, table: ZaberAxisConfig) -> ZaberDrive:
        drive = ZaberDrive(line, name, table)
        drive.check_travel()
        return drive

    return open_two_axes(config, context, line.line, make)


driver = Driver("stage", ZaberStageConfig, open_stage)

"""One Zaber X-RST rotary stage with firmware 7: which command moves it, its settings, its warning flags.

Distances are microsteps.  Speeds on the wire are microsteps per second times 1.6384, accelerations
microsteps per second squared times 1.6384 / 10000 (Zaber's units of firmware 7).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gonio_simulators.bench.motor import Fault, Motor
from gonio_simulators.wire.zaber_message import Request, format_alert, format_reply

SPEED_UNIT = 1.6384
ACCELERATION_UNIT = 1.6384 / 10000.0
RESOLUTION = 64  # microsteps per full step
STEPS_PER_REVOLUTION = 1_536_000  # 360 deg of an X-RST at the default resolution
MAX_SPEED = RESOLUTION * 16384  # firmware's ceiling of maxspeed
MAX_ACCELERATION = 32767
DEVICE_ID = 50952  # stands for an X-RST; the vendor's table of ids is online only and could not be consulted
PACKET_SIZE = 80  # longest command line, terminator included


class Rejected(Exception):
    """The command is answered ``RJ`` with this reason."""


@dataclass(frozen=True, slots=True)
class _Setting:
    """A setting of the device (axis 0) or of its axis."""

    read: Callable[[], object]
    write: Callable[[int], None] | None = None
    low: int = 0
    high: int = 2**31 - 1
    of_device: bool = False


class RotaryStage:
    """One device with one axis."""

    def __init__(self, address: int, motor: Motor, *, serial: int, limits_deg: tuple[float, float]) -> None:
        self.address = address
        self.motor = motor
        self.announces = False  # comm.alert
        self._always_checksum = False
        self._serial = serial
        self._offset = 0  # `set pos` renames where the counter stands
        self._interrupted = False
        self._had_reference = False  # before the homing that runs: the old one holds meanwhile
        self._was_moving = False
        low, high = _travel_steps(motor, limits_deg)
        self._limit_min = min(0, low)
        self._limit_max = max(self._limit_min + STEPS_PER_REVOLUTION, high)
        self._power_on = (motor.speed_steps_s, motor.acceleration_steps_s2, self._limit_min, self._limit_max)
        self._settings = self._make_settings()
        self._commands: dict[str, Callable[[Sequence[str], int], str]] = {
            "get": self._get,
            "set": self._set,
            "home": self._home,
            "move": self._move,
            "stop": self._stop,
            "estop": self._stop,
            "warnings": self._warnings,
            "tools": self._tools,
            "system": self._system,
        }

    def answer(self, request: Request) -> bytes:
        """Carry out a command that is addressed to this device and return the reply, after any due alert."""
        announced = self.alert() if self.announces else b""
        accepted = True
        try:
            data = self._run(request)
        except Rejected as rejection:
            accepted, data = False, str(rejection)
        busy = self.motor.is_moving()
        self._was_moving = busy
        return announced + format_reply(
            self.address,
            request.axis,
            request.message_id,
            accepted=accepted,
            busy=busy,
            flag=self._top_flag(),
            data=data,
            with_checksum=request.has_checksum or self._always_checksum,
        )

    def alert(self) -> bytes:
        """Return the alert that a movement has ended since the last look, or nothing."""
        if not self.announces or not self._was_moving or self.motor.is_moving():
            return b""
        self._was_moving = False
        return format_alert(
            self.address, 1, busy=False, flag=self._top_flag(), with_checksum=self._always_checksum
        )

    def power_cycle(self) -> None:
        """Switch off and on: the reference and the warnings are lost, settings are kept in the device."""
        self.motor.power_cycle()
        self._offset = 0
        self._interrupted = self._had_reference = self._was_moving = False

    def has_to_announce(self) -> bool:
        """Say whether an alert may become due without a further command."""
        return self.announces and self._was_moving

    # -- commands -----------------------------------------------------------------------------------------

    def _run(self, request: Request) -> str:
        if request.axis > 1:
            raise Rejected("BADAXIS")
        if not request.words:
            return "0"  # the empty command asks for the status alone
        command = self._commands.get(request.words[0])
        if command is None:
            raise Rejected("BADCOMMAND")
        return command(request.words[1:], request.axis)

    def _get(self, words: Sequence[str], axis: int) -> str:
        if len(words) != 1:
            raise Rejected("BADCOMMAND")
        return str(self._setting(words[0], axis).read())

    def _set(self, words: Sequence[str], axis: int) -> str:
        if len(words) != 2:
            raise Rejected("BADCOMMAND")
        setting = self._setting(words[0], axis)
        if setting.write is None:
            raise Rejected("BADCOMMAND")
        value = _integer(words[1])
        if not setting.low <= value <= setting.high:
            raise Rejected("BADDATA")
        setting.write(value)
        return "0"

    def _setting(self, name: str, axis: int) -> _Setting:
        setting = self._settings.get(name)
        if setting is None:
            raise Rejected("BADCOMMAND")
        if setting.of_device and axis != 0:
            raise Rejected("DEVICEONLY")
        return setting

    def _home(self, words: Sequence[str], axis: int) -> str:
        if words:
            raise Rejected("BADCOMMAND")
        self._begin_movement()
        self._had_reference = self.motor.referenced
        self._offset = 0
        self.motor.home()
        return "0"

    def _move(self, words: Sequence[str], axis: int) -> str:
        kind = words[0] if words else ""
        if kind in ("min", "max") and len(words) == 1:
            self._go_to(self._limit_min if kind == "min" else self._limit_max)
        elif kind in ("abs", "rel") and len(words) == 2:
            target = _integer(words[1]) + (self._position() if kind == "rel" else 0)
            if not self._limit_min <= target <= self._limit_max:
                raise Rejected("BADDATA")
            self._go_to(target)
        elif kind == "vel" and len(words) == 2:
            speed = _integer(words[1])
            if abs(speed) > MAX_SPEED:
                raise Rejected("BADDATA")
            self._go_at(speed)
        else:
            raise Rejected("BADCOMMAND")
        return "0"

    def _go_to(self, position: int) -> None:
        self._begin_movement()
        self.motor.speed_steps_s = self._max_speed / SPEED_UNIT
        self.motor.move_absolute(position + self._offset)

    def _go_at(self, speed: int) -> None:
        """Turn at a speed until stopped or at the end of the travel."""
        if speed == 0:
            self.motor.stop()
            return
        self._begin_movement()
        self.motor.speed_steps_s = abs(speed) / SPEED_UNIT
        self.motor.move_absolute((self._limit_max if speed > 0 else self._limit_min) + self._offset)

    def _begin_movement(self) -> None:
        self._interrupted = self.motor.is_moving()
        self.motor.clear_fault()  # a new movement acknowledges how the last one ended
        if self.motor.is_released():
            raise Rejected("DRIVERDISABLED")

    def _stop(self, words: Sequence[str], axis: int) -> str:
        if words:
            raise Rejected("BADCOMMAND")
        if self.motor.is_moving():
            self._interrupted = True
        self.motor.stop()
        return "0"

    def _warnings(self, words: Sequence[str], axis: int) -> str:
        if words not in ((), ("clear",)):
            raise Rejected("BADCOMMAND")
        flags = self._flags()
        if words:
            self._interrupted = False
            self.motor.clear_fault()
        return " ".join([f"{len(flags):02d}", *flags])

    def _tools(self, words: Sequence[str], axis: int) -> str:
        if not words or words[0] != "echo":
            raise Rejected("BADCOMMAND")
        if axis:
            raise Rejected("DEVICEONLY")
        return " ".join(words[1:]) or "0"

    def _system(self, words: Sequence[str], axis: int) -> str:
        if words != ("restore",):
            raise Rejected("BADCOMMAND")
        if axis:
            raise Rejected("DEVICEONLY")
        speed, acceleration, self._limit_min, self._limit_max = self._power_on
        self._max_speed = round(speed * SPEED_UNIT)
        self.motor.speed_steps_s, self.motor.acceleration_steps_s2 = speed, acceleration
        self.announces = self._always_checksum = False
        return "0"

    # -- flags --------------------------------------------------------------------------------------------

    def _flags(self) -> list[str]:
        """Warning flags, the gravest first (the manual's order of precedence)."""
        flags = []
        fault = self.motor.fault
        if fault is Fault.OVER_TEMPERATURE:
            flags.append("FD")
        elif fault is Fault.ENCODER:
            flags.append("FQ")
        elif fault is Fault.STALL:
            flags.append("FS")
        elif fault is not Fault.NONE:
            flags.append("FE")
        if self.motor.displaced:
            flags.append("WM")
        if not self._has_reference():
            flags.append("WR")
        if self.motor.is_manual():
            flags.append("NC")
        if self._interrupted or self.motor.interrupted_by_hand:
            flags.append("NI")
        return flags

    def _has_reference(self) -> bool:
        return self.motor.referenced or (self._had_reference and self.motor.is_homing())

    def _top_flag(self) -> str:
        motor = self.motor
        if motor.fault is Fault.NONE and motor.referenced and not (self._interrupted or motor.in_hands):
            return "--"
        flags = self._flags()
        return flags[0] if flags else "--"

    # -- settings -----------------------------------------------------------------------------------------

    def _position(self) -> int:
        return self.motor.position_steps() - self._offset

    def _make_settings(self) -> dict[str, _Setting]:
        motor = self.motor
        self._max_speed = round(motor.speed_steps_s * SPEED_UNIT)

        def write_position(value: int) -> None:
            self._offset = motor.position_steps() - value

        def write_speed(value: int) -> None:
            self._max_speed = value
            motor.speed_steps_s = value / SPEED_UNIT

        def write_acceleration(value: int) -> None:
            motor.acceleration_steps_s2 = value / ACCELERATION_UNIT

        def write_limit(name: str) -> Callable[[int], None]:
            return lambda value: setattr(self, name, value)

        def write_address(value: int) -> None:
            self.address = value

        def read_acceleration() -> int:
            return max(1, round(motor.acceleration_steps_s2 * ACCELERATION_UNIT))

        position = _Setting(self._position, write_position, -(2**31))
        acceleration = _Setting(read_acceleration, write_acceleration, 1, MAX_ACCELERATION)
        lowest = -(2**31)
        settings = {
            "pos": position,
            "encoder.pos": _Setting(lambda: motor.encoder_steps() - self._offset),
            "vel": _Setting(lambda: round(motor.speed_now_steps_s() * SPEED_UNIT)),
            "limit.min": _Setting(lambda: self._limit_min, write_limit("_limit_min"), lowest),
            "limit.max": _Setting(lambda: self._limit_max, write_limit("_limit_max"), lowest),
            "limit.cycle.dist": _Setting(lambda: STEPS_PER_REVOLUTION),
            "limit.home.pos": _Setting(lambda: 0),
            "limit.home.triggered": _Setting(lambda: int(motor.referenced and self._position() == 0)),
            "maxspeed": _Setting(lambda: self._max_speed, write_speed, 1, MAX_SPEED),
            "accel": acceleration,
            "motion.accelonly": acceleration,
            "motion.decelonly": acceleration,
            "motion.busy": _Setting(lambda: int(motor.is_moving())),
            "resolution": _Setting(lambda: RESOLUTION),
        }
        device = {
            "deviceid": lambda: DEVICE_ID,
            "device.id": lambda: DEVICE_ID,
            "system.serial": lambda: self._serial,
            "version": lambda: "7.35",
            "version.build": lambda: 16151,
            "system.axiscount": lambda: 1,
            "system.access": lambda: 1,
            "system.voltage": lambda: "48.0",
            "system.temperature": lambda: "31.4",
            "comm.packet.size.max": lambda: PACKET_SIZE,
            "comm.word.size.max": lambda: 50,
            "comm.command.packets.max": lambda: 1,
            "comm.protocol": lambda: 2,
        }
        settings.update({name: _Setting(read, of_device=True) for name, read in device.items()})
        settings["comm.address"] = _Setting(lambda: self.address, write_address, 1, 99, of_device=True)
        settings["comm.alert"] = _Setting(
            lambda: int(self.announces), lambda v: setattr(self, "announces", bool(v)), 0, 1, of_device=True
        )
        settings["comm.checksum"] = _Setting(
            lambda: int(self._always_checksum),
            lambda v: setattr(self, "_always_checksum", bool(v)),
            0,
            1,
            of_device=True,
        )
        return settings


def _travel_steps(motor: Motor, limits_deg: tuple[float, float]) -> tuple[int, int]:
    """Counts of the two ends of the travel, ascending."""
    hardware = motor.hardware
    low, high = sorted(round((a - hardware.zero_deg) * hardware.steps_per_deg) for a in limits_deg)
    return low, high


def _integer(word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise Rejected("BADDATA") from None

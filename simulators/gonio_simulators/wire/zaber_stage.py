"""One Zaber X-RST rotary stage with firmware 7: what each command does, its warning flags, its alerts.

Distances are microsteps.  Speeds on the wire are microsteps per second times 1.6384, accelerations
microsteps per second squared times 1.6384 / 10000 (Zaber's units of firmware 7).

A real stage also has streams, triggers, an oscilloscope, index and sinusoidal moves; here they are answered
``BADCOMMAND``, like ``lockstep`` and ``io``, which an X-RST (one axis, no inputs) does not have.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gonio_simulators.bench.motor import Fault, Motor
from gonio_simulators.wire.zaber_message import (
    BAD_ID,
    NO_REPLY,
    Rejected,
    Request,
    format_alert,
    format_info,
    format_reply,
)
from gonio_simulators.wire.zaber_settings import (
    HIGHEST,
    LOWEST,
    MAX_ACCELERATION,
    MAX_SPEED,
    STEPS_PER_REVOLUTION,
    STORED_POSITIONS,
    Setting,
    identity_settings,
    stored_settings,
)
from gonio_simulators.wire.zaber_storage import Storage

SPEED_UNIT = 1.6384
ACCELERATION_UNIT = 1.6384 / 10000.0

_HELP = "See the protocol manual of firmware 7 for the commands of this device"


class RotaryStage:
    """One device with one axis."""

    def __init__(self, address: int, motor: Motor, *, serial: int, limits_deg: tuple[float, float]) -> None:
        self.address = address
        self.motor = motor
        self.announces = False  # comm.alert
        self._always_checksum = False
        self._offset = 0  # `set pos` renames where the counter stands
        self._interrupted = False
        self._had_reference = False  # before the homing that runs: the old one holds meanwhile
        self._was_moving = False
        self._parked = False
        self._driver_off = False  # by command
        self._stored_positions = [0] * STORED_POSITIONS
        self._storage = Storage()
        self._info: list[str] = []  # lines that follow the reply
        low, high = _travel_steps(motor, limits_deg)
        self._limit_min = min(0, low)
        self._limit_max = max(self._limit_min + STEPS_PER_REVOLUTION, high)
        self._acceleration = motor.acceleration_steps_s2
        self._power_on = (motor.speed_steps_s, self._acceleration, self._limit_min, self._limit_max)
        self._stored = stored_settings()
        self._settings = self._make_settings(serial)
        self._commands: dict[str, Callable[[Sequence[str], int], str]] = {
            "get": self._get,
            "set": self._set,
            "home": self._home,
            "move": self._move,
            "stop": self._stop,
            "estop": self._emergency_stop,
            "warnings": self._warnings,
            "tools": self._tools,
            "system": self._system,
            "driver": self._driver,
            "storage": self._store,
            "help": self._help,
        }

    def answer(self, request: Request) -> bytes:
        """Carry out a command that is addressed to this device and return the reply, after any due alert."""
        announced = self.alert() if self.announces else b""
        accepted = True
        self._info = []
        try:
            data = self._run(request)
        except Rejected as rejection:
            accepted, data = False, str(rejection)
        busy = self.motor.is_moving()
        self._was_moving = busy
        if request.message_id == NO_REPLY:
            return announced
        with_checksum = request.has_checksum or self._always_checksum
        message_id = "" if request.message_id == BAD_ID else request.message_id
        reply = format_reply(
            self.address,
            request.axis,
            message_id,
            accepted=accepted,
            busy=busy,
            flag=self._top_flag(),
            data=data,
            with_checksum=with_checksum,
        )
        if accepted and self._info:
            reply += b"".join(
                [
                    format_info(self.address, request.axis, message_id, text, with_checksum=with_checksum)
                    for text in self._info
                ]
            )
        return announced + reply

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
        self._driver_off = self._parked = False
        self._interrupted = self._had_reference = self._was_moving = False

    def has_to_announce(self) -> bool:
        """Say whether an alert may become due without a further command."""
        return self.announces and self._was_moving

    # -- commands -----------------------------------------------------------------------------------------

    def _run(self, request: Request) -> str:
        if request.message_id == BAD_ID:
            raise Rejected("BADMESSAGEID")
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
        setting.write(_integer(words[1], setting.low, setting.high))
        return "0"

    def _setting(self, name: str, axis: int) -> Setting:
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
        """``move KIND [VALUE] [SPEED [ACCELERATION]]``; ``vel`` takes no further speed."""
        kind, rest = words[0] if words else "", words[1:]
        if kind not in ("min", "max"):
            if kind not in ("abs", "rel", "vel", "stored") or not rest:
                raise Rejected("BADCOMMAND")
            value, rest = rest[0], rest[1:]
        if len(rest) > (1 if kind == "vel" else 2):
            raise Rejected("BADCOMMAND")
        if kind == "vel":
            speed = _integer(value, -MAX_SPEED, MAX_SPEED)
            self._go_at(speed, _integer(rest[0], 1, MAX_ACCELERATION) if rest else None)
            return "0"
        speed = _integer(rest[0], 1, MAX_SPEED) if rest else self._max_speed
        acceleration = _integer(rest[1], 1, MAX_ACCELERATION) if len(rest) > 1 else None
        if kind in ("min", "max"):
            target = self._limit_min if kind == "min" else self._limit_max
        elif kind == "stored":
            target = self._stored_positions[_integer(value, 1, STORED_POSITIONS) - 1]
        else:
            target = _integer(value, LOWEST, HIGHEST) + (self._position() if kind == "rel" else 0)
        if not self._limit_min <= target <= self._limit_max:
            raise Rejected("BADDATA")
        self._begin_movement()
        self._run_at(speed, acceleration)
        self.motor.move_absolute(target + self._offset)
        return "0"

    def _go_at(self, speed: int, acceleration: int | None) -> None:
        """Turn at a speed until stopped or at the end of the travel."""
        if speed == 0:
            self.motor.stop()
            return
        self._begin_movement()
        self._run_at(abs(speed), acceleration)
        self.motor.move_absolute((self._limit_max if speed > 0 else self._limit_min) + self._offset)

    def _run_at(self, speed: int, acceleration: int | None) -> None:
        """Set the profile of one movement, in units of the wire."""
        self.motor.speed_steps_s = speed / SPEED_UNIT
        if acceleration is not None:
            self.motor.acceleration_steps_s2 = acceleration / ACCELERATION_UNIT

    def _begin_movement(self) -> None:
        if self._parked:
            raise Rejected("PARKED")
        self._interrupted = self.motor.is_moving()
        self.motor.clear_fault()  # a new movement acknowledges how the last one ended
        if self._driver_off or self.motor.is_released():
            raise Rejected("DRIVERDISABLED")
        self.motor.speed_steps_s = self._max_speed / SPEED_UNIT
        self.motor.acceleration_steps_s2 = self._acceleration

    def _stop(self, words: Sequence[str], axis: int) -> str:
        if words:
            raise Rejected("BADCOMMAND")
        if self.motor.is_moving():
            self._interrupted = True
        self.motor.stop()
        return "0"

    def _emergency_stop(self, words: Sequence[str], axis: int) -> str:
        """Stop as hard as the firmware can."""
        self.motor.acceleration_steps_s2 = MAX_ACCELERATION / ACCELERATION_UNIT
        return self._stop(words, axis)

    def _warnings(self, words: Sequence[str], axis: int) -> str:
        if words not in ((), ("clear",)):
            raise Rejected("BADCOMMAND")
        flags = self._flags()
        if words:
            self._interrupted = False
            self.motor.clear_fault()
        return " ".join([f"{len(flags):02d}", *flags])

    def _driver(self, words: Sequence[str], axis: int) -> str:
        if words == ("disable",):
            self.motor.stop()
            self._driver_off = True
        elif words == ("enable",):
            self.motor.clear_fault()
            if self.motor.is_released():
                raise Rejected("DRIVERDISABLED")
            self._driver_off = False
        else:
            raise Rejected("BADCOMMAND")
        return "0"

    def _tools(self, words: Sequence[str], axis: int) -> str:
        match words:
            case ("echo", *text):
                if axis:
                    raise Rejected("DEVICEONLY")
                return " ".join(text) or "0"
            case ("parking", "park"):
                if self.motor.is_moving():
                    raise Rejected("STATUSBUSY")
                self._parked = True
            case ("parking", "unpark"):
                self._parked = False
            case ("parking", "state"):
                return str(int(self._parked))
            case ("storepos", number):
                return str(self._stored_positions[_integer(number, 1, STORED_POSITIONS) - 1])
            case ("storepos", number, where):
                place = _integer(number, 1, STORED_POSITIONS) - 1
                position = self._position() if where == "current" else _integer(where, LOWEST, HIGHEST)
                self._stored_positions[place] = position
            case _:
                raise Rejected("BADCOMMAND")
        return "0"

    def _system(self, words: Sequence[str], axis: int) -> str:
        if words not in (("restore",), ("reset",)):
            raise Rejected("BADCOMMAND")
        if axis:
            raise Rejected("DEVICEONLY")
        if words == ("reset",):
            self.power_cycle()
            return "0"
        speed, self._acceleration, self._limit_min, self._limit_max = self._power_on
        self._max_speed = round(speed * SPEED_UNIT)
        self.motor.speed_steps_s, self.motor.acceleration_steps_s2 = speed, self._acceleration
        self.announces = self._always_checksum = False
        for stored, _ in self._stored.values():
            stored.restore()
        return "0"

    def _store(self, words: Sequence[str], axis: int) -> str:
        data, self._info = self._storage.carry_out(words, axis)
        return data

    def _help(self, words: Sequence[str], axis: int) -> str:
        self._info = [_HELP]
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
        if self._driver_off:
            flags.append("FO")
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
        if (
            motor.fault is Fault.NONE
            and motor.referenced
            and not (self._interrupted or self._driver_off or motor.in_hands)
        ):
            return "--"
        flags = self._flags()
        return flags[0] if flags else "--"

    # -- settings -----------------------------------------------------------------------------------------

    def _position(self) -> int:
        return self.motor.position_steps() - self._offset

    def _make_settings(self, serial: int) -> dict[str, Setting]:
        motor = self.motor
        self._max_speed = round(motor.speed_steps_s * SPEED_UNIT)

        def write_position(value: int) -> None:
            self._offset = motor.position_steps() - value

        def write_speed(value: int) -> None:
            self._max_speed = value
            motor.speed_steps_s = value / SPEED_UNIT

        def write_acceleration(value: int) -> None:
            self._acceleration = motor.acceleration_steps_s2 = value / ACCELERATION_UNIT

        def write_limit(name: str) -> Callable[[int], None]:
            return lambda value: setattr(self, name, value)

        def switch(name: str) -> Setting:
            return Setting(
                lambda: int(getattr(self, name)),
                lambda value: setattr(self, name, bool(value)),
                0,
                1,
                of_device=True,
            )

        def read_acceleration() -> int:
            return max(1, round(self._acceleration * ACCELERATION_UNIT))

        acceleration = Setting(read_acceleration, write_acceleration, 1, MAX_ACCELERATION)
        settings = identity_settings(serial)
        settings.update({name: setting for name, (_, setting) in self._stored.items()})
        settings.update(
            {
                "pos": Setting(self._position, write_position, LOWEST),
                "encoder.pos": Setting(lambda: motor.encoder_steps() - self._offset),
                "vel": Setting(lambda: round(motor.speed_now_steps_s() * SPEED_UNIT)),
                "limit.min": Setting(lambda: self._limit_min, write_limit("_limit_min"), LOWEST),
                "limit.max": Setting(lambda: self._limit_max, write_limit("_limit_max"), LOWEST),
                "limit.home.triggered": Setting(lambda: int(motor.referenced and self._position() == 0)),
                "maxspeed": Setting(lambda: self._max_speed, write_speed, 1, MAX_SPEED),
                "accel": acceleration,
                "motion.accelonly": acceleration,
                "motion.decelonly": acceleration,
                "motion.busy": Setting(lambda: int(motor.is_moving())),
                "parking.state": Setting(lambda: int(self._parked)),
                "driver.enabled": Setting(lambda: int(not (self._driver_off or motor.is_released()))),
                "comm.address": Setting(
                    lambda: self.address, lambda value: setattr(self, "address", value), 1, 99, of_device=True
                ),
                "comm.alert": switch("announces"),
                "comm.checksum": switch("_always_checksum"),
            }
        )
        return settings


def _travel_steps(motor: Motor, limits_deg: tuple[float, float]) -> tuple[int, int]:
    """Counts of the two ends of the travel, ascending."""
    hardware = motor.hardware
    low, high = sorted(round((a - hardware.zero_deg) * hardware.steps_per_deg) for a in limits_deg)
    return low, high


def _integer(word: str, low: int, high: int) -> int:
    """Return a whole number within a range, which a device takes with digits and a minus alone."""
    if not word.removeprefix("-").isdecimal() or not low <= int(word) <= high:
        raise Rejected("BADDATA")
    return int(word)

"""One drive with a register map: a `gonio_drivers.drive.Drive`.

The state is made of as few reads as the map allows (`plan_reads`), and everything that is set on connecting
is read back.  A command that may start a motion is never repeated.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from gonio.clock import Clock
from gonio.errors import DeviceError, MotionError
from gonio_drivers.drive import DriveState, MotorConfig
from gonio_drivers.modbus import ModbusLine, WordOrder
from gonio_drivers.modbus_axis_map import (
    AlarmRegister,
    Condition,
    PositionRegister,
    RegisterMap,
    SettingRegister,
    Write,
    words,
)
from gonio_drivers.modbus_axis_reads import Span, plan_reads
from gonio_drivers.modbus_axis_values import decode, encode, limits, width

TURNS_AT_MOST = 2.0  # of the axis beyond its limits; a count farther away has its words the wrong way round


def setting_value(register: SettingRegister, name: str, config: MotorConfig) -> tuple[str, float]:
    """Return the key of the rig file behind a setting, and what its register must hold."""
    key = "speed_deg_s" if name == "speed" else "acceleration_deg_s2"
    return key, float(getattr(config, key)) * abs(config.steps_per_deg) * register.scale


class RegisterDrive:
    """One axis of one Modbus unit.

    Parameters
    ----------
    line, unit
        Where it is.
    name
        Of the axis, for messages.
    referenced
        What to believe of its reference until it is homed, if it neither tells nor has an absolute encoder.
    """

    def __init__(
        self,
        line: ModbusLine,
        unit: int,
        name: str,
        config: MotorConfig,
        registers: RegisterMap,
        word_order: WordOrder,
        clock: Clock,
        *,
        referenced: bool,
    ) -> None:
        self._line = line
        self._unit = unit
        self._map = registers
        self._word_order = word_order
        self._clock = clock
        self._referenced = referenced
        self.device = f"{name} (Modbus unit {unit}) on the {line.line.device}"
        self._reads = plan_reads(registers.status_spans(), registers.position.span, bridge=registers.bridge)
        self._farthest_steps = abs(config.steps_per_deg) * (
            max(abs(limit_deg - config.zero_deg) for limit_deg in config.limits_deg) + 360.0 * TURNS_AT_MOST
        )
        self._settings = {
            setting: self._setting_words(setting, register, config)
            for setting, register in registers.settings().items()
        }
        self._set_up()

    @property
    def start_latency_s(self) -> float:
        """For so long it may say idle after it was told to move."""
        return self._map.start_latency_s

    @property
    def reports_reference(self) -> bool:
        """Whether it tells that it has lost its reference, or cannot lose it."""
        return bool(self._map.referenced) or not self._map.home

    def describe(self) -> str:
        """Return what the state looks like; there is no register for the model that all drives have."""
        content = self._read_words(self._reads)
        seen = sorted({condition.span for _, condition in self._map.conditions()})
        status = ", ".join(f"0x{s.address:02X} = 0x{content[s.function, s.address]:04X}" for s in seen)
        return f"Modbus unit {self._unit}, status {status}"

    def state(self) -> DriveState:
        """Ask for status, alarm and position."""
        content = self._read_words(self._reads)
        position = self._map.position
        value = self._number(content, position)
        if not math.isfinite(value):
            raise DeviceError(
                self.device,
                f"gave {value} as its position",
                "check type and word_order of position in the rig file",
            )
        fault, remedy = self._fault(content)
        if fault is None and (swapped := self._swapped(content, value)) is not None:
            fault = f"its position reads {value:g}, and {swapped:g} in the other word order"
            remedy = "correct word_order in the rig file, then home the axis"
        moving = _any(self._map.moving, content)
        # A faulty drive need not be in position to be at rest.
        if self._map.in_position and fault is None:
            moving = moving or not _all(self._map.in_position, content)
        referenced = self._referenced
        if self.reports_reference:
            referenced = _all(self._map.referenced, content)
        return DriveState(round(value / position.scale), moving, referenced, fault, remedy)

    def clear_faults(self) -> None:
        """Reset the alarm and enable the motor; what persists comes back with the next poll."""
        self._give(self._map.clear_faults)
        self._give(self._map.enable)

    def move_to(self, position_steps: int) -> None:
        """Write the target and begin the move, once."""
        target = self._map.target
        value = position_steps * target.scale
        low, high = limits(target.type)
        if not low <= value <= high:
            raise MotionError(
                self.device,
                f"its target {value:g} does not fit a {target.type} register, which holds {low:g}...{high:g}",
                "correct limits_deg, steps_per_deg or the target's scale in the rig file",
            )
        self._write_words(target.address, encode(value, target.type, self._word_order), target.write_function)
        self._give(self._map.start)

    def home(self) -> None:
        """Begin the search for the reference."""
        if not self._map.home:
            raise MotionError(
                self.device,
                "has no reference, and its register map has no command to find it",
                "set the encoder's zero with the maker's program, or give home in the rig file",
            )
        self._referenced = False
        self._give(self._map.home)

    def finish_home(self) -> None:
        """Call the place where the search ended zero, if the drive does not do so itself."""
        self._give(self._map.finish_home)
        self._referenced = True

    def stop(self) -> None:
        """Decelerate and stop; sent again if the reply fails, a stop can be repeated without harm."""
        self._line.line.query(lambda: self._give(self._map.stop))

    def resume(self) -> None:
        """Find out whether the drive was switched off, and set it up again.

        One that forgot nothing is left as it is: what is written to a drive that was switched off just after
        the question would hide that it was.
        """
        forgotten = self.confirm(0) is not None
        if forgotten:
            self._referenced = False
        can_tell = self._map.mark is not None or bool(self._map.readable_settings())
        if forgotten or self.reports_reference or not can_tell:
            self._set_up()

    def confirm(self, position_steps: int) -> str | None:
        """Look for what a drive that was switched off has forgotten: the mark, or speed and accelerations."""
        if self.reports_reference:
            return None
        if self._map.mark is not None:
            forgotten = self._line.read(self._unit, self._map.mark.address, 1) != [self._map.mark.value]
        else:
            forgotten = any(got != wanted for _, wanted, got in self._settings_read_back())
        return "it was switched off and on, and has lost its reference" if forgotten else None

    # -- inside ----------------------------------------------------------------------------------------------

    def _set_up(self) -> None:
        self._give(self._map.initialise)
        for name, register in self._map.settings().items():
            self._write_words(register.address, self._settings[name], register.write_function)
        for name, wanted, got in self._settings_read_back():
            if got != wanted:
                raise DeviceError(
                    self.device,
                    f"was told {name} = {wanted} (registers) and reads {got}",
                    f"correct speed_deg_s and acceleration_deg_s2, or the scale of {name}, in the rig file",
                )
        if self._map.mark is not None:
            self._line.write_one(self._unit, self._map.mark.address, self._map.mark.value)
            if self._line.read(self._unit, self._map.mark.address, 1) != [self._map.mark.value]:
                raise DeviceError(
                    self.device,
                    f"does not keep a mark in register 0x{self._map.mark.address:02X}",
                    "choose another register for mark in the rig file, or leave it out",
                )
        if not self._map.enabled:  # otherwise it is enabled when it is seen to be disabled
            self._give(self._map.enable)

    def _settings_read_back(self) -> Iterable[tuple[str, list[int], list[int]]]:
        """Return the name, the wanted and the present registers of each setting that can be read."""
        content = self._read_words(self._map.setting_reads())
        for name, register in self._map.readable_settings().items():
            got = [content[3, register.address + i] for i in range(width(register.type))]
            yield name, self._settings[name], got

    def _setting_words(self, name: str, register: SettingRegister, config: MotorConfig) -> list[int]:
        key, value = setting_value(register, name, config)
        low, high = limits(register.type)
        if not max(low, 0.5 if register.type != "float32" else low) <= value <= high:
            raise MotionError(
                self.device,
                f"{key} needs {value:g} in a {register.type} register, which holds 1...{high:g}",
                f"correct {key} or the scale of {name} in the rig file",
            )
        return encode(value, register.type, self._word_order)

    def _read_words(self, reads: Iterable[Span]) -> dict[tuple[int, int], int]:
        """Return every register of some reads by function and address."""
        content: dict[tuple[int, int], int] = {}
        for block in reads:
            got = self._line.read(self._unit, block.address, block.count, function=block.function)
            content.update({(block.function, block.address + i): word for i, word in enumerate(got)})
        return content

    def _number(
        self, content: Mapping[tuple[int, int], int], register: PositionRegister | AlarmRegister
    ) -> float:
        got = [content[register.function, register.address + i] for i in range(width(register.type))]
        return decode(got, register.type, self._word_order)

    def _swapped(self, content: Mapping[tuple[int, int], int], value: float) -> float | None:
        """Return the position in the other word order if only there it is one that the axis can have."""
        register = self._map.position
        if width(register.type) == 1 or abs(value / register.scale) <= self._farthest_steps:
            return None
        got = [content[register.function, register.address + i] for i in (1, 0)]
        swapped = decode(got, register.type, self._word_order)
        return swapped if abs(swapped / register.scale) <= self._farthest_steps else None

    def _fault(self, content: Mapping[tuple[int, int], int]) -> tuple[str | None, str]:
        """Return what is wrong in words and what to do: the alarm says most, being disabled least."""
        alarm = self._map.alarm
        if alarm is not None:
            value = int(self._number(content, alarm)) & alarm.mask
            if value:
                return alarm.explain(value)
        for condition in self._map.fault:
            if condition.met(_word(condition, content)):
                text, remedy = words(condition.text, "fault", "read the drive's display")
                return f"{text} ({_shown(condition, content)})", remedy
        for condition in self._map.enabled:
            if not condition.met(_word(condition, content)):
                text, remedy = words(
                    condition.text, "the motor is disabled", "enable it; check the drive's enable input"
                )
                return f"{text} ({_shown(condition, content)})", remedy
        return None, ""

    def _give(self, writes: Iterable[Write]) -> None:
        """Write values one after the other."""
        for write in writes:
            self._write(write, write.value)
            if write.then is not None:
                self._clock.sleep(write.hold_s)
                self._write(write, write.then)

    def _write(self, write: Write, value: int) -> None:
        if write.write_function == 5:
            self._line.write_coil(self._unit, write.address, bool(value))
            return
        self._write_words(write.address, encode(value, write.type, self._word_order), write.write_function)

    def _write_words(self, address: int, content: list[int], function: int | None) -> None:
        if function == 6 or (function is None and len(content) == 1):
            self._line.write_one(self._unit, address, content[0])
        else:
            self._line.write(self._unit, address, content)


def _word(condition: Condition, content: Mapping[tuple[int, int], int]) -> int:
    return content[condition.function, condition.address]


def _shown(condition: Condition, content: Mapping[tuple[int, int], int]) -> str:
    return f"register 0x{condition.address:02X} = 0x{_word(condition, content):04X}"


def _any(conditions: Iterable[Condition], content: Mapping[tuple[int, int], int]) -> bool:
    return any(condition.met(_word(condition, content)) for condition in conditions)


def _all(conditions: Iterable[Condition], content: Mapping[tuple[int, int], int]) -> bool:
    return all(condition.met(_word(condition, content)) for condition in conditions)

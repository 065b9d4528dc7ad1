"""Which register of a drive means what: the tables that a user writes into ``[stage.registers]``.

Addresses are those on the wire, from 0 (a manual's 40001 is address 0).  Whatever cannot work is refused when
the rig file is read: numbers that do not fit their registers, registers with two meanings, conditions that
can never be met.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gonio.config import NotNegative, Number, Strict
from gonio_drivers.modbus import ReadFunction
from gonio_drivers.modbus_axis_reads import Span, joined
from gonio_drivers.modbus_axis_values import IntegerType, NumberType, limits, width

Address = Annotated[int, Field(strict=True, ge=0, le=0xFFFF)]
Word = Annotated[int, Field(strict=True, ge=0, le=0xFFFF)]
Integer = Annotated[int, Field(strict=True)]
Words = str | tuple[str, str]
"""What a fault is, or what it is and what to do about it."""


class _Register(Strict):
    address: Address
    type: NumberType = "s32"
    scale: Number = 1.0  # units of the register per step, per step/s or per step/s2

    @model_validator(mode="after")
    def _scale_is_not_zero(self) -> Self:
        if self.scale == 0.0:
            raise ValueError("scale = 0: give the units of the register that one step is")
        return self

    @property
    def span(self) -> Span:
        """The registers it takes."""
        return Span(3, self.address, width(self.type))


class PositionRegister(_Register):
    """Where the drive says it stands."""

    function: Literal[3, 4] = 3

    @property
    def span(self) -> Span:
        """The registers it takes."""
        return Span(self.function, self.address, width(self.type))


class TargetRegister(_Register):
    """Where it is to go."""

    write_function: Literal[6, 16] | None = None  # by default 6 for one register, 16 for two

    @model_validator(mode="after")
    def _one_function_writes_one(self) -> Self:
        if self.write_function == 6 and width(self.type) == 2:
            raise ValueError(f"write_function = 6 writes one register, a {self.type} takes two; use 16")
        return self


class SettingRegister(TargetRegister):
    """A speed or an acceleration, set on connecting."""

    read_back: bool = True  # False for a register that cannot be read


class Write(Strict):
    """One value that is written to give a command; with `then`, a bit that is set and reset."""

    address: Address
    value: Integer
    type: IntegerType = "u16"
    write_function: Literal[5, 6, 16] | None = None  # 5 for a coil, whose values are 1 and 0
    then: Integer | None = None  # written right after `value`
    hold_s: NotNegative = 0.0  # waited before `then`, instrument seconds

    @model_validator(mode="after")
    def _values_fit(self) -> Self:
        kind = "coil" if self.write_function == 5 else self.type
        low, high = (0, 1) if self.write_function == 5 else limits(self.type)
        for value in (self.value, self.then):
            if value is not None and not low <= value <= high:
                raise ValueError(f"{value} does not fit a {kind}, which holds {low:g}...{high:g}; correct it")
        if self.write_function == 6 and width(self.type) == 2:
            raise ValueError(f"write_function = 6 writes one register, a {self.type} takes two; use 16")
        if self.hold_s and self.then is None:
            raise ValueError(f"hold_s = {self.hold_s:g} s waits for nothing; give the value to write then")
        return self

    @property
    def span(self) -> Span:
        """The registers it takes, or the coil."""
        return (
            Span(1, self.address, 1) if self.write_function == 5 else Span(3, self.address, width(self.type))
        )


class Condition(Strict):
    """A register that says something: ``(register & mask) == equals``, or any bit of the mask without it."""

    address: Address
    function: ReadFunction = 3
    mask: Word = 0xFFFF
    equals: Word | None = None
    text: Words | None = None  # of a fault

    @model_validator(mode="after")
    def _can_be_met_and_missed(self) -> Self:
        if self.mask == 0:
            raise ValueError("mask = 0 looks at no bit; give the bits that matter")
        if self.equals is not None and self.equals & ~self.mask:
            raise ValueError(
                f"equals = 0x{self.equals:04X} has bits outside mask = 0x{self.mask:04X} and can never be met"
            )
        return self

    @property
    def span(self) -> Span:
        """The register or bit it looks at."""
        return Span(self.function, self.address, 1)

    def met(self, word: int) -> bool:
        """Say whether the register's content fulfils it."""
        return bool(word & self.mask) if self.equals is None else word & self.mask == self.equals


class AlarmRegister(Strict):
    """What is wrong, as a bit each or as a number; zero is well."""

    address: Address
    type: Literal["u16", "u32"] = "u16"
    function: Literal[3, 4] = 3
    mask: Annotated[int, Field(strict=True, ge=1, le=0xFFFFFFFF)] = 0xFFFFFFFF
    bits: Mapping[str, Words] = Field(default_factory=dict)
    codes: Mapping[str, Words] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _keys_are_numbers(self) -> Self:
        if self.bits and self.codes:
            raise ValueError("bits and codes are both given; an alarm is either a sum of bits or a number")
        bits = 16 * width(self.type)
        for name, table, end in (("bits", self.bits, bits), ("codes", self.codes, 1 << bits)):
            for key in table:
                try:
                    number = int(key, 0)
                except ValueError:
                    raise ValueError(f"{name} has the key '{key}', which is not a number") from None
                if not 0 <= number < end:
                    raise ValueError(f"{name} has the key {key}; a {self.type} has 0...{end - 1}")
        return self

    @property
    def span(self) -> Span:
        """The registers it takes."""
        return Span(self.function, self.address, width(self.type))

    def explain(self, value: int) -> tuple[str, str]:
        """Return a number other than zero in words, and what to do."""
        shown = f"alarm 0x{value:0{4 * width(self.type)}X}"
        unknown = "look it up in the drive's manual"
        if not self.bits:
            text, remedy = words({int(k, 0): v for k, v in self.codes.items()}.get(value), "", unknown)
            return (f"{text} ({shown})" if text else shown), remedy
        known = {int(key, 0): table for key, table in self.bits.items()}
        parts = [
            words(known.get(bit), f"alarm bit {bit}", unknown)
            for bit in range(value.bit_length())
            if value >> bit & 1
        ]
        return f"{' and '.join(text for text, _ in parts)} ({shown})", parts[0][1]


def words(entry: Words | None, text: str, remedy: str) -> tuple[str, str]:
    """Return text and remedy of an entry, completed by these."""
    if entry is None:
        return text, remedy
    return (entry, remedy) if isinstance(entry, str) else entry


class MarkRegister(Strict):
    """A register without meaning in which a value is left: a drive that was switched off has forgotten it."""

    address: Address
    value: Word = 0x5AA5

    @property
    def span(self) -> Span:
        """The register."""
        return Span(3, self.address, 1)


class CanaryTable(Strict):
    """``canary``: a run of registers of a length that nothing else reads."""

    address: Address
    count: Annotated[int, Field(strict=True, ge=1, le=125)]
    function: Literal[3, 4] = 3


class RegisterMap(Strict):
    """``[stage.registers]``, or ``[stage.theta_i.registers]`` where the axes differ."""

    position: PositionRegister
    target: TargetRegister
    speed: SettingRegister | None = None  # per step/s
    acceleration: SettingRegister | None = None  # per step/s2
    deceleration: SettingRegister | None = None

    moving: tuple[Condition, ...] = ()  # any of them
    in_position: tuple[Condition, ...] = ()  # all of them
    enabled: tuple[Condition, ...] = ()  # all of them
    fault: tuple[Condition, ...] = ()  # any of them
    referenced: tuple[Condition, ...] = ()  # all of them
    alarm: AlarmRegister | None = None

    initialise: tuple[Write, ...] = ()  # on connecting: operating modes
    start: tuple[Write, ...] = ()  # behind the target; none: the target alone starts the move
    stop: tuple[Write, ...] = Field(min_length=1)
    home: tuple[Write, ...] = ()  # none: an absolute encoder
    finish_home: tuple[Write, ...] = ()  # when the search has ended: call this place zero
    clear_faults: tuple[Write, ...] = ()
    enable: tuple[Write, ...] = ()
    mark: MarkRegister | None = None

    start_latency_s: NotNegative = 0.1
    bridge: Annotated[int, Field(strict=True, ge=0, le=124)] = 0  # registers read along to save a read
    canary: CanaryTable | Literal["loopback"] | None = None

    def conditions(self) -> Iterator[tuple[str, Condition]]:
        """Return every condition with the name of its list."""
        for name in ("moving", "in_position", "enabled", "fault", "referenced"):
            for condition in getattr(self, name):
                yield name, condition

    def settings(self) -> dict[str, SettingRegister]:
        """Return speed and accelerations, those that there are."""
        found = {name: getattr(self, name) for name in ("speed", "acceleration", "deceleration")}
        return {name: register for name, register in found.items() if register is not None}

    def status_spans(self) -> tuple[Span, ...]:
        """Return the registers that make up the status."""
        alarm = () if self.alarm is None else (self.alarm.span,)
        return (*(condition.span for _, condition in self.conditions()), *alarm)

    def readable_settings(self) -> dict[str, SettingRegister]:
        """Return the settings that can be read back."""
        return {name: register for name, register in self.settings().items() if register.read_back}

    def setting_reads(self) -> list[Span]:
        """Return the reads that read the settings back."""
        return joined(register.span for register in self.readable_settings().values())

    def other_reads(self) -> list[Span]:
        """Return the reads made besides those of the state: settings and the mark."""
        return self.setting_reads() + ([] if self.mark is None else [self.mark.span])

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if not self.moving and not self.in_position:
            raise ValueError("moving and in_position are both missing: nothing would say when a move ends")
        if self.finish_home and not self.home:
            raise ValueError("finish_home without home: give the writes that start the search, or neither")
        numbers = {"position": self.position, "target": self.target, **self.settings()}
        spans = {name: register.span for name, register in numbers.items()}
        if self.alarm is not None:
            spans["alarm"] = self.alarm.span
        if self.mark is not None:
            spans["mark"] = self.mark.span
        for name, span in spans.items():
            if span.end > 0x10000:
                raise ValueError(f"{name} at 0x{span.address:X} ends behind the last register, 0xFFFF")
        for (first, one), (second, other) in itertools.combinations(spans.items(), 2):
            if one.overlaps(other):
                raise ValueError(
                    f"{first} takes {_shown(one)} and {second} {_shown(other)}, which overlap; "
                    "compare addresses and types with the drive's manual"
                )
        for name, condition in self.conditions():
            for other_name in ("position", "target"):
                if condition.span.overlaps(spans[other_name]):
                    raise ValueError(f"{name} looks at {_shown(condition.span)}, which is the {other_name}")
        for write in self.start:
            if write.span.overlaps(spans["target"]):
                raise ValueError(f"start writes {_shown(write.span)}, which is the target itself")
        return self


def _shown(span: Span) -> str:
    if span.count == 1:
        return f"0x{span.address:02X}"
    return f"0x{span.address:02X}-0x{span.end - 1:02X}"

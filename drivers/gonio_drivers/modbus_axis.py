"""The goniometer on two drives of any make that speak Modbus: ``stage.driver = "modbus-registers"``.

What each register means is written in the rig file (`gonio_drivers.modbus_axis_map`); docs/drivers.md
explains the language and lists drives that it covers.
"""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from gonio.config import Count
from gonio.errors import DeviceError, ReplyError
from gonio.rig import SIMULATED, Context, Driver, StageConfig
from gonio_drivers.drive import MotorConfig
from gonio_drivers.lines import connecting
from gonio_drivers.modbus import LOOPBACK, Canary, Framing, ModbusLine, WordOrder, open_modbus
from gonio_drivers.modbus_axis_drive import RegisterDrive, setting_value
from gonio_drivers.modbus_axis_map import RegisterMap
from gonio_drivers.modbus_axis_reads import Span, choose_canary, joined, plan_reads
from gonio_drivers.modbus_axis_values import limits
from gonio_drivers.stage import MotorStage
from gonio_drivers.transport import Parity
from gonio_drivers.two_axes import open_two_axes


class RegisterAxisConfig(MotorConfig):
    """One drive, or one axis of a drive that has several."""

    device: Annotated[int, Field(strict=True, ge=1, le=247)]  # Modbus unit
    registers: RegisterMap | None = None  # this axis' own map


class RegisterStageConfig(StageConfig):
    """``[stage]`` with ``driver = "modbus-registers"``."""

    framing: Framing = "rtu"
    word_order: WordOrder = "big"  # which half of a 32-bit number has the lower address
    baudrate: Count = 115200
    parity: Parity = "none"  # of a serial line; Modbus' own default is even
    home_on_connect: bool = True  # for drives that cannot say whether they have a reference
    registers: RegisterMap | None = None  # the map of both axes
    theta_i: RegisterAxisConfig
    theta_mes: RegisterAxisConfig

    def axes(self) -> dict[str, tuple[RegisterAxisConfig, RegisterMap]]:
        """Return the two axes by name, each with the map that holds for it."""
        found = {}
        for name, axis in (("theta_i", self.theta_i), ("theta_mes", self.theta_mes)):
            registers = axis.registers or self.registers
            if registers is None:
                raise ValueError(
                    f"{name} has no register map; add [stage.registers], or [stage.{name}.registers] "
                    "if the axes differ"
                )
            found[name] = axis, registers
        return found

    def canaries(self) -> dict[int, Canary | None]:
        """Return the read by which each unit proves that it is in step; None if Modbus TCP needs none."""
        found: dict[int, Canary | None] = {}
        for unit in sorted({self.theta_i.device, self.theta_mes.device}):
            maps = [registers for axis, registers in self.axes().values() if axis.device == unit]
            blocks = [
                block
                for registers in maps
                for block in plan_reads(
                    registers.status_spans(), registers.position.span, bridge=registers.bridge
                )
            ]
            others = [span for registers in maps for span in registers.other_reads()]
            given = next((registers.canary for registers in maps if registers.canary is not None), None)
            if given == "loopback":
                found[unit] = LOOPBACK
            elif given is not None:
                if any((s.function, s.count) == (given.function, given.count) for s in (*blocks, *others)):
                    raise ValueError(
                        f"canary: {given.count} registers are read by others as well, so that their reply "
                        "could be taken for the canary's; give another count"
                    )
                found[unit] = Canary(given.function, given.address, given.count)
            else:
                found[unit] = _own_canary(maps, blocks, others)
                if found[unit] is None and self.framing == "rtu":
                    lengths = sorted({span.count for span in (*blocks, *others) if span.function >= 3})
                    raise ValueError(
                        f"unit {unit}: every reply has a length that another reply has too (registers: "
                        f"{', '.join(map(str, lengths))}), so that a late one could not be told apart; give "
                        "canary = { address = ..., count = ... } with registers that exist and another "
                        'count, or canary = "loopback" if the drive knows function 8'
                    )
        return found

    @model_validator(mode="after")
    def _framing_suits_the_line(self) -> Self:
        if self.framing == "tcp" and self.address != SIMULATED and not self.address.startswith("socket://"):
            raise ValueError(
                f"framing = 'tcp' at {self.address}: a serial port carries RTU frames; "
                "write framing = 'rtu' or an address socket://host:port"
            )
        return self

    @model_validator(mode="after")
    def _maps_suit_the_axes(self) -> Self:
        axes = self.axes()
        for name, (axis, registers) in axes.items():
            _check_range(name, axis, registers)
            _check_settings(name, axis, registers)
        (_, (one, one_map)), (_, (other, other_map)) = axes.items()
        if one.device == other.device:
            for what, span, other_span in (
                ("position", one_map.position.span, other_map.position.span),
                ("target", one_map.target.span, other_map.target.span),
            ):
                if span.overlaps(other_span):
                    raise ValueError(
                        f"theta_i and theta_mes have the same {what} register 0x{span.address:02X} of "
                        f"the same device {one.device}; give them two devices, or two maps"
                    )
        self.canaries()
        return self


def _own_canary(maps: list[RegisterMap], blocks: list[Span], others: list[Span]) -> Canary | None:
    """Return a canary among the registers of the state, or else among all that the maps know."""
    state = [span for m in maps for span in (*m.status_spans(), m.position.span)]
    every = [*state, *(register.span for m in maps for register in (m.target, *m.settings().values()))]
    reads = [*blocks, *others]
    return choose_canary(blocks, state, reads) or choose_canary(joined(every), every, reads)


def _check_range(name: str, axis: RegisterAxisConfig, registers: RegisterMap) -> None:
    """Refuse limits that the registers cannot hold, and a tolerance finer than their unit."""
    for what, register in (("position", registers.position), ("target", registers.target)):
        low, high = limits(register.type)
        for angle_deg in axis.limits_deg:
            value = (angle_deg - axis.zero_deg) * axis.steps_per_deg * register.scale
            if not low <= value <= high:
                raise ValueError(
                    f"{name}: at {angle_deg:g} deg the {what} register would hold {value:g}, but a "
                    f"{register.type} holds {low:g}...{high:g}; correct limits_deg, zero_deg or type"
                )
        if register.type == "float32":
            continue
        half_unit_deg = 0.5 / abs(axis.steps_per_deg * register.scale)
        if axis.tolerance_deg < half_unit_deg:
            raise ValueError(
                f"{name}: tolerance_deg = {axis.tolerance_deg:g} deg is below half a unit of the {what} "
                f"register, {half_unit_deg:.3g} deg: no move could arrive; raise it"
            )


def _check_settings(name: str, axis: RegisterAxisConfig, registers: RegisterMap) -> None:
    for setting, register in registers.settings().items():
        key, value = setting_value(register, setting, axis)
        lowest = 0.0 if register.type == "float32" else 0.5
        high = limits(register.type)[1]
        if not lowest < value <= high:
            raise ValueError(
                f"{name}: {key} = {getattr(axis, key):g} needs {value:g} in the {setting} register, but a "
                f"{register.type} holds 1...{high:g}; correct it or the scale of {setting}"
            )


def open_stage(config: RegisterStageConfig, context: Context) -> MotorStage:
    """Connect, set both drives up, enable the motors and find the references.

    Raises
    ------
    ConnectionFailed
        The address cannot be opened.
    DeviceError
        A drive does not answer, lacks a register of the map, refuses its speed, or does not find its
        reference.
    """
    line = open_modbus(
        "stage",
        config.address,
        context,
        framing=config.framing,
        word_order=config.word_order,
        baudrate=config.baudrate,
        parity=config.parity,
    )
    with connecting(line.line):
        for unit, canary in config.canaries().items():
            line.use_canary(unit, canary)
            _try_canary(line, unit)
    axes = config.axes()

    def make(name: str, axis: RegisterAxisConfig) -> RegisterDrive:
        return RegisterDrive(
            line,
            axis.device,
            name,
            axis,
            axes[name][1],
            config.word_order,
            context.clock,
            referenced=not config.home_on_connect,
        )

    return open_two_axes(config, context, line.line, make, shared=line)


def _try_canary(line: ModbusLine, unit: int) -> None:
    """A drive that refuses the canary would be found out only after the first late reply."""
    try:
        line.prove(unit)
    except ReplyError:
        raise
    except DeviceError as error:
        raise DeviceError(
            error.device,
            f"{error.fault}: it refused the canary, the read by which a late reply is found out",
            "give another canary for it in the rig file",
        ) from None


driver = Driver("stage", RegisterStageConfig, open_stage)

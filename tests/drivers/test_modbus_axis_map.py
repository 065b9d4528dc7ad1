"""The language of register maps: numbers, the plan of the reads, the canary, and what is refused."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.config import parse_toml, validate
from gonio.errors import ConfigError
from gonio.rig import load_rig
from gonio_drivers.modbus import LOOPBACK, Canary, ModbusLine
from gonio_drivers.modbus_axis import RegisterStageConfig
from gonio_drivers.modbus_axis_drive import RegisterDrive
from gonio_drivers.modbus_axis_reads import Span, choose_canary, plan_reads
from gonio_drivers.modbus_axis_values import decode, encode, limits, width

from .test_modbus import read, registers, rtu

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "rigs" / "arta-modbus-registers.toml"

STAGE = """
driver = "modbus-registers"
[registers]
position = { address = 0x10 }
target = { address = 0x20 }
speed = { address = 0x22, type = "u16", scale = 0.01 }
moving = [{ address = 0x00, mask = 0x0010 }]
stop = [{ address = 0x30, value = 2 }]
start = [{ address = 0x30, value = 1 }]
home = [{ address = 0x30, value = 4 }]
[theta_i]
device = 1
steps_per_deg = 1000.0
limits_deg = [0.0, 95.0]
[theta_mes]
device = 2
steps_per_deg = -1000.0
zero_deg = 180.0
limits_deg = [15.0, 180.0]
"""


def stage(text: str) -> RegisterStageConfig:
    return validate(RegisterStageConfig, parse_toml(text, source="rig"), source="rig", prefix="stage")


# -- numbers ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "kind", "big"),
    [
        (-2, "s16", [0xFFFE]),
        (40000, "u16", [40000]),
        (-200_000, "s32", [0xFFFC, 0xF2C0]),
        (3_000_000_000, "u32", [0xB2D0, 0x5E00]),
        (30.125, "float32", [0x41F1, 0x0000]),
    ],
)
def test_registers_of_a_number(value, kind, big):
    assert encode(value, kind, "big") == big
    assert encode(value, kind, "little") == big[::-1]
    assert decode(big, kind, "big") == decode(big[::-1], kind, "little") == value


@given(st.sampled_from(["s16", "u16", "s32", "u32"]), st.sampled_from(["big", "little"]), st.data())
def test_integers_come_back(kind, word_order, data):
    low, high = limits(kind)
    value = data.draw(st.integers(int(low), int(high)))
    there = encode(value, kind, word_order)
    assert len(there) == width(kind)
    assert decode(there, kind, word_order) == value


@given(st.floats(width=32))
def test_floats_come_back(value):
    back = decode(encode(value, "float32", "little"), "float32", "little")
    assert back == value or (math.isnan(back) and math.isnan(value))


# -- reads -----------------------------------------------------------------------------


def spans(*entries: tuple[int, int]) -> list[Span]:
    return [Span(3, address, count) for address, count in entries]


@pytest.mark.parametrize(
    ("status", "bridge", "plan"),
    [
        ([(0, 1), (1, 1)], 4, [(0, 8)]),  # Applied Motion: one read
        ([(0, 1), (1, 1)], 3, [(0, 2), (6, 2)]),
        ([(8, 1)], 0, [(6, 3)]),  # touching
        ([(6, 1), (7, 1)], 0, [(6, 2)]),  # inside
        ([(20, 1)], 0, [(20, 1), (6, 2)]),  # the position last, though its address is lower
        ([(0, 1), (6 + 124, 1)], 124, [(130, 1), (0, 8)]),  # 125 registers at most
        ([(6 + 124, 1)], 124, [(6, 125)]),
    ],
)
def test_plan(status, bridge, plan):
    assert plan_reads(spans(*status), Span(3, 6, 2), bridge=bridge) == tuple(spans(*plan))


def test_functions_are_read_apart():
    plan = plan_reads([Span(4, 0, 1), Span(2, 8, 1), Span(2, 9, 1)], Span(3, 0, 2), bridge=0)
    assert plan == (Span(2, 8, 2), Span(4, 0, 1), Span(3, 0, 2))


@given(
    st.lists(st.tuples(st.sampled_from([3, 4]), st.integers(0, 300), st.integers(1, 2)), max_size=12),
    st.integers(0, 400),
    st.integers(0, 124),
)
def test_every_plan_covers_everything_whole_and_shortly(wanted, address, bridge):
    position = Span(3, address, 2)
    parts = [Span(*part) for part in wanted]
    plan = plan_reads(parts, position, bridge=bridge)
    assert all(any(block.contains(part) for block in plan) for part in parts)
    assert plan[-1].contains(position)
    assert all(1 <= block.count <= 125 for block in plan)
    assert len(set(plan)) == len(plan) <= len(set(parts)) + 1
    canary = choose_canary(plan, [*parts, position], [*plan, Span(3, 900, 1)])
    for count in () if canary is None else (canary.count, *canary.spare):
        assert (canary.function, count) not in {(b.function, b.count) for b in plan}
        assert (canary.function, count) != (3, 1)
        assert any(block.contains(Span(canary.function, canary.address, count)) for block in plan)


# -- canaries ----------------------------------------------------------------------------


def test_the_example_needs_no_canary_of_its_own():
    assert set(load_rig(EXAMPLE).stage.canaries().values()) == {Canary(3, 0x00, 2)}


def test_a_map_without_a_free_length_is_told_what_to_do():
    assert set(stage(STAGE).canaries().values()) == {Canary(3, 0x20, 3)}, "target and speed"
    lone = STAGE.replace("0x22", "0x40")
    with pytest.raises(ConfigError, match=r"unit 1: every reply .*\(registers: 1, 2\).*canary = \{ address"):
        stage(lone)
    given = lone.replace("home =", "canary = { address = 0x20, count = 4 }\nhome =")
    assert set(stage(given).canaries().values()) == {Canary(3, 0x20, 4)}
    assert set(stage(lone.replace("home =", 'canary = "loopback"\nhome =')).canaries().values()) == {LOOPBACK}
    tcp = lone.replace("[registers]", 'framing = "tcp"\n[registers]')
    assert set(stage(tcp).canaries().values()) == {None}
    with pytest.raises(ConfigError, match="2 registers are read by others as well"):
        stage(lone.replace("home =", "canary = { address = 0x20, count = 2 }\nhome ="))


def drive(scripted, context, text: str, *exchanges) -> RegisterDrive:
    config = stage(text)
    line = ModbusLine(scripted(*exchanges), "rtu", "big")
    for unit, canary in config.canaries().items():
        line.use_canary(unit, canary)
    axis, map_ = config.axes()["theta_i"]
    return RegisterDrive(line, 1, "theta_i", axis, map_, "big", context.clock, referenced=True)


SLOW = STAGE.replace("home =", "canary = { address = 0x20, count = 4 }\nhome =")
CONNECT = ((rtu("01 06 0022 00c8"), rtu("01 06 0022 00c8")), (read(0x22, 1), registers(200)))


def test_exact_bytes(scripted, context):
    axis = drive(
        scripted,
        context,
        SLOW,
        *CONNECT,
        (rtu("01 10 0020 0002 04 ffff d8f0"), rtu("01 10 0020 0002")),
        (rtu("01 06 0030 0001"), rtu("01 06 0030 0001")),
        (read(0x00, 1), registers(0x10)),
        (read(0x10, 2), registers(0xFFFF, 0xFFFE)),
        (rtu("01 06 0030 0002"), rtu("01 06 0030 0002")),
    )
    axis.move_to(-10_000)
    state = axis.state()
    assert (state.position_steps, state.moving, state.fault) == (-2, True, None)
    axis.stop()


def test_a_late_reply_of_a_map_is_found_out_by_its_canary(scripted, context):
    axis = drive(
        scripted,
        context,
        SLOW,
        *CONNECT,
        (read(0x00, 1), registers(0)),
        (read(0x10, 2), []),  # comes after the line was quiet: not the canary's length
        (read(0x20, 4), registers(0, 7)),
        (read(0x20, 4), registers(1, 2, 3, 4)),  # asked once more
        (read(0x10, 2), registers(0, 9)),
    )
    assert axis.state().position_steps == 9


def test_a_loopback_is_never_the_same_twice(scripted, context):
    text = SLOW.replace("{ address = 0x20, count = 4 }", '"loopback"')
    axis = drive(
        scripted,
        context,
        text,
        *CONNECT,
        (rtu("01 08 0000 0001"), rtu("01 08 0000 0001")),
        (rtu("01 08 0000 0002"), rtu("01 08 0000 0001")),  # the first came twice
    )
    axis._line.prove(1)
    with pytest.raises(Exception, match="not the loopback"):
        axis._line.prove(1)


def test_a_drive_that_cannot_tell_a_restart_is_set_up_again_in_any_case(scripted, context):
    text = SLOW.replace("scale = 0.01 }", "scale = 0.01, read_back = false }")
    axis = drive(scripted, context, text, CONNECT[0], CONNECT[0])
    assert axis.confirm(0) is None
    axis.resume()


def test_a_drive_that_forgot_nothing_is_not_written_to(scripted, context):
    axis = drive(scripted, context, SLOW, *CONNECT, CONNECT[1])
    axis.resume()


# -- refusals ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("target = { address = 0x20 }", "target = { address = 0x11 }", "position takes 0x10-0x11 and target"),
        ("address = 0x22", "address = 0x21", "target takes 0x20-0x21 and speed 0x21, which overlap"),
        ("0x00, mask", "0x11, mask", "moving looks at 0x11, which is the position"),
        ("0x30, value = 1 }", "0x21, value = 1 }", "start writes 0x21, which is the target itself"),
        ("mask = 0x0010", "mask = 0", "mask = 0 looks at no bit"),
        ("mask = 0x0010", "mask = 0x10, equals = 1", "bits outside mask = 0x0010 and can never be met"),
        ("moving = ", "# ", "nothing would say when a move ends"),
        ("stop = ", "# ", "stop is missing"),
        ("home = ", "finish_home = ", "finish_home without home"),
        ("value = 1 }", "value = 70000 }", "70000 does not fit a u16, which holds 0...65535"),
        ("value = 1 }", "value = 2, write_function = 5 }", "2 does not fit a coil"),
        ("value = 1 }", 'value = 2, type = "s32", write_function = 6 }', "a s32 takes two; use 16"),
        ("value = 1 }", "value = 1, hold_s = 0.1 }", "waits for nothing"),
        ("address = 0x20 }", "address = 0xFFFF }", "ends behind the last register"),
        ("address = 0x20 }", "address = 0x20, write_function = 6 }", "writes one register"),
        ("address = 0x20 }", 'address = 0x20, type = "s16" }', "at 95 deg the target register would hold"),
        ("address = 0x10 }", 'address = 0x10, type = "u16" }', "a u16 holds 0...65535"),
        ("scale = 0.01", "scale = 10.0", "theta_i: speed_deg_s = 20 needs 200000 in the speed register"),
        ("scale = 0.01", "scale = 0.00001", "needs 0.2 in the speed register, but a u16 holds 1...65535"),
        ("scale = 0.01", "scale = 0.0", "scale = 0"),
        ("address = 0x20 }", "address = 0x20, scale = 0.01 }", "below half a unit of the target register"),
        ("device = 2", "device = 1", "the same position register 0x10 of the same device 1"),
        ("[registers]", "[registers]\nalarm = { address = 0x40, bits = { x = 'a' } }", "not a number"),
        ("[registers]", "[registers]\nalarm = { address = 0x40, bits = { 16 = 'a' } }", "a u16 has 0...15"),
        ("[registers]", "[registers]\nalarm = { address = 0x10 }", "position takes .* and alarm"),
        ("position =", "positon =", "did you mean 'position'"),
    ],
)
def test_maps_that_cannot_work(old, new, words):
    text = STAGE.replace(old, new, 1)
    assert text != STAGE
    with pytest.raises(ConfigError, match=re.escape(words) if ".*" not in words else words):
        stage(text)


def test_an_axis_without_a_map():
    lines = [line for line in STAGE.splitlines() if "{ address" not in line and line != "[registers]"]
    with pytest.raises(ConfigError, match=r"theta_i has no register map; add \[stage.registers\]"):
        stage("\n".join(lines))


def test_two_axes_of_one_drive_with_maps_of_their_own():
    table = parse_toml(STAGE.replace("device = 2", "device = 1"), source="rig")
    own = {**table["registers"], "position": {"address": 0x12}, "target": {"address": 0x24}}
    table["theta_mes"]["registers"] = own
    config = validate(RegisterStageConfig, table, source="rig")
    assert [map_.position.address for _, map_ in config.axes().values()] == [0x10, 0x12]
    assert config == RegisterStageConfig.model_validate(config.model_dump())

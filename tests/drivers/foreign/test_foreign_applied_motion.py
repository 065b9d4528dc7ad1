"""Applied Motion drives as a servo, a slow drive, an old drive and a two-wire adapter behave."""

from __future__ import annotations

import struct

import pytest

from gonio.clock import Clock
from gonio.errors import ConnectionFailed, DeviceError, MotionError
from gonio.rig import Context
from gonio_drivers.applied_motion import open_stage
from gonio_drivers.lines import NoReply
from gonio_drivers.modbus import ModbusLine, open_modbus

from .applied_motion_servo import ServoLine, crc
from .bench import ForeignBench
from .rigs import SERVO_STAGE, foreign_rig
from .wires import served

NOWHERE = dict.fromkeys(("polarizer", "monochromator", "lockin"), "/dev/null")


def stage_config(address: str, *, word_order: str = "big"):
    return foreign_rig(SERVO_STAGE, {**NOWHERE, "stage": address}, word_order=word_order).stage


def context() -> Context:
    return Context("foreign", Clock())


@pytest.mark.parametrize(
    ("big", "echo", "has_function_16"), [(True, True, True), (False, False, False), (False, True, False)]
)
def test_a_servo_is_waited_for_until_it_is_in_position(big, echo, has_function_16):
    bench = ForeignBench()
    line = ServoLine(bench, big=big, echo=echo, has_function_16=has_function_16)
    with served(line, chunk=3) as address:
        stage = open_stage(stage_config(address, word_order="big" if big else "little"), context())
        for _ in range(2):
            for axis, target_deg in ((stage.theta_i, 30.0), (stage.theta_mes, 150.0), (stage.theta_i, 25.0)):
                axis.start(target_deg)
                assert axis.wait() == pytest.approx(target_deg, abs=0.01)
        assert (bench.theta_i_deg(), bench.theta_mes_deg()) == pytest.approx((25.0, 150.0), abs=0.01)
        stage.close()
    assert line.busy_answers > 0  # a busy drive was told again


@pytest.mark.parametrize("word_order", ["big", "little"])
def test_the_wrong_word_order_is_seen_before_anything_turns_far(word_order):
    """After the search for home the count is that of its way, which only one order makes a plausible one."""
    bench = ForeignBench()
    line = ServoLine(bench, big=word_order != "big")
    with (
        served(line) as address,
        pytest.raises(MotionError, match=r"theta_i .* and -5000 in the other word order; .*; correct word_o"),
    ):
        open_stage(stage_config(address, word_order=word_order), context())
    assert all(drive.angle_steps() == 0.0 for drive in line.drives.values())  # at the switch


def test_the_wrong_word_order_is_seen_on_the_way():
    """A drive that stood at its switch has no count that tells; the first move has."""
    bench = ForeignBench()
    line = ServoLine(bench, big=False)
    for drive in line.drives.values():
        drive.count_zero = 0.0
    with served(line) as address:
        stage = open_stage(stage_config(address), context())
        stage.theta_i.start(30.0)
        with pytest.raises(MotionError, match=r"in the other word order; .*; correct word_order"):
            stage.theta_i.wait()
        stage.close()
    assert not line.drives[1].glide.is_moving()
    assert abs(bench.theta_i_deg()) < 1e4  # on its way to 1.9 million degrees


def test_a_silent_unit_is_named():
    with served(ServoLine(ForeignBench(), echo=True)) as address:
        config = stage_config(address)
        absent = config.theta_mes.model_copy(update={"device": 3})
        with pytest.raises(ConnectionFailed, match=r"stage at .* unit 3: gave no complete reply"):
            open_stage(config.model_copy(update={"theta_mes": absent}), context())


def test_a_drive_that_confirms_late_is_waited_for():
    with served(ServoLine(ForeignBench(), write_s=1.1)) as address:
        line = open_modbus("stage", address, context(), framing="rtu", word_order="big", baudrate=9600)
        line.read(1, 0, 2)
        line.write_one(1, 0x7D, 7)
        assert line.read(1, 0x7D, 1) == [7]
        line.close()


def frame(hexadecimal: str) -> bytes:
    body = bytes.fromhex(hexadecimal)
    return body + crc(body)


def test_an_echo_alone_confirms_nothing(scripted):
    """On a line that echoes, the bytes of a one-register write come back whether a drive hears it or not."""
    ask, told = frame("01 03 0000 0002"), frame("01 03 04 0000 0009")
    write = frame("01 06 007c 0067")
    line = ModbusLine(scripted((ask, [ask[:3], ask[3:] + told]), (write, write)), "rtu", "big")
    assert line.read(1, 0, 2) == [0, 9]
    with pytest.raises(NoReply, match="unit 1: gave no complete reply"):
        line.write_one(1, 0x7C, 0x67)


def test_without_echo_a_confirmation_is_one(scripted):
    ask, told = frame("01 03 0000 0002"), frame("01 03 04 0000 0009")
    write = frame("01 06 007c 0067")
    line = ModbusLine(scripted((ask, told), (write, [write[:2], write[2:]])), "rtu", "big")
    line.read(1, 0, 2)
    line.write_one(1, 0x7C, 0x67)


@pytest.mark.parametrize("code", [0x06, 0x14])
def test_a_busy_drive_is_asked_again_and_a_refusal_is_not_repeated(scripted, code):
    write, busy = frame("01 06 007c 0067"), frame(f"01 86 {code:02x}")
    ModbusLine(scripted((write, busy), (write, busy), (write, write)), "rtu", "big").write_one(1, 0x7C, 0x67)
    with pytest.raises(DeviceError, match="exception 4"):
        ModbusLine(scripted((write, frame("01 86 04"))), "rtu", "big").write_one(1, 0x7C, 0x67)


def test_a_drive_without_function_16_gets_registers_one_by_one(scripted):
    together = frame("01 10 001e 0002 04 0001 0002")
    one, two = frame("01 06 001e 0001"), frame("01 06 001f 0002")
    line = ModbusLine(
        scripted((together, frame("01 90 01")), (one, one), (two, two), (one, one), (two, two)), "rtu", "big"
    )
    for _ in range(2):
        line.write(1, 0x1E, struct.unpack(">HH", bytes.fromhex("00010002")))

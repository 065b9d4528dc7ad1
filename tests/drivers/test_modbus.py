"""Modbus frames: exact bytes in both framings, and no reply taken for another's."""

from __future__ import annotations

import struct

import pytest
from pydantic import ValidationError

from gonio.errors import DeviceError, ReplyError
from gonio_drivers.applied_motion import (
    AppliedMotionAxisConfig,
    AppliedMotionDrive,
    AppliedMotionStageConfig,
    open_stage,
)
from gonio_drivers.lines import NoReply
from gonio_drivers.modbus import CANARY_COUNT, ModbusLine

from .conftest import SILENCE


def crc16(body: bytes) -> bytes:
    """CRC-16/MODBUS bit by bit, low byte first (Modbus over Serial Line V1.02, 6.2.2)."""
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return struct.pack("<H", crc)


def rtu(hexadecimal: str) -> bytes:
    body = bytes.fromhex(hexadecimal)
    return body + crc16(body)


def registers(*values: int, unit: int = 1) -> bytes:
    return rtu(f"{unit:02x} 03 {2 * len(values):02x}" + "".join(f"{v & 0xFFFF:04x}" for v in values))


def read(address: int, count: int, unit: int = 1) -> bytes:
    return rtu(f"{unit:02x} 03 {address:04x} {count:04x}")


CANARY = (read(0, CANARY_COUNT), registers(*[9] * CANARY_COUNT))


def modbus(scripted, *exchanges, framing="rtu", word_order="big") -> ModbusLine:
    return ModbusLine(scripted(*exchanges), framing, word_order)


def test_documented_frames(scripted):
    write = bytes.fromhex("01 10 00 1B 00 05 0A 02 58 02 58 00 F0 00 03 0D 40 CD 83")
    go = bytes.fromhex("01 06 00 7C 00 67 09 F8")
    stop = bytes.fromhex("01 06 00 7C 00 E1 88 5A")
    line = modbus(
        scripted,
        (write, bytes.fromhex("01 10 00 1B 00 05 70 0D")),
        (go, go),
        (stop, stop),
        (bytes.fromhex("01 03 00 01 00 01 D5 CA"), bytes.fromhex("01 03 02 40 01 48 44")),
    )
    line.write(1, 0x1B, [600, 600, 240, *line.from_s32(200_000)])
    line.write_one(1, 0x7C, 0x67)
    line.write_one(1, 0x7C, 0xE1)
    assert line.read(1, 0x01, 1) == [0x4001]


def test_tcp_frames_carry_transaction_numbers(scripted):
    def tcp(number: int, body: str) -> bytes:
        data = bytes.fromhex(body)
        return struct.pack(">HHH", number, 0, len(data)) + data

    line = modbus(
        scripted,
        (tcp(1, "01 03 0000 0002"), tcp(1, "01 03 04 0001 0002")),
        # the late reply to another number is skipped, split where it hurts
        (
            tcp(2, "01 03 0000 0002"),
            [
                tcp(1, "01 03 04 0009 0009"),
                tcp(2, "01 03 04 0003 0004")[:5],
                tcp(2, "01 03 04 0003 0004")[5:],
            ],
        ),
        framing="tcp",
    )
    assert line.read(1, 0, 2) == [1, 2]
    assert line.read(1, 0, 2) == [3, 4]


@pytest.mark.parametrize("value", [0, 1, -1, 200_000, -200_000, 2**31 - 1, -(2**31)])
def test_word_orders(scripted, value):
    high, low = struct.unpack(">HH", struct.pack(">i", value))
    big, little = modbus(scripted), modbus(scripted, word_order="little")
    assert big.from_s32(value) == [high, low]
    assert little.from_s32(value) == [low, high]
    assert big.s32([high, low]) == little.s32([low, high]) == value


def test_a_late_rtu_reply_is_never_the_next_answer(scripted):
    """RTU has no transaction number: asked for 20, a library alone returns the late 10."""
    line = modbus(
        scripted,
        (read(10, 1), [SILENCE, registers(1010)]),  # comes while the line is drained
        CANARY,
        (read(10, 1), registers(1010)),
        (read(20, 1), registers(2020)),
    )
    assert line.read(1, 10, 1) == [1010]
    assert line.read(1, 20, 1) == [2020]


def test_a_very_late_rtu_reply_is_found_out_by_the_canary(scripted):
    line = modbus(
        scripted,
        (read(10, 1), []),
        (CANARY[0], registers(1010)),  # later than the line was quiet: not the canary's length
        (read(0, 6), registers(*[9] * 6)),
        (read(10, 1), registers(1011)),
    )
    assert line.read(1, 10, 1) == [1011]


def test_the_late_reply_to_a_canary_does_not_prove_the_next(scripted):
    """Between the two canaries' replies lies one that would be taken for the reading (found by fuzzing)."""
    line = modbus(
        scripted,
        (read(10, 1), []),
        (CANARY[0], []),
        (read(0, 6), CANARY[1]),
        (read(0, 5), [registers(1010), registers(*[9] * 5)]),
        (read(0, 4), registers(*[9] * 4)),
        (read(20, 1), registers(2020)),
    )
    with pytest.raises(ReplyError, match="no complete reply"):
        line.read(1, 10, 1)
    with pytest.raises(ReplyError, match="not the 5 registers"):  # after the 6, which were the 7 asked before
        line._read(1, 20, 1, 3)
    assert line.read(1, 20, 1) == [2020]


def test_nobody_may_ask_for_the_canarys_length(scripted):
    with pytest.raises(ValueError, match="canary"):
        modbus(scripted).read(1, 0, CANARY_COUNT)


@pytest.mark.parametrize("damage", ["crc", "garbage", "other unit", "short"])
def test_damaged_rtu_replies(scripted, damage):
    good = registers(5)
    reply = {
        "crc": good[:-1] + bytes([good[-1] ^ 1]),
        "garbage": b"\xff\xfe\xfd",
        "other unit": registers(5, unit=2),
        "short": good[:-1],
    }[damage]
    line = modbus(scripted, (read(3, 1), reply), CANARY, (read(3, 1), good))
    assert line.read(1, 3, 1) == [5]
    assert line.line.statistics.retries == 1


def test_a_write_is_never_repeated(scripted):
    line = modbus(scripted, (rtu("01 06 007c 0067"), []))
    with pytest.raises(NoReply, match="within 4 s"):
        line.write_one(1, 0x7C, 0x67)


def test_a_wrong_confirmation_is_an_error(scripted):
    line = modbus(scripted, (rtu("01 06 007c 0067"), rtu("01 06 007c 00e1")))
    with pytest.raises(ReplyError, match="not the confirmation of a write to 0x7C"):
        line.write_one(1, 0x7C, 0x67)


@pytest.mark.parametrize(
    ("code", "words"), [(1, "function"), (2, "register"), (3, "refused the value"), (4, "failed")]
)
def test_exceptions_in_words(scripted, code, words):
    line = modbus(scripted, (read(0, 2), rtu(f"01 83 {code:02x}")))
    with pytest.raises(
        DeviceError, match=rf"stage at scripted unit 1: .*{words}.*\(Modbus exception {code}\)"
    ):
        line.read(1, 0, 2)


# -- the drive -----------------------------------------------------------------------

CONFIG = AppliedMotionAxisConfig(
    device=1, steps_per_deg=4000.0, limits_deg=(0.0, 90.0), speed_deg_s=20.0, acceleration_deg_s2=100.0
)
# 20 deg/s x 4000 steps/deg / 20 000 steps/rev = 4 rps, x 240 = 960; 100 deg/s2 = 20 rps/s, x 6 = 120
CONNECT = (
    (rtu("01 10 001b 0003 06 0078 0078 03c0"), rtu("01 10 001b 0003")),
    (read(0x1B, 3), registers(120, 120, 960)),
    (rtu("01 06 0081 5aa5"), rtu("01 06 0081 5aa5")),
    (read(0x81, 1), registers(0x5AA5)),
)


def drive(scripted, *exchanges, config=CONFIG) -> AppliedMotionDrive:
    return AppliedMotionDrive(modbus(scripted, *CONNECT, *exchanges), "theta_i", config, referenced=True)


def opcode(code: int) -> tuple[bytes, bytes]:
    return rtu(f"01 06 007c {code:04x}"), rtu(f"01 06 007c {code:04x}")


def test_move_home_and_stop_bytes(scripted):
    axis = drive(
        scripted,
        (rtu("01 10 001e 0002 04 fffe c780"), rtu("01 10 001e 0002")),
        opcode(0x67),
        opcode(0xE1),
        opcode(0xDB),
        (rtu("01 10 007d 0002 04 0000 0000"), rtu("01 10 007d 0002")),
        opcode(0xA5),
        opcode(0xBA),
        opcode(0x9F),
    )
    axis.move_to(-80_000)
    axis.stop()
    axis.home()
    axis.finish_home()
    axis.clear_faults()


def test_a_stop_may_be_repeated_a_move_may_not(scripted):
    axis = drive(scripted, (opcode(0xE1)[0], []), CANARY, opcode(0xE1))
    axis.stop()
    axis = drive(
        scripted, (rtu("01 10 001e 0002 04 0000 0001"), rtu("01 10 001e 0002")), (opcode(0x67)[0], [])
    )
    with pytest.raises(NoReply):
        axis.move_to(1)


@pytest.mark.parametrize(
    ("alarm", "status", "moving", "words"),
    [
        (0, 0x0009, False, None),
        (0, 0x0011, True, None),
        (0, 0x0401, True, None),
        (0x0001, 0x0205, False, "stalled"),
        (0x0002, 0x0201, False, "counter-clockwise limit"),
        (0x0004, 0x0201, False, "it met the clockwise limit"),
        (0x0008, 0x0201, False, "too hot"),
        (0x1000, 0x0200, False, "motor was disabled"),
        (0x8000, 0x0201, False, "alarm bit 15"),
        (0x0020, 0x0201, False, "voltage is too high"),
        (0x4400, 0x0209, False, None),
        (0x0003, 0x0201, False, "stalled or was pushed and it met"),
        (0, 0x0005, False, "fault without an alarm bit"),
        (0, 0x0008, False, "motor is disabled"),
    ],
)
def test_alarm_and_status_bits_in_words(scripted, alarm, status, moving, words):
    axis = drive(scripted, (read(0, 8), registers(alarm, status, 0, 0, 0, 777, 0xFFFF, 0xFFFE)))
    state = axis.state()
    assert (state.position_steps, state.moving) == (-2, moving)
    assert (state.fault is None) if words is None else (words in state.fault)


def test_with_an_encoder_the_read_back_is_the_shafts(scripted):
    config = CONFIG.model_copy(update={"encoder_counts_per_rev": 4000.0})
    axis = drive(scripted, (read(0, 8), registers(0, 9, 0, 0, 0, 2000, 0, 9999)), config=config)
    assert axis.state().position_steps == 10_000  # half a revolution


def test_a_drive_that_was_switched_off_has_forgotten_the_mark(scripted):
    axis = drive(
        scripted,
        (read(0x81, 1), registers(0x5AA5)),
        (read(0x81, 1), registers(0)),
        (read(0x81, 1), registers(0)),
        *CONNECT,
    )
    assert axis.confirm(0) is None
    assert "switched off" in axis.confirm(0)
    axis.resume()  # sets speeds and mark again; the reference is gone
    axis._line.read = lambda unit, address, count: [0, 9, 0, 0, 0, 0, 0, 0]
    assert not axis.state().referenced


def test_a_drive_without_that_register_is_known_by_its_speeds(scripted):
    refused = rtu("01 86 02")
    axis = AppliedMotionDrive(
        modbus(
            scripted,
            *CONNECT[:2],
            (CONNECT[2][0], refused),
            (read(0x1B, 3), registers(120, 120, 960)),
            (read(0x1B, 3), registers(600, 600, 240)),
        ),
        "theta_i",
        CONFIG,
        referenced=True,
    )
    assert axis.confirm(0) is None
    assert "switched off" in axis.confirm(0)


def test_speeds_that_no_register_holds(scripted):
    config = CONFIG.model_copy(update={"speed_deg_s": 1e4})
    with pytest.raises(DeviceError, match=r"speed_deg_s needs 480000 in a register that holds 1\.\.\.65535"):
        AppliedMotionDrive(modbus(scripted), "theta_i", config, referenced=True)


def test_speeds_the_drive_did_not_take(scripted):
    line = modbus(scripted, CONNECT[0], (CONNECT[1][0], registers(120, 120, 900)))
    with pytest.raises(DeviceError, match=r"was told .*\[120, 120, 960\] and reads \[120, 120, 900\]"):
        AppliedMotionDrive(line, "theta_i", CONFIG, referenced=True)


def test_tcp_frames_on_a_serial_port_are_a_mistake_in_the_rig_file():
    with pytest.raises(ValidationError, match="a serial port carries RTU frames"):
        AppliedMotionStageConfig(
            driver="applied-motion", address="/dev/ttyUSB0", framing="tcp", theta_i=CONFIG, theta_mes=CONFIG
        )


def test_open_stage_is_the_entry_points_function():
    from gonio.rig import find_driver

    assert find_driver("stage", "applied-motion", source="test").open is open_stage

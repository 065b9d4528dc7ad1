"""Zaber stages: exact bytes, numbers that tell replies apart, flags in words."""

from __future__ import annotations

import pytest

from gonio.errors import DeviceError, ReplyError
from gonio_drivers.lines import NoReply
from gonio_drivers.zaber import ZaberAxisConfig, ZaberDrive
from gonio_drivers.zaber_protocol import Reply, ZaberLine, checksum

from .conftest import SILENCE

CONFIG = ZaberAxisConfig(
    device=1, steps_per_deg=-12800.0 / 3, limits_deg=(0.0, 180.0), speed_deg_s=20.0, acceleration_deg_s2=100.0
)
# 20 deg/s = 85 333.3 microsteps/s, x 1.6384 = 139 810; 100 deg/s2 = 426 666.7, x 1.6384e-4 = 69.9
CONNECT = (
    (b"/1 1 01 set maxspeed 139810\n", b"@01 1 01 OK IDLE -- 0\r\n"),
    (b"/1 1 02 get maxspeed\n", b"@01 1 02 OK IDLE -- 139810\r\n"),
    (b"/1 1 03 set accel 70\n", b"@01 1 03 OK IDLE -- 0\r\n"),
    (b"/1 1 04 get accel\n", b"@01 1 04 OK IDLE -- 70\r\n"),
)


def chain(line, *, after: int = 0, checksums: bool = False) -> ZaberLine:
    zaber = ZaberLine(line, checksums=checksums)
    zaber._number = after
    return zaber


def drive(scripted, *exchanges) -> ZaberDrive:
    return ZaberDrive(chain(scripted(*CONNECT, *exchanges)), "theta_i", CONFIG)


@pytest.mark.parametrize(
    ("number", "command", "request_", "reply", "expected"),
    [
        (0, "", b"/0 0 00\n", b"@00 0 00 OK IDLE WR 0\r\n", Reply(False, "WR", "0")),
        (3, "get pos", b"/1 1 03 get pos\n", b"@01 1 03 OK IDLE WR 0\r\n", Reply(False, "WR", "0")),
        (5, "home", b"/1 1 05 home\n", b"@01 1 05 OK BUSY -- 0\r\n", Reply(True, "--", "0")),
        (
            7,
            "move abs 20000",
            b"/1 1 07 move abs 20000\n",
            b"@01 1 07 OK BUSY -- 0\r\n",
            Reply(True, "--", "0"),
        ),
        (8, "", b"/1 1 08\n", b"@01 1 08 OK BUSY -- 0\r\n", Reply(True, "--", "0")),
        (15, "stop", b"/1 1 15 stop\n", b"@01 1 15 OK BUSY -- 0\r\n", Reply(True, "--", "0")),
        (17, "warnings", b"/1 1 17 warnings\n", b"@01 1 17 OK IDLE -- 00\r\n", Reply(False, "--", "00")),
    ],
)
def test_documented_exchanges(scripted, number, command, request_, reply, expected):
    device = axis = int(request_[1:2])
    zaber = chain(scripted((request_, reply)), after=(number - 1) % 100)
    assert zaber.command(device, axis, command) == expected


def test_documented_checksum(scripted):
    assert checksum(b"1 1 02 get pos") == 0x2A
    zaber = chain(
        scripted((b"/1 1 02 get pos:2A\n", b"@01 1 02 OK IDLE -- 30000:47\r\n")), after=1, checksums=True
    )
    assert zaber.command(1, 1, "get pos") == Reply(False, "--", "30000")


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        ("BADDATA", "out of range"),
        ("BADCOMMAND", "does not know this command"),
        ("PARKED", "is parked"),
        ("XYZ", "rejected the command"),
    ],
)
def test_a_rejection_is_an_error_in_words_and_not_repeated(scripted, reason, words):
    line = scripted((b"/1 1 01 move abs -5\n", f"@01 1 01 RJ IDLE -- {reason}\r\n".encode()))
    with pytest.raises(DeviceError, match=rf"stage at scripted device 1: .*{words}.*'move abs -5'"):
        chain(line).query(1, 1, "move abs -5")


def test_alerts_and_late_replies_are_not_the_answer(scripted):
    line = scripted(
        (
            b"/1 1 01 get pos\n",
            [
                b"!01 1 IDLE --\r\n#01 1 note\r\n@01 1 99 OK IDLE -- 111\r\n",
                b"@02 1 01 OK IDLE -- 222\r\n",
                b"@01 1 01 OK",
                b" IDLE -- 333\r\n",
            ],
        )
    )
    assert chain(line).command(1, 1, "get pos").data == "333"


def test_the_reply_that_comes_after_its_deadline_is_never_the_next_answer(scripted):
    """Also when it arrives only after the line was quiet: its number betrays it."""
    line = scripted(
        (b"/1 1 01 get pos\n", []),
        (b"/1 1 02 get pos\n", b"@01 1 01 OK IDLE -- 111\r\n@01 1 02 OK IDLE -- 222\r\n"),
        (b"/1 1 03 get pos\n", [SILENCE, b"@01 1 03 OK IDLE -- 333\r\n"]),
        (b"/1 1 04 get pos\n", b"@01 1 04 OK IDLE -- 444\r\n"),
    )
    zaber = chain(line)
    assert zaber.query(1, 1, "get pos").data == "222"
    assert zaber.query(1, 1, "get pos").data == "444"
    assert line.statistics.retries == 2


def test_numbers_wrap_after_99(scripted):
    line = scripted(
        (b"/1 1 99\n", b"@01 1 99 OK IDLE -- 0\r\n"), (b"/1 1 00\n", b"@01 1 00 OK IDLE -- 0\r\n")
    )
    zaber = chain(line, after=98)
    zaber.command(1, 1, "")
    zaber.command(1, 1, "")


@pytest.mark.parametrize(
    "reply",
    [b"garbage\r\n", b"@01 1 01 OK MAYBE -- 3\r\n", b"@01 1 01 OK IDLE -- 30002:47\r\n", b"@01 1 0\r\n"],
)
def test_a_damaged_reply_is_an_error(scripted, reply):
    with pytest.raises(ReplyError, match="replied"):
        chain(scripted((b"/1 1 01 get pos\n", reply))).command(1, 1, "get pos")


def test_noise_before_a_reply_is_harmless(scripted):
    line = scripted((b"/1 1 01 get pos\n", b"\xff\x00@@01 1 01 OK IDLE -- 5\r\n"))
    assert chain(line).command(1, 1, "get pos").data == "5"


def test_once_replies_have_checksums_one_without_is_damaged(scripted):
    reply = b"01 1 %02d OK IDLE -- 5"
    first = b"@" + reply % 1 + b":%02X\r\n" % checksum(reply % 1)
    zaber = chain(scripted((b"/1 1 01\n", first), (b"/1 1 02\n", b"@" + reply % 2 + b"\r\n")))
    zaber.command(1, 1, "")
    with pytest.raises(ReplyError, match="checksum is missing"):
        zaber.command(1, 1, "")


def test_speed_and_acceleration_are_set_once_in_the_devices_units_and_read_back(scripted):
    drive(scripted)


def test_a_speed_the_device_did_not_take_is_an_error(scripted):
    exchanges = (CONNECT[0], (b"/1 1 02 get maxspeed\n", b"@01 1 02 OK IDLE -- 100000\r\n"))
    with pytest.raises(DeviceError, match="was told maxspeed = 139810 and reads 100000; lower speed_deg_s"):
        ZaberDrive(chain(scripted(*exchanges)), "theta_i", CONFIG)


def test_move_home_stop_bytes(scripted):
    axis = drive(
        scripted,
        (b"/1 1 05 move abs -64000\n", b"@01 1 05 OK BUSY -- 0\r\n"),
        (b"/1 1 06 get pos\n", b"@01 1 06 OK BUSY -- -12345\r\n"),
        (b"/1 1 07 stop\n", b"@01 1 07 OK BUSY -- 0\r\n"),
        (b"/1 1 08 home\n", b"@01 1 08 OK BUSY WR 0\r\n"),
        (b"/1 1 09 warnings clear\n", b"@01 1 09 OK IDLE -- 00\r\n"),
    )
    axis.move_to(-64000)
    state = axis.state()
    assert (state.position_steps, state.moving, state.referenced, state.fault) == (-12345, True, True, None)
    axis.stop()
    axis.home()
    axis.finish_home()


@pytest.mark.parametrize(
    ("flags", "referenced", "words"),
    [
        (["FS"], True, "stalled"),
        (["FE"], True, "limit switch"),
        (["FD"], True, "driver is disabled"),
        (["FH"], True, "emergency stop"),
        (["FQ"], True, "encoder"),
        (["FF"], True, "critical"),
        (["WM"], True, "displaced"),
        (["NI"], True, "interrupted"),
        (["NC"], True, "manual control"),
        (["F9"], True, "unknown fault"),
        (["WR"], False, None),
        (["WH"], False, None),
        (["WR", "FS"], False, "stalled"),
        (["WS"], True, None),
    ],
)
def test_flags_in_words(scripted, flags, referenced, words):
    data = " ".join([f"{len(flags):02d}", *flags])
    axis = drive(
        scripted,
        (b"/1 1 05 get pos\n", f"@01 1 05 OK IDLE {flags[0]} 42\r\n".encode()),
        (b"/1 1 06 warnings\n", f"@01 1 06 OK IDLE {flags[0]} {data}\r\n".encode()),
    )
    state = axis.state()
    assert state.position_steps == 42
    assert state.referenced is referenced
    assert (state.fault is None) if words is None else (words in state.fault)


def test_a_move_whose_reply_fails_is_not_sent_again(scripted):
    axis = drive(scripted, (b"/1 1 05 move abs 100\n", []))
    with pytest.raises(NoReply):
        axis.move_to(100)


# -- the encoder ---------------------------------------------------------------------


def encoder(number: int, answer: bytes) -> tuple[bytes, bytes]:
    return b"/1 1 %02d get encoder.pos\n" % number, b"@01 1 %02d OK IDLE -- %s\r\n" % (number, answer)


def test_an_encoder_tells_of_lost_steps_once_it_has_agreed(scripted):
    axis = drive(scripted, encoder(5, b"0"), encoder(6, b"85335"), encoder(7, b"84000"))
    assert axis.confirm(0) is None  # at zero every encoder agrees
    assert axis.confirm(85_333) is None
    assert "-1333 steps off its counter" in axis.confirm(85_333)


def test_an_encoder_that_never_agreed_is_none(scripted):
    axis = drive(scripted, encoder(5, b"0"))
    assert axis.confirm(85_333) is None
    assert axis.confirm(85_333) is None  # not asked again


def test_a_stage_without_an_encoder_is_asked_once(scripted):
    refused = b"/1 1 05 get encoder.pos\n", b"@01 1 05 RJ IDLE -- BADCOMMAND\r\n"
    axis = drive(scripted, refused)
    assert axis.confirm(85_333) is None
    assert axis.confirm(85_333) is None

"""What a client may write otherwise than the recorded one, protocol by protocol."""

from __future__ import annotations

import pytest

from gonio.errors import ConfigError
from gonio_simulators.wire.modbus_frames import mbap_frame, rtu_frame
from gonio_simulators.wire.zaber_message import checksum


def checked(text: str) -> bytes:
    return f"{text}:{checksum(text[1:]):02X}".encode()


def zaber(request: bytes, *replies: str) -> str:
    lines = ["stage = wire-log 1: zaber", f"stage > {request.decode()}\\n"]
    return "\n".join(lines + [f"stage < {reply}" for reply in replies])


def test_zaber_numbers_and_checksums_are_the_clients(played):
    log = zaber(checked("/1 1 42 get pos"), checked("@01 1 42 OK IDLE -- 30000").decode() + r"\r\n")
    assert played(log).ask("stage", checked("/1 1 07 get pos") + b"\n") == (
        checked("@01 1 07 OK IDLE -- 30000") + b"\r\n"
    )
    assert played(log).ask("stage", b"/1 1 07 get pos\n") == b"@01 1 07 OK IDLE -- 30000\r\n"
    assert played(log).ask("stage", b"/01 1 get  pos\r\n") == b"@01 1 OK IDLE -- 30000\r\n"


def test_zaber_recorded_without_numbers_and_checksums(played):
    log = zaber(b"/1 1 get pos", r"@01 1 OK IDLE FS 500\r\n")
    assert played(log).ask("stage", checked("/1 1 07 get pos") + b"\n") == (
        checked("@01 1 07 OK IDLE FS 500") + b"\r\n"
    )


def test_zaber_damage_is_replayed_as_damage(played):
    wrong = f"@01 1 42 OK IDLE -- 30000:{(checksum('01 1 42 OK IDLE -- 30000') + 5) & 0xFF:02X}"
    log = zaber(checked("/1 1 42 get pos"), wrong + r"\r\n")
    right = checksum("01 1 07 OK IDLE -- 30000")
    assert played(log).ask("stage", checked("/1 1 07 get pos") + b"\n") == (
        f"@01 1 07 OK IDLE -- 30000:{(right + 5) & 0xFF:02X}\r\n".encode()
    )
    garbage = zaber(b"/1 1 42 get pos", r"\x80\xff@@01 1 4", r"\x00\r\n")
    assert played(garbage).ask("stage", b"/1 1 07 get pos\n") == b"\x80\xff@@01 1 4\x00\r\n"


def test_zaber_a_late_reply_carries_its_own_number(played):
    player = played(
        r"""
        stage = wire-log 1: zaber
        stage > /1 1 05 get pos\n
        stage = gave up: no complete reply within 2 s
        stage > /1 1 06 get pos\n
        stage < @01 1 05 OK BUSY -- 1\r\n!01 1 IDLE --\r\n@01 1 06 OK IDLE -- 2\r\n
        """
    )
    assert player.ask("stage", b"/1 1 71 get pos\n") == b""
    assert player.ask("stage", b"/1 1 80 get pos\n") == (
        b"@01 1 71 OK BUSY -- 1\r\n!01 1 IDLE --\r\n@01 1 80 OK IDLE -- 2\r\n"
    )


def test_zaber_requests_sent_together(played):
    player = played(
        r"""
        stage = wire-log 1: zaber
        stage > /1 1 01 get pos\n/2 1 02 get pos\n
        stage < @02 1 02 OK IDLE -- 2\r\n@01 1 01 OK IDLE -- 1\r\n
        """
    )
    assert player.ask("stage", b"/2 1 09 get pos\n") == b"@02 1 09 OK IDLE -- 2\r\n"
    assert player.ask("stage", b"/1 1 10 get pos\n") == b"@01 1 10 OK IDLE -- 1\r\n"


def modbus(protocol: str, *frames: bytes) -> str:
    lines = [f"stage = wire-log 1: {protocol}"]
    for number, frame in enumerate(frames):
        lines.append(f"stage {'<' if number % 2 else '>'} " + "".join(f"\\x{byte:02x}" for byte in frame))
    return "\n".join(lines)


READ = bytes.fromhex("03 0001 0001")
READ_REPLY = bytes.fromhex("03 02 4001")
GO = bytes.fromhex("06 007C 0067")


def test_modbus_tcp_transaction_numbers_are_the_clients(played):
    log = modbus(
        "modbus-tcp",
        mbap_frame(9, 1, READ),
        mbap_frame(9, 1, READ_REPLY),
        mbap_frame(10, 1, GO),
        mbap_frame(9, 1, READ_REPLY) + mbap_frame(10, 1, GO),
    )
    player = played(log)
    assert player.ask("stage", mbap_frame(5000, 1, READ)) == mbap_frame(5000, 1, READ_REPLY)
    assert player.ask("stage", mbap_frame(65535, 1, GO)) == (
        mbap_frame(5000, 1, READ_REPLY) + mbap_frame(65535, 1, GO)
    )
    assert player.ask("stage", mbap_frame(0, 1, GO)) is None
    assert player.ask("stage", mbap_frame(1, 2, READ)) is None
    assert "'unit 2: 03 00 01 00 01'" in player.unexpected[-1]


def test_modbus_rtu_reads_are_queries_and_writes_commands(played):
    player = played(
        modbus("modbus-rtu", rtu_frame(1, READ), rtu_frame(1, READ_REPLY), rtu_frame(1, GO), rtu_frame(1, GO))
    )
    for _ in range(3):
        assert player.ask("stage", rtu_frame(1, READ)) == rtu_frame(1, READ_REPLY)
    assert player.ask("stage", rtu_frame(1, GO)[:3]) == b""
    assert player.ask("stage", rtu_frame(1, GO)[3:]) == rtu_frame(1, GO)
    assert player.ask("stage", rtu_frame(1, GO)) is None


@pytest.mark.parametrize("protocol", ["modbus-rtu", "modbus-tcp"])
def test_modbus_loopbacks_return_the_clients_data(played, protocol):
    def frame(data: int) -> bytes:
        pdu = bytes((8, 0, 0)) + data.to_bytes(2, "big")
        return rtu_frame(1, pdu) if protocol == "modbus-rtu" else mbap_frame(data, 1, pdu)

    player = played(modbus(protocol, frame(1), frame(1)))
    for data in (1, 7, 2):
        assert player.ask("stage", frame(data)) == frame(data)


def test_elliptec_commands_are_told_apart_by_their_length(played):
    player = played(
        r"""
        polarizer = wire-log 1: elliptec
        polarizer > 0ma00008C00
        polarizer < 0GS09\r\n
        polarizer < 0PO00008C00\r\n
        polarizer > 0gp
        polarizer < 0PO00008BFF\r\n
        polarizer > Agp
        polarizer < APO00000001\r\n
        """
    )
    assert player.ask("polarizer", b"0ma0000") == b""
    assert (
        player.ask("polarizer", b"8C00\r\n0gpagp")
        == b"0GS09\r\n0PO00008C00\r\n0PO00008BFF\r\nAPO00000001\r\n"
    )
    assert player.ask("polarizer", b"0ma00008C00") is None


CORNERSTONE = r"""
mono = wire-log 1: cs260
mono > GOWAVE 500.000\r\nWAVE?\r\n
mono < GOWAVE 500.000\r\nWAV
mono < E?\r\n500.010\r\n
"""


def test_cornerstone_statements_sent_one_by_one_and_echoed_as_written(played):
    player = played(CORNERSTONE)
    assert player.ask("mono", b"gowave 500.0\n") == b"gowave 500.0\n"
    assert player.ask("mono", b"WAVE?\n") == b"WAVE?\n500.010\r\n"
    assert player.ask("mono", b"WAVE?\r\n") == b"WAVE?\r\n500.010\r\n"


def test_cornerstone_statements_sent_together(played):
    player = played(CORNERSTONE)
    assert player.ask("mono", b"GOWAVE 500.000\r\nWAVE?\r\n") == b"GOWAVE 500.000\r\nWAVE?\r\n500.010\r\n"


def test_lock_in_statements_of_a_line_and_alone(played):
    log = r"""
    lockin = wire-log 1: sr830
    lockin > OUTX 0\r
    lockin > SENS 20;SENS?;LIAS?\r
    lockin < 20\r
    lockin < 0\r
    """
    player = played(log)
    assert player.ask("lockin", b"OUTX 0\n") == b""
    assert player.ask("lockin", b"SENS 20;SENS?;LIAS?\r") == b"20\r0\r"
    player = played(log)
    assert player.ask("lockin", b"outx 0\nSENS  20\n") == b""
    assert player.ask("lockin", b"LIAS?\n") == b"0\r"
    assert player.ask("lockin", b"SENS?\n") == b"20\r"


def test_lock_in_questions_of_one_line_are_of_one_instant(played):
    """Asked in the other order, both answers still belong together."""
    player = played(
        r"""
        lockin = wire-log 1: sr830
        lockin > SNAP? 1,2;LIAS?\r
        lockin < 1,1\r1\r
        lockin > SNAP? 1,2;LIAS?\r
        lockin < 2,2\r2\r
        lockin > SNAP? 1,2;LIAS?\r
        lockin < 3,3\r3\r
        """
    )
    assert player.ask("lockin", b"LIAS?;SNAP? 1,2\r") == b"1\r1,1\r"
    assert player.ask("lockin", b"SNAP? 1,2;LIAS?\r") == b"2,2\r2\r"
    assert player.ask("lockin", b"LIAS?;SNAP? 1,2\r") == b"3\r3,3\r"
    assert player.ask("lockin", b"LIAS?;SNAP? 1,2\r") == b"3\r3,3\r"


def test_a_protocol_that_nobody_knows(played):
    player = played(
        "shutter = wire-log 1: raw\nshutter > \\x02OPEN\\x03\nshutter < \\x06\n"
        "shutter > S?\nshutter < 1\nshutter > \\x02CLOSE\\x03\nshutter < \\x06"
    )
    assert player.ask("shutter", b"\x02OP") == b""
    assert player.ask("shutter", b"EN\x03S?") == b"\x061"
    assert player.ask("shutter", b"S?") == b"1"
    assert player.ask("shutter", b"\x02SHUT\x03") is None
    assert "'\\x02SHUT\\x03' is not in the log" in player.unexpected[0]
    with pytest.raises(ConfigError, match=r"shutter speaks morse.* write 'raw'"):
        played("shutter = wire-log 1: morse\nshutter > a\n")

"""Reading back what the drivers write, and what a kill, a power cut or an editor made of it."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.errors import ConfigError
from gonio.wirelog import Opening, format_bytes, format_note, from_printable, printable, read_log

OPENING = (
    "0.000100 stage = wire-log 1: zaber at socket://127.0.0.1:4001, "
    "session of 2026-01-02T03:04:05.678+00:00\n"
)
SENT = r"0.001000 stage > 2f3120312030332067657420706f730a  /1 1 03 get pos\n" + "\n"
RECEIVED = r"0.002000 stage < 403031203120303320...".replace("...", "4f4b0d0a") + r"  @01 1 03 OK\r\n" + "\n"


@pytest.fixture
def read(tmp_path: Path):
    def call(content: str | bytes):
        path = tmp_path / "wire.log"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_log(path)

    return call


def test_what_a_log_says(read):
    log = read(OPENING + SENT + RECEIVED + "0.003000 stage = closed after 1 replies\n")
    assert log.warnings == []
    (session,) = log.sessions
    line = session.lines["stage"]
    assert (session.start, line.protocol, line.opening.address) == (
        "2026-01-02T03:04:05.678+00:00",
        "zaber",
        "socket://127.0.0.1:4001",
    )
    assert [(r.number, r.time_s, r.direction, r.data) for r in line.records[1:3]] == [
        (2, 0.001, ">", b"/1 1 03 get pos\n"),
        (3, 0.002, "<", b"@01 1 03 OK\r\n"),
    ]
    assert line.records[3].text == "closed after 1 replies"


@given(st.binary(min_size=1, max_size=40), st.floats(0, 1e6))
def test_every_byte_comes_back(tmp_path_factory, data, time_s):
    assert from_printable(printable(data)) == data
    path = tmp_path_factory.getbasetemp() / "every-byte.log"
    text = OPENING.replace("0.000100", "0") + format_bytes(time_s, "stage", "<", data)
    path.write_text(text, encoding="utf-8")
    record = read_log(path).sessions[0].lines["stage"].records[1]
    assert record.data == data
    assert record.time_s == pytest.approx(time_s, abs=1e-6)


@pytest.mark.parametrize(
    "opening",
    [
        Opening("cs260"),
        Opening("modbus-tcp", "/dev/ttyUSB0"),
        Opening("sr830", "usb://0403:6001/A", "2026-01-02T03:04:05.678+00:00", 4000.0),
    ],
)
def test_openings(read, opening):
    log = read(format_note(0.0, "lockin", opening.text()))
    assert log.sessions[0].lines["lockin"].opening == opening


def test_written_by_hand(read):
    """Times in whole seconds, text alone, hexadecimal in groups without text, remarks, another editor."""
    log = read(
        "\ufeff# from the manual, page 12\r\n\r\n0 lockin = wire-log 1: sr830\r\n"
        "1 lockin > -  SENS?\\r\r\n  2 lockin < 32 36 0d\r\n"
    )
    records = log.sessions[0].lines["lockin"].records
    assert [(r.number, r.time_s, r.data) for r in records[1:]] == [(4, 1.0, b"SENS?\r"), (5, 2.0, b"26\r")]


def test_several_sessions_in_one_file(read):
    second = OPENING.replace("03:04:05", "04:00:00")
    log = read(
        OPENING
        + OPENING.replace("stage", "lockin").replace("zaber", "sr830")
        + SENT
        + second
        + RECEIVED
        + "9 stage = closed\n"
    )
    assert [list(session.lines) for session in log.sessions] == [["stage", "lockin"], ["stage"]]
    assert [len(session.lines["stage"].records) for session in log.sessions] == [2, 3]


def test_hand_written_sessions_begin_where_a_role_comes_again(read):
    log = read(
        "0 stage = wire-log 1: zaber\n0 lockin = wire-log 1: sr830\n1 stage = a\n"
        "0 stage = wire-log 1: zaber\n"
    )
    assert [list(session.lines) for session in log.sessions] == [["stage", "lockin"], ["stage"]]


def test_a_line_opened_again_in_its_session_goes_on(read):
    log = read(OPENING + SENT + OPENING.replace("0.000100", "5.0") + SENT.replace("0.001000", "6.0"))
    (session,) = log.sessions
    assert [r.time_s for r in session.lines["stage"].records] == [0.0001, 0.001, 5.0, 6.0]


def test_cut_at_every_byte(read):
    """A kill leaves a beginning of the file: whole records are read, the last is left out and named."""
    content = (OPENING + SENT + RECEIVED).encode()
    first = len(OPENING)
    for end in range(first, len(content) + 1):
        log = read(content[:end])
        whole = content[:end].count(b"\n")
        records = log.sessions[0].lines["stage"].records
        # a record without its line end is taken if its bytes and its text agree
        assert whole <= len(records) <= whole + 1
        assert len(log.warnings) == (end > 0 and content[end - 1 : end] != b"\n" and len(records) == whole)
        assert all(record.data in (b"", b"/1 1 03 get pos\n", b"@01 1 03 OK\r\n") for record in records)


def test_torn_before_another_session(read):
    log = read(OPENING + SENT[:30] + "\n" + OPENING.replace("03:04:05", "04:00:00") + SENT)
    assert len(log.sessions) == 2
    assert "line 2: left out, as it breaks off" in log.warnings[0]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "holds no record"),
        ("# nothing\n", "holds no record"),
        ("theta,signal\n1,2\n3,4\n", "line 1: is not a record"),
        (b"\x89HDF\r\n\x1a\n" + bytes(range(200, 256)), "line 1: is not text"),
        (SENT + SENT, "line 1: nothing says yet what stage speaks; put '0 stage = wire-log 1: PROTOCOL'"),
        (OPENING + "x" + SENT + SENT, "line 2: 'x0.001000' is not a time"),
        (OPENING + SENT.replace("0.001000", "nan") + SENT, "line 2: 'nan' is not a time"),
        (OPENING + SENT.replace("2f31", "2f3") + SENT, "line 2: '2f3"),
        (OPENING + SENT.replace("2f31", "2f32") + SENT, "line 2: the hexadecimal bytes say"),
        (OPENING + SENT.replace("get pos", "gét pos") + SENT, "line 2: the text"),
        (OPENING + "1 stage >\n" + SENT, "line 2: holds no bytes"),
        (OPENING + "1 stage > -\n" + SENT, "line 2: '-' needs the text"),
        (OPENING + "1 stage ? 00\n" + SENT, "line 2: is not a record"),
        (
            OPENING + SENT + SENT.replace("0.001000", "0.5") + SENT,
            "line 4: the time of stage goes back from 0.5",
        ),
        (
            OPENING.replace("wire-log 1", "wire-log 2"),
            "line 1: the log has format 2, this gonio reads format 1",
        ),
        (OPENING.replace(": zaber", " zaber"), "line 1: 'wire-log 1 zaber"),
        (
            OPENING + OPENING.replace("zaber", "elliptec"),
            "line 2: stage speaks elliptec here and zaber before",
        ),
        (OPENING[:-1] + ", instrument clock xfast\n", "line 1: instrument clock xfast is not a number"),
    ],
)
def test_errors_name_the_line(read, content, words):
    with pytest.raises(ConfigError, match=r"^wire log ") as caught:
        read(content)
    assert words in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read_log(tmp_path / "none.log")


@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any-bytes.log"
    path.write_bytes(OPENING.encode() + data)
    try:
        log = read_log(path)
    except ConfigError:
        return
    assert log.sessions

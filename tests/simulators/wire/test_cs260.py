"""The Cornerstone 260: echo, responses, status and error codes, and answers that wait for the mechanics."""

import tomllib

import pytest
import tomli_w

from gonio.rig import default_rig_text
from gonio_simulators.wire.cs260 import Cornerstone260
from tests.simulators.wire.conftest import StillBench, advance_until_answered


@pytest.fixture
def talk(bench: StillBench):
    return Cornerstone260(bench).open()


def settle(bench: StillBench, talk) -> bytes:
    bench.clock.advance(60.0)
    return talk.poll()


def test_echo_and_response(talk) -> None:
    assert talk.feed(b"GOWAVE 500\n") == b"GOWAVE 500\n"
    assert talk.feed(b"wave?\r\n") == b"wave?\r\n500.000\r\n"
    assert talk.feed(b"GRAT?\n") == b"GRAT?\n1,1200,GRAT1\r\n"
    assert talk.feed(b"STB?\n") == b"STB?\n00\r\n"


def test_each_character_is_echoed_as_it_comes(talk) -> None:
    assert [talk.feed(c.encode()) for c in "WAVE?"] == [b"W", b"A", b"V", b"E", b"?"]
    assert talk.feed(b"\n") == b"\n500.000\r\n"


def test_a_query_is_answered_when_the_move_is_over(bench: StillBench, talk) -> None:
    assert talk.feed(b"GOWAVE 623.5\n") == b"GOWAVE 623.5\n"
    assert talk.feed(b"WAVE?\n") == b"WAVE?\n"
    assert talk.wait_s == pytest.approx(bench.monochromator.busy_until_s)
    bench.clock.advance(0.5 * bench.monochromator.busy_until_s)
    assert talk.poll() == b""
    assert advance_until_answered(bench, talk, step_s=0.01) == b"623.500\r\n"
    assert bench.clock.now_s() == pytest.approx(bench.monochromator.busy_until_s, abs=0.011)
    assert talk.wait_s is None


def test_statements_keep_their_order(bench: StillBench, talk) -> None:
    talk.feed(b"GOWAVE 600\nWAVE?\nGOWAVE 650\nWAVE?\nSHUTTER O\nSHUTTER?\n")
    received = b""
    while received.count(b"\r\n") < 3:
        received += advance_until_answered(bench, talk, step_s=0.01)
    assert received == b"600.000\r\n650.000\r\nO\r\n"


def test_abort_acts_at_once(bench: StillBench, talk) -> None:
    talk.feed(b"GOWAVE 675\nWAVE?\n")
    bench.clock.advance(0.5)
    reply = talk.feed(b"ABORT\n")
    echo, stopped_nm, _ = reply.replace(b"\r", b"").split(b"\n")
    assert echo == b"ABORT"
    assert 500.0 < float(stopped_nm) < 675.0
    assert float(stopped_nm) == pytest.approx(bench.monochromator.wavelength_nm, abs=1e-3)


@pytest.mark.parametrize(
    ("statement", "code"),
    [
        (b"FOO", b"1"),
        (b"FOO?", b"1"),
        (b"GRAT9LABEL?", b"1"),
        (b"GOWAVE abc", b"2"),
        (b"GOWAVE", b"2"),
        (b"SHUTTER X", b"2"),
        (b"GRAT 7", b"2"),
        (b"FILTER 1.5", b"2"),
        (b"OUTPORT 9", b"2"),
        (b"SLIT1MICRONS 9999", b"2"),
        (b"GOWAVE 99999", b"3"),
        (b"FILTER1LABEL CHARTREUSE", b"9"),
    ],
)
def test_errors(bench: StillBench, talk, statement: bytes, code: bytes) -> None:
    assert talk.feed(statement + b"\n") == statement + b"\n"
    assert talk.feed(b"STB?\n") == b"STB?\n20\r\n"
    assert talk.feed(b"STB?\n") == b"STB?\n00\r\n"  # reading clears it
    assert talk.feed(b"ERROR?\n") == b"ERROR?\n" + code + b"\r\n"
    assert talk.feed(b"ERROR?\n") == b"ERROR?\n0\r\n"


def test_handshake_follows_the_completion(bench: StillBench, talk) -> None:
    assert talk.feed(b"HANDSHAKE 1\n") == b"HANDSHAKE 1\n00\r\n"
    assert talk.feed(b"WAVE?\n") == b"WAVE?\n500.000\r\n00\r\n"
    assert talk.feed(b"GOWAVE 600\n") == b"GOWAVE 600\n"
    assert settle(bench, talk) == b"00\r\n"
    assert talk.feed(b"GOWAVE 650\nFOO\n") == b"GOWAVE 650\nFOO\n"
    assert settle(bench, talk) == b"00\r\n20\r\n"
    assert talk.feed(b"GOWAVE 99999\n") == b"GOWAVE 99999\n20\r\n"  # an error is reported at once
    assert talk.feed(b"HANDSHAKE 0\n") == b"HANDSHAKE 0\n"


@pytest.mark.parametrize(
    ("command", "query", "response"),
    [
        (b"GRAT 2", b"GRAT?", b"2,600,GRAT2"),
        (b"FILTER 3", b"FILTER?", b"3"),
        (b"OUTPORT 2", b"OUTPORT?", b"2"),
        (b"SHUTTER O", b"SHUTTER?", b"O"),
        (b"SLIT1MICRONS 300", b"SLIT1MICRONS?", b"300"),
        (b"SLIT2MICRONS 250", b"SLIT2MICRONS?", b"250"),
        (b"GRAT1LABEL BLUE", b"GRAT?", b"1,1200,BLUE"),
        (b"GRAT1FACTOR 0.9991", b"GRAT1FACTOR?", b"0.9991000"),
        (b"BANDPASS 5", b"BANDPASS?", b"5.000"),
        (b"UNITS UM", b"WAVE?", b"0.500000"),
        (b"UNITS WN", b"WAVE?", b"20000.00"),
        (b"UNITS WN\nGOWAVE 16000", b"WAVE?", b"16000.00"),
        (b"STEP 10", b"WAVE?", b"501.000"),
        (b"HANDSHAKE 0", b"HANDSHAKE?", b"0"),
    ],
)
def test_settings_are_read_back(
    bench: StillBench, talk, command: bytes, query: bytes, response: bytes
) -> None:
    assert talk.feed(command + b"\n") == command + b"\n"
    received = talk.feed(query + b"\n") + settle(bench, talk)
    assert received == query + b"\n" + response + b"\r\n"
    assert talk.feed(b"STB?\n") == b"STB?\n00\r\n"


def test_the_light_follows_the_statements(bench: StillBench, talk) -> None:
    talk.feed(b"SHUTTER O\nOUTPORT 2\nGRAT 2\nFILTER 3\nGOWAVE 900\n")
    bench.clock.advance(60.0)
    path = bench.monochromator.state_at(bench.clock.now_s())
    assert (path.wavelength_nm, path.grating, path.filter, path.shutter_open, path.output_port) == (
        900.0,
        2,
        3,
        True,
        2,
    )


def test_without_a_filter_wheel_there_is_no_accessory() -> None:
    tables = tomllib.loads(default_rig_text())
    del tables["spectrometer"]["monochromator"]["filters"]
    bare = StillBench.of(tomli_w.dumps(tables))
    talk = Cornerstone260(bare).open()
    for statement in (b"FILTER 1", b"FILTER?"):
        assert talk.feed(statement + b"\n") == statement + b"\n"
        assert talk.feed(b"ERROR?\n") == b"ERROR?\n6\r\n"


def test_statements_may_have_spaces_and_any_case(bench: StillBench, talk) -> None:
    assert talk.feed(b"  gowave   510.5  \r\n") == b"  gowave   510.5  \r\n"
    settle(bench, talk)
    assert talk.feed(b"Wave?\r\n") == b"Wave?\r\n510.500\r\n"
    assert talk.feed(b"abort \r\n") == b"abort \r\n"  # as one client sends it
    assert talk.feed(b"STB?\n") == b"STB?\n00\r\n"

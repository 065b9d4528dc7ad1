"""The Elliptec rotator: exact bytes, one answer per movement, busy in between."""

import pytest

from gonio_simulators.wire.elliptec import Elliptec
from tests.simulators.wire.conftest import StillBench, advance_until_answered


@pytest.fixture
def talk(bench: StillBench):
    return Elliptec(bench).open()


def home(bench: StillBench, talk) -> None:
    assert talk.feed(b"0ho0") == b""
    assert advance_until_answered(bench, talk) == b"0PO00000000\r\n"


def test_documented_bytes(bench: StillBench, talk) -> None:
    assert talk.feed(b"0in") == b"0IN0E1140005120221701016800023000\r\n"
    assert talk.feed(b"0gs") == b"0GS00\r\n"
    home(bench, talk)
    assert talk.feed(b"0ma00004600") == b""
    assert advance_until_answered(bench, talk) == b"0PO00004600\r\n"
    assert bench.polarizer.angle_deg() == 45.0
    assert talk.feed(b"0gp") == b"0PO00004600\r\n"


def test_negative_positions_are_two_s_complement(bench: StillBench, talk) -> None:
    home(bench, talk)
    talk.feed(b"0mrFFFFFF00")
    assert advance_until_answered(bench, talk) == b"0POFFFFFF00\r\n"
    assert bench.polarizer.position_steps() == -256


def test_busy_until_the_answer(bench: StillBench, talk) -> None:
    home(bench, talk)
    talk.feed(b"0ma00011800")
    bench.clock.advance(0.01)
    assert talk.wait_s is not None
    assert talk.feed(b"0gp") == b"0GS09\r\n"
    assert advance_until_answered(bench, talk, step_s=0.01) == b"0PO00011800\r\n"
    assert talk.wait_s is None


def test_the_answer_to_a_movement_precedes_that_to_a_later_command(bench: StillBench, talk) -> None:
    home(bench, talk)
    talk.feed(b"0ma00004600")
    bench.clock.advance(60.0)
    assert talk.feed(b"0gs") == b"0PO00004600\r\n0GS00\r\n"


def test_a_movement_to_where_it_stands_is_answered_at_once(bench: StillBench, talk) -> None:
    home(bench, talk)
    assert talk.feed(b"0ma00000000") == b"0PO00000000\r\n"


def test_jogging(bench: StillBench, talk) -> None:
    home(bench, talk)
    assert talk.feed(b"0sj00000100") == b"0GS00\r\n"
    assert talk.feed(b"0gj") == b"0GJ00000100\r\n"
    for command, position in ((b"0fw", b"0PO00000100\r\n"), (b"0bw", b"0PO00000000\r\n")):
        assert talk.feed(command) == b""
        assert advance_until_answered(bench, talk) == position


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (b"0zz", b"0GS03\r\n"),  # not supported
        (b"0maGGGGGGGG", b"0GS04\r\n"),
        (b"0ma00100000", b"0GS0C\r\n"),  # beyond a turn
        (b"0ho7", b"0GS04\r\n"),
        (b"0sv00", b"0GS04\r\n"),
        (b"0us", b"0GS00\r\n"),
    ],
)
def test_status_of_commands(talk, command: bytes, reply: bytes) -> None:
    assert talk.feed(command) == reply
    assert talk.feed(b"0gs") == reply  # kept until it is asked for
    assert talk.feed(b"0gs") == b"0GS00\r\n"


def test_the_velocity_is_a_percentage(bench: StillBench, talk) -> None:
    full = bench.polarizer.speed_steps_s
    assert talk.feed(b"0gv") == b"0GV64\r\n"
    assert talk.feed(b"0sv32") == b"0GS00\r\n"
    assert talk.feed(b"0gv") == b"0GV32\r\n"
    assert bench.polarizer.speed_steps_s == 0.5 * full


def test_the_bus_is_shared_and_the_address_can_change(talk) -> None:
    assert talk.feed(b"1gs") == b""
    assert talk.feed(b"5ma00000000") == b""
    assert talk.feed(b"0caA") == b"AGS00\r\n"
    assert talk.feed(b"0gs") == b""
    assert talk.feed(b"Ags") == b"AGS00\r\n"


def test_commands_in_pieces_and_with_line_ends(talk) -> None:
    assert [talk.feed(c.encode()) for c in "0g"] == [b"", b""]
    assert talk.feed(b"s\r\n") == b"0GS00\r\n"
    assert talk.feed(b"0gs\r\n0gs\n") == b"0GS00\r\n0GS00\r\n"

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


def test_a_bounded_movement_cannot_be_stopped(bench: StillBench, talk) -> None:
    home(bench, talk)
    talk.feed(b"0ma00011800")
    bench.clock.advance(0.05)
    assert talk.feed(b"0st") == b"0GS09\r\n"
    assert talk.feed(b"0gs") == b"0GS09\r\n"
    assert advance_until_answered(bench, talk) == b"0PO00011800\r\n"
    assert talk.feed(b"0gs") == b"0GS00\r\n"  # to have been busy is no error that is kept


def test_turning_without_end(bench: StillBench, talk) -> None:
    home(bench, talk)
    assert talk.feed(b"0sj00000000") == b"0GS00\r\n"
    assert talk.feed(b"0bw") == b"0GS00\r\n"
    bench.clock.advance(100.0)
    assert talk.feed(b"0gp") == b"0GS09\r\n"
    assert talk.feed(b"0st") == b""
    assert advance_until_answered(bench, talk) == b"0GS00\r\n"
    assert bench.polarizer.position_steps() < -50 * 143360
    reply = talk.feed(b"0gp")
    assert int(reply[3:11], 16) == bench.polarizer.position_steps() & 0xFFFFFFFF


def test_the_home_offset_moves_the_zero(bench: StillBench, talk) -> None:
    assert talk.feed(b"0so00000100") == b"0GS00\r\n"
    assert talk.feed(b"0go") == b"0HO00000100\r\n"
    home(bench, talk)
    assert bench.polarizer.position_steps() == 0x100
    talk.feed(b"0ma00000200")
    assert advance_until_answered(bench, talk) == b"0PO00000200\r\n"
    assert bench.polarizer.position_steps() == 0x300


def test_a_group_address_lasts_for_one_movement(bench: StillBench, talk) -> None:
    home(bench, talk)
    assert talk.feed(b"0gaA") == b"AGS00\r\n"
    assert talk.feed(b"0gs") == b"0GS00\r\n"
    assert talk.feed(b"Ama00000100") == b""
    assert advance_until_answered(bench, talk) == b"0PO00000100\r\n"
    assert talk.feed(b"Ags") == b""


def test_isolation_is_silence_for_minutes(bench: StillBench, talk) -> None:
    assert talk.feed(b"0is02") == b"0GS00\r\n"
    bench.clock.advance(119.0)
    assert talk.feed(b"0gs") == b""
    bench.clock.advance(1.5)
    assert talk.feed(b"0gs") == b"0GS00\r\n"
    talk.feed(b"0isFF")
    assert talk.feed(b"0is00") == b"0GS00\r\n"
    assert talk.feed(b"0gs") == b"0GS00\r\n"


@pytest.mark.parametrize(("command", "duration_s"), [(b"0s1", 2.0), (b"0om", 60.0), (b"0cm", 60.0)])
def test_tuning_keeps_the_module_busy(bench: StillBench, talk, command: bytes, duration_s: float) -> None:
    assert talk.feed(command) == b""
    bench.clock.advance(duration_s - 0.1)
    assert talk.feed(b"0in") == b"0GS09\r\n"
    assert advance_until_answered(bench, talk) == b"0GS00\r\n"
    talk.feed(command)
    assert talk.feed(b"0st") == b"0GS00\r\n"


def test_resonance_periods(talk) -> None:
    assert talk.feed(b"0i1") == b"0I110054CFFFFFFFF00930086\r\n"
    assert talk.feed(b"0f180A0") == b"0GS00\r\n"
    assert talk.feed(b"0b10090") == b"0GS00\r\n"
    assert talk.feed(b"0i1") == b"0I110054CFFFFFFFF00A00090\r\n"
    assert talk.feed(b"0f18FFF") == b"0GS00\r\n"
    assert talk.feed(b"0i1") == b"0I110054CFFFFFFFF00930090\r\n"


def test_cases_are_told_apart(talk) -> None:
    assert talk.feed(b"0ma0000a000") == b"0GS04\r\n"
    assert talk.feed(b"0GS") == b"0GS03\r\n"
    assert talk.feed(b"0caA") == b"AGS00\r\n"
    assert talk.feed(b"ags\r\n") == b""


def test_half_a_command_is_forgotten(bench: StillBench) -> None:
    now_s = 0.0
    talk = Elliptec(bench, now=lambda: now_s).open()
    assert talk.feed(b"0ma0000") == b""
    now_s = 1.9
    assert talk.feed(b"0") == b""  # still the same command
    now_s = 4.0
    assert talk.feed(b"0gs") == b"0GS00\r\n"
    assert talk.feed(b"0ma00\r\n0gs\r\n") == b"0GS00\r\n"

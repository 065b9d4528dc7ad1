"""The Zaber chain: exact bytes, flags, limits, the blind zone."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio_simulators.wire.zaber import ZaberChain
from gonio_simulators.wire.zaber_message import checksum, parse_request
from tests.simulators.wire.conftest import StillBench, advance_until_answered


@pytest.fixture
def talk(bench: StillBench):
    return ZaberChain(bench, theta_i=1, theta_mes=2).open()


def home(bench: StillBench, talk, device: int) -> None:
    assert b"BUSY" in talk.feed(b"/%d 1 home\n" % device)
    bench.clock.advance(60.0)
    assert talk.feed(b"/%d 1 get pos\n" % device) == b"@%02d 1 OK IDLE -- 0\r\n" % device


def test_bytes_before_homing(talk) -> None:
    assert talk.feed(b"/0 0 00\n") == b"@01 0 00 OK IDLE WR 0\r\n@02 0 00 OK IDLE WR 0\r\n"
    assert talk.feed(b"/1 1 03 get pos\n") == b"@01 1 03 OK IDLE WR 0\r\n"
    assert talk.feed(b"/1 1 17 warnings\n") == b"@01 1 17 OK IDLE WR 01 WR\r\n"
    assert talk.feed(b"/1 1 05 home\n") == b"@01 1 05 OK BUSY WR 0\r\n"


def test_bytes_after_homing(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    assert talk.feed(b"/1 1 07 move abs 20000\n") == b"@01 1 07 OK BUSY -- 0\r\n"
    assert talk.feed(b"/1 1 08\n") == b"@01 1 08 OK BUSY -- 0\r\n"
    bench.clock.advance(10.0)
    assert talk.feed(b"/1 1 03 get pos\n") == b"@01 1 03 OK IDLE -- 20000\r\n"
    assert talk.feed(b"/1 1 19 move abs -5\n") == b"@01 1 19 RJ IDLE -- BADDATA\r\n"
    assert talk.feed(b"/1 0 20 foo\n") == b"@01 0 20 RJ IDLE -- BADCOMMAND\r\n"
    assert talk.feed(b"/1 1 17 warnings\n") == b"@01 1 17 OK IDLE -- 00\r\n"
    talk.feed(b"/1 1 move abs 30000\n")
    bench.clock.advance(10.0)
    assert talk.feed(b"/1 1 02 get pos:2A\n") == b"@01 1 02 OK IDLE -- 30000:47\r\n"
    assert talk.feed(b"/1 1 05 home\n") == b"@01 1 05 OK BUSY -- 0\r\n"  # the old reference still holds


def test_a_wrong_checksum_and_other_devices_are_met_with_silence(talk) -> None:
    assert talk.feed(b"/1 1 02 get pos:2B\n") == b""
    assert talk.feed(b"/7 1 02 get pos\n") == b""
    assert talk.feed(b"get pos\n\r\n\xff\n") == b""


def test_a_command_may_come_in_pieces_and_end_in_cr(talk) -> None:
    assert [talk.feed(piece) for piece in (b"/1 1 0", b"3 get p", b"os")] == [b"", b"", b""]
    assert talk.feed(b"\r\n/2 1 04\r\n") == b"@01 1 03 OK IDLE WR 0\r\n@02 1 04 OK IDLE WR 0\r\n"


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        (b"/1 2 get pos", b"@01 2 RJ IDLE WR BADAXIS"),
        (b"/1 1 get system.serial", b"@01 1 RJ IDLE WR DEVICEONLY"),
        (b"/1 1 get nonsense", b"@01 1 RJ IDLE WR BADCOMMAND"),
        (b"/1 1 set resolution 128", b"@01 1 RJ IDLE WR BADCOMMAND"),
        (b"/1 1 set maxspeed 0", b"@01 1 RJ IDLE WR BADDATA"),
        (b"/1 1 set maxspeed fast", b"@01 1 RJ IDLE WR BADDATA"),
        (b"/1 1 move abs", b"@01 1 RJ IDLE WR BADCOMMAND"),
        (b"/1 1 move abs 20.5", b"@01 1 RJ IDLE WR BADDATA"),
        (b"/1 1 get resolution", b"@01 1 OK IDLE WR 64"),
        (b"/1 0 get version", b"@01 0 OK IDLE WR 7.35"),
        (b"/1 1 100 get pos", b"@01 1 RJ IDLE WR BADMESSAGEID"),
        (b"/1 1 007 get pos", b"@01 1 07 OK IDLE WR 0"),
        (b"/1 1 move abs 1_000", b"@01 1 RJ IDLE WR BADDATA"),
        (b"/1 1 move abs 10 0", b"@01 1 RJ IDLE WR BADDATA"),
        (b"/1 1 move abs 10 1 1 1", b"@01 1 RJ IDLE WR BADCOMMAND"),
        (b"/1 1 move stored 17", b"@01 1 RJ IDLE WR BADDATA"),
        (b"/1 1 set pos", b"@01 1 RJ IDLE WR BADCOMMAND"),
        (b"/1 1 tools echo hello", b"@01 1 RJ IDLE WR DEVICEONLY"),
        (b"/1 0 lockstep 1 info", b"@01 0 RJ IDLE WR BADCOMMAND"),
        (b"/1 0 io info", b"@01 0 RJ IDLE WR BADCOMMAND"),
        (b"/1 1 get peripheralid", b"@01 1 RJ IDLE WR BADCOMMAND"),  # the axis is built in
        (b"/1 1 get driver.enabled", b"@01 1 OK IDLE WR 1"),
        (b"/1 0 storage get nothing", b"@01 0 RJ IDLE WR BADDATA"),
        (b"/1 0 tools echo hello there", b"@01 0 OK IDLE WR hello there"),
        (b"/2 1 get limit.min", b"@02 1 OK IDLE WR 0"),
        (b"/1 1 " + b"x" * 80, b"@01 1 RJ IDLE WR BADCOMMAND"),
    ],
)
def test_answers(talk, command: bytes, answer: bytes) -> None:
    assert talk.feed(command + b"\n") == answer + b"\r\n"


def test_speed_and_acceleration_set_the_time_of_a_move(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    # 10 000 steps/s and 50 000 steps/s2: 40 000 steps take 4 s + 0.2 s
    assert talk.feed(b"/1 1 set maxspeed 16384\n/1 1 set accel 8\n").count(b"OK") == 2
    assert talk.feed(b"/1 1 get accel\n") == b"@01 1 OK IDLE -- 8\r\n"
    acceleration = 8 * 10000 / 1.6384
    duration_s = 40000 / 10000 + 10000 / acceleration
    talk.feed(b"/1 1 move abs 40000\n")
    bench.clock.advance(duration_s - 1e-3)
    assert b"BUSY" in talk.feed(b"/1 1\n")
    bench.clock.advance(2e-3)
    assert talk.feed(b"/1 1 get pos\n") == b"@01 1 OK IDLE -- 40000\r\n"


def test_a_stop_and_a_second_move_interrupt(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    talk.feed(b"/1 1 move abs 300000\n")
    bench.clock.advance(1.0)
    assert talk.feed(b"/1 1 stop\n") == b"@01 1 OK BUSY NI 0\r\n"
    bench.clock.advance(5.0)
    assert talk.feed(b"/1 1 warnings clear\n") == b"@01 1 OK IDLE -- 01 NI\r\n"
    assert talk.feed(b"/1 1 move rel 1000\n") == b"@01 1 OK BUSY -- 0\r\n"
    assert talk.feed(b"/1 1 move rel 1000\n") == b"@01 1 OK BUSY NI 0\r\n"


def test_move_at_a_speed(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    talk.feed(b"/1 1 move vel 16384\n")
    bench.clock.advance(2.0)
    assert talk.feed(b"/1 1 get vel\n") == b"@01 1 OK BUSY -- 16384\r\n"
    before = bench.theta_i.position_steps()
    bench.clock.advance(1.0)
    assert bench.theta_i.position_steps() - before == 10000
    talk.feed(b"/1 1 stop\n")
    bench.clock.advance(5.0)
    talk.feed(b"/1 1 move abs 0\n")
    bench.clock.advance(1.0)
    assert bench.theta_i.speed_steps_s == pytest.approx(85333.3, rel=1e-5)  # maxspeed holds again


def test_the_blind_zone_has_a_limit_switch(bench: StillBench, talk) -> None:
    home(bench, talk, 2)
    talk.feed(b"/2 1 move abs 768000\n")  # 0 deg: the beam
    bench.clock.advance(60.0)
    reply = talk.feed(b"/2 1 get pos\n")
    assert reply.startswith(b"@02 1 OK IDLE FE ")
    stands_deg = 180.0 - int(reply.split()[-1]) / 4266.6666666666667
    assert stands_deg == pytest.approx(bench.theta_mes.angle_deg(), abs=1e-3)
    assert 14.0 < stands_deg < 15.0
    assert talk.feed(b"/2 1 warnings clear\n") == b"@02 1 OK IDLE -- 01 FE\r\n"
    talk.feed(b"/2 1 move abs 384000\n")
    bench.clock.advance(60.0)
    assert talk.feed(b"/2 1 get pos\n") == b"@02 1 OK IDLE -- 384000\r\n"


def test_an_obstacle_is_a_stall(talk, bench: StillBench) -> None:
    from tests.simulators.wire.conftest import rig_text

    blocked = StillBench.of(rig_text() + "\n[simulation.theta_i]\nobstacle_deg = 70.0\n")
    talk = ZaberChain(blocked, theta_i=1, theta_mes=2).open()
    home(blocked, talk, 1)
    talk.feed(b"/1 1 move abs 384000\n")  # 90 deg
    blocked.clock.advance(60.0)
    reply = talk.feed(b"/1 1 get pos\n")
    assert reply.startswith(b"@01 1 OK IDLE FS ")
    assert int(reply.split()[-1]) / 4266.6666666666667 == pytest.approx(70.0, abs=0.1)
    assert talk.feed(b"/1 1 warnings\n") == b"@01 1 OK IDLE FS 01 FS\r\n"


def test_an_alert_announces_the_end_of_a_move(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    talk.feed(b"/0 0 set comm.alert 1\n")
    assert talk.wait_s is None
    talk.feed(b"/1 1 move abs 20000\n")
    assert talk.wait_s is not None
    assert talk.poll() == b""
    assert advance_until_answered(bench, talk) == b"!01 1 IDLE --\r\n"
    assert talk.wait_s is None
    assert talk.poll() == b""


def test_renumbering_follows_the_chain(talk) -> None:
    assert talk.feed(b"/2 0 01 renumber 5\n") == b"@05 0 01 OK IDLE WR 0\r\n"
    assert talk.feed(b"/2 1 02\n") == b""
    assert talk.feed(b"/0 0 03 renumber\n") == b"@01 0 03 OK IDLE WR 0\r\n@02 0 03 OK IDLE WR 0\r\n"
    assert talk.feed(b"/0 0 04 renumber 99\n").count(b"BADDATA") == 2


def test_set_pos_renames_the_place(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    talk.feed(b"/1 1 set pos 1000\n")
    assert talk.feed(b"/1 1 get pos\n") == b"@01 1 OK IDLE -- 1000\r\n"
    talk.feed(b"/1 1 move abs 3000\n")
    bench.clock.advance(5.0)
    assert bench.theta_i.position_steps() == 2000


@given(st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters="/:")))
def test_any_text_with_its_checksum_is_accepted_and_with_another_ignored(text: str) -> None:
    good = f"/{text}:{checksum(text):02X}".encode("ascii")
    bad = f"/{text}:{checksum(text) ^ 1:02X}".encode("ascii")
    words = text.split()
    numbered = next((w for w in words[:3] if w.isdigit() and len(w) > 2), None)
    request = parse_request(good)
    assert (request is not None and request.has_checksum) or numbered is not None
    assert parse_request(bad) is None

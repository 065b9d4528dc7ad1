"""The Zaber stages: commands without reply, profiles of one move, parking, driver, storage, long replies."""

import pytest

from gonio_simulators.wire.zaber import ZaberChain
from gonio_simulators.wire.zaber_message import checksum
from tests.simulators.wire.conftest import StillBench
from tests.simulators.wire.test_zaber import home


@pytest.fixture
def talk(bench: StillBench):
    return ZaberChain(bench, theta_i=1, theta_mes=2).open()


def test_a_command_may_want_no_reply(bench: StillBench, talk) -> None:
    assert talk.feed(b"/1 1 -- set maxspeed 1234\n/0 0 --\n/1 1 -- nonsense\n") == b""
    assert talk.feed(b"/1 1 01 get maxspeed\n") == b"@01 1 01 OK IDLE WR 1234\r\n"


def test_speed_and_acceleration_of_one_move(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    talk.feed(b"/1 1 move abs 40000 16384 8\n")  # 10 000 steps/s, 48 828 steps/s2
    duration_s = 40000 / 10000 + 10000 / (8 * 10000 / 1.6384)
    bench.clock.advance(duration_s - 1e-3)
    assert b"BUSY" in talk.feed(b"/1 1\n")
    bench.clock.advance(2e-3)
    assert talk.feed(b"/1 1 get pos\n") == b"@01 1 OK IDLE -- 40000\r\n"
    assert talk.feed(b"/1 1 get maxspeed\n") == b"@01 1 OK IDLE -- 139810\r\n"
    talk.feed(b"/1 1 move rel -40000\n")  # at maxspeed and accel again
    bench.clock.advance(1.0)
    assert talk.feed(b"/1 1 get pos\n") == b"@01 1 OK IDLE -- 0\r\n"


def test_stored_positions(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    assert talk.feed(b"/1 1 tools storepos 3 5000\n/1 1 tools storepos 3\n").endswith(b"-- 5000\r\n")
    talk.feed(b"/1 1 move stored 3\n")
    bench.clock.advance(5.0)
    assert talk.feed(b"/1 1 get pos\n") == b"@01 1 OK IDLE -- 5000\r\n"
    talk.feed(b"/1 1 tools storepos 16 current\n")
    assert talk.feed(b"/1 1 tools storepos 16\n") == b"@01 1 OK IDLE -- 5000\r\n"


def test_parking_forbids_moves(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    talk.feed(b"/1 1 move abs 20000\n")
    assert talk.feed(b"/1 1 tools parking park\n") == b"@01 1 RJ BUSY -- STATUSBUSY\r\n"
    bench.clock.advance(10.0)
    assert talk.feed(b"/1 1 tools parking park\n") == b"@01 1 OK IDLE -- 0\r\n"
    assert talk.feed(b"/1 1 get parking.state\n") == b"@01 1 OK IDLE -- 1\r\n"
    for command in (b"home", b"move abs 0", b"move vel 100"):
        assert talk.feed(b"/1 1 %s\n" % command) == b"@01 1 RJ IDLE -- PARKED\r\n"
    talk.feed(b"/1 1 tools parking unpark\n")
    assert talk.feed(b"/1 1 move abs 0\n") == b"@01 1 OK BUSY -- 0\r\n"


def test_a_disabled_driver_stops_and_does_not_move(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    talk.feed(b"/1 1 move abs 300000\n")
    bench.clock.advance(1.0)
    assert talk.feed(b"/1 1 driver disable\n") == b"@01 1 OK BUSY FO 0\r\n"
    bench.clock.advance(5.0)
    assert talk.feed(b"/1 1 move abs 0\n") == b"@01 1 RJ IDLE FO DRIVERDISABLED\r\n"
    assert talk.feed(b"/1 1 get driver.enabled\n") == b"@01 1 OK IDLE FO 0\r\n"
    assert talk.feed(b"/1 1 warnings\n") == b"@01 1 OK IDLE FO 01 FO\r\n"
    assert (
        talk.feed(b"/1 1 driver enable\n/1 1 move abs 0\n") == b"@01 1 OK IDLE -- 0\r\n@01 1 OK BUSY -- 0\r\n"
    )


def test_an_emergency_stop_is_harder_than_a_stop(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    talk.feed(b"/1 1 move abs 300000\n")
    bench.clock.advance(1.0)
    talk.feed(b"/1 1 estop\n")
    bench.clock.advance(0.01)
    assert talk.feed(b"/1 1\n") == b"@01 1 OK IDLE NI 0\r\n"
    talk.feed(b"/1 1 move abs 0\n")
    assert bench.theta_i.acceleration_steps_s2 == pytest.approx(100.0 * 4266.6666666666667)


def test_settings_survive_a_restart_and_the_reference_does_not(bench: StillBench, talk) -> None:
    home(bench, talk, 1)
    talk.feed(b"/1 1 set maxspeed 2000\n/1 1 set knob.enable 0\n")
    assert talk.feed(b"/1 0 system reset\n") == b"@01 0 OK IDLE WR 0\r\n"
    assert talk.feed(b"/1 1 get maxspeed\n/1 1 get knob.enable\n").count(b"WR 2000") == 1
    assert talk.feed(b"/1 0 system restore\n/1 1 get knob.enable\n").endswith(b"WR 1\r\n")


def test_storage_of_device_and_axis(talk) -> None:
    assert talk.feed(b"/1 0 storage set a.b 1 2\n") == b"@01 0 OK IDLE WR 0\r\n"
    assert talk.feed(b"/1 1 storage axis set a.b 3\n") == b"@01 1 OK IDLE WR 0\r\n"
    talk.feed(b"/1 0 storage append a.b 4\n/1 0 storage set z 9\n")
    assert talk.feed(b"/1 0 storage get a.b\n") == b"@01 0 OK IDLE WR 1 2 4\r\n"
    assert talk.feed(b"/1 1 storage axis get a.b\n") == b"@01 1 OK IDLE WR 3\r\n"
    assert talk.feed(b"/1 0 05 storage all print prefix a\n") == (
        b"@01 0 05 OK IDLE WR 0\r\n#01 0 05 set a.b 1 2 4\r\n#01 0 05 axis 1 set a.b 3\r\n"
    )
    assert talk.feed(b"/1 0 storage print keys\n").endswith(b"#01 0 set a.b\r\n#01 0 set z\r\n")
    assert talk.feed(b"/1 0 storage erase z\n/1 0 storage exists z\n").endswith(b"WR 0\r\n")
    assert talk.feed(b"/1 0 storage axis get a.b\n") == b"@01 0 RJ IDLE WR BADAXIS\r\n"


def test_a_long_reply_comes_in_packets(talk) -> None:
    text = " ".join(f"word{i}" for i in range(30))
    for part in range(6):
        verb = "append" if part else "set"
        talk.feed(f"/1 0 storage {verb} k {' '.join(text.split()[5 * part : 5 * part + 5])}\n".encode())
    line = b"/1 0 07 storage get k"
    lines = talk.feed(line + b":%02X\n" % checksum(line[1:].decode())).split(b"\r\n")[:-1]
    assert len(lines) > 2
    assert all(len(packet) <= 78 for packet in lines)
    received = ""
    for i, packet in enumerate(lines):
        body, _, given = packet.decode().rpartition(":")
        assert int(given, 16) == checksum(body[1:])
        assert body.endswith("\\") is (i + 1 < len(lines))
        head = "@01 0 07 OK IDLE WR " if i == 0 else "#01 0 07 cont "
        assert body.startswith(head)
        received += " " * bool(i) + body.removeprefix(head).removesuffix("\\")
    assert received == text


def test_help_is_information_behind_the_reply(talk) -> None:
    reply, information, _ = talk.feed(b"/2 0 03 help\n").split(b"\r\n")
    assert reply == b"@02 0 03 OK IDLE WR 0"
    assert information.startswith(b"#02 0 03 ")


def test_a_long_command_comes_in_packets(talk) -> None:
    assert talk.feed(b"/1 0 04 storage set k one two\\\n") == b""
    assert talk.feed(b"/1 0 04 cont 1 three\\\n/1 0 04 cont 2 four\n") == b"@01 0 04 OK IDLE WR 0\r\n"
    assert talk.feed(b"/1 0 storage get k\n") == b"@01 0 OK IDLE WR one two three four\r\n"
    assert talk.feed(b"/1 0 05 cont 1 five\n") == b"@01 0 05 RJ IDLE WR BADCOMMAND\r\n"
    assert (
        talk.feed(b"/1 0 06 storage set k six\\\n/1 0 06 cont 2 eight\n")
        == b"@01 0 06 RJ IDLE WR BADCOMMAND\r\n"
    )
    talk.feed(b"/1 0 07 storage set k nine\\\n")
    assert talk.feed(b"/1 0 08\n") == b"@01 0 08 OK IDLE WR 0\r\n"  # another command, as usual

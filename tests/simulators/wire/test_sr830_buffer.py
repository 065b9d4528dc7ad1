"""The SR830's data buffer: rates, triggers, ends, and the three ways to transfer it."""

import struct

import pytest

from gonio_simulators.wire.sr830 import Sr830
from gonio_simulators.wire.sr830_buffer import ascii_points, lia_points
from tests.simulators.wire.conftest import StillBench
from tests.simulators.wire.test_sr830 import lit


@pytest.fixture
def talk(bench: StillBench):
    return Sr830(bench).open()


def test_points_are_taken_in_bench_time_while_nobody_asks(bench: StillBench, talk) -> None:
    signal_v = lit(bench)
    assert talk.feed(b"SRAT 7;SEND 0;REST;STRT\r") == b""  # 8 Hz
    assert talk.feed(b"*STB? 0\r") == b"0\r"  # a scan is in progress
    bench.clock.advance(0.49)
    bench.monochromator.set_shutter(False)
    bench.clock.advance(0.49)
    assert talk.feed(b"SPTS?\r") == b"8\r"
    points = struct.unpack("<8f", talk.feed(b"TRCB? 1,0,8\r"))
    assert points[:4] == pytest.approx([signal_v] * 4, abs=1 / 32768)
    assert points[4] > points[5] > points[6] > points[7] > 0.0
    assert talk.feed(b"PAUS;*STB? 0\r") == b"0\r"  # paused is in progress, too
    bench.clock.advance(10.0)
    assert talk.feed(b"SPTS?\r") == b"8\r"
    talk.feed(b"STRT\r")
    bench.clock.advance(0.99)
    assert talk.feed(b"SPTS?\r") == b"16\r"
    assert talk.feed(b"REST;SPTS?;*STB? 0\r") == b"0\r1\r"


def test_both_displays_are_stored_as_they_were(bench: StillBench, talk) -> None:
    signal_v = lit(bench)
    talk.feed(b"DDEF 1,1,0;DDEF 2,1,0;PHAS 90;SRAT 4;STRT\r")
    bench.clock.advance(1.5)
    talk.feed(b"PHAS 30\r")
    bench.clock.advance(1.0)
    assert talk.feed(b"SPTS?\r") == b"3\r"
    assert [float(v) for v in talk.feed(b"TRCA?1,0,3\r").strip(b",\r").split(b",")] == pytest.approx(
        [signal_v] * 3, abs=2 / 32768
    )
    theta_deg = struct.unpack("<3f", talk.feed(b"TRCB? 2,0,3\r"))
    assert theta_deg == pytest.approx([-90.0, -90.0, -30.0], abs=0.01)


def test_one_shot_ends_and_a_loop_goes_on(bench: StillBench, talk) -> None:
    talk.feed(b"SRAT 13;SEND 0;STRT\r")  # 512 Hz
    bench.clock.advance(40.0)
    assert talk.feed(b"SPTS?;*STB? 0\r") == b"16383\r1\r"
    talk.feed(b"SEND 1;REST;STRT\r")
    bench.clock.advance(1e6)  # a loop over bench weeks costs no more than its last points
    assert talk.feed(b"SPTS?;*STB? 0\r") == b"16383\r0\r"


def test_triggers(bench: StillBench, talk) -> None:
    talk.feed(b"SRAT 14;TSTR 1;TRIG;TRIG\r")
    assert talk.feed(b"SPTS?;LIAS? 6\r") == b"2\r1\r"
    talk.feed(b"REST;TSTR 0;TRIG\r")
    assert talk.feed(b"SPTS?\r") == b"0\r"


def test_a_delayed_start(bench: StillBench, talk) -> None:
    talk.feed(b"SRAT 10;FAST 2;STRD\r")  # 64 Hz
    bench.clock.advance(0.49)
    assert talk.feed(b"SPTS?;FAST?\r") == b"0\r2\r"
    bench.clock.advance(0.02)
    assert talk.feed(b"SPTS?\r") == b"1\r"


def test_number_forms() -> None:
    assert ascii_points([-1.234567e-9, 7.654321e-9]) == "-1.234567e-009,+7.654321e-009,"
    for value in (0.0, 1.0, -0.3, 7.77e-9, 0.9999999):
        mantissa, exponent, zero = struct.unpack("<hBB", lia_points([value]))
        assert zero == 0
        assert mantissa * 2.0 ** (exponent - 124) == pytest.approx(value, rel=2**-15)

"""The SR830: slope, offset and expand, displays, automatics, stored setups, input overflow."""

import math

import pytest

from gonio_simulators.wire.sr830 import Sr830
from tests.simulators.wire.conftest import StillBench
from tests.simulators.wire.test_sr830 import lit


@pytest.fixture
def talk(bench: StillBench):
    return Sr830(bench).open()


def volts(talk, query: bytes) -> float:
    return float(talk.feed(query + b"\r"))


@pytest.mark.parametrize("slope", range(4))
def test_the_slope_shapes_the_decay(bench: StillBench, talk, slope: int) -> None:
    signal_v = lit(bench)
    talk.feed(b"OFSL %d\r" % slope)
    bench.monochromator.set_shutter(False)
    bench.clock.advance(0.5 + 0.02)  # five time constants and the shutter
    left = math.exp(-5.0) * sum(5.0**k / math.factorial(k) for k in range(slope + 1))
    assert volts(talk, b"OUTP? 1") == pytest.approx(signal_v * left, rel=0.12)


def test_offset_is_taken_off_x_but_not_off_r(bench: StillBench, talk) -> None:
    signal_v = lit(bench)
    talk.feed(b"OEXP 1,50,0\r")
    assert talk.feed(b"OEXP? 1\r") == b"50.00,0\r"
    assert volts(talk, b"OUTP? 1") == pytest.approx(signal_v - 0.5, abs=2 / 32768)
    assert volts(talk, b"OUTP? 3") == pytest.approx(signal_v, abs=2 / 32768)
    assert volts(talk, b"OUTP? 4") == pytest.approx(0.0, abs=0.01)


def test_auto_offset_and_expand_show_the_small_rest(bench: StillBench, talk) -> None:
    signal_v = lit(bench)
    talk.feed(b"LIAS?\rAOFF 1\r")
    percent, expand = talk.feed(b"OEXP? 1\r").split(b",")
    assert float(percent) == pytest.approx(100.0 * signal_v, abs=0.006)
    assert expand == b"0\r"
    talk.feed(b"OEXP 1,%s,2\r" % percent)
    rest_v = volts(talk, b"OUTP? 1")
    assert rest_v == pytest.approx(signal_v - float(percent) / 100.0, abs=0.51 / 32768 / 100)
    assert talk.feed(b"LIAS?\r") == b"0\r"
    talk.feed(b"OEXP 1,0,2\r")  # the whole signal does not fit the expanded range
    assert volts(talk, b"OUTP? 1") == pytest.approx(1.09 / 100)
    assert talk.feed(b"LIAS? 2\r") == b"1\r"


def test_displays(bench: StillBench, talk) -> None:
    signal_v = lit(bench)
    talk.feed(b"PHAS 60;DDEF 1,1,0;DDEF 2,1,0\r")
    r_v, theta_deg = (float(v) for v in talk.feed(b"SNAP? 10,11\r").split(b","))
    assert r_v == pytest.approx(signal_v, abs=2 / 32768)
    assert theta_deg == pytest.approx(-60.0, abs=0.02)
    assert volts(talk, b"OUTR? 1") == r_v
    assert talk.feed(b"DDEF? 2\r") == b"1,0\r"
    talk.feed(b"DDEF 1,3,0\r")
    assert talk.feed(b"OUTR? 1\r") == b"0\r"  # nothing is plugged into the auxiliary input
    assert talk.feed(b"OAUX? 1;AUXV? 1;SNAP? 5,9\r") == b"0.000\r0.000\r0.000,137.000\r"


def test_the_noise_display_is_the_detector_s(bench: StillBench) -> None:
    from gonio.rig import default_rig_text
    from gonio_simulators.bench.bench import Bench
    from gonio_simulators.bench.config import BenchConfig
    from gonio_simulators.clock import ManualClock

    noisy = Bench(BenchConfig.from_text(default_rig_text()), ManualClock())
    talk = Sr830(noisy).open()
    talk.feed(b"DDEF 1,2,0\r")
    shown = volts(talk, b"OUTR? 1")
    signal = noisy.detector_signal(0.0)
    assert shown == pytest.approx(math.sqrt(2.0) * signal.in_phase_sd_v, rel=1e-4)
    assert shown > 0


def test_automatics_keep_the_instrument_busy(bench: StillBench, talk) -> None:
    lit(bench)
    assert talk.feed(b"*STB?\r") == b"3\r"  # no scan, nothing in progress
    talk.feed(b"PHAS 30;APHS\r")
    assert talk.feed(b"*STB? 1\r") == b"0\r"
    bench.clock.advance(1.001)
    assert talk.feed(b"*STB? 1\r") == b"1\r"
    assert talk.feed(b"PHAS?\r") == b"0.00\r"
    talk.feed(b"RMOD 0;ARSV\r")
    assert talk.feed(b"RMOD?\r") == b"2\r"
    talk.feed(b"SENS 26;AGAN\r")
    assert talk.feed(b"*STB? 1;SENS?\r") == b"0\r26\r"


def test_a_harmonic_beyond_the_limit_becomes_the_highest(talk) -> None:
    talk.feed(b"FMOD 1;FREQ 20000;HARM 9\r")
    assert talk.feed(b"HARM?\r") == b"5\r"
    talk.feed(b"FMOD 0;HARM 9\r")
    assert talk.feed(b"HARM?\r") == b"9\r"


def test_setups_are_stored_and_recalled(bench: StillBench, talk) -> None:
    talk.feed(b"SENS 20;OFLT 6;OFSL 2;PHAS 12.5;OEXP 2,10,1;DDEF 1,1,0;AUXV 3,1.5;SSET 4\r")
    talk.feed(b"*RST\r")
    assert talk.feed(b"SENS?;OEXP? 2\r") == b"26\r0.00,0\r"
    talk.feed(b"RSET 4\r")
    assert talk.feed(b"SENS?;OFLT?;OFSL?;PHAS?;OEXP? 2;DDEF? 1;AUXV? 3\r") == (
        b"20\r6\r2\r12.50\r10.00,1\r1,0\r1.500\r"
    )
    assert (bench.lockin.sensitivity_v, bench.lockin.time_constant_s, bench.lockin.order) == (0.01, 0.01, 3)


def test_more_than_the_input_buffer_holds_is_lost(talk) -> None:
    talk.feed(b"*CLS\r")
    assert talk.feed(b"x" * 300) == b""
    assert talk.feed(b"*ESR? 0\r") == b"1\r"

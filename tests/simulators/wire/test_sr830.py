"""The SR830: commands and their ranges, status registers, and voltages against the bench's own."""

import math

import pytest

from gonio_simulators.wire.sr830 import Sr830
from gonio_simulators.wire.sr830_parameters import SENSITIVITY_V, TIME_CONSTANT_S
from tests.simulators.wire.conftest import StillBench


@pytest.fixture
def talk(bench: StillBench):
    return Sr830(bench).open()


def lit(bench: StillBench) -> float:
    """Send the direct beam to the detector and return its voltage."""
    bench.monochromator.set_shutter(True)
    for motor, target_deg in ((bench.theta_i, 90.0), (bench.theta_mes, 180.0)):
        motor.home()
        bench.clock.advance(60.0)
        motor.move_absolute(round((target_deg - motor.hardware.zero_deg) * motor.hardware.steps_per_deg))
        bench.clock.advance(60.0)
    signal_v = bench.detector_signal(bench.clock.now_s()).mean_v
    assert signal_v > 0.1
    return signal_v


def test_identity_and_terminators(talk) -> None:
    assert talk.feed(b"*IDN?\n") == b"Stanford_Research_Systems,SR830,s/n83022,ver1.07\r"
    assert talk.feed(b"*idn?\r") == b"Stanford_Research_Systems,SR830,s/n83022,ver1.07\r"
    assert talk.feed(b"SENS?;OFLT?\r\n") == b"26\r8\r"
    assert [talk.feed(c.encode()) for c in "SENS?"] == [b""] * 5
    assert talk.feed(b"\r") == b"26\r"


def test_tables_of_ranges() -> None:
    assert (len(SENSITIVITY_V), len(TIME_CONSTANT_S)) == (27, 20)
    assert SENSITIVITY_V[0] == pytest.approx(2e-9)
    assert SENSITIVITY_V[17] == pytest.approx(1e-3)
    assert SENSITIVITY_V[26] == 1.0
    assert [TIME_CONSTANT_S[i] for i in (0, 8, 10, 19)] == pytest.approx([10e-6, 0.1, 1.0, 30e3])


@pytest.mark.parametrize(
    ("command", "query", "answer"),
    [
        (b"SENS 20", b"SENS?", b"20"),
        (b"SENS20", b"SENS?", b"20"),
        (b"OFLT 10", b"OFLT?", b"10"),
        (b"OFSL 3", b"OFSL?", b"3"),
        (b"SRAT4.000000", b"SRAT?", b"4"),
        (b"PHAS -90.5", b"PHAS?", b"-90.50"),
        (b"PHAS 541", b"PHAS?", b"-179.00"),
        (b"HARM 3", b"HARM?", b"3"),
        (b"FMOD 1;FREQ 1.00000e+03", b"FREQ?", b"1000.00"),
        (b"SLVL0.101", b"SLVL?", b"0.100"),
        (b"AUXV1,2.5", b"AUXV? 1", b"2.500"),
        (b"DDEF1,1,0", b"DDEF?1", b"1,0"),
        (b"LIAE 2,1", b"LIAE?", b"4"),
        (b"LIAE 5", b"LIAE? 2", b"1"),
        (
            b"RMOD 2;ILIN 3;ICPL 1;IGND 1;ISRC 1;SYNC 1",
            b"RMOD?;ILIN?;ICPL?;IGND?;ISRC?;SYNC?",
            b"2\r3\r1\r1\r1\r1",
        ),
    ],
)
def test_settings_are_read_back(talk, command: bytes, query: bytes, answer: bytes) -> None:
    assert talk.feed(command + b"\r") == b""
    assert talk.feed(query + b"\r") == answer + b"\r"
    assert talk.feed(b"*ESR?\r") == b"128\r"  # power on, and no error


@pytest.mark.parametrize(
    ("command", "bit"),
    [
        (b"FOOO 1", 5),
        (b"SENS", 5),
        (b"SENS x", 5),
        (b"SNAP?1", 5),
        (b"OUTP 1", 5),
        (b"SENS 27", 4),
        (b"SENS 2.5", 4),
        (b"OFLT -1", 4),
        (b"OUTP? 5", 4),
        (b"SNAP? 1,12", 4),
        (b"PHAS 800", 4),
        (b"AUXV 1,11", 4),
        (b"FREQ 100", 4),  # the reference is external
        (b"FMOD 1;HARM 200;FREQ 2000", 4),  # beyond 102 kHz
        (b"AOFF 4", 4),
        (b"OEXP 1,106,0", 4),
        (b"OEXP 1,50,3", 4),
        (b"OUTR? 3", 4),
        (b"RSET 7", 4),  # nothing stored there
        (b"TRCA? 1,0,1", 4),  # nothing recorded
        (b"STRT 1", 5),
        (b"SPTS", 5),
    ],
)
def test_errors_say_nothing_and_set_an_event(talk, command: bytes, bit: int) -> None:
    talk.feed(b"*CLS\r")
    assert talk.feed(command + b"\r") == b""
    assert talk.feed(b"*ESR? %d\r" % bit) == b"1\r"
    assert talk.feed(b"*ESR?\r") == b"0\r"


def test_outputs_are_the_detector_s_voltage(bench: StillBench, talk) -> None:
    signal_v = lit(bench)
    talk.feed(b"PHAS 30\r")
    x_v, y_v = (float(v) for v in talk.feed(b"SNAP? 1,2\r").split(b","))
    resolution_v = 1.0 / 32768
    assert x_v == pytest.approx(signal_v * math.cos(math.radians(30.0)), abs=resolution_v)
    assert y_v == pytest.approx(-signal_v * math.sin(math.radians(30.0)), abs=resolution_v)
    assert float(talk.feed(b"OUTP? 3\r")) == pytest.approx(signal_v, abs=2 * resolution_v)
    assert float(talk.feed(b"OUTP?4\r")) == pytest.approx(-30.0, abs=0.02)
    assert talk.feed(b"SNAP?1,2,3,4,9,5\r").count(b",") == 5
    talk.feed(b"APHS\r")
    assert float(talk.feed(b"PHAS?\r")) == pytest.approx(0.0, abs=0.02)


def test_overload_is_latched_until_read(bench: StillBench, talk) -> None:
    signal_v = lit(bench)
    assert talk.feed(b"LIAS?\r") == b"0\r"
    talk.feed(b"SENS 22\r")  # 50 mV
    x_v, status = talk.feed(b"OUTP? 1;LIAS?\r").split(b"\r")[:2]
    assert float(x_v) == pytest.approx(1.09 * 0.05, rel=1e-3)  # no further than the output goes
    assert status == b"4"
    talk.feed(b"OUTP? 1;SENS 26\r")
    assert talk.feed(b"LIAS? 2\r") == b"1\r"
    assert talk.feed(b"LIAS? 2\r") == b"0\r"
    talk.feed(b"LIAE 2,1;SENS 22;OUTP? 1\r")
    assert int(talk.feed(b"*STB?\r")) & 0b1000
    talk.feed(b"*CLS;SENS 0;AGAN\r")
    assert SENSITIVITY_V[int(talk.feed(b"SENS?\r"))] >= signal_v


def test_the_time_constant_is_the_bench_s(bench: StillBench, talk) -> None:
    assert talk.feed(b"OFLT?\r") == b"8\r"
    talk.feed(b"OFLT 11\r")
    assert bench.lockin.time_constant_s == pytest.approx(3.0)
    signal_v = lit(bench)
    bench.monochromator.set_shutter(False)
    bench.clock.advance(3.0 + 0.02)  # the shutter takes 20 ms
    assert float(talk.feed(b"OUTP? 1\r")) == pytest.approx(signal_v / math.e, rel=0.01)


def test_reset_and_interface(bench: StillBench, talk) -> None:
    talk.feed(b"SENS 3;OFLT 1;PHAS 20;OUTX 1\r")
    assert talk.feed(b"SENS?\r") == b""  # answers go to the other interface
    assert talk.feed(b"OUTX?\r") == b"1\r"
    assert talk.feed(b"OUTX 0;*RST;SENS?;OFLT?;OFSL?;PHAS?\r") == b"26\r8\r1\r0.00\r"
    assert (bench.lockin.sensitivity_v, bench.lockin.time_constant_s, bench.lockin.order) == (1.0, 0.1, 2)

"""Whatever bytes arrive, every front end goes on answering."""

from functools import cache

from hypothesis import given, settings
from hypothesis import strategies as st

from gonio.rig import default_rig_text
from gonio_simulators.wire.applied_motion import AppliedMotionLine
from gonio_simulators.wire.cs260 import Cornerstone260
from gonio_simulators.wire.elliptec import Elliptec
from gonio_simulators.wire.lines import Instrument
from gonio_simulators.wire.modbus_frames import mbap_frame, rtu_frame
from gonio_simulators.wire.sr830 import Sr830
from gonio_simulators.wire.zaber import ZaberChain
from tests.simulators.wire.conftest import StillBench


@cache
def _bench() -> StillBench:
    return StillBench.of(default_rig_text())


def _drives(framing: str) -> AppliedMotionLine:
    return AppliedMotionLine(
        _bench(), theta_i=1, theta_mes=2, steps_per_rev=(2e4, 2e4), framing=framing, word_order="big"
    )


def _words(*vocabulary: bytes) -> st.SearchStrategy[bytes]:
    """Sequences of the protocol's own words, numbers and any bytes."""
    numbers = st.one_of(st.integers(), st.floats()).map(lambda v: str(v).encode("ascii"))
    return st.lists(st.one_of(st.sampled_from(vocabulary), numbers, st.binary(max_size=5))).map(b"".join)


def _answers(instrument: Instrument, data: bytes, question: bytes) -> bytes:
    talk = instrument.open()
    assert isinstance(talk.feed(data), bytes)
    _bench().clock.advance(1e4)
    talk.poll()
    again = instrument.open()
    again.feed(b"")
    return again.feed(question)


_ZABER = _words(
    *(
        b"/",
        b"1 ",
        b"2 ",
        b"0 ",
        b" ",
        b"\n",
        b":",
        b"get ",
        b"set ",
        b"pos ",
        b"accel ",
        b"maxspeed ",
        b"move ",
    ),
    *(b"abs ", b"vel ", b"max", b"home", b"stop", b"warnings", b"clear", b"system restore", b"tools echo"),
    b"comm.alert ",
)
_CS260 = _words(
    *(
        b"\n",
        b"\r\n",
        b" ",
        b"?",
        b"GOWAVE ",
        b"WAVE",
        b"STEP ",
        b"GRAT",
        b"1",
        b"LABEL",
        b"FACTOR ",
        b"FILTER ",
    ),
    *(b"SLIT", b"MICRONS ", b"HANDSHAKE 1", b"ABORT", b"UNITS UM", b"SHUTTER O", b"ERROR?", b"CALIBRATE "),
)
_SR830 = _words(
    *(b"\r", b";", b",", b"?", b" ", b"SNAP", b"OUTP", b"SENS", b"OFLT", b"PHAS", b"APHS", b"AGAN", b"LIAE"),
    *(b"LIAS", b"*ESR", b"*STB", b"*RST", b"DDEF", b"AUXV", b"OEXP", b"FREQ", b"SLVL", b"1", b"2"),
    *(
        b"STRT",
        b"SRAT",
        b"SEND",
        b"TRIG",
        b"TSTR",
        b"TRCA",
        b"TRCB",
        b"TRCL",
        b"REST",
        b"SSET",
        b"RSET",
        b"OFSL",
    ),
)
_ELLIPTEC = _words(
    *(
        b"0",
        b"in",
        b"gs",
        b"ma",
        b"mr",
        b"00000100",
        b"FFFFFF00",
        b"ho",
        b"sj",
        b"sv",
        b"32",
        b"fw",
        b"st",
        b"\r\n",
    )
)


@settings(max_examples=30, deadline=None)
@given(_ZABER)
def test_zaber(data: bytes) -> None:
    assert b"@" in _answers(ZaberChain(_bench(), theta_i=1, theta_mes=2), data, b"/0 0 01\n")


@settings(max_examples=30, deadline=None)
@given(_CS260)
def test_cs260(data: bytes) -> None:
    assert _answers(Cornerstone260(_bench()), data, b"WAVE?\n").startswith(b"WAVE?\n")


@settings(max_examples=30, deadline=None)
@given(_SR830)
def test_sr830(data: bytes) -> None:
    assert _answers(Sr830(_bench()), data, b"OUTX 0;*IDN?\r").startswith(b"Stanford")


@settings(max_examples=30, deadline=None)
@given(_ELLIPTEC)
def test_elliptec(data: bytes) -> None:
    assert _answers(Elliptec(_bench()), data, b"0gp").startswith(b"0PO")


@settings(max_examples=30, deadline=None)
@given(st.lists(st.binary(max_size=12)))
def test_modbus(bodies: list[bytes]) -> None:
    question = bytes.fromhex("0300010001")
    rtu = b"".join(rtu_frame(1, body or b"\x03") for body in bodies)
    assert len(_answers(_drives("rtu"), rtu, rtu_frame(1, question))) == 7
    mbap = b"".join(mbap_frame(i, 1, body or b"\x03") for i, body in enumerate(bodies))
    assert len(_answers(_drives("tcp"), mbap, mbap_frame(1, 1, question))) == 11

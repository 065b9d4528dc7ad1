"""The SR830: exact bytes, tables against the manual, statistics of the filter against its closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import quad, solve_ivp

from gonio.errors import DeviceError, ReplyError
from gonio_drivers.sr830 import FULL_SCALE_V, SPACING_TIME_CONSTANTS, SR830, TIME_CONSTANT_S, SR830Config

from .conftest import SILENCE

CONFIG = SR830Config(driver="sr830")
IDENTITY = b"Stanford_Research_Systems,SR830,s/n12345,ver1.07\r"
IDN = (b"*IDN?\r", IDENTITY)
CONNECT = (
    (b"OUTX 0\r", b""),
    IDN,
    (b"OFLT 8;OFLT?\r", b"8\r"),
    (b"OFSL 0;OFSL?\r", b"0\r"),
    (b"SENS?\r", b"26\r"),
    (
        b"ISRC?;*IDN?;HARM 1;HARM?;*IDN?;OEXP 1,0,0;OEXP? 1;*IDN?;OEXP 2,0,0;OEXP? 2;*IDN?;PHAS?;*IDN?\r",
        IDENTITY.join([b"0\r", b"1\r", b"0,0\r", b"0,0\r", b"-30.50\r", b""]),
    ),
    (b"SNAP? 1,2,3;LIAS?\r", b"0.3,0.4,0.5\r0\r"),
)
GUARDED, AS_BEFORE = b";ISRC?;HARM?;OEXP? 1;OEXP? 2;PHAS?\r", b"0\r1\r0,0\r0,0\r-30.50\r"
READ = b"SNAP? 1,2;LIAS?\r"


@pytest.fixture
def lockin(scripted, context):
    def make(*exchanges, config=CONFIG, connect=CONNECT):
        amplifier = SR830(config, context, scripted(*connect, *exchanges, role="lockin"))
        return without_magnitude(amplifier)

    return make


def without_magnitude(amplifier: SR830) -> SR830:
    """Make it one whose R proves nothing, so that readings are short in the tests."""
    amplifier._magnitude_agrees, amplifier._status_first = False, True
    return amplifier


def test_tables_of_the_manual():
    assert len(FULL_SCALE_V) == 27
    assert FULL_SCALE_V[0] == pytest.approx(2e-9)
    assert FULL_SCALE_V[17] == pytest.approx(1e-3)
    assert FULL_SCALE_V[26] == pytest.approx(1.0)
    assert len(TIME_CONSTANT_S) == 20
    assert [TIME_CONSTANT_S[i] for i in (0, 8, 10, 19)] == pytest.approx([10e-6, 0.1, 1.0, 30e3])


def test_a_reading_is_one_exchange(lockin):
    reading = lockin((READ, [b"1.25e-3,-4.", b"0e-6\r0\r"])).read()
    assert (reading.x_v, reading.y_v, reading.overload) == (1.25e-3, -4.0e-6, False)


@pytest.mark.parametrize(
    ("bits", "overload"), [(0, False), (1, True), (2, True), (4, True), (16, False), (20, True)]
)
def test_overload_bits(lockin, bits, overload):
    assert lockin((READ, b"0.1,0\r%d\r" % bits)).read().overload is overload


def test_range_is_set_and_verified_in_one_exchange_and_only_when_it_changes(lockin):
    amplifier = lockin((b"SENS 20;SENS?\r", b"20\r"))
    assert amplifier.set_range(20)
    assert not amplifier.set_range(20)
    amplifier = lockin((b"SENS 20;SENS?\r", b"26\r"))
    with pytest.raises(DeviceError, match="was told SENS 20 and reads 26"):
        amplifier.set_range(20)


def test_phase_is_set_if_the_rig_file_gives_it(lockin):
    connect = (*CONNECT[:4], (b"PHAS -30.50;PHAS?\r", b"-30.50\r"), *CONNECT[4:])
    lockin(connect=connect, config=SR830Config(driver="sr830", phase_deg=-30.5))


def test_another_instrument_is_refused(scripted, context):
    line = scripted((b"OUTX 0\r", b""), (b"*IDN?\r", b"Stanford_Research_Systems,SR865,1,2\r"))
    with pytest.raises(DeviceError, match=r"identified itself as .*SR865.*not as an SR830"):
        SR830(CONFIG, context, line)


def test_a_late_reading_is_never_the_next(lockin):
    amplifier = lockin(
        (READ, [SILENCE, b"1.0,0\r0\r"]),  # drained
        IDN,
        (b"LIAS?;SNAP? 1,2\r", b"0\r2.0,0\r"),  # the two answers change places from one look to the next
        (READ, []),
        (b"*IDN?\r", b"3.0,0\r0\r"),  # later than quiet: not the identity
        IDN,
        (b"LIAS?;SNAP? 1,2\r", b"0\r4.0,0\r"),
    )
    assert amplifier.read().x_v == 2.0
    assert amplifier.read().x_v == 4.0


@pytest.mark.parametrize("reply", [b"1.0\r0\r", b"1.0,2.0,3.0\r0\r", b"one,two\r0\r", b"1.0,2.0\r\xff\r"])
def test_damaged_readings_are_errors(lockin, reply):
    """Asked for once more, and damaged again."""
    outputs, status = reply.split(b"\r")[:2]
    turned = status + b"\r" + outputs + b"\r"
    amplifier = lockin((READ, reply), IDN, (b"LIAS?;SNAP? 1,2\r", turned))
    with pytest.raises(ReplyError, match="numbers"):
        amplifier.read()


@pytest.mark.parametrize("time_constant_s", [0.2, 0.5, 5e-6, 1e6])
def test_time_constants_the_instrument_has_not(time_constant_s):
    with pytest.raises(ValidationError, match="powers of ten; the nearest is"):
        SR830Config(driver="sr830", time_constant_s=time_constant_s)


def autocorrelation(poles: int, x: float) -> float:
    """Of white noise behind `poles` equal low-passes, from the spectrum 1/(1 + w2)^poles by quadrature."""
    if x == 0:
        return 1.0
    total, _ = quad(lambda w: (1 + w * w) ** -poles, 0, np.inf)
    if poles == 1:
        return math.exp(-x)  # the quadrature converges badly for a spectrum that falls so slowly
    part, _ = quad(lambda w: (1 + w * w) ** -poles, 0, np.inf, weight="cos", wvar=x)
    return part / total


@pytest.mark.parametrize(("slope", "spacing"), SPACING_TIME_CONSTANTS.items())
def test_averaged_readings_are_nearly_independent(slope, spacing):
    assert 0.04 < autocorrelation(slope // 6, spacing) <= 0.05


def step_left(poles: int, x: float) -> float:
    """What is left of a unit step after x time constants: the poles integrated one after the other."""
    solution = solve_ivp(
        lambda t, y: np.append(1.0, y[:-1]) - y, (0, x), np.zeros(poles), rtol=1e-10, atol=1e-12
    )
    return 1.0 - solution.y[-1, -1]


@pytest.mark.parametrize(("slope", "settle"), [(6, 5.0), (12, 7.0), (18, 9.0), (24, 10.0)])
def test_what_settling_leaves(slope, settle):
    config = SR830Config(driver="sr830", slope_db_oct=slope, settle_time_constants=settle)
    assert config.left_of_a_step() == pytest.approx(step_left(slope // 6, settle), rel=1e-5)
    assert step_left(slope // 6, config.jump_settle_s() / config.time_constant_s) < 1e-4


def test_too_short_a_settling_for_the_slope_is_refused():
    with pytest.raises(ValidationError, match=r"= 5 leaves 27% of a step .* 24 dB/octave; wait longer"):
        SR830Config(driver="sr830", slope_db_oct=24)


# -- R proves X and Y ----------------------------------------------------------------

WITH_R, TURNED_WITH_R = b"SNAP? 1,2,3;LIAS?\r", b"LIAS?;SNAP? 1,2,3\r"


@pytest.fixture
def proven(scripted, context):
    def make(*exchanges):
        return SR830(CONFIG, context, scripted(*CONNECT, *exchanges, role="lockin"))

    return make


@pytest.mark.parametrize(
    "damaged",
    [
        b"0.3118,0.4,0.5",  # a digit
        b"30.3,0.4,0.5",  # a digit more
        b"0.3e2,0.4,0.5",
        b"0.03,0.4,0.5",
        b"0.3,0.4,0.7",
    ],
)
def test_a_damaged_digit_is_a_damaged_reply(proven, damaged):
    amplifier = proven((TURNED_WITH_R, b"0\r" + damaged + b"\r"), IDN, (WITH_R, b"0.3,0.4,0.5\r0\r"))
    assert amplifier.read().x_v == 0.3
    assert amplifier.line.statistics.damaged == 1


def test_rounding_of_the_outputs_is_no_damage(proven):
    """All three in steps of 1 V / 32768."""
    amplifier = proven((TURNED_WITH_R, b"0\r0.300018,-0.399994,0.499969\r"))
    assert amplifier.read().y_v == -0.399994


def test_an_instrument_whose_r_is_something_else_is_read_without(scripted, context):
    """R expanded ten times, or made up: after three looks it is not asked for any more."""
    odd = b"0.03,0.04,0.5\r0\r"
    turned = b"0\r0.03,0.04,0.5\r"
    amplifier = SR830(
        CONFIG,
        context,
        scripted(
            *CONNECT[:-1],
            (WITH_R, odd),
            *(IDN, (TURNED_WITH_R, turned)),
            *(IDN, (WITH_R, odd)),
            *(IDN, (b"LIAS?;SNAP? 1,2\r", b"0\r0.03,0.04\r")),
            role="lockin",
        ),
    )
    assert amplifier.read().x_v == 0.03


def test_an_output_at_its_stop_is_overloaded_whatever_the_bits_say(lockin):
    assert lockin((READ, b"1.09,0\r0\r")).read().overload
    assert not lockin((READ, b"1.07,0\r0\r")).read().overload

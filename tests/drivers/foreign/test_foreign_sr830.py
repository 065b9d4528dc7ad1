"""Lock-ins as others left them, and replies as others send them."""

from __future__ import annotations

import pytest

from gonio.clock import Clock
from gonio.errors import ConnectionFailed, DeviceError, ReplyError
from gonio.rig import Context
from gonio_drivers.sr830 import SR830, SR830Config, open_sr830

from ..test_sr830 import CONNECT, IDN, READ, without_magnitude
from .bench import DARK_V, FULL_V, ForeignBench, lamp
from .lockin import ForeignLockin
from .wires import served

CONFIG = SR830Config(driver="sr830", time_constant_s=1e-3)


@pytest.fixture
def bench():
    made = ForeignBench()
    made.theta_i_deg = lambda: 90.0
    return made


@pytest.fixture
def connect():
    return lambda address: open_sr830(CONFIG.model_copy(update={"address": address}), Context("f", Clock()))


@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n"])
@pytest.mark.parametrize("knows_offsets", [True, False])
def test_offset_and_harmonic_of_the_last_user_are_taken_off(bench, connect, end, knows_offsets):
    foreign = ForeignLockin(bench, end=end, knows_offsets=knows_offsets)
    if not knows_offsets:
        foreign.offset_percent[1] = 0.0
    with served(foreign, chunk=3) as address:
        lockin = connect(address)
        reading = lockin.read()
        assert reading.x_v == pytest.approx(DARK_V + FULL_V * lamp(500.0), rel=1e-6)
        assert not reading.overload
        lockin.set_range(20)
        assert lockin.read().overload
        lockin.set_range(26)
        lockin.verify()
        lockin.close()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"source": 2}, r"measures a current \(ISRC 2\).*amperes, not volts; set its input to A"),
        ({"source": 3}, r"ISRC 3"),
        ({"keeps_offset": True}, r"answers OEXP\? 1 with 25,0 although it was told 0,0: X would be a wrong"),
    ],
)
def test_settings_that_would_make_a_wrong_voltage_are_refused(bench, connect, options, words):
    with (
        served(ForeignLockin(bench, **options)) as address,
        pytest.raises(DeviceError, match=words),
    ):
        connect(address)


@pytest.mark.parametrize(
    "identity",
    [
        "Stanford_Research_Systems,SR810,s/n00111,ver1.000",
        "Stanford_Research_Systems,SR850,s/n00111,ver1.000",
        "Stanford_Research_Systems,SR8300,s/n00111,ver1.000",
        "DSP865,000111,1.0",
    ],
)
def test_other_models_are_refused_by_name(bench, connect, identity):
    with (
        served(ForeignLockin(bench, identity=identity)) as address,
        pytest.raises(ConnectionFailed, match=rf"identified itself as '{identity}', not as an SR830"),
    ):
        connect(address)


def test_blanks_in_the_identity(bench, connect):
    foreign = ForeignLockin(bench, identity="Stanford Research Systems, SR830, 111, 1.1")
    with served(foreign) as address:
        connect(address).close()


def test_a_reading_without_lock_waits_for_it(bench, connect):
    with served(ForeignLockin(bench, unlocked_s=0.06)) as address:
        lockin = connect(address)
        readings = [lockin.read().x_v for _ in range(10)]
        assert readings == pytest.approx([DARK_V + FULL_V * lamp(500.0)] * 10, rel=1e-6)
        lockin.close()


def test_a_chopper_that_stands_still_is_an_error(bench, connect):
    with served(ForeignLockin(bench, unlocked_s=1e6)) as address:
        lockin = connect(address)
        with pytest.raises(DeviceError, match=r"not locked to its reference.*check that the chopper turns"):
            lockin.read()
        lockin.close()


def test_an_offset_pressed_in_the_middle_is_found_at_the_end_of_the_pass(bench, connect):
    foreign = ForeignLockin(bench)
    with served(foreign) as address:
        lockin = connect(address)
        lockin.verify()
        foreign.offset_percent[1] = 10.0
        with pytest.raises(DeviceError, match=r"answers OEXP\? 1 with 10,0, although it was 0,0 before"):
            lockin.verify()
        lockin.close()


@pytest.fixture
def lockin(scripted, context):
    config = SR830Config(driver="sr830")
    return lambda *exchanges: without_magnitude(
        SR830(config, context, scripted(*CONNECT, *exchanges, role="lockin"))
    )


@pytest.mark.parametrize(
    ("text", "x_v"),
    [
        (b"1.23e-05,-0", 1.23e-5),
        (b" +1.5E-3 , 0.000", 1.5e-3),
        (b"-0,0", 0.0),
        (b"-.25,1.", -0.25),
        (b"0.000012,-4e-7", 1.2e-5),
    ],
)
def test_forms_of_numbers(lockin, text, x_v):
    assert lockin((READ, text + b"\r\n 0\r\n")).read().x_v == pytest.approx(x_v)


@pytest.mark.parametrize("text", [b"nan,0", b"inf,0", b"1_0,0", b"1e999,0", b"0x1p3,0"])
def test_what_python_takes_for_a_number_and_no_lockin_says(lockin, text):
    turned = b"LIAS?;SNAP? 1,2\r"
    with pytest.raises(ReplyError, match="not 2 numbers"):
        lockin((READ, text + b"\r0\r"), IDN, (turned, b"0\r" + text + b"\r")).read()


PROBE = CONNECT[5]


@pytest.mark.parametrize(
    "damage", [(b"0,0\r", b"1\r"), (b"1\r", b"1\r1\r"), (b"1\r", b"7\r"), (b"0\rStan", b"2\rStan")]
)
def test_a_setting_is_wrong_only_if_it_is_wrong_twice(scripted, context, damage):
    """A late or doubled answer in the place of another, and a damaged digit."""
    reply = PROBE[1].replace(*damage, 1)
    assert reply != PROBE[1]
    malformed = damage[1] in (b"1\r", b"1\r1\r")
    again = (IDN, PROBE) if malformed else (PROBE,)
    line = scripted(*CONNECT[:5], (PROBE[0], reply), *again, CONNECT[6], role="lockin")
    SR830(SR830Config(driver="sr830"), context, line)

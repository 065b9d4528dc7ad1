"""The Cornerstone 260: echoes, exact bytes, and a query after every statement."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from gonio.errors import DeviceError, RefusedError, ReplyError
from gonio_drivers.cs260 import CS260, CS260Config

from .conftest import SILENCE

GRATINGS = ({"number": 1, "range_nm": (200.0, 700.0)}, {"number": 2, "range_nm": (700.0, 1600.0)})
FILTERS = ({"number": 1, "range_nm": (200.0, 400.0)}, {"number": 3, "range_nm": (400.0, 1600.0)})
CONFIG = CS260Config(driver="cs260", gratings=GRATINGS, filters=FILTERS)


def says(statement: str, *answers: str):
    """A statement, its echo and the lines of its answer."""
    echo = f"{statement}\r\n"
    return echo.encode(), "".join([echo, *(f"{a}\r\n" for a in answers)]).encode()


GREETING = (
    says("HANDSHAKE 0"),
    says("UNITS NM"),
    says("UNITS?", "NM"),
    says("ERROR?", "0"),
    says("INFO?", "Oriel,Cornerstone 260,SN 1,V1.0"),
)
INFO = tuple(b"".join(parts) for parts in zip(*GREETING, strict=True))  # sent and answered at once
NO_ERROR = says("ERROR?", "0")


@pytest.fixture
def mono(scripted, context):
    def make(*exchanges, config=CONFIG):
        return CS260(config, context, scripted(INFO, *exchanges, role="monochromator"))

    return make


def test_documented_drive(mono):
    monochromator = mono(says("GOWAVE 623.500"), says("WAVE?", "623.500"))
    assert monochromator.go_to(623.5) == 623.5
    assert monochromator.identify() == "Oriel,Cornerstone 260,SN 1,V1.0"


def test_the_wavelength_read_back_counts(mono):
    assert mono(says("GOWAVE 500.000"), says("WAVE?", "500.040")).go_to(500.0) == 500.04
    monochromator = mono(says("GOWAVE 500.000"), says("WAVE?", "499.000"), says("ERROR?", "3"))
    with pytest.raises(
        DeviceError,
        match=r"stands at 499\.000 nm instead of 500\.000 nm: it cannot go to that .*error 3.*ranges",
    ):
        monochromator.go_to(500.0)


def test_pipelined_drive_is_one_round_trip(mono):
    config = CONFIG.model_copy(update={"pipelined": True})
    both = (b"GOWAVE 623.500\r\nWAVE?\r\n", b"GOWAVE 623.500\r\nWAVE?\r\n623.500\r\n")
    assert mono(both, config=config).go_to(623.5) == 623.5


def test_pipelined_drive_notices_a_lost_question(mono):
    config = CONFIG.model_copy(update={"pipelined": True})
    sent = b"GOWAVE 623.500\r\nWAVE?\r\n"
    lost = (sent, b"GOWAVE 623.500\r\n")  # the instrument was deaf while it drove
    one_by_one = says("GOWAVE 623.500"), says("WAVE?", "623.500")
    assert mono(lost, says("STB?", "00"), *one_by_one, config=config).go_to(623.5) == 623.5


def test_grating_and_filter_change_only_at_their_borders(mono):
    monochromator = mono(
        says("GRAT?", "1,1200,VIS"),
        says("FILTER?", "1"),
        says("FILTER 3"),
        says("FILTER?", "3"),
        says("GRAT 2"),
        says("GRAT?", "2,600,NIR"),
    )
    assert monochromator.select_bands(399.9) is False
    assert monochromator.select_bands(400.0) is True
    assert monochromator.select_bands(699.9) is False
    assert monochromator.select_bands(700.0) is True
    assert monochromator.select_bands(1600.0) is False


def test_port_and_shutter(mono):
    monochromator = mono(
        says("OUTPORT?", "1"),
        says("OUTPORT 2"),
        says("OUTPORT?", "2"),
        says("SHUTTER?", "C"),
        says("SHUTTER O"),
        says("SHUTTER?", "O"),
        says("SHUTTER C"),
        says("SHUTTER?", "C"),
        says("SHUTTER C"),
        says("SHUTTER?", "C"),
    )
    assert monochromator.select_port(2)
    assert not monochromator.select_port(2)
    assert monochromator.set_shutter(True)
    assert not monochromator.set_shutter(True)
    monochromator.close_shutter()
    monochromator.close_shutter()  # told again, whatever is believed


def test_a_stuck_filter_wheel_is_an_error_with_the_instruments_reason(mono):
    monochromator = mono(
        says("GRAT?", "1,1200,VIS"),
        says("FILTER?", "1"),
        says("FILTER 3"),
        says("FILTER?", "2"),
        says("ERROR?", "6"),
        says("FILTER?", "2"),
        says("FILTER 3"),
        says("FILTER?", "3"),
    )
    with pytest.raises(
        DeviceError, match=r"monochromator at scripted: was told FILTER 3 and reads 2: it does not have that"
    ):
        monochromator.select_bands(500.0)
    assert monochromator.select_bands(500.0) is True  # asked again, because nothing is believed of it


def test_slits_are_set_once_if_the_rig_file_gives_them(mono):
    exchanges = []
    for slit in (1, 2):
        exchanges += [
            says(f"SLIT{slit}MICRONS?", "600"),
            says(f"SLIT{slit}MICRONS 760"),
            says(f"SLIT{slit}MICRONS?", "760"),
        ]
    mono(*exchanges, config=CONFIG.model_copy(update={"slit_um": 760.0}))


def test_uncovered_wavelength_sends_nothing(mono):
    with pytest.raises(RefusedError, match=r"wavelength = 1700 nm is covered by no grating .*200-1600 nm"):
        mono().select_bands(1700.0)


def test_doubled_echo_is_skipped(mono):
    request, _ = says("WAVE?")
    monochromator = mono((request, b"WAVE?\r\nWAVE?\r\n500.000\r\n"))
    assert monochromator.query("WAVE?") == "500.000"


def test_missing_echo_is_no_answer(mono):
    """A value without the echo of its own question may be the answer to another."""
    request, _ = says("WAVE?")
    monochromator = mono((request, b"500.000\r\n"), says("STB?", "00"), says("WAVE?", "623.500"))
    assert monochromator.query("WAVE?") == "623.500"


def test_a_late_reply_is_never_the_next_answer(mono):
    monochromator = mono(
        says("GOWAVE 500.000"),
        (says("WAVE?")[0], [SILENCE, b"WAVE?\r\n450.000\r\n"]),
        says("STB?", "00"),
        says("GOWAVE 500.000"),
        says("WAVE?", "500.000"),
    )
    assert monochromator.go_to(500.0) == 500.0


def test_nonsense_is_an_error_after_one_repetition(mono):
    monochromator = mono(
        says("GOWAVE 500.000"),
        says("WAVE?", "what"),
        says("STB?", "00"),
        says("GOWAVE 500.000"),
        says("WAVE?", "what"),
    )
    with pytest.raises(ReplyError, match="not a number"):
        monochromator.go_to(500.0)


@pytest.mark.parametrize(
    ("gratings", "words"),
    [
        (({"number": 1, "range_nm": (700.0, 200.0)},), "must ascend"),
        (
            ({"number": 1, "range_nm": (200.0, 600.0)}, {"number": 2, "range_nm": (700.0, 1600.0)}),
            "ranges that meet",
        ),
        ((), "at least 1 item"),
    ],
)
def test_gratings_of_a_rig_file(gratings, words):
    with pytest.raises(ValidationError, match=words):
        CS260Config(driver="cs260", gratings=gratings)

"""Monochromators of the Cornerstone family: echo or none; early, late or no answers; left by others."""

from __future__ import annotations

import pytest

from gonio.clock import Clock
from gonio.errors import ConnectionFailed, DeviceError, ReplyError
from gonio.rig import Context
from gonio_drivers import cs260
from gonio_drivers.cs260 import CS260, CS260Config, open_cs260
from gonio_drivers.cs260_line import GREETING

from .bench import ForeignBench
from .cornerstone import Cornerstone
from .wires import served

CONFIG = CS260Config(
    driver="cs260",
    gratings=({"number": 1, "range_nm": (200.0, 700.0)}, {"number": 2, "range_nm": (700.0, 1600.0)}),
    filters=({"number": 1, "range_nm": (200.0, 400.0)}, {"number": 3, "range_nm": (400.0, 1600.0)}),
    drive_nm_s=8000.0,
    grating_change_s=0.05,
    filter_step_s=0.01,
    port_change_s=0.02,
)


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(cs260, "_REAL_ARRIVAL_S", 0.1)
    monkeypatch.setattr(cs260, "_SLACK", 1.2)


def impatient_context() -> Context:
    """Deadlines of a tenth, so that lost answers cost the tests less."""
    return Context("foreign", Clock(), reply_timeout_s=0.3)


@pytest.fixture
def connect():
    def make(address: str, **changes) -> CS260:
        return open_cs260(CONFIG.model_copy(update={"address": address, **changes}), impatient_context())

    return make


INSTRUMENTS = {
    "original": {},
    "echo ended by CR": {"echo_end": b"\r"},
    "echo ended by LF": {"echo_end": b"\n"},
    "answers ended by CR": {"end": b"\r", "echo_end": b"\r"},
    "answers ended by LF": {"end": b"\n"},
    "no echo": {"echo": False},
    "no echo, early": {"echo": False, "manner": "early", "wave": "{:.2f}"},
    "early": {"manner": "early", "shutter": ("0", "1")},
    "deaf": {"manner": "deaf"},
    "deaf without echo": {"manner": "deaf", "echo": False},
    "blanks": {"wave": " {:.3f} ", "shutter": ("CLOSED", "OPEN")},
    "one decimal": {"wave": "{:.1f}", "shutter": ("c", "o")},
    "no units": {"has_units": False},
    "with its unit": {"wave": "{:.3f} nm"},
}


PIPELINED = ("original", "no echo", "early", "deaf")


@pytest.mark.parametrize(
    ("kind", "pipelined"),
    [(kind, False) for kind in INSTRUMENTS if kind != "deaf"] + [(kind, True) for kind in PIPELINED],
)
def test_a_wavelength_is_believed_when_the_instrument_stands_there(connect, kind, pipelined):
    bench = ForeignBench()
    foreign = Cornerstone(bench, **INSTRUMENTS[kind])
    with served(foreign, chunk=6) as address:
        mono = connect(address, pipelined=pipelined)
        assert not foreign.handshake
        for wavelength_nm, port in ((450.0, 1), (350.0, 1), (800.0, 2)):
            mono.select_bands(wavelength_nm)
            mono.select_port(port)
            mono.set_shutter(True)
            assert mono.go_to(wavelength_nm) == pytest.approx(wavelength_nm, abs=0.1)
            assert bench.wavelength_nm() == pytest.approx(wavelength_nm, abs=0.1)
            assert not foreign.drive.is_moving()
            assert (foreign.grating, foreign.filter) == (
                1 if wavelength_nm < 700 else 2,
                1 if wavelength_nm < 400 else 3,
            )
            assert foreign.port == port
            assert foreign.is_open
            assert not foreign.turret.is_moving()
        mono.verify()
        mono.close_shutter()
        assert not foreign.is_open
        mono.close()


def test_a_deaf_instrument_is_soon_asked_only_when_it_has_arrived(connect):
    foreign = Cornerstone(ForeignBench(), manner="deaf")
    with served(foreign) as address:
        mono = connect(address, pipelined=True)
        for wavelength_nm in (600.0, 500.0, 600.0):
            mono.go_to(wavelength_nm)
        lost = len(foreign.lost)
        for wavelength_nm in (500.0, 600.0, 500.0):
            mono.go_to(wavelength_nm)
        assert lost >= 2
        assert len(foreign.lost) == lost
        mono.close()


def test_an_instrument_that_stays_in_another_unit_is_refused(connect):
    with (
        served(Cornerstone(ForeignBench(), stays_in="WN")) as address,
        pytest.raises(DeviceError, match="works in WN although it was told UNITS NM; set it to nanometres"),
    ):
        connect(address)


def test_a_wavelength_beyond_the_grating(connect):
    """What the rig file allows and the grating does not."""
    foreign = Cornerstone(ForeignBench())
    with served(foreign) as address:
        mono = connect(address)
        with pytest.raises(DeviceError, match=r"instead of 1000\.000 nm: it cannot go to that .*error 3"):
            mono.go_to(1000.0)
        assert mono.go_to(600.0) == pytest.approx(600.0, abs=0.1)
        mono.close()


@pytest.mark.parametrize("echo", [True, False])
def test_a_wheel_that_is_not_there(connect, echo):
    with served(Cornerstone(ForeignBench(), has_wheel=False, echo=echo)) as address:
        mono = connect(address)
        with pytest.raises(
            DeviceError, match=r"gave no answer to FILTER\?: it does not have that accessory \(error 6\)"
        ):
            mono.select_bands(500.0)
        mono.close()


def test_another_instrument_says_nothing_that_could_be_taken_for_one(scripted, context):
    greeting = "".join(f"{statement}\r\n" for statement in GREETING).encode()
    other = (greeting, b"\xff\xfe\x00?\r\n7\r\n"), (b"INFO?\r\n", b"")
    line = scripted(*other, *other, role="monochromator")
    with pytest.raises(ReplyError):
        CS260(CONFIG, context, line)


def test_statements_one_by_one_for_an_instrument_that_loses_some(scripted, context):
    greeting = "".join(f"{statement}\r\n" for statement in GREETING).encode()
    line = scripted(
        (greeting, b"HANDSHAKE 0\r\n"),  # the rest was lost
        (b"INFO?\r\n", b"INFO?\r\nOriel,260\r\n"),
        (b"HANDSHAKE 0\r\n", b"HANDSHAKE 0\r\n"),
        (b"UNITS NM\r\n", b"UNITS NM\r\n"),
        (b"UNITS?\r\n", b"UNITS?\r\nNM\r\n"),
        role="monochromator",
    )
    assert CS260(CONFIG, context, line).identify() == "Oriel,260"


def test_noise_in_the_greeting_is_no_identity(scripted, context):
    greeting = "".join(f"{statement}\r\n" for statement in GREETING).encode()
    line = scripted(
        (greeting, b"~xyz\r\nORIEL\r\n"),
        (b"INFO?\r\n", b"INFO?\r\nOriel,260\r\n"),
        (greeting, greeting.replace(b"UNITS?\r\n", b"UNITS?\r\nNM\r\n") + b"Oriel,260\r\n"),
        (b"GOWAVE 500.000\r\n", b"GOWAVE 500.000\r\n"),
        (b"WAVE?\r\n", b"WAVE?\r\n500.000\r\n"),
        role="monochromator",
    )
    mono = CS260(CONFIG, context, line)
    assert mono.identify() == "Oriel,260"
    assert mono.go_to(500.0) == 500.0


def test_without_echo_a_late_answer_is_told_by_the_identity(scripted, context):
    greeting = "".join(f"{statement}\r\n" for statement in GREETING).encode()
    line = scripted(
        (greeting, b"NM\r\n0\r\nOriel,260\r\n"),
        (b"INFO?\r\n", b"Oriel,260\r\n"),
        (b"GOWAVE 500.000\r\n", b""),
        (b"WAVE?\r\n", []),
        (b"INFO?\r\n", b"450.000\r\n"),  # the late one: asked once more
        (b"INFO?\r\n", b"Oriel,260\r\n"),
        (b"GOWAVE 500.000\r\n", b""),
        (b"WAVE?\r\n", b"500.000\r\n"),
        role="monochromator",
    )
    assert CS260(CONFIG, context, line).go_to(500.0) == 500.0


def test_nobody_there():
    with served(_Silent()) as address, pytest.raises(ConnectionFailed, match="gave no complete reply"):
        open_cs260(CONFIG.model_copy(update={"address": address}), impatient_context())


class _Silent:
    def heard(self, data: bytes) -> bytes:
        return b""

    def unasked(self) -> bytes:
        return b""

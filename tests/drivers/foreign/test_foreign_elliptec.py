"""Elliptec modules of other firmware, on a bus with others."""

from __future__ import annotations

import pytest

from gonio.clock import Clock
from gonio.errors import DeviceError, MotionError
from gonio.rig import Context
from gonio_drivers.elliptec import ElliptecConfig, ElliptecRotator, open_polarizer

from .bench import ForeignBench
from .elliptec_bus import ElliptecBus
from .wires import served

CONFIG = ElliptecConfig(driver="elliptec", device="a", s_deg=0.0, p_deg=-45.0)
CONNECT = (
    (b"Ain", b"AIN0e1140077220232501016800023000\r\n"),
    (b"Aho0", b"APO00000000\r\n"),
    (b"Agp", b"APO00000000\r\n"),
)
AT_ZERO = CONNECT[-1]
TURN = b"AmaFFFFBA00"


@pytest.fixture
def rotator(scripted, context):
    return lambda *exchanges: ElliptecRotator(
        CONFIG, context, scripted(*CONNECT, *exchanges, role="polarizer")
    )


@pytest.mark.parametrize("options", [{}, {"ends_with_status": True}, {"pulses_told": 398}])
def test_a_busy_bus(options):
    bench = ForeignBench()
    with served(ElliptecBus(bench, **options), chunk=4) as address:
        rotator = open_polarizer(CONFIG.model_copy(update={"address": address}), Context("f", Clock()))
        assert bench.polarizer_deg() == pytest.approx(0.0, abs=0.01)
        for polarization, angle_deg in (("p", -45.0), ("p", -45.0), ("s", 0.0)):
            assert rotator.select(polarization) == pytest.approx(angle_deg, abs=0.01)
            assert bench.polarizer_deg() == pytest.approx(angle_deg, abs=0.01)
        rotator.close()


def test_another_module_than_an_ell14_is_refused():
    bus = ElliptecBus(ForeignBench(), pulses_told=262144)
    with (
        served(bus) as address,
        pytest.raises(DeviceError, match="counts 262144 pulses per turn, the rig file says 143360; correct"),
    ):
        open_polarizer(CONFIG.model_copy(update={"address": address}), Context("f", Clock()))


def test_a_position_on_the_way_is_not_where_it_stands(rotator):
    polarizer = rotator(
        AT_ZERO,
        (TURN, [b"AGS09\r\n", b"APOfffff000\r\n"]),
        (b"Agp", b"AGS09\r\n"),
        (b"Agp", b"APOffffd000\r\n"),
        (b"Agp", b"APOffffba01\r\n"),
    )
    assert polarizer.select("p") == pytest.approx(-45.0, abs=0.01)


def test_an_adapter_that_hears_itself(rotator):
    assert rotator((b"Agp", b"AgpAPO00000000\r\n")).position_deg() == 0.0


def test_where_it_stays_is_where_it_stands(rotator):
    stuck = (b"Agp", b"APOfffff000\r\n")
    with pytest.raises(MotionError, match=r"is at -10\.29 deg instead of -45"):
        rotator(AT_ZERO, (TURN, b"AGS00\r\n"), stuck, stuck).select("p")


@pytest.mark.parametrize(
    ("status", "words"),
    [(b"02", "mechanical time-out"), (b"08", "too hot"), (b"0c", "out of range"), (b"0D", "over-current")],
)
def test_a_fault_after_busy_ends_the_turn(rotator, status, words):
    with pytest.raises(MotionError, match=words):
        rotator(AT_ZERO, (TURN, b"AGS09\r\n3PO00000001\r\naGS" + status + b"\r\n")).select("p")


def test_a_module_that_is_still_moving_when_we_come_is_waited_for(scripted, context):
    busy = (b"Ain", b"AGS09\r\n")
    line = scripted(busy, busy, *CONNECT, role="polarizer")
    assert "ELL14" in ElliptecRotator(CONFIG, context, line).identify()


def test_a_module_that_stays_busy_is_an_error(scripted, context):
    line = scripted(*[(b"Ain", b"AGS09\r\n")] * 100, role="polarizer")
    with pytest.raises(MotionError, match="stays busy"):
        ElliptecRotator(CONFIG, context, line)

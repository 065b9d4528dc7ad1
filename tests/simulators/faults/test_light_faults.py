"""Faults of lamp, detectors, lock-in and monochromator, as the instruments tell of them."""

from __future__ import annotations

import math

import pytest

from gonio.rig import default_rig_text
from gonio_simulators.bench.bench import Bench
from gonio_simulators.bench.config import BenchConfig
from gonio_simulators.clock import ManualClock
from gonio_simulators.faults import FaultLog, parse_fault
from gonio_simulators.faults.injector import Injector

DIRECT_BEAM = (
    default_rig_text()
    + "\n[simulation.theta_i]\npower_on_deg = 90.0\n[simulation.theta_mes]\npower_on_deg = 180.0\n"
)
TAU_S = 0.1
INPUT, OUTPUT = 1, 4


def lit(faulty, *specs: str):
    """A bench with the direct beam on the PMT, settled."""
    f = faulty(*specs, text=DIRECT_BEAM)
    f.bench.monochromator.set_shutter(True)
    f.advance(5.0)
    return f, f.lockin()


def volts(wire) -> float:
    return float(wire.ask(b"OUTP?1\r"))


def overloads(wire) -> int:
    return int(wire.ask(b"LIAS?\r"))


def test_detector_saturated(faulty) -> None:
    f, wire = lit(faulty, "detector-saturated@pmt:at=10:hold_s=5:level_v=1.5")
    before_v = volts(wire)
    assert overloads(wire) & (INPUT | OUTPUT) == 0
    f.advance(5.0)  # t = 10
    f.advance(2.0)
    assert volts(wire) == pytest.approx(1.09, abs=1e-3)  # the output clips
    assert overloads(wire) & (INPUT | OUTPUT) == INPUT | OUTPUT
    f.advance(4.0)
    overloads(wire)
    assert overloads(wire) & (INPUT | OUTPUT) == 0
    assert volts(wire) == pytest.approx(before_v, abs=1e-4)
    assert [(i.name, i.target, i.bench_s) for i in f.injected] == [("detector-saturated", "pmt", 10.0)]


def test_only_the_detector_with_the_light_has_an_opportunity(faulty) -> None:
    f, wire = lit(faulty, "detector-change:nth=2:size=-0.5")
    before_v = volts(wire)
    volts(wire)
    f.advance(2.0)
    assert volts(wire) == pytest.approx(0.5 * before_v, abs=1e-4)
    assert [i.target for i in f.injected] == ["pmt"]


def test_lockin_overload_is_momentary(faulty) -> None:
    f, wire = lit(faulty, "lockin-overload:nth=2:size=0.05")
    before_v = volts(wire)
    x, lias = (float(v) for v in wire.ask(b"OUTP?1;LIAS?\r").split(b"\r")[:2])
    assert x == pytest.approx(before_v + 0.05, abs=1e-3)
    assert int(lias) & INPUT
    f.advance(2.0 * TAU_S)
    assert overloads(wire) & INPUT == 0
    assert volts(wire) == pytest.approx(before_v + 0.05 * 0.1353, abs=1e-3)
    f.advance(20.0 * TAU_S)
    assert volts(wire) == pytest.approx(before_v, abs=1e-4)


def test_output_overload(faulty) -> None:
    _, wire = lit(faulty, "lockin-overload:nth=1:at=output:size=0")
    assert overloads(wire) & (INPUT | OUTPUT) == OUTPUT
    assert overloads(wire) & (INPUT | OUTPUT) == 0


def test_lamp_step_and_ramp(faulty) -> None:
    f, wire = lit(faulty, "lamp-drift:at=10:size=-0.2", "lamp-drift:at=20:size=0.5:ramp_s=10")
    before_v = volts(wire) - 2e-4
    f.advance(5.0)
    f.advance(2.0)
    assert volts(wire) - 2e-4 == pytest.approx(0.8 * before_v, abs=1e-4)
    f.advance(8.0)  # t = 20
    f.advance(5.0)  # half of the ramp; the low-pass lags by its time constant
    assert volts(wire) - 2e-4 == pytest.approx(0.8 * before_v * (1.25 - 0.05 * TAU_S), abs=1e-4)
    f.advance(10.0)
    assert volts(wire) - 2e-4 == pytest.approx(1.2 * before_v, abs=1e-4)


def test_the_lock_in_integrates_over_a_step_in_between(faulty) -> None:
    f, wire = lit(faulty, "lamp-out:at=10:hold_s=0.3")
    before_v = volts(wire) - 2e-4
    f.advance(5.0)
    f.clock.advance(0.4)  # 0.3 s dark, then 0.1 s light
    after_v = volts(wire) - 2e-4
    expected_v = before_v * (math.exp(-4.0) + 1.0 - math.exp(-1.0))
    assert after_v == pytest.approx(expected_v, abs=1e-4)


def test_lamp_out(faulty) -> None:
    f, wire = lit(faulty, "lamp-out:at=10:hold_s=60")
    before_v = volts(wire)
    f.advance(5.0)
    f.advance(10.0)
    assert volts(wire) == pytest.approx(2e-4, abs=1e-4)
    f.advance(60.0)
    assert volts(wire) == pytest.approx(before_v, abs=1e-4)


def test_filter_stuck(faulty) -> None:
    f = faulty("filter-stuck:nth=1")
    wire = f.monochromator()
    f.advance(1.0)
    assert wire.ask(b"FILTER 3\n") == b"FILTER 3\n"
    f.advance(5.0)
    assert wire.ask(b"FILTER?\n") == b"FILTER?\n1\r\n"
    assert wire.ask(b"STB?\n") == b"STB?\n20\r\n"
    assert wire.ask(b"ERROR?\n") == b"ERROR?\n6\r\n"
    assert f.bench.monochromator.state_at(f.clock.now_s()).filter == 1
    wire.ask(b"FILTER 3\n")
    f.advance(5.0)
    assert wire.ask(b"FILTER?\n") == b"FILTER?\n3\r\n"
    assert wire.ask(b"ERROR?\n") == b"ERROR?\n0\r\n"
    assert wire.ask(b"FILTER 3\n") == b"FILTER 3\n"  # no change, no opportunity
    assert f.names == ["filter-stuck"]


def test_a_wheel_that_stays_stuck(faulty) -> None:
    f = faulty("filter-stuck:nth=1:hold_s=60")
    wire = f.monochromator()
    for _ in range(3):
        wire.ask(b"FILTER 2\n")
        f.advance(15.0)
        assert wire.ask(b"FILTER?\n") == b"FILTER?\n1\r\n"
    f.advance(20.0)
    wire.ask(b"FILTER 2\n")
    f.advance(5.0)
    assert wire.ask(b"FILTER?\n") == b"FILTER?\n2\r\n"
    assert f.names == ["filter-stuck"]


def test_grating_stuck(faulty) -> None:
    f = faulty("grating-stuck:nth=1")
    wire = f.monochromator()
    wire.ask(b"GRAT 2\n")
    f.advance(20.0)
    assert wire.ask(b"GRAT?\n").startswith(b"GRAT?\n1,")
    assert wire.ask(b"ERROR?\n") == b"ERROR?\n8\r\n"


@pytest.mark.parametrize(("silent", "says"), [("false", b"C"), ("true", b"O")])
def test_shutter_stuck(faulty, silent: str, says: bytes) -> None:
    f = faulty(f"shutter-stuck:nth=1:silent={silent}")
    wire = f.monochromator()
    wire.ask(b"SHUTTER O\n")
    f.advance(1.0)
    assert wire.ask(b"SHUTTER?\n") == b"SHUTTER?\n" + says + b"\r\n"
    assert not f.bench.monochromator.state_at(f.clock.now_s()).shutter_open


@pytest.mark.parametrize(("silent", "says"), [("false", b"575.000"), ("true", b"600.000")])
def test_wavelength_stuck(faulty, silent: str, says: bytes) -> None:
    f = faulty(f"wavelength-stuck:nth=1:part=0.75:silent={silent}")
    wire = f.monochromator()
    wire.ask(b"GOWAVE 600\n")
    f.advance(5.0)
    assert wire.ask(b"WAVE?\n") == b"WAVE?\n" + says + b"\r\n"
    assert f.bench.monochromator.state_at(f.clock.now_s()).wavelength_nm == 575.0
    wire.ask(b"GOWAVE 600\n")
    f.advance(5.0)
    assert wire.ask(b"WAVE?\n") == b"WAVE?\n600.000\r\n"
    assert f.bench.monochromator.state_at(f.clock.now_s()).wavelength_nm == 600.0


def test_noise_is_the_same_with_faults_that_never_strike() -> None:
    def noisy(specs: list[str]) -> list[tuple[float, ...]]:
        clock = ManualClock()
        bench = Bench(BenchConfig.from_text(DIRECT_BEAM), clock)
        Injector([parse_fault(s) for s in specs], bench, FaultLog())
        bench.monochromator.set_shutter(True)
        readings = []
        for _ in range(50):
            clock.advance(0.7)
            bench.theta_mes.move_absolute(len(readings) * 100)
            readings.append(tuple(bench.lockin.sample()))
        return readings

    everything = [f"{name}:0" for name in ("stall", "lamp-drift", "detector-change", "lockin-overload")]
    assert noisy(everything) == noisy([])


def test_nothing_is_plugged_in_without_faults() -> None:
    bench = Bench(BenchConfig.from_text(DIRECT_BEAM), ManualClock())
    injector = Injector([parse_fault("late-reply@stage:0.5")], bench, FaultLog())
    assert bench.theta_i.disturb is bench.lockin.before_look is bench.monochromator.interfere is None
    assert bench.disturbance is None
    assert injector.filter_for("lockin", "sr830", object()) is None  # type: ignore[arg-type]

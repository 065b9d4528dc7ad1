"""The composed bench: direct beam, dark, detectors, orders of the grating, drift, polarizer, a reading."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest

from gonio_simulators.bench import Bench
from gonio_simulators.bench.photometry import Lamp
from gonio_simulators.clock import BenchClock, ManualClock


def ready(
    bench: Bench, clock: ManualClock, *, wavelength_nm: float, grating: int, band: int, port: int
) -> None:
    """Home everything, open the shutter, and set the monochromator."""
    for motor in (bench.theta_i, bench.theta_mes, bench.polarizer):
        motor.home()
    mono = bench.monochromator
    mono.select_grating(grating)
    mono.select_filter(band)
    mono.set_output_port(port)
    mono.goto(wavelength_nm)
    mono.set_shutter(True)
    clock.advance(120.0)
    assert not mono.is_busy()


def turn(bench: Bench, clock: ManualClock, theta_i_deg: float, theta_mes_deg: float) -> None:
    for motor, angle in ((bench.theta_i, theta_i_deg), (bench.theta_mes, theta_mes_deg)):
        for via in (min(angle + 0.5, motor.hardware.limits_deg[1] - 0.1), angle):  # from above
            motor.move_absolute(round((via - motor.hardware.zero_deg) * motor.hardware.steps_per_deg))
            clock.advance(30.0)


def volts(bench: Bench) -> float:
    return bench.detector_signal(bench.clock.now_s()).mean_v


def at_500(bench: Bench, clock: ManualClock) -> None:
    ready(bench, clock, wavelength_nm=500.0, grating=1, band=2, port=1)


def test_r_is_what_the_ratio_of_signals_says(make_bench, no_noise) -> None:
    bench, clock = make_bench({**no_noise, "simulation.detectors.pmt": {"full_beam_v": 0.9, "dark_v": 2e-4}})
    at_500(bench, clock)
    turn(bench, clock, 90.0, 180.0)
    full = volts(bench) - 2e-4
    for theta_i_deg, theta_mes_deg in ((20.0, 39.0), (55.0, 132.0)):
        turn(bench, clock, theta_i_deg, theta_mes_deg)
        r = (volts(bench) - 2e-4) / full
        assert r == pytest.approx(bench.scattering.r(theta_i_deg, theta_mes_deg, 1.0, 500.0), rel=1e-3)
        bench.monochromator.set_shutter(False)
        clock.advance(1.0)
        assert volts(bench) == 2e-4
        bench.monochromator.set_shutter(True)
        clock.advance(1.0)


def test_mismatch_and_stray_light_change_the_sample_only(make_bench, no_noise) -> None:
    plain = {"full_beam_v": 0.9, "dark_v": 0.0}
    crooked = {**plain, "mismatch": -0.10, "stray": 0.001}
    signals = []
    for detector in (plain, crooked):
        bench, clock = make_bench({**no_noise, "simulation.detectors.pmt": detector})
        at_500(bench, clock)
        turn(bench, clock, 90.0, 180.0)
        direct = volts(bench)
        turn(bench, clock, 30.0, 80.0)
        signals.append((direct, volts(bench)))
    (direct, sample), (direct_crooked, sample_crooked) = signals
    assert direct_crooked == direct
    assert sample_crooked == pytest.approx(0.9 * sample + 0.001 * direct, rel=1e-12)


def test_the_sample_blocks_the_direct_beam_unless_edge_on(make_bench, no_noise) -> None:
    bench, clock = make_bench({**no_noise, "simulation.detectors.pmt.dark_v": 0.0})
    at_500(bench, clock)
    turn(bench, clock, 90.5, 180.0)
    assert volts(bench) > 0.5
    turn(bench, clock, 60.0, 180.0)
    assert volts(bench) == 0.0
    turn(bench, clock, 88.0, 180.0)  # what comes now is the lobe at grazing incidence, half of it cut off
    r = bench.scattering.r(88.0, 180.0, 1.0, 500.0)
    assert 0.05 < r < 0.5
    assert volts(bench) == pytest.approx(0.9 * r, rel=0.02)


@pytest.mark.parametrize(
    ("beam", "theta_mes_deg", "part"),
    [
        ((1.0, 1.0), 180.0, 1.0),
        ((0.0, 0.0), 175.0, 1.0),
        ((52.0, 36.0), 180.0, 0.25),
        ((1.0, 1.0), 150.0, 0.0),
        ((1.0, 1.0), 20.0, 0.0),
        ((10.0, 1.0), 180.0 - math.degrees(math.asin(13.0 / 95.2353)), None),
    ],
)
def test_part_of_the_direct_beam_in_the_aperture(make_bench, beam, theta_mes_deg, part) -> None:
    bench, _ = make_bench({"simulation.beam": {"width_mm": beam[0], "height_mm": beam[1]}})
    found = bench.direct_fraction(theta_mes_deg)
    if part is None:  # the aperture's edge, drawn in by its tilt, crosses just off the middle of the beam
        tilt = math.asin(13.0 / 95.2353)
        part = 0.5 - (13.0 - 13.0 * math.cos(tilt)) / 10.0
    assert found == pytest.approx(part, abs=1e-12)


def test_a_divergent_beam_outgrows_the_aperture(make_bench) -> None:
    bench, _ = make_bench({"simulation.beam": {"width_mm": 1.0, "height_mm": 1.0, "divergence_deg": 9.0}})
    assert bench.direct_fraction(180.0) == pytest.approx(1.0)
    small = {"width_mm": 4.0, "height_mm": 4.0, "distance_mm": 95.2353}
    bench, _ = make_bench({"aperture": small, "simulation.beam": {"divergence_deg": 9.0}})
    assert 0.0 < bench.direct_fraction(180.0) < 0.5


def test_polarizer_follows_malus(make_bench) -> None:
    bench, _ = make_bench()
    assert bench.s_fraction(0.0) == 1.0
    assert bench.s_fraction(90.0) == pytest.approx(0.0, abs=1e-30)
    assert bench.s_fraction(30.0) == pytest.approx(0.75)
    assert bench.s_fraction(-30.0) == pytest.approx(0.75)
    half_wave, _ = make_bench({"polarizer.s_deg": 10.0, "polarizer.p_deg": 55.0})
    assert half_wave.s_fraction(10.0) == 1.0
    assert half_wave.s_fraction(32.5) == pytest.approx(0.5)


def test_the_lamp_favours_one_polarization(make_bench, no_noise) -> None:
    bench, clock = make_bench({**no_noise, "simulation.detectors.pmt.dark_v": 0.0})
    at_500(bench, clock)
    turn(bench, clock, 90.0, 180.0)
    s = volts(bench)
    bench.polarizer.move_absolute(143360 // 4)
    clock.advance(10.0)
    assert volts(bench) / s == pytest.approx((1 - 0.1) / (1 + 0.1), rel=1e-9)


def test_the_wrong_filter_lets_the_second_order_through(make_bench, no_noise) -> None:
    bench, clock = make_bench({**no_noise, "simulation.detectors.pmt.dark_v": 0.0})
    ready(bench, clock, wavelength_nm=680.0, grating=1, band=2, port=1)
    turn(bench, clock, 90.0, 180.0)
    right = volts(bench)
    bench.monochromator.select_filter(1)
    clock.advance(10.0)
    assert volts(bench) > 1.03 * right
    bench.monochromator.select_filter(4)
    clock.advance(10.0)
    assert volts(bench) < 1e-6 * right


def test_a_grating_beyond_its_range_loses_light(make_bench, no_noise) -> None:
    bench, clock = make_bench({**no_noise, "simulation.detectors.pmt.dark_v": 0.0})
    ready(bench, clock, wavelength_nm=850.0, grating=2, band=3, port=1)
    turn(bench, clock, 90.0, 180.0)
    right = volts(bench)
    bench.monochromator.select_grating(1)
    clock.advance(10.0)
    assert volts(bench) < 0.2 * right


def test_the_ends_of_a_detector_are_weaker_but_usable(make_bench) -> None:
    bench, _ = make_bench()
    for port, low, high in ((1, 300.0, 860.0), (2, 860.0, 1500.0)):
        colour = [bench._detectors[port].colour(w) for w in np.linspace(low, high, 57).tolist()]
        assert max(colour) == pytest.approx(1.0, abs=0.01)
        assert 0.1 < colour[0] < 0.9
        assert 0.1 < colour[-1] < 0.99


def test_a_signal_settles_after_the_grating_has_turned(make_bench, no_noise) -> None:
    bench, clock = make_bench(no_noise)
    at_500(bench, clock)
    turn(bench, clock, 90.0, 180.0)
    before = volts(bench)
    bench.monochromator.goto(640.0)
    clock.advance(bench.monochromator.busy_until_s - clock.now_s())
    assert bench.monochromator.wavelength_nm == 640.0
    after = volts(bench)
    assert abs(after - before) > 0.1
    early = bench.lockin.sample().x_v
    clock.advance(0.3)
    late = bench.lockin.sample().x_v
    quantum = 1.0 / 32768
    assert late == pytest.approx(after + (early - after) * math.exp(-3.0), abs=2 * quantum)


def test_light_is_off_while_turret_wheel_or_mirror_turn(make_bench, no_noise) -> None:
    bench, clock = make_bench(no_noise)
    at_500(bench, clock)
    turn(bench, clock, 90.0, 180.0)
    dark = bench.config.simulation.detectors["pmt"].dark_v
    for command in (
        lambda: bench.monochromator.select_grating(2),
        lambda: bench.monochromator.select_filter(4),
        lambda: bench.monochromator.set_output_port(2),
    ):
        command()
        clock.advance(0.2)
        assert bench.monochromator.is_busy()
        assert volts(bench) == dark
        clock.advance(20.0)


def test_commands_wait_for_their_turn_and_abort_stops_them(make_bench) -> None:
    bench, clock = make_bench()
    mono = bench.monochromator
    mono.goto(500.0)
    clock.advance(10.0)
    mono.goto(675.0)  # one second of slewing
    mono.select_filter(3)
    clock.advance(0.5)
    assert 500.0 < mono.wavelength_nm < 675.0
    mono.abort()
    stopped = mono.wavelength_nm
    clock.advance(20.0)
    assert mono.wavelength_nm == stopped
    assert mono.filter == 1
    assert not mono.is_busy()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("goto", 5000.0),
        ("goto", math.nan),
        ("select_grating", 7),
        ("select_filter", 0),
        ("set_output_port", 3),
        ("set_slit", 0.0),
    ],
)
def test_the_monochromator_refuses_what_it_does_not_have(make_bench, name: str, value: float) -> None:
    bench, _ = make_bench()
    before = bench.monochromator.state_at(0.0)
    with pytest.raises(ValueError, match=r"wavelength|fitted|slit"):
        getattr(bench.monochromator, name)(value)
    assert bench.monochromator.state_at(0.0) == before


def test_drift_has_the_stated_rate_and_is_smooth() -> None:
    rates = []
    for seed in range(200):
        lamp = Lamp(0.004, np.random.default_rng(seed))
        assert lamp.power(0.0) == pytest.approx(1.0, abs=1e-15)
        rates += [lamp.power(t + 36.0) - lamp.power(t) for t in np.arange(0.0, 72_000.0, 7_200.0).tolist()]
    assert statistics.pstdev(rates) == pytest.approx(0.004 / 100.0, rel=0.05)
    lamp = Lamp(0.004, np.random.default_rng(1))
    bends = [lamp.power(t + 2) - 2 * lamp.power(t + 1) + lamp.power(t) for t in range(0, 30_000, 500)]
    assert max(map(abs, bends)) < 1e-8


def test_noise_of_a_reading(make_bench) -> None:
    # 100 % beam at the best wavelength: flicker and shot noise of 5e-4 each in 1 s, the floor is small
    bench, clock = make_bench({"simulation.noise.lamp_drift_per_hour": 0.0})
    at_500(bench, clock)
    turn(bench, clock, 90.0, 180.0)
    light = (volts(bench) - 2e-4) / 0.9
    readings = []
    for _ in range(4000):
        clock.advance(1.0)
        readings.append(bench.lockin.sample().x_v)
    sigma = 0.9 * math.hypot(5e-4 * light, 5e-4 * math.sqrt(light), 2e-5) * math.sqrt(1.0 / (2.0 * 0.1))
    assert statistics.stdev(readings) == pytest.approx(sigma, rel=5.0 / math.sqrt(8000.0))


def test_same_seed_same_readings(make_bench) -> None:
    def readings(seed: int) -> list[float]:
        bench, clock = make_bench({"simulation.seed": seed})
        at_500(bench, clock)
        turn(bench, clock, 30.0, 60.0)
        result = []
        for _ in range(5):
            clock.advance(0.3)
            result.append(bench.lockin.sample().x_v)
        return result

    assert readings(4) == readings(4)
    assert readings(4) != readings(5)


def test_the_clock_runs_at_its_speed(monkeypatch) -> None:
    now = [100.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    clock = BenchClock(1000.0)
    now[0] += 0.25
    assert clock.now_s() == pytest.approx(250.0)

"""The low-pass and its noise against closed forms and an independent integration."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from gonio_simulators.bench.lockin import DetectorSignal, Lockin
from gonio_simulators.clock import ManualClock


def quiet(volts: float) -> DetectorSignal:
    return DetectorSignal(volts, 0.0, 0.0)


def make(
    signal_at: Callable[[float], DetectorSignal],
    changes: list[tuple[float, float]] | None = None,
    *,
    time_constant_s: float = 0.1,
    seed: int = 1,
) -> tuple[Lockin, ManualClock]:
    clock = ManualClock()

    def moving(start_s: float, end_s: float) -> list[tuple[float, float]]:
        return [c for c in changes or [] if c[1] > start_s and c[0] < end_s]

    lockin = Lockin(signal_at, moving, clock, np.random.default_rng(seed), time_constant_s)
    lockin.sensitivity_v = 1.0
    return lockin, clock


QUANTUM = 1.0 / 32768


@pytest.mark.parametrize("time_constant_s", [0.03, 0.1, 3.0])
def test_step_response(time_constant_s: float) -> None:
    lockin, clock = make(
        lambda t: quiet(0.8 if t >= 1.0 else 0.1), [(1.0, 1.0)], time_constant_s=time_constant_s
    )
    clock.advance(1.0)
    for part in (0.3, 0.7, 1.5, 5.0):
        clock.advance(1.0 + part * time_constant_s - clock.now_s())
        expected = 0.8 - 0.7 * math.exp(-part)
        assert lockin.sample().x_v == pytest.approx(expected, abs=0.51 * QUANTUM)


def test_a_step_seen_only_afterwards_is_followed_as_exactly() -> None:
    lockin, clock = make(lambda t: quiet(0.8 if t >= 1.0 else 0.1), [(1.0, 1.0)])
    clock.advance(1.25)
    assert lockin.sample().x_v == pytest.approx(0.8 - 0.7 * math.exp(-2.5), abs=0.51 * QUANTUM)


def test_a_moving_signal_is_followed_as_a_differential_equation_says() -> None:
    def volts(t: float) -> float:
        return 0.5 + 0.4 * math.sin(5.0 * t) if 0.2 <= t < 1.4 else (0.5 if t < 0.2 else 0.1)

    lockin, clock = make(lambda t: quiet(volts(t)), [(0.2, 1.4)])
    clock.advance(1.5)
    reading = lockin.sample().x_v
    step, value = 1e-5, 0.5
    for k in range(150_000):
        value += step / 0.1 * (volts((k + 0.5) * step) - value)
    assert reading == pytest.approx(value, abs=2e-3)  # half time constants, straight in between


def noise_of(
    lockin: Lockin, clock: ManualClock, spacing_s: float, count: int
) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.empty(count), np.empty(count)
    for i in range(count):
        clock.advance(spacing_s)
        reading = lockin.sample()
        x[i], y[i] = reading.x_v, reading.y_v
    return x, y


@pytest.mark.parametrize("time_constant_s", [0.1, 1.0])
def test_noise_has_the_variance_of_the_equivalent_noise_bandwidth(time_constant_s: float) -> None:
    in_phase, quadrature = 3e-3, 1e-3
    lockin, clock = make(
        lambda t: DetectorSignal(0.2, in_phase, quadrature), time_constant_s=time_constant_s, seed=5
    )
    count = 20_000
    x, y = noise_of(lockin, clock, 10.0 * time_constant_s, count)
    bandwidth = (1.0 / (4.0 * time_constant_s)) / 0.5  # relative to that of a 1 s average
    tolerance = 5.0 / math.sqrt(2.0 * count)  # five standard errors of a standard deviation
    assert np.std(x) == pytest.approx(in_phase * math.sqrt(bandwidth), rel=tolerance)
    assert np.std(y) == pytest.approx(quadrature * math.sqrt(bandwidth), rel=tolerance)
    assert abs(np.mean(x) - 0.2) < 5.0 * np.std(x) / math.sqrt(count)


def test_readings_closer_than_a_time_constant_are_correlated() -> None:
    lockin, clock = make(lambda t: DetectorSignal(0.0, 3e-3, 3e-3), seed=6)
    x, y = noise_of(lockin, clock, 0.05, 20_000)
    for series in (x, y):
        correlation = np.corrcoef(series[1:], series[:-1])[0, 1]
        assert correlation == pytest.approx(math.exp(-0.5), abs=0.03)
    assert abs(np.corrcoef(x, y)[0, 1]) < 0.05


def test_noise_does_not_depend_on_how_often_one_looks() -> None:
    lockin, clock = make(lambda t: DetectorSignal(0.0, 3e-3, 3e-3), seed=7)
    seldom = np.std(noise_of(lockin, clock, 1.0, 8_000)[0])
    often = np.std(noise_of(lockin, clock, 0.02, 80_000)[0][::50])
    assert often == pytest.approx(seldom, rel=0.1)


def test_phase_turns_the_signal_between_the_outputs() -> None:
    lockin, clock = make(lambda t: quiet(0.6))
    clock.advance(10.0)
    lockin.phase_deg = 30.0
    reading = lockin.sample()
    assert reading.x_v == pytest.approx(0.6 * math.cos(math.radians(30.0)), abs=QUANTUM)
    assert math.hypot(reading.x_v, reading.y_v) == pytest.approx(0.6, abs=2 * QUANTUM)


def test_overloads_are_flagged_and_the_output_stays_at_its_stop() -> None:
    level = [0.108]
    lockin, clock = make(lambda t: quiet(level[0]))
    lockin.sensitivity_v = 0.1
    clock.advance(10.0)
    reading = lockin.sample()
    assert not reading.output_overload
    assert reading.x_v == pytest.approx(0.108, abs=0.1 * QUANTUM)
    level[0] = 0.3
    clock.advance(10.0)
    reading = lockin.sample()
    assert reading.output_overload
    assert not reading.input_overload
    assert reading.x_v == pytest.approx(0.109, abs=0.1 * QUANTUM)
    level[0] = 1.3
    clock.advance(10.0)
    assert lockin.sample().input_overload


def test_outputs_are_quantised_to_the_range() -> None:
    lockin, clock = make(lambda t: quiet(1.234567e-3))
    lockin.sensitivity_v = 5e-3
    clock.advance(10.0)
    steps = lockin.sample().x_v / (5e-3 / 32768)
    assert steps == pytest.approx(round(steps), abs=1e-6)
    assert lockin.sample().x_v == pytest.approx(1.234567e-3, abs=0.51 * 5e-3 / 32768)


def test_a_change_of_time_constant_starts_from_what_was_there() -> None:
    level = [0.0]
    lockin, clock = make(lambda t: quiet(level[0]), time_constant_s=1.0)
    clock.advance(50.0)
    lockin.sample()
    level[0] = 0.5
    clock.advance(1.0)
    lockin.time_constant_s = 0.1
    assert lockin.sample().x_v == pytest.approx(0.5 * (1.0 - math.exp(-1.0)), abs=QUANTUM)
    clock.advance(0.1)
    assert lockin.sample().x_v == pytest.approx(0.5 * (1.0 - math.exp(-2.0)), abs=QUANTUM)

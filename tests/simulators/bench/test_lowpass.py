"""Steeper slopes: step responses in closed form, and noise bandwidths as the instrument's manual has them."""

import math

import numpy as np
import pytest

from gonio_simulators.bench.lockin import DetectorSignal
from gonio_simulators.bench.lowpass import decay, kick, response
from tests.simulators.bench.test_lockin import QUANTUM, make

ORDERS = (1, 2, 3, 4)


@pytest.mark.parametrize("order", ORDERS)
def test_step_response(order: int) -> None:
    lockin, clock = make(lambda t: DetectorSignal(0.8 if t >= 1.0 else 0.1, 0.0, 0.0), [(1.0, 1.0)])
    lockin.order = order
    for part in (0.3, 0.7, 1.5, 5.0, 12.0):
        clock.advance(1.0 + 0.1 * part - clock.now_s())
        left = math.exp(-part) * sum(part**k / math.factorial(k) for k in range(order))
        assert lockin.sample().x_v == pytest.approx(0.8 - 0.7 * left, abs=0.51 * QUANTUM)


@pytest.mark.parametrize("order", ORDERS)
def test_two_steps_of_time_are_as_good_as_one(order: int) -> None:
    early, late, whole = kick(order, 0.3), kick(order, 0.7), kick(order, 1.0)
    forgotten = decay(order, 0.7) @ early
    assert forgotten @ forgotten.T + late @ late.T == pytest.approx(whole @ whole.T, abs=1e-14)
    stages = np.stack([np.linspace(0.4, 0.9, order), np.linspace(-1.0, 2.0, order)])
    inputs = np.array([[1.0, 1.6, 3.0], [0.5, 0.5, 0.5]])
    half = response(stages, 0.3, 2.0, inputs[:, :2])
    whole_way = response(stages, 1.0, 2.0, inputs[:, ::2])
    assert response(half, 0.7, 2.0, inputs[:, 1:]) == pytest.approx(whole_way, abs=1e-14)


def test_a_short_time_leaves_every_stage_its_small_noise() -> None:
    noise = kick(4, 1e-6)
    assert np.diag(noise @ noise.T) == pytest.approx([1e-6, 1e-18 / 3, 1e-30 / 20, 1e-42 / 252], rel=1e-4)
    assert np.all(kick(4, 0.0) == 0.0)


@pytest.mark.parametrize(("order", "bandwidth_tau"), [(1, 1 / 4), (2, 1 / 8), (3, 3 / 32), (4, 5 / 64)])
def test_noise_bandwidth(order: int, bandwidth_tau: float) -> None:
    """Equivalent noise bandwidths 1/(4 tau), 1/(8 tau), 3/(32 tau), 5/(64 tau)."""
    sigma_1 = 1e-2
    lockin, clock = make(lambda t: DetectorSignal(0.0, sigma_1, 0.5 * sigma_1), time_constant_s=0.1)
    lockin.order = order
    lockin.sensitivity_v = 0.1
    seen = []
    for _ in range(4000):
        clock.advance(1.0)
        lockin.advance()
        seen.append(lockin.demodulated())
    expected = sigma_1 * math.sqrt(2.0 * bandwidth_tau / 0.1)
    x_sd, y_sd = np.std(seen, axis=0)
    assert x_sd == pytest.approx(expected, rel=0.05)
    assert y_sd == pytest.approx(0.5 * expected, rel=0.05)


def test_a_change_of_slope_keeps_the_reading() -> None:
    lockin, clock = make(lambda t: DetectorSignal(0.5, 0.0, 0.0))
    for order in (3, 1, 4, 2):
        lockin.order = order
        assert lockin.sample().x_v == 0.5
        clock.advance(0.02)
        assert lockin.sample().x_v == 0.5


def test_a_recorder_sees_each_of_its_instants() -> None:
    lockin, clock = make(lambda t: DetectorSignal(0.8 if t >= 1.0 else 0.1, 0.0, 0.0), [(1.0, 1.0)])

    class Every:
        next_s = 0.25
        seen: list[tuple[float, float]]

        def __init__(self) -> None:
            self.seen = []

        def take(self) -> None:
            self.seen.append((self.next_s, lockin.demodulated()[0]))
            self.next_s += 0.25

    lockin.recorder = recorder = Every()
    clock.advance(1.5)
    lockin.advance()
    assert [t for t, _ in recorder.seen] == [0.25, 0.5, 0.75, 1.0, 1.25, 1.5]
    assert [v for _, v in recorder.seen] == pytest.approx(
        [0.1] * 4 + [0.8 - 0.7 * math.exp(-2.5), 0.8 - 0.7 * math.exp(-5.0)]
    )

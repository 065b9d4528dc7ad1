"""Instrument time runs as fast as it is told."""

from __future__ import annotations

import time

from gonio.clock import Clock


def test_a_fast_clock_counts_and_sleeps_in_instrument_seconds() -> None:
    clock = Clock(speed=1000.0)
    start_real, start = time.monotonic(), clock.now_s()
    clock.sleep(5.0)
    real, passed = time.monotonic() - start_real, clock.now_s() - start
    assert passed >= 5.0
    assert abs(passed - 1000 * real) < 0.2 * passed
    clock.sleep(-1.0)  # nothing to wait for

"""The range memory: every signal ends in a range that neither overloads nor limits the resolution."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio_drivers.ranges import TOO_INSENSITIVE, RangeMemory
from gonio_drivers.sr830 import FULL_SCALE_V

LOWEST = FULL_SCALE_V.index(min(FULL_SCALE_V, key=lambda v: abs(v - 1e-3)))


def memory() -> RangeMemory:
    return RangeMemory(FULL_SCALE_V, smallest_v=1e-3)


@given(st.floats(0, 0.99), st.integers(LOWEST, 26))
def test_from_any_range_a_steady_signal_finds_its_range_and_stays(signal_v: float, index: int):
    ranges = memory()
    for _ in range(6):
        overload = signal_v > 1.09 * FULL_SCALE_V[index]
        better = ranges.better(index, min(signal_v, 1.09 * FULL_SCALE_V[index]), overload=overload)
        if better == index:
            break
        index = better
    else:
        pytest.fail("did not settle")
    assert signal_v <= 1.09 * FULL_SCALE_V[index]
    assert index == LOWEST or signal_v >= FULL_SCALE_V[index] / TOO_INSENSITIVE


def test_no_finer_than_the_smallest_range():
    assert memory().better(26, 0.0, overload=False) == LOWEST


def test_overload_in_the_largest_range_has_no_better():
    assert memory().better(26, 1.09, overload=True) == 26


def test_each_beam_and_detector_has_its_own():
    ranges = memory()
    ranges.remember("sample", 0, 20)
    assert ranges.start("sample", 0) == 20
    assert ranges.start("sample", 1) == ranges.start("direct", 0) == 26

"""A short, seeded run of `benchmarks/fuzz.py`: every parser gets damaged input and none misbehaves."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator

import pytest
from fuzzing.checked_lines import ModbusRtuReplies
from fuzzing.outcome import Target, Verdict
from fuzzing.run import run
from fuzzing.targets import SHARES
from fuzzing.text_lines import ElliptecReplies
from pymodbus.framer import FramerRTU

from gonio_drivers import elliptec

INPUTS_PER_SHARE = 150


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """pymodbus logs each damaged frame, and pytest keeps what is logged."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.parametrize("target", SHARES, ids=lambda target: target.name)
def test_damaged_input_is_refused_or_true(target: type[Target]) -> None:
    tally = run(target, max(40, round(SHARES[target] * INPUTS_PER_SHARE)), seed=1)
    assert tally.examples == []
    assert tally.defects == 0
    assert tally.verdicts[Verdict.RIGHT] > 0.05 * tally.inputs, "hardly anything true came through"
    assert tally.most_reads < 100


def test_a_parser_that_takes_anything_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The harness itself: without a check that it has made necessary, it reports it missing."""
    monkeypatch.setattr(elliptec, "_FARTHEST_DEG", math.inf)
    tally = run(ElliptecReplies, 2000, seed=1)
    assert tally.verdicts[Verdict.ABSURD] > 0


def test_a_broken_checksum_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FramerRTU, "check_CRC", classmethod(lambda cls, data, check: True))
    tally = run(ModbusRtuReplies, 2000, seed=1)
    assert tally.verdicts[Verdict.CORRUPT] > 0

"""When faults strike, that runs repeat, and that the log says what happened."""

from __future__ import annotations

import itertools
import random

import pytest

from gonio.errors import ConfigError
from gonio_simulators.faults import FaultLog, read_fault_log
from gonio_simulators.faults.schedule import Trigger
from gonio_simulators.faults.spec import When


def trigger(mode, value: float, seed: int = 1) -> Trigger:
    return Trigger(When(mode, value), random.Random(seed))


def taken(t: Trigger, count: int, now_s: float = 0.0) -> list[int]:
    return [i for i in range(1, count + 1) if t.at_opportunity(now_s)]


def test_by_count() -> None:
    assert taken(trigger("nth", 3), 20) == [3]
    assert taken(trigger("every", 4), 13) == [4, 8, 12]


def test_by_chance() -> None:
    hits = len(taken(trigger("probability", 0.1), 10_000))
    assert abs(hits - 1000) < 5 * 30  # five standard deviations
    assert taken(trigger("probability", 0.1), 500) == taken(trigger("probability", 0.1), 500)
    assert taken(trigger("probability", 0.1), 500) != taken(trigger("probability", 0.1, seed=2), 500)
    assert taken(trigger("probability", 0.0), 100) == []
    assert taken(trigger("probability", 1.0), 3) == [1, 2, 3]


def test_by_time() -> None:
    t = trigger("at", 5.0)
    assert [t.at_opportunity(now_s) for now_s in (0.0, 4.9, 5.0, 6.0)] == [False, False, True, False]
    t = trigger("rate", 60.0)
    times = []
    now_s = 0.0
    while now_s < 3600.0 * 50:
        now_s += 1.0
        if t.take_due(now_s):
            times.append(now_s)
    assert abs(len(times) - 3000) < 5 * 55
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert sum(g > 60.0 for g in gaps) / len(gaps) == pytest.approx(0.37, abs=0.05)  # exponential: 1/e
    assert not trigger("rate", 0.0).take_due(1e12)


def test_the_log_is_read_back(tmp_path) -> None:
    path = tmp_path / "faults.log"
    log = FaultLog(path)
    log.record(1.25, "stall", "theta_i", "silent=False\tat\nhome")
    assert len(read_fault_log(path)) == 1  # it is there before the log is closed
    log.close()
    log.close()
    again = FaultLog(path)
    again.record(0.5, "hang", "stage", "")
    assert again.counts == {"hang": 1}
    assert again.summary() == "fault hang injected 1 x"
    again.close()
    first, second = read_fault_log(path)
    assert (first.bench_s, first.name, first.target, first.details) == (
        1.25,
        "stall",
        "theta_i",
        "silent=False at home",
    )
    assert (second.name, second.details) == ("hang", "")
    assert first.real_time <= second.real_time
    with path.open("a", encoding="utf-8") as file:
        file.write("3.0\t2026-01-01T00:0")  # a kill in mid-line
    assert len(read_fault_log(path)) == 2


def test_a_foreign_or_unwritable_log_is_one_message(tmp_path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("dear diary\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="line 1 is no line of a fault log"):
        read_fault_log(path)
    with pytest.raises(ConfigError, match="cannot be written"):
        FaultLog(tmp_path / "no" / "faults.log")


def test_no_log_counts_all_the_same() -> None:
    log = FaultLog()
    log.record(0.0, "hang", "stage", "")
    log.record(0.0, "hang", "lockin", "")
    assert log.summary() == "fault hang injected 2 x"

"""A bench on a clock that the test turns, with any part of the built-in rig file replaced."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from typing import Any

import pytest

from gonio.rig import default_rig_text
from gonio_simulators.bench import Bench, BenchConfig
from gonio_simulators.clock import ManualClock

Tables = dict[str, Any]


def merged(tables: Mapping[str, Any], changes: Mapping[str, Any]) -> Tables:
    """Return `tables` with the dotted keys of `changes` replaced; a value of None removes the key."""
    result: Tables = {k: merged(v, {}) if isinstance(v, dict) else v for k, v in tables.items()}
    for dotted, value in changes.items():
        *path, last = dotted.split(".")
        table = result
        for part in path:
            table = table.setdefault(part, {})
        if value is None:
            table.pop(last, None)
        else:
            table[last] = value
    return result


@pytest.fixture
def make_tables() -> Callable[..., Tables]:
    def make(changes: Mapping[str, Any] | None = None) -> Tables:
        return merged(tomllib.loads(default_rig_text()), changes or {})

    return make


@pytest.fixture
def make_config(make_tables: Callable[..., Tables]) -> Callable[..., BenchConfig]:
    def make(changes: Mapping[str, Any] | None = None) -> BenchConfig:
        return BenchConfig.from_tables(make_tables(changes))

    return make


@pytest.fixture
def make_bench(make_config: Callable[..., BenchConfig]) -> Callable[..., tuple[Bench, ManualClock]]:
    def make(changes: Mapping[str, Any] | None = None) -> tuple[Bench, ManualClock]:
        clock = ManualClock()
        return Bench.from_config(make_config(changes), clock), clock

    return make


NO_NOISE = {f"simulation.noise.{k}": 0.0 for k in ("lamp_drift_per_hour", "flicker", "shot_at_full", "floor")}


@pytest.fixture
def no_noise() -> dict[str, float]:
    return dict(NO_NOISE)

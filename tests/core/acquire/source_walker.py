"""A source of positions that goes where the readings send it, and scans of it on the bench in memory."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest

import gonio
from gonio.acquire import FaultPolicy, Runner, Snapshot
from gonio.errors import ScanStopped
from gonio.plan import Position, parse_plan
from gonio.plan.source import Measured

PLAN = parse_plan("""
title = "Chosen on the way"
[[wavelengths]]
values_nm = [500.0, 900.0]
[source]
name = "python"
[references]
every_positions = 3
averages = 2
""")
ABORT = FaultPolicy(retries=0, then="abort")


@dataclass
class Walker:
    """Goes where the last readings send it, so that a wrong or missing one sends it elsewhere."""

    count: int = 8
    max_positions: int = 12
    salt: int = 0
    shown: list[Sequence[Measured]] = field(default_factory=list, repr=False)

    name = "walker"

    def next(self, measured: Sequence[Measured]) -> Position | None:
        self.shown.append(measured)
        index = len(measured)
        if index == self.count:
            return None
        code = sum(round(1e5 * float(np.nan_to_num(found.r[0]))) for found in measured) + self.salt
        return Position(index, 10.0 * (1 + code % 4), 30.0 + (7 * code + 13 * index) % 90, "sp"[code % 2])  # type: ignore[arg-type]


SHORT = functools.partial(Walker, 5)


def whole(memory: ModuleType, path: Path, source: Any = None, **world: Any) -> gonio.Scan:
    Runner(memory.rig(memory.World(**world)), PLAN, path, source=source or Walker()).run()
    return gonio.load(path)


def stopped(memory: ModuleType, path: Path, done: int, source: Any = None, **world: Any) -> None:
    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == done:
            runner.stop()

    rig = memory.rig(memory.World(**world))
    runner = Runner(rig, PLAN, path, source=source or Walker(), on_snapshot=on_snapshot)
    with pytest.raises(ScanStopped):
        runner.run()


def asked_for(scan: gonio.Scan) -> list[tuple[float, float, str]]:
    return list(
        zip(
            np.round(scan.theta_i_deg - 0.002, 6).tolist(),
            np.round(scan.theta_mes_deg + 0.003, 6).tolist(),
            scan.polarization.tolist(),
            strict=True,
        )
    )


def events(path: Path) -> list[str]:
    with h5py.File(path) as file:
        return list(file["entry/events/message"].asstr()[...])


def same_bits(a: Measured, b: Measured) -> bool:
    return a.position == b.position and all(
        getattr(a, name).tobytes() == getattr(b, name).tobytes()
        for name in ("wavelength_nm", "r", "r_sd", "quality")
    )

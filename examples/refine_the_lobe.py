"""Let the readings say where to look closer: every nine degrees first, then every three where r is steep.

    python refine_the_lobe.py rig.toml sample

One scan, one file.  `Refine` is a source of positions: a function of what was measured, asked for the next
position after each one.  It can be interrupted like any scan; started again with the same names it goes on.
Without a rig file (give "-") the simulated ARTA is measured.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import gonio
from gonio.acquire import FaultPolicy, Runner, resume_scan
from gonio.bench_process import served
from gonio.errors import GonioError
from gonio.plan import Position, parse_plan
from gonio.plan.source import Measured

PLAN = """
title = "A lobe, closer where it is steep"
polarization = ["s"]
[[wavelengths]]
values_nm = [550.0]
[source]
name = "python"
[references]
every_positions = 20
"""


@dataclass(frozen=True)
class Refine:
    """Nine degrees apart, then three between neighbours that differ by more than `steep` of the maximum."""

    theta_i_deg: float = 45.0
    start_deg: float = 18.0
    stop_deg: float = 126.0
    steep: float = 0.05
    version: str = "1"

    @property
    def max_positions(self) -> int:
        """As many as there are if r is steep everywhere."""
        return len(self._coarse_deg()) * 3 - 2

    def next(self, measured: Sequence[Measured]) -> Position | None:
        """Return the next position; the same whenever it is asked with the same readings."""
        coarse_deg = self._coarse_deg()
        angles_deg = coarse_deg
        if len(measured) >= len(coarse_deg):
            angles_deg = [*coarse_deg, *self._between(measured[: len(coarse_deg)])]
        if len(measured) == len(angles_deg):
            return None
        return Position(len(measured), self.theta_i_deg, angles_deg[len(measured)], "s")

    def _coarse_deg(self) -> list[float]:
        return np.arange(self.start_deg, self.stop_deg + 1e-9, 9.0).tolist()

    def _between(self, coarse: Sequence[Measured]) -> list[float]:
        r = np.array([found.r[0] for found in coarse])  # NaN where a position had to be skipped: never steep
        limit = self.steep * np.nanmax(r)
        return [
            coarse[i].position.theta_mes_deg + step_deg
            for i in np.flatnonzero(np.abs(np.diff(r)) > limit).tolist()
            for step_deg in (3.0, 6.0)
        ]


def main(rig_file: str, sample: str) -> int:
    """Measure, or go on with what was begun; return 1 with a message if something stands in the way."""
    config = gonio.load_rig(None if rig_file == "-" else Path(rig_file))
    policy, path = FaultPolicy(retries=3, then="skip"), Path(f"{sample}.h5")
    try:
        with served(config) as rig, gonio.open_rig(rig) as connected:
            if path.with_name(path.name + ".journal").exists():
                runner = resume_scan(path, connected, source=Refine(), policy=policy)
            else:
                runner = Runner(connected, parse_plan(PLAN), path, source=Refine(), policy=policy)
            scan = gonio.load(runner.run())
    except GonioError as error:
        print(error, file=sys.stderr)
        return 1
    order = np.argsort(scan.theta_mes_deg)
    for row in order.tolist():
        print(f"{scan.theta_mes_deg[row]:8.2f} deg  r = {scan.r[row, 0]:.5f}")
    print(f"{len(order)} positions of at most {Refine().max_positions}")
    return 0


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))

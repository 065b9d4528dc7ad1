"""The dry run's estimate against the simulated scan: plans, clocks, difference.

For each plan and clock: the bench is started, latencies are measured on it (as ``gonio plan --measure``
does), the scan is estimated, run over the wire, and its duration is taken from the finished file.  The axes
are sent to the baseline position first, since the estimate does not know where they stand.

    python benchmarks/estimate.py [--clocks 10,100,1000,4000] [--longest 120]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

from gonio.acquire import Runner
from gonio.acquire.latencies import measured_latency
from gonio.bench_process import served
from gonio.plan import Plan, parse_plan, resolved, timetable
from gonio.rig import default_rig_text, open_rig, parse_rig

_SHORT = """
title = "{title}"
polarization = ["s", "p"]
{top}
[[wavelengths]]
values_nm = {wavelengths}
{per_range}
[[sweeps]]
theta_i_deg = 30.0
theta_mes_deg = {theta_mes}
[[sweeps]]
theta_i_deg = 55.0
theta_mes_deg = {theta_mes}
[references]
averages = 2
{references}
{more}
"""


def _plan(title: str, wavelengths: str, theta_mes: str, **parts: str) -> Plan:
    blank = {"top": "", "per_range": "", "references": "", "more": ""}
    return parse_plan(
        _SHORT.format(title=title, wavelengths=wavelengths, theta_mes=theta_mes, **{**blank, **parts})
    )


_FEW = "[450.0, 550.0, 650.0, 840.0, 860.0, 870.0]"
_ANGLES = "{ start = 15.0, stop = 105.0, step = 15.0 }"

PLANS: dict[str, Plan] = {
    "tiny": _plan("tiny", "[550.0, 600.0]", "[40.0, 60.0]"),
    "few wavelengths": _plan("few wavelengths", _FEW, _ANGLES),
    "averages 5": _plan("averages 5", _FEW, _ANGLES, per_range="averages = 5"),
    "random order": _plan("random order", _FEW, _ANGLES, more='[order]\nkind = "random"\nseed = 3'),
    "overlap and baselines": _plan(
        "overlap and baselines", _FEW, _ANGLES, top="overlap_nm = 20.0", references="every_positions = 6"
    ),
    "optimised": _plan("optimised", _FEW, _ANGLES, more='[order]\nkind = "optimised"'),
    "the paper's": Plan.paper(),
}


def duration_s(path: Path) -> float:
    """Return the instrument time of the last reading of a finished scan, seconds since it began."""
    with h5py.File(path, "r") as file:
        return float(
            max(np.nanmax(file["entry/data/reading_time"]), np.nanmax(file["entry/references/time"]))
        )


def main() -> None:
    """Run the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--clocks", default="10,100,1000,4000", help="bench seconds per real second")
    parser.add_argument("--longest", type=float, default=120.0, help="real seconds for one scan, at most")
    parser.add_argument("--plans", default=",".join(PLANS), help="which of the plans")
    options = parser.parse_args()
    head = (
        f"{'plan':<22}{'clock':>7}{'readings':>10}{'bench time':>12}{'wire, real':>12}"
        f"{'estimate':>12}{'measured':>12}{'difference':>12}{'ranges':>8}"
    )
    print(head, "-" * len(head), sep="\n")
    for clock in (float(text) for text in options.clocks.split(",")):
        for name in options.plans.split(","):
            row(name, PLANS[name], clock, options.longest)


def row(name: str, plan: Plan, clock: float, longest_s: float) -> None:
    """Measure one line of the table; left out if the bench time alone would take too long."""
    rig = parse_rig(default_rig_text().replace("clock_speed = 4000.0", f"clock_speed = {clock:g}"))
    if timetable(resolved(plan, rig), rig).instrument_s / clock > longest_s:
        return
    with tempfile.TemporaryDirectory() as folder, served(rig) as reachable, open_rig(reachable) as connected:
        latency = measured_latency(connected, plan, Path(folder))
        measured_rig = rig.model_copy(update={"latency": latency})
        table = timetable(resolved(plan, measured_rig), measured_rig)
        connected.move_to(rig.baseline.theta_i_deg, rig.baseline.theta_mes_deg)
        connected.polarizer.select(plan.polarization[-1])
        path = Path(folder) / "scan.h5"
        began_s = time.perf_counter()
        Runner(connected, plan, path).run()
        real_s = time.perf_counter() - began_s
        measured_s = duration_s(path)
        with h5py.File(path, "r") as file:
            quality = file["entry/data/quality"][...]
            ranges = float(np.count_nonzero(quality & 16)) / len(quality)
            readings = quality.size
    print(
        f"{name:<22}{clock:>7g}{readings:>10}{table.instrument_s:>10.1f} s{table.real_s:>10.2f} s"
        f"{table.total_s:>10.1f} s{measured_s:>10.1f} s{100 * (table.total_s / measured_s - 1):>10.1f} %"
        f"{ranges:>8.1f}   ({real_s:.1f} s)",
        flush=True,
    )


if __name__ == "__main__":
    main()

"""How much longer does a scan take than its physics: motion, settling and integration, one after the other?

A small plan on the simulated bench over its sockets, at clocks on which the wire does not dominate.  The sum
is that of the rig's own model (`gonio.plan.timetable` without latencies): trapezoidal moves of both axes at
once with the approach against backlash, turns of the polarizer, drives of the monochromator, settling and
averaging of the lock-in.  None of these can overlap with another: the amplifier settles on the light that the
last of them lets through.  The scan is measured on the bench's clock from `run()` to the finished file;
checks, storing and flushing are in it.

Run: python benchmarks/duration.py [--speeds 50 20 5] [--positions 6]      (--speeds 1 takes ten minutes)
Exit code 1 if the ratio at the slowest clock exceeds 1.05.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gonio.acquire import Runner
from gonio.bench_process import served
from gonio.plan import Plan, channels, parse_plan, timetable
from gonio.rig import Rig, RigConfig, default_rig_text, open_rig, parse_rig

MOST = 1.05
PLAN = """
title = "duration"
[[wavelengths]]
start_nm = 500.0
stop_nm = 1100.0
step_nm = 100.0
[[sweeps]]
theta_i_deg = 30.0
theta_mes_deg = {{ start = 45.0, stop = {stop:.1f}, step = 5.0 }}
[reading]
averages = 2
[references]
averages = 2
"""


def parts_of(plan: Plan, rig: RigConfig) -> dict[str, float]:
    """Return what the model says, instrument seconds: passes over the wavelengths, and all motion."""
    table = timetable(plan, rig)
    columns = channels(plan, rig)
    lockin: Any = rig.spectrometer.lockin  # type: ignore[attr-defined]
    steps = len(table.steps)
    settling_s = lockin.settle_s() * len(columns) * steps
    spacing_s = lockin.spacing_s() * len(columns) * steps  # averages = 2 everywhere
    return {"settling": settling_s, "integration": spacing_s, "all": table.instrument_s}


def timed(rig: Rig) -> dict[str, float]:
    """Note the bench's seconds that the runner spends waiting for each device."""
    spent: dict[str, float] = defaultdict(float)

    def wrap(owner: Any, name: str, part: str) -> None:
        original: Callable[..., Any] = getattr(owner, name)

        def measured(*args: Any, **kwargs: Any) -> Any:
            began_s = rig.clock.now_s()
            try:
                return original(*args, **kwargs)
            finally:
                spent[part] += rig.clock.now_s() - began_s

        setattr(owner, name, measured)

    wrap(rig, "begin_move", "stage")
    wrap(rig, "finish_move", "stage")
    wrap(rig.polarizer, "select", "polarizer")
    wrap(rig.spectrometer, "measure_spectrum", "spectrometer")
    wrap(rig, "verify_still", "looking back")
    return spent


def measure(speed: float, plan: Plan, folder: Path) -> float:
    """Scan once and print; return the ratio."""
    text = re.sub(r"clock_speed = [\d.]+", f"clock_speed = {speed}", default_rig_text())
    config = parse_rig(text)
    with served(config) as reachable, open_rig(reachable) as rig:
        rig.move_to(config.baseline.theta_i_deg, config.baseline.theta_mes_deg)
        spent = timed(rig)
        began_s, began_real_s = rig.clock.now_s(), time.perf_counter()
        Runner(rig, plan, folder / f"{speed:g}.h5").run()
        took_s, took_real_s = rig.clock.now_s() - began_s, time.perf_counter() - began_real_s
    model = parts_of(plan, config)
    ratio = took_s / model["all"]
    other_s = took_s - sum(spent.values())
    moves_s = model["all"] - model["settling"] - model["integration"]
    print(
        f"{speed:>6g}{took_real_s:>9.1f}{took_s:>10.1f}{model['all']:>10.1f}{ratio:>8.3f}{'':>16}"
        f"{spent['stage']:>8.1f}{spent['polarizer']:>11.1f}{spent['spectrometer']:>14.1f}"
        f"{spent['looking back']:>8.2f}{other_s:>7.2f}{'':>15}{moves_s:>14.1f}{model['settling']:>10.1f}"
        f"{model['integration']:>13.1f}"
    )
    return ratio


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--speeds", type=float, nargs="+", default=[50.0, 20.0, 5.0])
    parser.add_argument("--positions", type=int, default=6, help="both polarizations together")
    options = parser.parse_args()
    plan = parse_plan(PLAN.format(stop=45.0 + 5.0 * (max(options.positions // 2, 1) - 1)))
    print(
        f"{'clock':>6}{'real s':>9}{'scan':>10}{'sum':>10}{'ratio':>8}   of the scan: {'stage':>7}"
        f"{'polarizer':>11}{'spectrometer':>14}{'checks':>8}{'rest':>7}   of the sum: {'moves, drives':>14}"
        f"{'settling':>10}{'integration':>13}"
    )
    with tempfile.TemporaryDirectory(prefix="gonio-duration-") as folder:
        ratios = {speed: measure(speed, plan, Path(folder)) for speed in options.speeds}
    slowest = min(ratios)
    print(
        f"bench seconds; at clock {slowest:g} the ratio is {ratios[slowest]:.3f}, at most {MOST} is asked for"
    )
    return 0 if ratios[slowest] <= MOST else 1


if __name__ == "__main__":
    sys.exit(main())

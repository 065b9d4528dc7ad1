"""`gonio plan`: everything that can be said of a scan before it begins."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from gonio.acquire.latencies import measured_latency
from gonio.bench_process import served
from gonio.cli.progress import readable_duration
from gonio.latency import LatencyConfig
from gonio.plan import Plan, Timetable, channels, check, load_plan, order_costs, resolved, timetable
from gonio.plan.check import bytes_needed, refused_room
from gonio.plan.optimise import MANY_POSITIONS, describe
from gonio.rig import RigConfig, load_rig, open_rig


def dry_run(
    plan_file: Path, rig_file: Path | None, *, measure: bool = False, folder: Path | None = None
) -> int:
    """Check every position of a plan; print counts, refusals, the time estimate and what other orders
    cost.
    """
    rig = load_rig(rig_file)
    plan = load_plan(plan_file)
    here = Path.cwd() if folder is None else folder
    refusals = [str(refusal) for refusal in check(plan, rig)]
    _print_counts(plan, rig)
    if not refusals:
        if measure:
            rig = _with_measured(plan, rig, here)
        plan = resolved(plan, rig)
        table = timetable(plan, rig)
        needed = bytes_needed(table, len(channels(plan, rig)))
        room = refused_room(needed, here)
        refusals += [room] if room else []
    for refusal in refusals:
        print(f"refused: {refusal}", file=sys.stderr)
    if refusals:
        print(
            f"{len(refusals)} refused; nothing would be measured until the plan is corrected", file=sys.stderr
        )
        return 1
    if plan.source is not None and plan.n_positions == 0:
        print(
            f"the positions come from the source '{plan.source.name}' while the scan runs: each is checked "
            "before it is gone to, and no time can be told before"
        )
        return 0
    print(
        "every position is allowed, and every way between them; the file takes up to "
        f"{needed / 1e6:.1f} MB while it is written"
    )
    _print_time(plan, rig, table)
    _print_orders(plan, rig)
    return 0


def _print_counts(plan: Plan, rig: RigConfig) -> None:
    repeats = plan.repeats.count
    print(
        f"{plan.title}: {plan.n_positions} positions"
        + (f" (each {repeats} times)" if repeats > 1 else "")
        + f", {len(plan.wavelength_nm)} wavelengths, rig '{rig.name}'"
    )


def _with_measured(plan: Plan, rig: RigConfig, folder: Path) -> RigConfig:
    with served(rig) as reachable, open_rig(reachable) as connected:
        latency = measured_latency(connected, plan, folder)
    print("measured, for the rig file:\n[latency]  # real seconds per exchange, and per record on the disk")
    for name, value in latency.model_dump().items():
        print(f"{name} = {value:g}")
    return rig.model_copy(update={"latency": latency})


def _print_time(plan: Plan, rig: RigConfig, table: Timetable) -> None:
    columns = channels(plan, rig)
    twice = len(columns) - len(plan.wavelength_nm)
    averages = sorted(set(np.asarray(columns.averages).tolist()))
    print(
        f"steps: {plan.n_positions} positions, {table.count('dark')} dark and {table.count('baseline')} "
        f"baseline readings; {len(columns)} columns"
        + (f", {twice} wavelengths with both detectors" if twice else "")
        + f"; averages {', '.join(map(str, averages))}"
    )
    print(
        f"estimated duration {readable_duration(table.total_s)} of instrument time: motion, settling and "
        f"averaging {readable_duration(table.instrument_s)}, wires and disk {readable_duration(table.real_s)}"
        + (f" of real time at {rig.clock_speed():g} x" if rig.clock_speed() != 1.0 else "")
    )
    if rig.clock_speed() != 1.0:
        print(f"in real time {readable_duration(table.total_s / rig.clock_speed())}")
    if rig.latency == LatencyConfig():
        print("wires and disk are not counted: the rig file has no [latency]; --measure finds it")


def _print_orders(plan: Plan, rig: RigConfig) -> None:
    if plan.n_positions > MANY_POSITIONS:
        print(
            f"order: {describe(plan.order)}; with more than {MANY_POSITIONS} positions others are not tried"
        )
        return
    costs = order_costs(plan, rig)
    own_s = costs[0].total_s
    print(f"\n{'duration':>12}{'saving':>12}  order")
    for cost in costs:
        saving = f"{100.0 * (own_s - cost.total_s) / own_s:.1f} %" if cost is not costs[0] else "the plan's"
        print(f"{readable_duration(cost.total_s):>12}{saving:>12}  {cost}")
    best = min(costs, key=lambda cost: cost.total_s)
    if best is not costs[0] and best.total_s < 0.995 * own_s:
        print(f"\nto save {readable_duration(own_s - best.total_s)}, put into the plan:\n[order]")
        for name, value in best.order.model_dump(exclude_none=True).items():
            text = str(value).lower() if isinstance(value, bool) else (
                str(list(value)).replace("'", '"') if isinstance(value, tuple) else f'"{value}"'
            )  # fmt: skip
            print(f"{name} = {text}")

"""`gonio queue`: several samples one after the other, with a person who changes them, or without."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from gonio.acquire import FaultPolicy
from gonio.acquire.queue import Answer, Measure, QueueResult, ScanQueue, Standing
from gonio.acquire.queue_file import QueuedScan
from gonio.bench_process import served
from gonio.cli.acquisition import acquire, continue_scan
from gonio.cli.progress import readable_duration
from gonio.errors import RefusedError
from gonio.plan import channels
from gonio.rig import RigConfig, load_rig


def run_queue(
    path: Path,
    rig_file: Path | None,
    *,
    check_only: bool = False,
    unattended: bool = False,
    policy: FaultPolicy | None = None,
) -> int:
    """Check every scan of a queue, measure those that are not done, and print the summary."""
    queue, config = ScanQueue.load(path)
    rig = load_rig(rig_file or config.rig)
    problems = queue.check(rig)
    for problem in problems:
        print(f"refused: {problem}", file=sys.stderr)
    if problems:
        print(f"{len(problems)} refused; nothing is measured until they are corrected", file=sys.stderr)
        return 1
    _print_plan(queue, rig)
    if check_only:
        return 0
    attended = sys.stdin is not None and sys.stdin.isatty()
    if not unattended and not attended and any(scan.pause for scan in queue.scans[1:]):
        raise RefusedError(
            "the queue waits for somebody to change samples, and nobody can answer here; run it at a "
            "terminal, or give --unattended (or pause = false) if the samples change by themselves"
        )
    try:
        with served(rig) as reachable:
            queue.run(rig, _with_a_bar(reachable, policy), ask=None if unattended else _ask)
    finally:
        results = queue.results(rig)
        _print_results(results)
        print(f"summary: {queue.summary}")
    return 0 if all(result.standing == Standing.DONE.value for result in results) else 1


def _with_a_bar(rig: RigConfig, policy: FaultPolicy | None) -> Measure:
    def measure(scan: QueuedScan, goes_on: bool) -> None:
        print(f"{scan.sample}: {'goes on' if goes_on else 'begins'} -> {scan.output}")
        if goes_on:
            continue_scan(scan.output, rig, policy=policy)
        else:
            acquire(scan.plan, rig, scan.output, policy=policy)

    return measure


def _ask(scan: QueuedScan) -> Answer:
    """Wait until the operator has changed the sample; the end of the input is a reason to stop."""
    print(f"put '{scan.sample}' in, then press Enter (s Enter: skip it, q Enter: end the queue): ", end="")
    sys.stdout.flush()
    line = sys.stdin.readline()
    if not line or line.strip().lower() == "q":
        return "stop"
    return "skip" if line.strip().lower() == "s" else "go"


def _print_plan(queue: ScanQueue, rig: RigConfig) -> None:
    print(f"{queue.title}: {len(queue.scans)} scans on rig '{rig.name}'; every position of each is allowed")
    left_s = 0.0
    for scan in queue.scans:
        standing = queue.standing(scan, rig)
        takes_s = queue.estimated_s(scan, rig)
        if standing is not Standing.DONE:
            left_s += takes_s
        print(
            f"  {scan.sample:<24.24}{standing.value:<12}{scan.plan.n_positions:>6} positions x"
            f"{len(channels(scan.plan, rig)):>5}{readable_duration(takes_s):>16}  {scan.output.name}"
        )
    print(f"still to measure: at most {readable_duration(left_s)}, and the time to change samples")


def _print_results(results: Sequence[QueueResult]) -> None:
    print(f"\n{'sample':<24}{'':<12}{'positions':>11}{'flagged':>9}{'took':>16}  file")
    for result in results:
        counted = f"{result.positions}/{result.planned}"
        print(
            f"{result.sample:<24.24}{result.standing:<12}{counted:>11}{result.flagged:>9}"
            f"{readable_duration(result.took_s) if result.took_s else '-':>16}  {Path(result.output).name}"
        )
        if result.message:
            print(f"    {result.message}")

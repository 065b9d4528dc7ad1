"""`gonio scan`, `gonio devices`: what is done with the instrument."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from gonio.acquire import Runner, Snapshot, State, resume_scan, stored_rig
from gonio.bench_process import served
from gonio.cli.progress import progress_bar, readable_duration
from gonio.errors import RefusedError, StoreError
from gonio.plan import Plan, check, load_plan
from gonio.rig import RigConfig, load_rig, open_rig
from gonio.store import load


def scan(plan_file: Path, rig_file: Path | None, output: Path, *, wire_log: Path | None) -> int:
    """Acquire a plan into a new file."""
    rig = load_rig(rig_file)
    plan = load_plan(plan_file)
    refuse_bad_plan(plan, rig)
    refuse_existing(output)
    with served(rig) as reachable:
        acquire(plan, reachable, output, wire_log=wire_log)
    _say_complete(output)
    return 0


def resume(path: Path, rig_file: Path | None, *, wire_log: Path | None) -> int:
    """Continue an interrupted scan with the rig stored in it, or with another description of the same
    bench.
    """
    rig = load_rig(rig_file) if rig_file is not None else stored_rig(path)
    with served(rig) as reachable:
        continue_scan(path, reachable, wire_log=wire_log)
    _say_complete(path)
    return 0


def _say_complete(path: Path) -> None:
    done = load(path)
    flagged = done.quality.size - int(done.usable.sum())
    print(
        f"{path}: {len(done.position)} positions x {len(done.wavelength_nm)} wavelengths, complete"
        + (f"; {flagged} readings are flagged and not usable" if flagged else "")
        + f"; next: gonio fit {path}"
    )


def refuse_bad_plan(plan: Plan, rig: RigConfig) -> None:
    """Raise `RefusedError` with every reason if the rig cannot measure the plan."""
    refusals = check(plan, rig)
    if refusals:
        shown = "\n".join(str(refusal) for refusal in refusals[:10])
        more = f"\n... and {len(refusals) - 10} more (gonio plan lists all)" if len(refusals) > 10 else ""
        raise RefusedError(f"the plan '{plan.title}' cannot be measured:\n{shown}{more}")


def refuse_existing(path: Path) -> None:
    """Raise `StoreError` if a file is in the way, before any device is touched."""
    if path.exists():
        raise StoreError(
            f"{path} exists already and is never overwritten; choose another name with -o, or continue it "
            f"with gonio scan --resume {path}"
        )
    if not path.absolute().parent.is_dir():
        raise StoreError(f"{path}: the folder {path.parent} does not exist; make it first")


def acquire(plan: Plan, rig: RigConfig, output: Path, *, wire_log: Path | None = None) -> None:
    """Run a plan with a progress bar; Ctrl-C stops in order and leaves a file that can be resumed."""
    with open_rig(rig, wire_log=wire_log) as connected, _watched(plan.title, rig) as on_snapshot:
        runner = Runner(connected, plan, output, on_snapshot=on_snapshot)
        with _stopped_by_signals(runner):
            runner.run()


def continue_scan(path: Path, rig: RigConfig, *, wire_log: Path | None = None) -> None:
    """Resume a scan with a progress bar."""
    with open_rig(rig, wire_log=wire_log) as connected, _watched(path.name, rig) as on_snapshot:
        runner = resume_scan(path, connected, on_snapshot=on_snapshot)
        with _stopped_by_signals(runner):
            runner.run()


@contextmanager
def _watched(title: str, rig: RigConfig) -> Iterator[Callable[[Snapshot], None]]:
    speed = rig.clock_speed()  # the person waits in real seconds
    with progress_bar(title, 1.0) as bar:

        def show(snapshot: Snapshot) -> None:
            if snapshot.state is State.RUNNING:
                state = f"{readable_duration(snapshot.left_s / speed)} left"
            else:
                state = snapshot.state.value
            done = snapshot.readings_done / max(snapshot.readings_total, 1)
            bar.update(done, f"{snapshot.done}/{snapshot.total} positions, {state}")

        yield show


@contextmanager
def _stopped_by_signals(runner: Runner) -> Iterator[None]:
    """Turn Ctrl-C and SIGTERM into an orderly stop; a second Ctrl-C interrupts at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous: dict[int, Any] = {}

    def stop(_signal: int, _frame: FrameType | None) -> None:
        restore()
        # not here: the handler may run inside the very lock that stop() needs
        threading.Thread(target=runner.stop, daemon=True).start()

    def restore() -> None:
        for number, handler in previous.items():
            signal.signal(number, handler)

    for name in ("SIGINT", "SIGTERM"):
        if hasattr(signal, name):
            number = getattr(signal, name)
            previous[number] = signal.signal(number, stop)
    try:
        yield
    finally:
        restore()


def devices(rig_file: Path | None) -> int:
    """Connect to every device of the rig and print what each says of itself."""
    rig = load_rig(rig_file)
    with served(rig) as reachable, open_rig(reachable) as connected:
        addresses = reachable.addresses()
        rows = {"stage": connected.stage.identify(), "polarizer": connected.polarizer.identify()}
        rows |= dict(connected.spectrometer.identify())
        for role, text in rows.items():
            print(f"{role:<14}{addresses.get(role, ''):<32}{text}")
        theta_i, theta_mes = connected.stage.theta_i, connected.stage.theta_mes
        print(f"theta_i = {theta_i.position_deg():.3f} deg, theta_mes = {theta_mes.position_deg():.3f} deg")
    return 0

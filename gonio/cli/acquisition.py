"""`gonio scan`, `gonio devices`: what is done with the instrument."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gonio.acquire import FaultPolicy, Runner, Snapshot, State, resume_scan, stored_rig
from gonio.acquire.session import OnRecord
from gonio.bench_process import served
from gonio.cli.attended import run_attended
from gonio.errors import RefusedError, StoreError
from gonio.plan import Plan, check, load_plan
from gonio.rig import RigConfig, load_rig, open_rig
from gonio.store import load
from gonio.store.records import EventRecord, PositionRecord, ReferenceRecord


def scan(
    plan_file: Path,
    rig_file: Path | None,
    output: Path,
    *,
    wire_log: Path | None,
    policy: FaultPolicy | None = None,
) -> int:
    """Acquire a plan into a new file."""
    rig = load_rig(rig_file)
    plan = load_plan(plan_file)
    refuse_bad_plan(plan, rig)
    refuse_existing(output)
    with served(rig) as reachable:
        acquire(plan, reachable, output, wire_log=wire_log, policy=policy)
    _say_complete(output)
    return 0


def resume(
    path: Path, rig_file: Path | None, *, wire_log: Path | None, policy: FaultPolicy | None = None
) -> int:
    """Continue an interrupted scan with the rig stored in it, or with another description of the same
    bench.
    """
    rig = load_rig(rig_file) if rig_file is not None else stored_rig(path)
    with served(rig) as reachable:
        continue_scan(path, reachable, wire_log=wire_log, policy=policy)
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


def acquire(
    plan: Plan,
    rig: RigConfig,
    output: Path,
    *,
    wire_log: Path | None = None,
    policy: FaultPolicy | None = None,
) -> None:
    """Run a plan with a progress bar."""
    with open_rig(rig, wire_log=wire_log) as connected:
        run_attended(
            plan.title,
            connected,
            lambda on_snapshot, on_record: Runner(
                connected, plan, output, on_snapshot=on_snapshot, on_record=on_record, policy=policy
            ),
        )


def continue_scan(
    path: Path, rig: RigConfig, *, wire_log: Path | None = None, policy: FaultPolicy | None = None
) -> None:
    """Resume a scan with a progress bar."""
    with open_rig(rig, wire_log=wire_log) as connected:
        known = True  # events of before are told again first, and are no news

        def make(on_snapshot: Callable[[Snapshot], None], on_record: OnRecord) -> Runner:
            def news(snapshot: Snapshot) -> None:
                nonlocal known
                known = snapshot.state is State.PREPARING
                on_snapshot(snapshot)

            def tell(record: ReferenceRecord | PositionRecord | EventRecord) -> None:
                if not known:
                    on_record(record)

            return resume_scan(path, connected, on_snapshot=news, on_record=tell, policy=policy)

        run_attended(path.name, connected, make)


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

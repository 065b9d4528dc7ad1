"""What can be done with a scan that was interrupted: go on with it, or ask which rig it was begun with."""

from __future__ import annotations

from pathlib import Path

from gonio.acquire.journal import journal_path, read_header
from gonio.acquire.policy import FaultPolicy
from gonio.acquire.runner import OnSnapshot, Runner
from gonio.acquire.session import OnRecord
from gonio.errors import StoreError
from gonio.plan.model import parse_plan
from gonio.plan.source import PositionSource
from gonio.rig import Rig, RigConfig, parse_rig
from gonio.store.records import ScanHeader


def resume_scan(
    path: str | Path,
    rig: Rig,
    *,
    on_snapshot: OnSnapshot | None = None,
    on_record: OnRecord | None = None,
    policy: FaultPolicy | None = None,
    source: PositionSource | None = None,
    ask_again: bool = True,
) -> Runner:
    """Return a runner that goes on with an interrupted scan, however it was interrupted; call its `run`.

    A scan whose positions a source chose goes on with that `source`; see `Runner` for `ask_again`.

    Raises
    ------
    StoreError
        There is nothing to resume at `path`.
    """
    path = Path(path)
    header = _interrupted(path)
    plan = parse_plan(header.plan_text, source=f"the plan in {journal_path(path).name}")
    return Runner(
        rig, plan, path, on_snapshot=on_snapshot, on_record=on_record, continues=True, policy=policy,
        source=source, ask_again=ask_again,
    )  # fmt: skip


def stored_rig(path: str | Path) -> RigConfig:
    """Return the rig that an interrupted scan was begun with; `StoreError` if there is nothing to resume."""
    path = Path(path)
    return parse_rig(_interrupted(path).rig_text, source=f"the rig in {journal_path(path).name}")


def _interrupted(path: Path) -> ScanHeader:
    if journal_path(path).exists():
        return read_header(journal_path(path))
    if path.exists():
        raise StoreError(
            f"{path}: has no journal beside it, so nothing is left to resume; the scan is complete"
        )
    raise StoreError(f"{path}: there is neither a scan nor its journal; check the path")

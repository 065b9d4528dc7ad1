"""A scan's files made or taken up again, and where its axis of time begins."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gonio.acquire.agenda import Agenda, PlanAgenda, SourceAgenda
from gonio.acquire.preparing import Prepared, header_of
from gonio.acquire.session import OnRecord, Session, facts_of
from gonio.acquire.sourcing import Asked, must_be_same
from gonio.plan.model import Plan
from gonio.rig import Rig
from gonio.store.records import DecisionRecord, Level


@dataclass(frozen=True, slots=True)
class Opened:
    """A session, scan time minus the rig's clock, and what is to be told as events."""

    session: Session
    offset_s: float
    notes: tuple[tuple[Level, str], ...] = ()


def begun(
    rig: Rig, plan: Plan, path: Path, ready: Prepared, source: Asked | None, on_record: OnRecord | None
) -> Opened:
    """Make the files of a scan that begins now."""
    header = header_of(rig, plan, ready, source)
    offset_s = -rig.clock.now_s()
    return Opened(Session.begin(path, header, plan, on_record), offset_s)


def taken_up(
    rig: Rig, path: Path, source: Asked | None, on_record: OnRecord | None, *, ask_again: bool
) -> Opened:
    """Open the files of a scan that was interrupted; `StoreError` if it is not one of this rig and source."""
    session, damage = Session.resume(path, facts_of(rig.config), on_record)
    try:
        change = must_be_same(source, session.header.source, session.history, ask_again=ask_again)
    except BaseException:
        session.close()
        raise
    away_s = max(time.time() - session.last_unix_s, 0.0)
    gap_s = away_s if rig.clock.speed == 1.0 else 0.0
    notes: list[tuple[Level, str]] = [("warning", note) for note in (damage, change) if note]
    notes.append(("info", f"resumed {away_s:.0f} s after the last record"))
    return Opened(session, session.last_time_s + gap_s - rig.clock.now_s(), tuple(notes))


def agenda_of(
    rig: Rig,
    plan: Plan,
    ready: Prepared,
    source: Asked | None,
    session: Session,
    now_s: float,
    keep: Callable[[DecisionRecord], None],
) -> Agenda:
    """Return what is left to do, for a plan or a source; `keep` puts a decision on the disk."""
    if source is None:
        return PlanAgenda(ready.steps, session, now_s)
    return SourceAgenda(source, plan, rig.config, session, now_s, first=ready.first, keep=keep)

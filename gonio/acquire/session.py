"""What a scan has on the disk: its journal and the NeXus file made from it, kept in step.

A record is appended to the journal; while the disk confirms it, it is written into the `.h5`, which is
flushed.  It counts when both are done.  Whatever instant the process dies, the journal holds every finished
position once; `Session.resume` makes the `.h5` anew from it beside the old one, puts it in the old one's
place in one step, and goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gonio.acquire.history import History
from gonio.acquire.journal import Journal, died_at_birth, journal_path
from gonio.acquire.room import RESERVE_BYTES, must_have_room, prove_room
from gonio.errors import StoreError
from gonio.plan.model import Plan, Position, parse_plan
from gonio.rig import RigConfig
from gonio.store.file import ScanFile, explained, sync_file
from gonio.store.layout import SPECTRUM_GROUPS
from gonio.store.read import opened
from gonio.store.records import (
    DecisionRecord,
    DetectorFacts,
    EventRecord,
    PositionRecord,
    Record,
    ReferenceRecord,
    RigFacts,
    ScanHeader,
)

OnRecord = Callable[[ReferenceRecord | PositionRecord | EventRecord], None]

_BLOCK = 256  # positions written at a time when the file is made anew


class Session:
    """The files of a running scan.

    Attributes
    ----------
    done
        Keys of the steps whose records are on the disk (see `gonio.acquire.steps`).
    last_time_s, last_unix_s
        Latest time on the scan's axis and on the computer's clock that a record bears.
    history
        What a source of positions decided and was told, if the scan has one.
    """

    def __init__(
        self, path: Path, header: ScanHeader, journal: Journal, file: ScanFile, on_record: OnRecord | None
    ) -> None:
        self.path = path
        self.header = header
        self.done: set[int | tuple[str, str, str]] = set()
        self.last_time_s = 0.0
        self.last_unix_s = header.unix_s
        self.history: History | None = None
        if header.source is not None:
            columns_nm = _plan_of(path, header).wavelength_nm
            if header.wavelength_nm is not None:
                columns_nm = header.wavelength_nm
            self.history = History(columns_nm, header.detector_index)
        self._journal = journal
        self._file = file
        self._on_record = on_record
        self._journaled: Record | None = None  # the last record that the journal has
        self._broken = False  # the `.h5` could not be written and must be made anew
        self._reserve = RESERVE_BYTES + _BLOCK * len(header.detector_index) * 8

    @classmethod
    def begin(cls, path: Path, header: ScanHeader, plan: Plan, on_record: OnRecord | None = None) -> Session:
        """Create both files, which must not exist; `on_record` is told of each record once it is safe."""
        refuse_existing(path)
        journal = Journal.create(journal_path(path), header)
        try:
            file, _ = _made(path, header, plan, [])
            return cls(path, header, journal, file, on_record)
        except BaseException:
            journal.remove()  # nothing was measured, and the name must stay free
            raise

    @classmethod
    def resume(cls, path: Path, facts: RigFacts, on_record: OnRecord | None = None) -> tuple[Session, str]:
        """Make the `.h5` anew from the journal; return the session and a note on damage, if there was any.

        `on_record` is told of the earlier records first, in their order.

        Raises
        ------
        StoreError
            There is no journal, another process holds it, or the scan was made on a rig that differs from
            `facts`.
        """
        journal, header, records, note = Journal.reopen(journal_path(path))
        try:
            _refuse_other_rig(path, header.rig, facts)
            file, remark = _made(path, header, _plan_of(path, header), records)
        except BaseException:
            journal.close()
            raise
        session = cls(path, header, journal, file, on_record)
        for record in records:
            session._note(record)
        return session, "; ".join(text for text in (note, remark) if text)

    def record(self, record: ReferenceRecord | DecisionRecord | PositionRecord | EventRecord) -> None:
        """Keep a record for good: it is on the disk when this returns.

        After a `StoreError` it may be called again with the same record, which is kept once.  If it was the
        `.h5` that could not be written, records go to the journal alone until `repair`.
        """
        if record is self._journaled:
            return
        must_have_room(self.path, self._reserve)
        try:
            self._journal.write(record)
            try:
                if not self._broken:
                    add_records(self._file, [record])
                    self._file.flush()
            finally:
                self._journal.confirm()
                self._journaled = record
                self._note(record)
        except StoreError:
            if not self._broken:
                self._broken = True
                self._file.abandon()
            raise

    def has(self, record: EventRecord) -> bool:
        """Say whether a record whose keeping failed is safe in the journal all the same."""
        return record is self._journaled

    def repair(self) -> None:
        """Make the `.h5` anew from the journal after a failed write; `StoreError` if that fails, too."""
        if not self._broken:
            return
        prove_room(self.path, self._reserve + 2 * self.path.stat().st_size)
        self._file, _ = _made(
            self.path, self.header, _plan_of(self.path, self.header), self._journal.records()
        )
        self._broken = False

    def _note(self, record: Record) -> None:
        if self.history is not None and not self.history.note(record):
            return
        if isinstance(record, DecisionRecord):
            return
        if isinstance(record, PositionRecord):
            self.done.add(record.index)
        elif isinstance(record, ReferenceRecord):
            self.done.add((record.kind, record.when, record.polarization))
        if isinstance(record, EventRecord):
            latest_s = record.time_s
        elif isinstance(record, ScanHeader):
            latest_s = 0.0
        else:
            latest_s = float(np.nanmax(record.time_s))
        self.last_time_s = max(self.last_time_s, latest_s)
        self.last_unix_s = max(self.last_unix_s, record.unix_s)
        if self._on_record is not None and not isinstance(record, ScanHeader):
            self._on_record(record)

    def finish(self, end_time: str) -> None:
        """Correct all positions with all references, close the file for good and remove the journal.

        Where a source chose the positions, the file is first made anew with a row for each of them and no
        more, and with the sweeps that they turned out to be.
        """
        self.repair()
        if self.history is not None:
            self._file.close()
            self._broken = True  # until it is there again; the journal has everything
            self._file, _ = _made(
                self.path,
                self.header,
                _plan_of(self.path, self.header),
                self._journal.records(),
                self.history.decided,
            )
            self._broken = False
        for event in self._file.finish(end_time):
            self._note(event)
        self._file.close()
        with explained(self.path, "finished"):
            sync_file(self.path)
            self._journal.remove()

    def close(self) -> None:
        """Close both files as they are; the scan can be resumed."""
        try:
            if not self._broken:
                self._file.close()
        finally:
            self._journal.close()


def facts_of(config: RigConfig) -> RigFacts:
    """Return what of the rig decides the meaning of the data."""
    return RigFacts(
        name=config.name,
        width_mm=config.aperture.width_mm,
        height_mm=config.aperture.height_mm,
        distance_mm=config.aperture.distance_mm,
        baseline_theta_i_deg=config.baseline.theta_i_deg,
        baseline_theta_mes_deg=config.baseline.theta_mes_deg,
        s_deg=config.polarizer.s_deg,
        p_deg=config.polarizer.p_deg,
        detectors=tuple(DetectorFacts(d.name, d.type, *d.range_nm) for d in config.spectrometer.detectors),
        beam_width_mm=None if config.beam is None else config.beam.width_mm,
        beam_height_mm=None if config.beam is None else config.beam.height_mm,
        beam_divergence_deg=None if config.beam is None else config.beam.divergence_deg,
    )


def refuse_existing(path: Path) -> None:
    """Raise `StoreError` if the file, or the journal of an unfinished scan, is already there."""
    if journal_path(path).exists() and not died_at_birth(journal_path(path)):
        raise StoreError(
            f"{path}: an unfinished scan is there; continue it with gonio scan --resume {path}, or choose "
            "another name"
        )
    if path.exists():
        raise StoreError(f"{path} exists already and is never overwritten; choose another name")
    if not path.absolute().parent.is_dir():
        raise StoreError(f"{path}: the folder {path.absolute().parent} does not exist; make it first")


def _refuse_other_rig(path: Path, stored: RigFacts, facts: RigFacts) -> None:
    if stored == facts:
        return
    differing = [
        f"{name} was {getattr(stored, name)} and is {getattr(facts, name)}"
        for name in RigFacts.__slots__
        if getattr(stored, name) != getattr(facts, name)
    ]
    raise StoreError(
        f"{path}: cannot be resumed on another rig ({'; '.join(differing)}); use the rig file of the scan's "
        "beginning"
    )


def add_records(file: ScanFile, records: Sequence[Record]) -> None:
    """Write records in order, runs of consecutive positions at once."""
    block: list[PositionRecord] = []
    for record in records:
        if isinstance(record, DecisionRecord):
            file.add_decision(record)  # of other columns than the block's
            continue
        if isinstance(record, PositionRecord) and not file.expects(record.index):
            continue
        if isinstance(record, PositionRecord):
            if block and (record.index != block[-1].index + 1 or len(block) == _BLOCK):
                file.add_positions(block)
                block = []
            block.append(record)
            continue
        if block:
            file.add_positions(block)
            block = []
        if isinstance(record, ReferenceRecord):
            file.add_reference(record)
        elif isinstance(record, EventRecord):
            file.add_event(record)
    if block:
        file.add_positions(block)


def _plan_of(path: Path, header: ScanHeader) -> Plan:
    return parse_plan(header.plan_text, source=f"the plan in {journal_path(path).name}")


def _made(
    path: Path,
    header: ScanHeader,
    plan: Plan,
    records: Sequence[Record],
    decided: Sequence[Position] | None = None,
) -> tuple[ScanFile, str]:
    """Make the file of the records and put it in the place of the old one, if there is one, in one step.

    A file of that name is whole at any instant.  Returned with a remark on what of the old one was lost.
    """
    temporary = path.with_name(path.name + ".rebuilt")  # under the journal's lock: a leftover is ours
    file = ScanFile(temporary, header, plan, "w", decided)
    try:
        add_records(file, records)
        remark = _carry_over(path, file)
        file.move_to(path)
    except BaseException:
        file.abandon()
        temporary.unlink(missing_ok=True)
        raise
    return file, remark


def _carry_over(old_path: Path, file: ScanFile) -> str:
    """Copy what others have put into the old file: spectra always, fits only if they saw the whole scan."""
    try:
        with opened(old_path, "r") as old:
            entry = old["entry"]
            finished = entry.attrs.get("scan_status") == "finished"
            fits = [name for name in entry if name.startswith("fit_")]
            keep = [name for name in SPECTRUM_GROUPS if name in entry] + (fits if finished else [])
            for name in keep:
                file.copy_group(entry[name])
    except StoreError:
        return ""  # torn by the crash, or never there; the journal has all that was measured
    if fits and not finished:
        return f"{', '.join(fits)} saw only a part of the scan and was dropped; fit again"
    return ""

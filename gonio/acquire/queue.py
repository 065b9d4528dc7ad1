"""Several scans one after the other, resumable as a whole: what is done is told by the files themselves.

A queue keeps no state of its own.  A scan whose file is finished is done, one with a journal is gone on with,
one without a file is begun.  So a queue that was killed, stopped or changed is simply run again.
"""

from __future__ import annotations

import contextlib
import datetime
import enum
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from gonio.acquire.interrupted import resume_scan
from gonio.acquire.journal import died_at_birth, journal_path, read_header
from gonio.acquire.policy import FaultPolicy
from gonio.acquire.queue_file import QueueConfig, QueuedScan, WhenOneFails, load_queue
from gonio.acquire.runner import OnSnapshot, Runner
from gonio.errors import GonioError, RefusedError, ScanStopped, StoreError
from gonio.plan.check import check
from gonio.plan.model import parse_plan
from gonio.plan.optimise import resolved
from gonio.plan.timetable import timetable
from gonio.rig import RigConfig, open_rig
from gonio.store.read import load

Answer = Literal["go", "skip", "stop"]
Ask = Callable[[QueuedScan], Answer]
Measure = Callable[[QueuedScan, bool], None]
"""Measures a scan; the flag says that it goes on with one that was begun."""


class Standing(enum.Enum):
    """How a scan of a queue stands."""

    WAITING = "waiting"
    UNFINISHED = "unfinished"  # begun, and can be gone on with
    DONE = "done"
    SKIPPED = "skipped"  # by the operator
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class QueueResult:
    """One line of the summary; counts are zero where there is no file yet."""

    sample: str
    output: str
    standing: str
    positions: int = 0
    planned: int = 0
    wavelengths: int = 0
    flagged: int = 0  # readings that are not usable
    took_s: float = 0.0  # real seconds, in this run of the queue
    message: str = ""


class ScanQueue:
    """A queue of scans on one rig; `load` reads the file, `check` touches nothing, `run` measures.

    Parameters
    ----------
    scans
        In the order in which they are measured.
    when_one_fails
        ``stop`` ends the queue there, ``next`` goes on with the next; what failed is tried again when the
        queue is run again.
    summary
        JSON file that is written anew after every scan; None for none.
    """

    def __init__(
        self,
        scans: Sequence[QueuedScan],
        *,
        title: str = "Scan queue",
        when_one_fails: WhenOneFails = "stop",
        summary: Path | None = None,
    ) -> None:
        self.scans = tuple(scans)
        self.title = title
        self.when_one_fails = when_one_fails
        self.summary = summary
        self._results: dict[int, QueueResult] = {}

    @classmethod
    def load(cls, path: str | Path) -> tuple[ScanQueue, QueueConfig]:
        """Return the queue of a file, with the summary beside it, and the file's own words (its rig)."""
        path = Path(path)
        config = load_queue(path)
        summary = path.with_name(f"{path.stem}-summary.json")
        return (
            cls(config.scans, title=config.title, when_one_fails=config.when_one_fails, summary=summary),
            config,
        )

    # -- before anything moves -------------------------------------------------------------------------------

    def check(self, rig: RigConfig) -> list[str]:
        """Return everything that stands in the way of any scan of the queue, empty if nothing does."""
        problems: list[str] = []
        for scan in self.scans:
            try:
                refusals = [str(refusal) for refusal in check(scan.plan, rig)]
                self.standing(scan, rig)
            except GonioError as error:
                refusals = [str(error)]
            if not scan.output.absolute().parent.is_dir():
                refusals.append(f"the folder {scan.output.parent} does not exist; make it first")
            problems += [f"{scan.sample}: {text}" for text in refusals]
        return problems

    def estimated_s(self, scan: QueuedScan, rig: RigConfig) -> float:
        """Return the real seconds that a whole scan is estimated to take."""
        return timetable(resolved(scan.plan, rig), rig).total_s / rig.clock_speed()

    def standing(self, scan: QueuedScan, rig: RigConfig) -> Standing:
        """Say how a scan stands, from its files.

        Raises
        ------
        StoreError
            A file of that name is in the way: it is no scan, another plan's or sample's, or was cut short.
        """
        path = scan.output
        journal = journal_path(path)
        if journal.exists():
            if died_at_birth(journal):
                return Standing.WAITING
            _must_be_of(scan, rig, read_header(journal).plan_text)
            return Standing.UNFINISHED
        if not path.exists():
            return Standing.WAITING
        found = load(path)
        _must_be_of(scan, rig, found.plan_text)
        if not found.finished:
            raise StoreError(
                f"{path}: is not finished, and has no journal to go on from; move it away, or choose another "
                "output"
            )
        return Standing.DONE

    # -- the run ---------------------------------------------------------------------------------------------

    def run(self, rig: RigConfig, measure: Measure, *, ask: Ask | None = None) -> list[QueueResult]:
        """Measure whatever is not done yet, and return how every scan stands then.

        Parameters
        ----------
        rig
            What the plans are checked against, all of them before the first is measured.
        measure
            Measures one scan, `measured_on` for instance.
        ask
            Asks the operator whether the sample is in place; without it no scan waits.

        Raises
        ------
        RefusedError
            Something stands in the way of a scan: see `check`.  Nothing has been measured.
        ScanStopped
            A scan was stopped; the queue goes on from there when it is run again.
        """
        problems = self.check(rig)
        if problems:
            raise RefusedError("the queue cannot be run:\n" + "\n".join(problems))
        self._results.clear()
        in_place: str | None = None
        ended = False
        for number, scan in enumerate(self.scans):
            standing = self.standing(scan, rig)
            if standing is Standing.DONE or ended:
                self._note(number, standing, 0.0, "")
                continue
            if ask is not None and scan.pause and self._other_sample(number, standing, in_place):
                answer = ask(scan)
                if answer != "go":
                    self._note(number, Standing.SKIPPED, 0.0, "skipped by the operator")
                    ended = answer == "stop"
                    continue
            in_place = scan.sample
            ended = not self._measure(number, scan, measure, standing) and self.when_one_fails == "stop"
        return self.results(rig)

    def results(self, rig: RigConfig) -> list[QueueResult]:
        """Return how every scan stands: as noted by the last run, else from its files."""
        for number, scan in enumerate(self.scans):
            if number not in self._results:
                self._note(number, self.standing(scan, rig), 0.0, "")
        return [self._results[number] for number in range(len(self.scans))]

    def _other_sample(self, number: int, standing: Standing, in_place: str | None) -> bool:
        """Say whether the sample must be changed: the first is in, and so is that of a scan half done."""
        if in_place is not None:
            return self.scans[number].sample != in_place
        return number > 0 and standing is not Standing.UNFINISHED

    def _measure(self, number: int, scan: QueuedScan, measure: Measure, standing: Standing) -> bool:
        began_s = time.monotonic()
        try:
            measure(scan, standing is Standing.UNFINISHED)
        except (ScanStopped, KeyboardInterrupt):
            self._note(number, Standing.STOPPED, time.monotonic() - began_s, "stopped by the operator")
            raise
        except GonioError as error:
            self._note(number, Standing.FAILED, time.monotonic() - began_s, str(error))
            return False
        self._note(number, Standing.DONE, time.monotonic() - began_s, "")
        return True

    def _note(self, number: int, standing: Standing, took_s: float, message: str) -> None:
        scan = self.scans[number]
        counts = {"planned": scan.plan.n_positions}
        with contextlib.suppress(GonioError):  # no file yet, or one that its error speaks of
            found = load(scan.output)
            counts |= {
                "positions": len(found.position),
                "wavelengths": len(found.wavelength_nm),
                "flagged": found.quality.size - int(found.usable.sum()),
            }
        self._results[number] = QueueResult(
            scan.sample, str(scan.output), standing.value, took_s=round(took_s, 1), message=message, **counts
        )
        self._write_summary()

    def _write_summary(self) -> None:
        """Write the summary beside its old self and put it in its place, so that it is whole at any time."""
        if self.summary is None:
            return
        text = json.dumps(
            {
                "title": self.title,
                "written": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
                "scans": [asdict(result) for _, result in sorted(self._results.items())],
            },
            indent=2,
            ensure_ascii=False,
        )
        new = self.summary.with_name(self.summary.name + ".new")
        try:
            new.write_text(text + "\n", encoding="utf-8")
            os.replace(new, self.summary)
        except OSError as error:
            raise StoreError(
                f"{self.summary}: cannot be written ({error}); check the folder's rights and free space"
            ) from error


def measured_on(
    rig: RigConfig, *, policy: FaultPolicy | None = None, on_snapshot: OnSnapshot | None = None
) -> Measure:
    """Return what measures a scan of a queue on a rig whose addresses answer; it connects for each anew."""

    def measure(scan: QueuedScan, goes_on: bool) -> None:
        with open_rig(rig) as connected:
            if goes_on:
                runner = resume_scan(scan.output, connected, on_snapshot=on_snapshot, policy=policy)
            else:
                runner = Runner(connected, scan.plan, scan.output, on_snapshot=on_snapshot, policy=policy)
            runner.run()

    return measure


def _must_be_of(scan: QueuedScan, rig: RigConfig, plan_text: str) -> None:
    stored = parse_plan(plan_text, source=f"the plan in {scan.output.name}")
    if stored.sample.name != scan.sample:
        raise StoreError(
            f"{scan.output}: holds a scan of '{stored.sample.name}', not of '{scan.sample}'; choose another "
            "output"
        )
    if stored != scan.plan and stored != resolved(scan.plan, rig):
        raise StoreError(
            f"{scan.output}: was measured with another plan than the queue has now; choose another output, "
            "or put the plan back as it was"
        )

"""What a killed scan has left: does its file open, is every row true, is anything gone that was there?"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import gonio
from gonio.acquire.journal import decode, frames, journal_path
from gonio.devices import Quality
from gonio.plan import Plan
from gonio.plan.model import Position
from gonio.store.records import PositionRecord

NOT_USABLE = int(Quality.OVER_RANGE | Quality.REFUSED | Quality.NOT_MEASURED | Quality.SKIPPED)
PAGE = 4096

Truth = Callable[[Position, float, float, np.ndarray], np.ndarray]
"""r of a position at its angles as read back, (m,) for the wavelengths in nm."""


@dataclass
class Tally:
    """What a campaign has seen."""

    kills: int = 0
    power_cuts: int = 0  # of the kills: after which journal and .h5 were torn as well
    scans: int = 0  # that came to their end
    positions: int = 0  # in them
    looked_at: int = 0  # .h5 files of killed scans
    rows: int = 0  # of positions in those
    half: int = 0  # of the rows: in the middle of their flush; what is not written yet is NaN
    lost: int = 0
    doubled: int = 0
    wrong: int = 0
    unopened: int = 0
    not_resumed: int = 0
    flagged: int = 0  # readings that say themselves that they are not usable
    phases: Counter[str] = field(default_factory=Counter)
    complaints: list[str] = field(default_factory=list)

    @property
    def bad(self) -> int:
        """Return how much of what must not happen has happened."""
        return self.lost + self.doubled + self.wrong + self.unopened + self.not_resumed

    def complain(self, text: str) -> None:
        """Keep what was wrong, the first of it in words."""
        if len(self.complaints) < 20:
            self.complaints.append(text)


@dataclass
class Examiner:
    """Compares what is on the disk with the plan and with what is true on the bench.

    `offset_deg` is what the axes of the bench are beside their targets; `relative` and `absolute` how far r
    may be from the truth.
    """

    plan: Plan
    truth: Truth
    tally: Tally
    offset_deg: tuple[float, float] = (0.0, 0.0)
    angle_deg: float = 0.011
    relative: float = 2e-3
    absolute: float = 2e-6
    _torn: int | None = None  # inode of the `.h5` that was torn, until another one is in its place

    def killed(self, path: Path, known: set[int]) -> set[int]:
        """Look at what a killed scan left, with plain h5py; return the positions that are safe.

        `known` are those that were safe after the kill before.
        """
        tally = self.tally
        safe = journaled(path)
        tally.lost += len(known - safe)
        if known - safe:
            tally.complain(f"positions {sorted(known - safe)} were in the journal and are gone")
        if not path.exists() or path.stat().st_ino == self._torn:
            return safe
        self._torn = None
        tally.looked_at += 1
        try:
            with h5py.File(path, "r") as file:
                data = {name: file["entry/data"][name][...] for name in COLUMNS}
        except (OSError, KeyError, RuntimeError) as error:
            tally.unopened += 1
            tally.complain(f"a killed scan's .h5 does not open: {error}")
            return safe
        rows = np.flatnonzero(np.isfinite(data["theta_i"])).tolist()
        tally.rows += len(rows)
        if not set(rows) <= safe:
            tally.wrong += 1
            tally.complain(f"rows {sorted(set(rows) - safe)} of the .h5 are not in the journal")
        half = 0
        for row in rows:
            half += self._row(
                row, {name: values[row] if name in ROWS else values for name, values in data.items()}
            )
        tally.half += half
        if half > 1:
            tally.wrong += 1
            tally.complain(f"{half} rows of one file are half written")
        return safe

    def tear(self, path: Path, rng: random.Random) -> None:
        """Do to the files what a power cut may do: the last record torn, pages of the `.h5` gone."""
        self.tally.power_cuts += 1
        _tear(path, rng)
        self._torn = path.stat().st_ino if path.exists() else None

    def finished(self, path: Path) -> None:
        """Look at a finished file."""
        tally, n = self.tally, self.plan.n_positions
        tally.scans += 1
        scan = gonio.load(path)
        index = scan.position.tolist()
        tally.positions += len(index)
        tally.doubled += len(index) - len(set(index))
        tally.lost += len(set(range(n)) - set(index))
        if not scan.finished or journal_path(path).exists():
            tally.wrong += 1
            tally.complain("a scan ended without being finished")
        if np.any(np.diff(scan.time_s[np.argsort(scan.position)]) <= 0):
            tally.wrong += 1
            tally.complain("the time of the scan does not go on")
        with h5py.File(path, "r") as file:
            kinds = file["entry/references/kind"].asstr()[...].tolist()
            when = file["entry/references/when"].asstr()[...].tolist()
            polarization = file["entry/references/polarization"].asstr()[...].tolist()
        keys = Counter(zip(kinds, when, polarization, strict=True))
        tally.doubled += sum(keys.values()) - len(keys)
        for row, i in enumerate(index):
            half = self._row(
                i,
                {
                    "theta_i": scan.theta_i_deg[row],
                    "theta_mes": scan.theta_mes_deg[row],
                    "polarization": str(scan.polarization[row]).encode(),
                    "wavelength": scan.wavelength_nm,
                    "r": scan.r[row],
                    "quality": scan.quality[row],
                },
            )
            if half:
                tally.wrong += 1
                tally.complain(f"position {i} of a finished file is half written")

    def _row(self, index: int, row: dict[str, Any]) -> bool:
        """Compare a row; say whether it is half written: the process died in the flush of that very row."""
        at, tally = self.plan.positions()[index], self.tally
        if not np.isfinite(row["theta_mes"]):
            return True
        there = (float(row["theta_i"]), float(row["theta_mes"]))
        off = max(
            abs(there[0] - at.theta_i_deg - self.offset_deg[0]),
            abs(there[1] - at.theta_mes_deg - self.offset_deg[1]),
        )
        if off > self.angle_deg or row["polarization"].decode() != at.polarization:
            tally.wrong += 1
            tally.complain(f"position {index} stands under {there}, {row['polarization']!r} instead of {at}")
            return False
        usable = (row["quality"] & NOT_USABLE) == 0
        tally.flagged += int(np.count_nonzero(~usable))
        truth = self.truth(at, *there, row["wavelength"])
        half = bool(np.all(np.isnan(row["r"])) and np.any(usable))
        bad = usable & ~(np.abs(row["r"] - truth) <= self.relative * truth + self.absolute) & (not half)
        if np.any(bad):
            tally.wrong += 1
            tally.complain(f"position {index}: r = {row['r'][bad]} instead of {truth[bad]}")
        return half


ROWS = ("theta_i", "theta_mes", "polarization", "r", "quality")
COLUMNS = (*ROWS, "wavelength")


def journaled(path: Path) -> set[int]:
    """Return the positions whose records are whole in the journal."""
    try:
        data = journal_path(path).read_bytes()
    except FileNotFoundError:
        return set()
    records = [decode(payload) for _, payload in frames(data)]
    return {record.index for record in records if isinstance(record, PositionRecord)}


def _tear(path: Path, rng: random.Random) -> None:
    journal = journal_path(path)
    data = journal.read_bytes()
    ends = [end for end, _ in frames(data)]
    if len(ends) > 1:  # the header was confirmed before anything else happened
        cut = rng.randrange(ends[-2], ends[-1])
        kept = data[:cut] + bytes(rng.choice((0, len(data) - cut)))
        journal.write_bytes(kept)
    if path.exists():
        content = bytearray(path.read_bytes())
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(0, len(content), PAGE)
            content[at : at + PAGE] = bytes(len(content[at : at + PAGE]))
        path.write_bytes(content[: rng.choice((len(content), rng.randrange(len(content))))])

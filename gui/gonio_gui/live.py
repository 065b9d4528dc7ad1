"""What has been measured so far, as arrays that the drawings read.  No Qt.

Only the GUI thread touches a `LiveScan`; the scan's thread hands over records through a queue.  r of a
position is corrected with the references known at that moment; the file is corrected again at the end of the
scan with all of them, and `replace` then takes over the stored values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.devices import FloatArray, Polarization
from gonio.overlap import block_starts
from gonio.overlap import changes_nm as detector_changes_nm
from gonio.plan import Plan, Position, channels, resolved
from gonio.rig import RigConfig
from gonio.store import Scan
from gonio.store.records import PositionRecord, ReferenceRecord
from gonio.store.reduction import Reduction
from gonio.store.scan import UNUSABLE

NANOMETRES_OF_INTEREST = 550.0
"""Wavelength the polar plot opens at, if the plan has it: the eye's maximum."""


@dataclass(frozen=True, slots=True)
class SweepKey:
    """One curve of the polar plot."""

    theta_i_deg: float
    polarization: Polarization


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """The spectrum of one position; arrays (m,)."""

    index: int
    theta_i_deg: float
    theta_mes_deg: float
    polarization: str
    wavelength_nm: FloatArray
    r: FloatArray


class LiveScan:
    """The measured part of one plan.

    Parameters
    ----------
    plan
        What is measured.
    rig
        Decides where the detector changes.
    """

    def __init__(self, plan: Plan, rig: RigConfig) -> None:
        columns = channels(plan, rig)
        plan = resolved(plan, rig)  # positions are numbered in the order in which they are measured
        self.plan = plan
        self.wavelength_nm = columns.wavelength_nm
        self.detector_index = columns.detector_index
        self._positions = plan.positions()
        n, m = len(self._positions), len(self.wavelength_nm)
        # rows are only read where `measured`: untouched pages of a large plan cost no memory
        self._r = np.empty((n, m))
        self._theta_i_deg = np.full(n, np.nan)
        self._theta_mes_deg = np.full(n, np.nan)
        self.measured: NDArray[np.bool_] = np.zeros(n, dtype=np.bool_)
        self.last: int | None = None
        self.revision: dict[str, int] = dict.fromkeys(plan.polarization, 0)  # grow with every change
        self._rows: dict[SweepKey, NDArray[np.intp]] = _rows_by_sweep(self._positions)
        self._references: list[ReferenceRecord] = []
        self._reduction = Reduction([], self.detector_index)

    @property
    def sweeps(self) -> tuple[SweepKey, ...]:
        """Curves in measuring order."""
        return tuple(self._rows)

    @property
    def incidences_deg(self) -> tuple[float, ...]:
        """Incidences in measuring order, once each."""
        return tuple(dict.fromkeys(key.theta_i_deg for key in self._rows))

    @property
    def detector_change_nm(self) -> tuple[float, ...]:
        """Wavelengths halfway between neighbours of different detectors."""
        return detector_changes_nm(self.wavelength_nm, self.detector_index)

    def column_near(self, wavelength_nm: float) -> int:
        """Return the index of the wavelength nearest to one asked for."""
        return int(np.argmin(np.abs(self.wavelength_nm - wavelength_nm)))

    # -- growing ----------------------------------------------------------------------------------------

    def add_reference(self, record: ReferenceRecord) -> None:
        """Use a reference for the positions that follow."""
        self._references.append(record)
        self._reduction = Reduction(self._references, self.detector_index)

    def add_position(self, record: PositionRecord) -> None:
        """Add one measured position."""
        reduced = self._reduction.apply(
            record.signal_v[None, :],
            record.signal_sd_v[None, :],
            np.array([record.averages]),
            record.time_s[None, :],
            [record.polarization],
        )
        bad = (record.quality & np.uint16(UNUSABLE)) != 0
        self._store(
            record.index, record.theta_i_deg, record.theta_mes_deg, np.where(bad, np.nan, reduced.r[0])
        )
        self.last = record.index

    def replace(self, scan: Scan) -> None:
        """Take the values of a stored scan of the same plan in place of those there are."""
        if scan.n_planned != len(self.measured) or scan.r.shape[1] != len(self.wavelength_nm):
            raise ValueError(
                f"{scan.path} holds {scan.n_planned} positions x {scan.r.shape[1]} wavelengths, the plan "
                f"{len(self.measured)} x {len(self.wavelength_nm)}"
            )
        r = np.where(scan.usable, scan.r, np.nan)
        for row, index in enumerate(scan.position.tolist()):
            self._store(index, float(scan.theta_i_deg[row]), float(scan.theta_mes_deg[row]), r[row])
        if len(scan.position):
            self.last = int(scan.position[-1])

    def _store(self, index: int, theta_i_deg: float, theta_mes_deg: float, r: FloatArray) -> None:
        self._r[index] = r
        self._theta_i_deg[index] = theta_i_deg
        self._theta_mes_deg[index] = theta_mes_deg
        self.measured[index] = True
        self.revision[self._positions[index].polarization] += 1

    # -- reading ----------------------------------------------------------------------------------------

    def curve(self, key: SweepKey, column: int) -> tuple[FloatArray, FloatArray]:
        """Return (theta_o_deg, r), each (k,), of the measured positions of a sweep at one wavelength.

        Angles are those read back, in ascending order; NaN in r means that there is no value.
        """
        rows = self._rows[key]
        rows = rows[self.measured[rows]]
        theta_o_deg = self._theta_mes_deg[rows] - self._theta_i_deg[rows]
        order = np.argsort(theta_o_deg, kind="stable")
        return theta_o_deg[order], self._r[rows[order], column]

    def last_spectrum(self) -> Spectrum | None:
        """Return the spectrum of the position measured last, or None before the first."""
        if self.last is None:
            return None
        return Spectrum(
            index=self.last,
            theta_i_deg=float(self._theta_i_deg[self.last]),
            theta_mes_deg=float(self._theta_mes_deg[self.last]),
            polarization=self._positions[self.last].polarization,
            wavelength_nm=self.wavelength_nm,
            r=self._r[self.last],
        )


def _rows_by_sweep(positions: Sequence[Position]) -> dict[SweepKey, NDArray[np.intp]]:
    found: dict[SweepKey, list[int]] = {}
    for position in positions:
        found.setdefault(SweepKey(position.theta_i_deg, position.polarization), []).append(position.index)
    return {key: np.array(rows, dtype=np.intp) for key, rows in found.items()}


def broken_at(
    wavelength_nm: FloatArray, values: FloatArray, changes_nm: Sequence[float]
) -> tuple[FloatArray, FloatArray]:
    """Return a curve with a gap (NaN) at every detector change: no line joins two detectors."""
    where = block_starts(wavelength_nm)
    if not len(where):
        where = np.searchsorted(wavelength_nm, np.asarray(changes_nm, dtype=np.float64))
    return np.insert(wavelength_nm, where, changes_nm), np.insert(values, where, np.nan)

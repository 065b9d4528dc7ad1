"""What was decided and measured so far, as a source of positions is told: made from the records alone.

Live and from the journal the records come in the same order, and each position is corrected by itself, so
that a source of a resumed scan sees the same numbers bit for bit.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gonio.devices import FloatArray
from gonio.plan.model import Position
from gonio.plan.source import Measured
from gonio.store.latest import LatestReduction
from gonio.store.records import DecisionRecord, PositionRecord, Record, ReferenceRecord

_T = TypeVar("_T", bound=np.generic)


class History:
    """The positions of a source, decided and measured.

    Attributes
    ----------
    decided
        What the source asked for, in order.
    measured
        What was measured at them, from the first one on without a gap.
    """

    def __init__(self, wavelength_nm: FloatArray, detector_index: NDArray[np.uint8]) -> None:
        self.decided: list[Position] = []
        self.measured: list[Measured] = []
        self._wavelength_nm = _frozen(wavelength_nm)
        self._latest = LatestReduction(detector_index)
        self._known: dict[int, Position] = {}  # some may stand behind a record that the disk has damaged
        self._waiting: dict[int, Measured] = {}  # likewise

    def note(self, record: Record) -> bool:
        """Take a record into account; say whether it counts: a position without its decision does not."""
        if isinstance(record, ReferenceRecord):
            self._latest.add(record)
        elif isinstance(record, DecisionRecord):
            self._known[record.index] = Position(
                record.index, record.theta_i_deg, record.theta_mes_deg, record.polarization
            )
            while (position := self._known.get(len(self.decided))) is not None:
                self.decided.append(position)
        elif isinstance(record, PositionRecord):
            if record.index not in self._known:
                return False
            self._waiting[record.index] = self._seen(record)
            while (found := self._waiting.pop(len(self.measured), None)) is not None:
                self.measured.append(found)
        return True

    def _seen(self, record: PositionRecord) -> Measured:
        reduced = self._latest.now().apply(
            record.signal_v[None],
            record.signal_sd_v[None],
            np.broadcast_to(record.averages, (1, len(record.signal_v))),
            record.time_s[None],
            [record.polarization],
        )
        return Measured(
            position=self._known[record.index],
            theta_i_deg=record.theta_i_deg,
            theta_mes_deg=record.theta_mes_deg,
            wavelength_nm=self._wavelength_nm,
            r=_frozen(reduced.r[0]),
            r_sd=_frozen(reduced.r_sd[0]),
            quality=_frozen(record.quality),
        )


def _frozen(values: NDArray[_T]) -> NDArray[_T]:
    """Return a copy that a source cannot change."""
    copy = np.array(values)
    copy.flags.writeable = False
    return copy

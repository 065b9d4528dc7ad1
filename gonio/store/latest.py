"""The correction of a position at the instant it is measured: with the references there are until then."""

from __future__ import annotations

from collections import defaultdict, deque

import numpy as np
from numpy.typing import NDArray

from gonio.store.records import ReferenceRecord
from gonio.store.reduction import Reduction

_LATEST = 8  # references of one kind: what a long scan's cost per position must not grow with


class LatestReduction:
    """The `Reduction` with the latest references of each kind and polarization; see `add` and `now`."""

    def __init__(self, detector_index: NDArray[np.uint8]) -> None:
        self._detector_index = detector_index
        self._latest: dict[tuple[str, str], deque[ReferenceRecord]] = defaultdict(
            lambda: deque(maxlen=_LATEST)
        )
        self._reduction: Reduction | None = None  # made when a position needs it after a new reference

    def add(self, reference: ReferenceRecord) -> None:
        """Take a reference into account from now on."""
        self._latest[reference.kind, reference.polarization].append(reference)
        self._reduction = None

    def now(self) -> Reduction:
        """Return the reduction with the references so far."""
        if self._reduction is None:
            latest = [reference for few in self._latest.values() for reference in few]
            self._reduction = Reduction(latest, self._detector_index)
        return self._reduction

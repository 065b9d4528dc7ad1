"""Collect cyclic garbage in the GUI thread only.

Python collects in whichever thread happens to allocate.  If that is the scan's thread and a cycle holds a Qt
object, the object is destroyed in the wrong thread and the process crashes.  So automatic collection is off
while the window is open, and a timer of the GUI thread does what the interpreter would have done.
"""

from __future__ import annotations

import gc

from PySide6.QtCore import QObject, QTimer

PERIOD_MS = 500


class GuiThreadCollector(QObject):
    """Take over garbage collection until `release`."""

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._was_enabled = gc.isenabled()
        gc.disable()
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._collect)
        self._timer.start(PERIOD_MS)

    def _collect(self) -> None:
        """Collect the oldest generation that is due, as the interpreter does."""
        counts, thresholds = gc.get_count(), gc.get_threshold()
        for generation in (2, 1, 0):
            if thresholds[generation] and counts[generation] > thresholds[generation]:
                gc.collect(generation)
                return

    def release(self) -> None:
        """Give collection back to the interpreter."""
        self._timer.stop()
        if self._was_enabled:
            gc.enable()

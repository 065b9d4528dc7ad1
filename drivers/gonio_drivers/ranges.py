"""Which amplifier range suits a signal: not overloaded, and not so coarse that its resolution matters."""

from __future__ import annotations

from collections.abc import Sequence

from gonio.devices import Beam

HEADROOM = 2.5  # full scale over signal, when a range is chosen: room for noise and for the next wavelength
TOO_INSENSITIVE = 20.0
"""A signal below full scale / 20 deserves a finer range.

There the resolution, full scale / 32768, is 0.06 % of the signal, an rms error of 0.018 %.  The gap between
this and `HEADROOM` keeps a slowly changing spectrum from switching back and forth."""


class RangeMemory:
    """Remembers by beam and detector which range worked; begins with the largest, which harms nothing.

    Parameters
    ----------
    full_scale_v
        The ranges, ascending.
    smallest_v
        Least full scale that may be chosen.
    """

    def __init__(self, full_scale_v: Sequence[float], *, smallest_v: float) -> None:
        self._full_scale_v = full_scale_v
        self._lowest = next(i for i, v in enumerate(full_scale_v) if v >= smallest_v * (1 - 1e-9))
        self._remembered: dict[tuple[Beam, int], int] = {}

    def start(self, beam: Beam, detector: int) -> int:
        """Return the index of the range to begin with."""
        return self._remembered.get((beam, detector), len(self._full_scale_v) - 1)

    def remember(self, beam: Beam, detector: int, index: int) -> None:
        """Keep a range that gave a good reading."""
        self._remembered[beam, detector] = index

    def forget(self) -> None:
        """Begin with the largest range again: what was remembered may have been found in a failure."""
        self._remembered.clear()

    def better(self, index: int, magnitude_v: float, *, overload: bool) -> int:
        """Return the range for a signal that was read in range `index`; `index` itself if that is good
        enough.

        An overloaded reading does not say how large the signal is: the next range but one is five times less
        sensitive (ranges go 1, 2, 5).
        """
        if overload:
            return min(index + 2, len(self._full_scale_v) - 1)
        if magnitude_v * TOO_INSENSITIVE >= self._full_scale_v[index] or index <= self._lowest:
            return index
        fitting = next(i for i, v in enumerate(self._full_scale_v) if v >= HEADROOM * magnitude_v)
        return min(index, max(self._lowest, fitting))

"""Which of several basins of chi2 is the deepest?  A start from every summit that a grid shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.separable import Separable
from gonio.fitting.solve import refine

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

_MOST = 3  # summits of one profile that are tried
_FLAT = 1e-9  # relative rise that makes a summit; on a plateau rounding alone makes more of them
_STEPS = 40


def summits(gain: FloatArray) -> list[tuple[IndexArray, IndexArray, IndexArray]]:
    """Return the summits of a grid other than the highest: rows of (problem, second index, first index).

    Parameters
    ----------
    gain
        (G0, G1, m): what each grid point takes off chi2.

    Returns
    -------
    list
        Of triples of equally long arrays.  The summits are those of the profiles along either parameter, the
        maximum over the other; of each profile the highest few.
    """
    found = []
    for axis in (0, 1):
        profile, other = np.max(gain, axis=axis), np.argmax(gain, axis=axis)
        edge = np.full((1, profile.shape[1]), -np.inf)
        before, after = np.concatenate([edge, profile[:-1]]), np.concatenate([profile[1:], edge])
        rise = _FLAT * np.abs(profile)
        peaks = np.where((profile > before + rise) & (profile >= after) & (profile > 0.0), profile, -np.inf)
        order = np.argsort(-peaks, axis=0)
        for rank in range(1, _MOST):
            columns = np.flatnonzero(np.take_along_axis(peaks, order[rank : rank + 1], axis=0)[0] > -np.inf)
            if columns.size:
                own = order[rank, columns]
                across = other[own, columns]
                found.append((columns, own, across) if axis == 0 else (columns, across, own))
    return found + _shoulders(np.max(gain, axis=0), np.argmax(gain, axis=0))


def _shoulders(profile: FloatArray, other: IndexArray) -> list[tuple[IndexArray, IndexArray, IndexArray]]:
    """Return grid points before the plateau at the far end of a profile, (G1, m), where that is the highest.

    A lobe inside one aperture looks the same however narrow it is; a slightly wider, better one may lie
    between two points of the grid just before.
    """
    last = profile[-1]
    flat = np.abs(profile - last) <= _FLAT * np.abs(last)
    length = np.sum(np.cumprod(flat[::-1], axis=0), axis=0)
    first = len(profile) - length
    there = (length > 1) & (np.argmax(profile, axis=0) >= first - 1) & (last > 0.0)
    found = []
    for back in range(1, 1 + _MOST):
        columns = np.flatnonzero(there & (first >= back))
        if columns.size:
            own = first[columns] - back
            found.append((columns, own, other[own, columns]))
    return found


def best_descent(
    model: Separable,
    y: FloatArray,
    w: FloatArray,
    best: FloatArray,
    others: list[tuple[IndexArray, FloatArray]],
) -> FloatArray:
    """Return where to begin, (m, k): `best`, or the end of the descent from it or from another start.

    `others` are problems by their numbers with another start each.  Problems without another start are not
    searched here.
    """
    if not others:
        return best
    rows = np.unique(np.concatenate([columns for columns, _ in others]))
    result, count = best.copy(), len(model.linear)
    lowest = np.full(len(best), np.inf)
    for columns, begin in [(rows, best[rows]), *others]:
        end = refine(model, y[:, columns], w[:, columns], begin, iterations=_STEPS)
        better = end.chi2 < lowest[columns]
        result[columns[better]] = end.basic[better, count:]
        lowest[columns[better]] = end.chi2[better]
    return result

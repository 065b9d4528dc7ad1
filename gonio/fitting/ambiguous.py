"""Is there another index that P readings accept as well?

R_p falls to zero at Brewster's angle and rises again: between two incidences its ratio takes most values
twice, for an index on either side.  S readings, whose R rises steadily, decide; P readings alone may not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.columns import BoolArray, FitModel
from gonio.fitting.solve import Solution, refine

FloatArray = NDArray[np.float64]

_INDICES = np.concatenate(
    [1.0 + np.geomspace(1e-3, 0.15, 6), np.arange(1.2, 2.0, 0.04), [2.2, 2.6, 3.0, 3.6, 4.5, 6.0, 10.0]]
)
_ROUNDING = 1e-20  # of the readings squared


def other_index(
    model: FitModel,
    y: FloatArray,
    w: FloatArray,
    optimum: Solution,
    lower: FloatArray,
    upper: FloatArray,
    variance: FloatArray,
    rows: BoolArray,
) -> FloatArray:
    """Return an index outside the interval that fits as well, (m,); NaN where there is none.

    As well is ``chi2 - chi2_min <= s^2``, at most one standard error away, where the interval of 95 % ends at
    two.

    Parameters
    ----------
    lower, upper
        Interval of n2, (m,).
    variance
        s^2 of weighted residuals, (m,).
    rows
        Wavelengths to be examined, (m,).
    """
    found = np.full(len(rows), np.nan)
    pick = np.flatnonzero(rows)
    if not pick.size:
        return found
    at, linear = model.shape.index("n2"), len(model.linear)
    y, w = y[:, pick], w[:, pick]
    begin = np.repeat(optimum.basic[None, pick, linear:], len(_INDICES), axis=0)
    begin[:, :, at] = np.clip(_INDICES, model.low[at], model.high[at])[:, None]
    profile = np.stack([refine(model, y, w, x, free=False, iterations=1).chi2 for x in begin])
    edge = np.full((1, pick.size), np.inf)
    lowest = profile < np.concatenate([edge, profile[:-1]])
    lowest &= profile <= np.concatenate([profile[1:], edge])
    accepted = optimum.chi2[pick] + variance[pick] + _ROUNDING * np.sum(w * y * y, axis=0)
    for start, here in zip(begin, lowest, strict=True):
        columns = np.flatnonzero(here)
        if not columns.size:
            continue
        end = refine(model, y[:, columns], w[:, columns], start[columns])
        n2, of = end.basic[:, linear + at], pick[columns]
        inside = (n2 > lower[of] - 1e-6) & (n2 < upper[of] + 1e-6)
        good = ~inside & (end.chi2 <= accepted[columns])
        found[of[good]] = n2[good]
    return found

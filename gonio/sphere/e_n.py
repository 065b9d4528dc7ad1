"""Do two results agree within what they claim?  The one place where E_n is computed.

The degree of equivalence of ISO/IEC 17043 (formerly guide 43),

    E_n = (x - X) / sqrt(U_x**2 + U_X**2),

with expanded uncertainties at 95 %, of which either may be a sum of squares of independent parts.
``abs(E_n) <= 1`` says that the two agree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def e_n(difference: ArrayLike, *expanded: ArrayLike) -> FloatArray:
    """Return E_n of a difference, broadcast with the independent parts of its expanded uncertainty.

    NaN where the difference or a part is unknown, and where no uncertainty at all is claimed.
    """
    squares = [np.square(np.asarray(part, np.float64)) for part in expanded]
    total = np.sqrt(np.sum(np.broadcast_arrays(*squares), axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.asarray(difference, np.float64) / total
    return np.asarray(np.where(np.isfinite(found), found, np.nan))

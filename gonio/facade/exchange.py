"""How much light do the patches exchange, and how sure is that?

With E the irradiance and M the diffuse exitance of n patches, W/m2,

    M = M0 + D M,    E = E0 + T M,

where E0 arrives from sun, sky and lobes, M0 is what of it is reflected diffusely, T holds the form factors
and D the same weighted with k_d.  All reflections are in the solution; nothing is cut off.

The standard error follows from the replicas by linearisation: replica r of all inputs misses the mean
solution by the residual ``M0_r + D_r M - M``, which the exchange itself amplifies by ``(1 - D)^-1``.  That
is exact to first order, and the bias of solving with averaged inputs is of second order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from gonio.errors import SceneError
from gonio.facade.layout import FloatArray, IntArray
from gonio.facade.transport import Matrix

_ACCURACY = 1e-11
_INFLUENCE = 0.02  # relative accuracy of what only serves standard errors


class Exchange:
    """The system ``(1 - D) x = b`` of one band.

    Parameters
    ----------
    diffuse
        D, (n, n).

    Raises
    ------
    SceneError
        When solved: no solution, since a closed space reflects all of the light in it.
    """

    def __init__(self, diffuse: Matrix) -> None:
        self._size = diffuse.shape[0]
        self._matrix = diffuse
        self._factors: tuple[FloatArray, NDArray[Any]] | None = None
        if isinstance(diffuse, np.ndarray) and self._size > 0:
            system = np.eye(self._size) - diffuse
            self._factors = linalg.lu_factor(system, check_finite=False)

    def solve(self, given: FloatArray) -> FloatArray:
        """Return x for one right-hand side, (n,), to 1e-11."""
        if not np.any(given):
            return np.zeros_like(given)
        if self._factors is not None:
            found = linalg.lu_solve(self._factors, given, check_finite=False)
        else:
            system = sparse.eye_array(self._size, format="csr") - self._matrix
            found, failed = sparse_linalg.gmres(
                system, given, x0=given, rtol=_ACCURACY, atol=0.0, restart=60, maxiter=50
            )
            if failed:
                found = np.full_like(given, np.nan)
        if not np.all(np.isfinite(found)):
            raise SceneError(
                "the light in this scene does not come to an end: a closed space reflects all of it; "
                "give its surfaces an albedo below 1, or open it"
            )
        return np.asarray(found)

    def residual(self, found: FloatArray, given: FloatArray) -> float:
        """Return the largest component of ``given - (1 - D) found``, in units of the largest of `given`."""
        largest = float(np.max(np.abs(given), initial=0.0))
        missed = float(np.max(np.abs(given - found + self._matrix @ found), initial=0.0))
        return missed / largest if largest > 0.0 else missed

    def amplified(self, residuals: FloatArray) -> FloatArray:
        """Return x for many right-hand sides (n, m), to the accuracy that standard errors need."""
        if self._factors is not None:
            return np.asarray(linalg.lu_solve(self._factors, residuals, check_finite=False))
        found = residuals.copy()
        step = residuals
        for _ in range(2000):
            step = self._matrix @ step
            found += step
            if np.max(np.abs(step), initial=0.0) <= _INFLUENCE * np.max(np.abs(found), initial=0.0):
                break
        return found


def merged(matrix: Matrix, group: IntArray, area: FloatArray) -> Matrix:
    """Return the transport between groups of patches: rows averaged by area, columns summed.

    `group` (n,) is the number of the group of each patch.
    """
    count, n = int(group.max()) + 1, len(group)
    members = sparse.csr_array((np.ones(n), (group, np.arange(n))), shape=(count, n))
    average = 1.0 / np.maximum(np.asarray(members @ area), 1e-300)
    if isinstance(matrix, np.ndarray):
        full = members.toarray()
        return np.asarray((average[:, None] * full * area) @ matrix @ full.T)
    weights = sparse.diags_array(average) @ members @ sparse.diags_array(area)
    return sparse.csr_array(weights @ matrix @ members.T)


def averaged(values: FloatArray, group: IntArray, area: FloatArray) -> FloatArray:
    """Return the averages by area over the groups, (groups,)."""
    total = np.bincount(group, weights=area)
    return np.asarray(np.bincount(group, weights=area * values) / np.maximum(total, 1e-300))

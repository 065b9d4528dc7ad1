"""What covariance does a Jacobian leave to the parameters?  mse (J'J)^-1 without ever forming J'J.

J = Q R with columns scaled to one, so that (J'J)^-1 = R^-1 R^-T keeps as many digits as J has to give; the
normal matrix would lose twice as many.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
_EPS = float(np.finfo(float).eps)


def inverse_gram(j: FloatArray) -> FloatArray:
    """Return ``(J'J)^-1``, (..., p, p), of Jacobians (..., n, p) whose rows carry the root of their weight.

    NaN where the columns are one another's combination to working precision, or not numbers; the other
    problems are not touched by it.
    """
    n, p = j.shape[-2:]
    good = np.all(np.isfinite(j), axis=(-2, -1)) & (n >= p)
    if not p or not np.any(good):
        return np.full((*j.shape[:-2], p, p), np.nan)
    size = _norm(np.where(good[..., None, None], j, 0.0))
    good &= np.all(size > 0.0, axis=-1)
    whole = size > 0.0
    unit = np.where(good[..., None, None], j, 0.0) / np.where(whole, size, 1.0)[..., None, :]
    r = np.asarray(np.linalg.qr(np.where(good[..., None, None], unit, np.eye(n, p)), mode="r"))
    spread = np.linalg.svd(r, compute_uv=False)
    good &= spread[..., -1] > _EPS * max(n, p) * spread[..., 0]
    inverse = (
        np.linalg.inv(np.where(good[..., None, None], r, np.eye(p))) / np.where(whole, size, 1.0)[..., None]
    )
    result = inverse @ np.swapaxes(inverse, -1, -2)
    return np.where(good[..., None, None], result, np.nan)


def _norm(j: FloatArray) -> FloatArray:
    """Return the norms of the columns, (..., p); their squares may be too large or too small to hold."""
    largest = np.max(np.abs(j), axis=-2, initial=0.0)
    unit = np.where(largest > 0.0, largest, 1.0)
    return np.asarray(largest * np.sqrt(np.sum((j / unit[..., None, :]) ** 2, axis=-2)))

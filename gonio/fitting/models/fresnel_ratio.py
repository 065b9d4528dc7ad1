"""The Fresnel ratio q = R(c)/R(1), c the cosine of incidence, and its first two derivatives by the index.

With ``root = sqrt(n^2 - 1 + c^2)``: for s ``q = ((n + 1)/(c + root))^4``; for p ``q = A^2``, ``A = (n + 1)^2
((n^2 + 1) c^2 - 1) / (n^2 c + root)^2``, which is zero at Brewster's angle.  Both stay finite at n = 1, where
R vanishes.  See `gonio.fresnel`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def ratio_s(n: FloatArray, c: FloatArray, order: int) -> tuple[FloatArray, ...]:
    """Return q, dq/dn, d2q/dn2 (up to `order`) of s light, broadcast; needs ``n > 1`` or ``c > 0``."""
    root = np.sqrt((n - 1.0) * (n + 1.0) + c**2)
    below = c + root
    square = ((n + 1.0) / below) ** 2
    q = square**2
    if order == 0:
        return (q,)
    slope = n / root
    first = 4.0 * (1.0 / (n + 1.0) - slope / below)  # of the logarithm
    if order == 1:
        return q, q * first
    curve = (1.0 - slope**2) / root
    second = 4.0 * ((slope / below) ** 2 - curve / below - 1.0 / (n + 1.0) ** 2)
    return q, q * first, q * (first**2 + second)


def ratio_p(n: FloatArray, c: FloatArray, order: int) -> tuple[FloatArray, ...]:
    """Return q, dq/dn, d2q/dn2 (up to `order`) of p light, broadcast; needs ``n > 1`` or ``c > 0``."""
    root = np.sqrt((n - 1.0) * (n + 1.0) + c**2)
    below = n**2 * c + root
    scale = ((n + 1.0) / below) ** 2
    above = (n**2 + 1.0) * c**2 - 1.0
    a = scale * above
    if order == 0:
        return (a**2,)
    slope = n / root
    below_n, above_n = 2.0 * n * c + slope, 2.0 * n * c**2
    log_n = 2.0 * (1.0 / (n + 1.0) - below_n / below)  # of log(scale)
    a_n = scale * (above_n + above * log_n)
    if order == 1:
        return a**2, 2.0 * a * a_n
    below_nn = 2.0 * c + (1.0 - slope**2) / root
    log_nn = 2.0 * ((below_n / below) ** 2 - below_nn / below - 1.0 / (n + 1.0) ** 2)
    a_nn = scale * (2.0 * c**2 + 2.0 * above_n * log_n + above * (log_n**2 + log_nn))
    return a**2, 2.0 * a * a_n, 2.0 * (a_n**2 + a * a_nn)


def normal_reflectance(n: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``R(1) = ((n - 1)/(n + 1))^2`` and its first two derivatives."""
    value = ((n - 1.0) / (n + 1.0)) ** 2
    return value, 4.0 * (n - 1.0) / (n + 1.0) ** 3, 8.0 * (2.0 - n) / (n + 1.0) ** 4


def distinct(values: FloatArray) -> tuple[FloatArray, NDArray[np.intp] | slice]:
    """Return the distinct values where a grid or a shared parameter repeats them, and how to spread them."""
    if values.size < 2:
        return values, slice(None)
    few, inverse = np.unique(values, return_inverse=True)
    return (few, inverse) if 2 * few.size <= values.size else (values, slice(None))

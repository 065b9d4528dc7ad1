"""The lobe's reading at every position, and its derivatives, for any alpha at the cost of a matrix product.

The receiver's lobe integral is a smooth function of ``log(alpha)``.  It is expanded once per scan in
Chebyshev polynomials; afterwards all wavelengths and all positions are one product ``(m, K) @ (K, n)``.
"""

from __future__ import annotations

import functools
from collections.abc import Hashable
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import InstrumentFunction, Receiver

FloatArray = NDArray[np.float64]

ALPHA_MIN, ALPHA_MAX = 0.1, 1e6
"""Range of the fit.  Below, the lobe is the uniform half-sphere; above, it is 0.06 deg wide, a mirror's."""

_DEGREE = 144


@dataclass(frozen=True, slots=True)
class LobeTable:
    """Chebyshev coefficients of the lobe term of n positions.

    The tabulated function is the lobe integral divided by `_growth`, its smooth envelope, so that it is of
    order one over the whole range.  The error of `evaluate` is below 1e-12 of the largest reading at that
    alpha, that of the derivatives below 1e-10 and 1e-7 (tested).
    """

    coefficients: FloatArray  # (3, K, n): of the function and of its first two derivatives in log(alpha)
    solid_angle_sr: float
    growth: float

    @classmethod
    def of(cls, receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray) -> LobeTable:
        """Tabulate the lobe term of a receiver at n positions, (n,) angles each, degrees.

        The last few tables are kept: a scan is fitted more than once.
        """
        return cls._each(receiver, theta_i_deg, theta_o_deg, 0)[0]

    @classmethod
    def moments_of(
        cls, receiver: InstrumentFunction, theta_i_deg: FloatArray, theta_o_deg: FloatArray, count: int
    ) -> tuple[LobeTable, ...]:
        """Tabulate the lobe times the Legendre polynomials of the beam's tilt, see `lobe_moments`."""
        return cls._each(receiver, theta_i_deg, theta_o_deg, count)

    @classmethod
    def _each(
        cls, receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray, moments: int
    ) -> tuple[LobeTable, ...]:
        position, inverse = np.unique(np.stack([theta_i_deg, theta_o_deg]), axis=1, return_inverse=True)
        tables = _coefficients(cast(Hashable, receiver), position.tobytes(), moments)
        omega, growth = receiver.solid_angle_sr, receiver.lobe_growth
        return tuple(cls(np.ascontiguousarray(t[:, :, inverse.ravel()]), omega, growth) for t in tables)

    def evaluate(self, log_alpha: FloatArray, *, derivatives: int = 0) -> tuple[FloatArray, ...]:
        """Return the lobe term (n, m) at m values of log(alpha), and its derivatives by log(alpha)."""
        low, high = np.log(ALPHA_MIN), np.log(ALPHA_MAX)
        z = np.clip((2.0 * log_alpha - low - high) / (high - low), -1.0, 1.0)
        basis = np.cos(np.arange(_DEGREE)[:, None] * np.arccos(z))  # (K, m)
        g, g1, g2 = _growth(log_alpha, self.solid_angle_sr, self.growth)
        f = [self.coefficients[order].T @ basis for order in range(derivatives + 1)]
        result = [f[0] * g]
        if derivatives > 0:
            result.append(f[1] * g + f[0] * g1)
        if derivatives > 1:
            result.append(f[2] * g + 2.0 * f[1] * g1 + f[0] * g2)
        return tuple(result)


@functools.lru_cache(maxsize=8)
def _coefficients(key: Hashable, positions: bytes, moments: int) -> tuple[FloatArray, ...]:
    """Return the coefficients (3, K, n) at different positions, rows of theta_i and of theta_o.

    `key` is the receiver.  One table of its lobe integral, or one of each of so many `moments`.
    """
    receiver = cast(Receiver, key)
    theta_i, theta_o = np.frombuffer(positions).reshape(2, -1)
    k = np.arange(_DEGREE)
    angle = np.pi * (k + 0.5) / _DEGREE
    low, high = np.log(ALPHA_MIN), np.log(ALPHA_MAX)
    log_alpha = 0.5 * (low + high) + 0.5 * (high - low) * np.cos(angle)
    where = np.exp(log_alpha), theta_i - theta_o, theta_o, theta_i
    if isinstance(receiver, InstrumentFunction) and moments > 0:
        values = receiver.lobe_moments(*where, count=moments)
    else:
        values = receiver.lobe_table(*where)[None]
    scale, result = 2.0 / (high - low), []
    for table in values / _growth(log_alpha, receiver.solid_angle_sr, receiver.lobe_growth)[0][:, None]:
        stack = np.zeros((3, _DEGREE, theta_i.size))
        stack[0] = 2.0 / _DEGREE * np.cos(np.outer(k, angle)) @ table
        stack[0, 0] *= 0.5
        stack[1, :-1] = np.polynomial.chebyshev.chebder(stack[0], 1, scl=scale)
        stack[2, :-2] = np.polynomial.chebyshev.chebder(stack[0], 2, scl=scale)
        stack.flags.writeable = False
        result.append(stack)
    return tuple(result)


def _growth(
    log_alpha: FloatArray, solid_angle_sr: float, growth: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the envelope ``(alpha + 1) / (alpha0 + alpha + 1)^(1 - growth)`` and its derivatives.

    A wide lobe's reading is ``(alpha + 1)/(2 pi) Omega``; it levels off, or goes on as ``alpha^growth``,
    where the lobe becomes narrower than the aperture, near ``alpha0 = 2 pi / Omega``.
    """
    a = np.exp(log_alpha)
    wide, narrow, p = 1.0 + a, 1.0 + a + 2.0 * np.pi / solid_angle_sr, 1.0 - growth
    g = wide * narrow**-p
    log_slope = a / wide - p * a / narrow
    log_curve = a / wide**2 - p * a * (narrow - a) / narrow**2
    return g, g * log_slope, g * (log_slope**2 + log_curve)

"""The column of coupled diffuse light: what enters the body, and what of it leaves into the aperture.

    B_x(n2) = (1 - R_x(n2, theta_i)) T(n2) / (1 - Rm(n2)),   T = ∫ (1 - R_u(n2, theta)) cos(theta)/pi dOmega

over the aperture, Rm the hemispherical mean of R_u; see `gonio.brdf.coupled`.  With R = R(0) q and ``T = D -
R(0) E``, ``E = ∫ q_u cos(theta)/pi dOmega`` is tabulated in Chebyshev polynomials of log(n2 - 1), in which q
is analytic up to ``± i 3 pi / 4``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.angles import cos_deg
from gonio.aperture import Receiver
from gonio.brdf.hemisphere import tanh_sinh
from gonio.brdf.quadrature import gauss_legendre
from gonio.fitting.columns import BoolArray, FloatArray
from gonio.fitting.models.bands import Bands, bands_of
from gonio.fitting.models.fresnel_ratio import normal_reflectance, ratio_p, ratio_s
from gonio.fitting.problem import N2_MAX, N2_MIN

_DEGREE = 64
_LOW, _HIGH = np.log(N2_MIN - 1.0), np.log(N2_MAX - 1.0)
_IN_PLANE, _OUT = (10, 32), (5, 10)
"""Nodes of a band that is a small part of the aperture, and of one that is most of it."""

Series = tuple[FloatArray, FloatArray, FloatArray]
"""A function of n2 and its first two derivatives."""


def _ratio_u(n2: FloatArray, cosine: FloatArray, order: int) -> tuple[FloatArray, ...]:
    pairs = zip(ratio_s(n2, cosine, order), ratio_p(n2, cosine, order), strict=True)
    return tuple(0.5 * (s + p) for s, p in pairs)


def _product(a: Series, b: Series) -> Series:
    return a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2]


def _one_minus(a: Series) -> Series:
    return 1.0 - a[0], -a[1], -a[2]


def _inverse(a: Series) -> Series:
    return 1.0 / a[0], -a[1] / a[0] ** 2, (2.0 * a[1] ** 2 / a[0] - a[2]) / a[0] ** 2


@dataclass(frozen=True, slots=True)
class Body:
    """B at n positions.

    Attributes
    ----------
    diffuse
        (o,), D of the distinct (theta_i, theta_o).
    leaving
        (3, K, o), Chebyshev coefficients of E and of its derivatives by log(n2 - 1).
    observation
        (n,), index into the o.
    cos_i
        (e,), of the distinct incidences and polarizations; `entering_s` (e,) says which are S.
    incidence
        (n,), index into the e.
    """

    diffuse: FloatArray
    leaving: FloatArray
    observation: NDArray[np.intp]
    cos_i: FloatArray
    entering_s: BoolArray
    incidence: NDArray[np.intp]

    @classmethod
    def of(
        cls, receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: BoolArray
    ) -> Body:
        """Tabulate a receiver at n positions, (n,) each."""
        places, observation = np.unique(np.stack([theta_i_deg, theta_o_deg]), axis=1, return_inverse=True)
        count = places.shape[1]
        pairs, incidence = np.unique(
            np.stack([theta_i_deg, is_s.astype(np.float64)]), axis=1, return_inverse=True
        )
        k = np.arange(_DEGREE)
        angle = np.pi * (k + 0.5) / _DEGREE
        n2 = 1.0 + np.exp(0.5 * (_LOW + _HIGH) + 0.5 * (_HIGH - _LOW) * np.cos(angle))
        bands = bands_of(receiver, places[0], places[1])
        values = np.stack([_received(bands, float(n), count) for n in n2])
        c = 2.0 / _DEGREE * np.cos(np.outer(k, angle)) @ values
        c[0] *= 0.5
        stack = np.zeros((3, *c.shape))
        stack[0] = c
        stack[1, :-1] = np.polynomial.chebyshev.chebder(c, 1, scl=2.0 / (_HIGH - _LOW))
        stack[2, :-2] = np.polynomial.chebyshev.chebder(c, 2, scl=2.0 / (_HIGH - _LOW))
        return cls(
            receiver.diffuse_integral(places[1], places[0]),
            stack,
            observation.reshape(-1),
            cos_deg(pairs[0]),
            pairs[1] > 0.5,
            incidence.reshape(-1),
        )

    def evaluate(self, n2: FloatArray) -> Series:
        """Return the column (n, m) at m indices, and its first two derivatives."""
        normal = normal_reflectance(n2)
        entering = _one_minus(_product(normal, self._ratio(n2)))
        through = _product(normal, self._leaving(n2))
        leaving = self.diffuse[:, None] - through[0], -through[1], -through[2]
        cosine, weight = tanh_sinh(16)
        share = weight * 2.0 * cosine
        mean = [share @ x for x in _ratio_u(n2, cosine[:, None], 2)]
        normalised = _product(leaving, _inverse(_one_minus(_product(normal, (mean[0], mean[1], mean[2])))))
        rows = entering[0][self.incidence], entering[1][self.incidence], entering[2][self.incidence]
        columns = (
            normalised[0][self.observation],
            normalised[1][self.observation],
            normalised[2][self.observation],
        )
        return _product(rows, columns)

    def _ratio(self, n2: FloatArray) -> Series:
        q = np.empty((3, self.cos_i.size, n2.size))
        for function, rows in ((ratio_s, self.entering_s), (ratio_p, ~self.entering_s)):
            if np.any(rows):
                q[:, rows] = function(n2, self.cos_i[rows, None], 2)
        return q[0], q[1], q[2]

    def _leaving(self, n2: FloatArray) -> Series:
        step = n2 - 1.0
        z = np.clip((2.0 * np.log(step) - _LOW - _HIGH) / (_HIGH - _LOW), -1.0, 1.0)
        basis = np.cos(np.arange(_DEGREE)[:, None] * np.arccos(z))
        value, slope, curve = (c.T @ basis for c in self.leaving)
        return value, slope / step, (curve - slope) / step**2


def _received(bands: Bands, n2: float, count: int) -> FloatArray:
    """Return E of every reading, (count,), at one index.

    Near grazing q changes over ``cos(theta) ~ sqrt(n2^2 - 1)``: nodes at equal steps of the square root of
    the angle to the nearer horizon.
    """
    index = np.array(n2)
    value = np.zeros(count)
    if bands.single:
        seen = np.abs(bands.axis) < 0.5 * np.pi
        cosine = np.where(seen, np.cos(bands.axis), 1.0)
        light = bands.weight * np.where(seen, _ratio_u(index, cosine, 0)[0] * cosine / np.pi, 0.0)
        np.add.at(value, bands.position, light)
        return value
    seen, most, most_out = bands.high > bands.low, bands.part > 0.3, bands.part_out > 0.3
    for in_plane in (False, True):
        for out in (False, True):
            rows = np.flatnonzero(seen & (most == in_plane) & (most_out == out))
            if rows.size:
                use = bands.pick(rows)
                np.add.at(value, use.position, _light(use, index, _IN_PLANE[in_plane], _OUT[out]) / np.pi)
    return value


def _light(use: Bands, index: FloatArray, in_plane: int, out: int) -> FloatArray:
    """Return ∫ q_u cos(theta) dOmega of every band, (b,)."""
    side = np.where(use.low + use.high < 0.0, -1.0, 1.0)
    near = np.maximum(0.5 * np.pi - np.where(side > 0.0, use.high, -use.low), 0.0)
    far = 0.5 * np.pi - np.where(side > 0.0, use.low, -use.high)
    nodes, weights = gauss_legendre(in_plane)
    s0, s1 = np.sqrt(near)[:, None], np.sqrt(far)[:, None]
    s = 0.5 * (s0 + s1) + 0.5 * (s1 - s0) * nodes
    t = side[:, None] * (0.5 * np.pi - s**2)
    over_t = use.weight[:, None] * 0.5 * (s1 - s0) * weights * 2.0 * s
    if use.flat:
        cosine = np.cos(t)
        return np.asarray(np.sum(over_t * _ratio_u(index, cosine, 0)[0] * cosine, axis=1))
    nodes, weights = gauss_legendre(out)
    share, distance_mm = use.accepted(t)
    slope = (np.cos(t - use.axis[:, None]) / distance_mm)[..., None]  # tan(psi) = v slope
    half = 0.5 * (use.to_mm - use.from_mm)[:, None, None]
    v = use.from_mm[:, None, None] + half * (1.0 + nodes)
    entering = use.level[:, None, None] + use.slope[:, None, None] * v
    cos_psi = 1.0 / np.sqrt(1.0 + (v * slope) ** 2)
    cosine = np.maximum(np.cos(t)[..., None] * cos_psi, 1e-300)
    # cos(psi) dpsi = slope cos(psi)^3 dv
    over_v = half * weights * entering * slope * cos_psi**3
    over = (over_t * share)[..., None] * over_v
    return np.asarray(np.sum(over * _ratio_u(index, cosine, 0)[0] * cosine, axis=(1, 2)))

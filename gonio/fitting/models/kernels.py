"""Which lobes are tabulated, and where do quadrature nodes belong for them?

A kernel is a lobe without its Fresnel term, and rules for its integral over a band
(`gonio.fitting.models.bands`).  In plane the nodes lie in u, the angle from the mirror direction; out of
plane in the slope ``y = tan(psi) / cos(t - axis)``, in which a rectangle ends at a constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from gonio.brdf.directions import Directions
from gonio.brdf.lobe import lobe_brdf
from gonio.brdf.microfacet import ggx_dsf
from gonio.brdf.quadrature import gauss_legendre
from gonio.fitting.lobe_table import ALPHA_MAX, ALPHA_MIN
from gonio.fitting.models.bands import Bands

FloatArray = NDArray[np.float64]
CountArray = NDArray[np.intp]

_SIZES = np.array([4, 5, 6, 8, 10, 12, 14, 16, 20, 24, 32, 40, 48, 64, 96])


class Kernel(Protocol):
    """A lobe with one shape parameter."""

    low: ClassVar[float]
    """Logarithm of the least value of the shape parameter."""
    high: ClassVar[float]
    """Logarithm of its largest value."""
    degree: ClassVar[int]
    """Chebyshev coefficients that its readings need over this range."""

    def dsf(self, shape: float, at: Directions) -> FloatArray:
        """Return the lobe with R = 1, 1/sr."""
        ...

    def envelope(self, log_shape: FloatArray, solid_angle_sr: float, growth: float) -> tuple[FloatArray, ...]:
        """Return a smooth function like the largest reading, and its first two derivatives by log(shape)."""
        ...

    def live(self, shape: float, bands: Bands) -> CountArray:
        """Return the bands that see anything of the lobe."""
        ...

    def sizes(self, shape: float, bands: Bands, facets: int) -> tuple[CountArray, CountArray]:
        """Return how many nodes each band needs in plane and out of plane, out of `_SIZES`."""
        ...

    def in_plane(self, shape: float, bands: Bands, count: int) -> tuple[FloatArray, FloatArray]:
        """Return nodes in u and weights, (b, count) each, radians."""
        ...

    def out_of_plane(
        self, shape: float, bands: Bands, u: FloatArray, distance_mm: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return nodes in y and weights, (b, t, count) each, seen from the distances (b, t)."""
        ...


def _rounded(needed: FloatArray) -> CountArray:
    return _SIZES[np.minimum(np.searchsorted(_SIZES, needed), _SIZES.size - 1)].astype(np.intp)


def envelope(
    log_width: FloatArray, narrow: float, growth: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``(1 + a)(1 + a + narrow)^(growth - 1)``, a = exp(log_width), and its derivatives by log_width.

    The reading of a lobe of solid angle 2 pi/a levels off, or goes on as ``a^growth``, where the lobe becomes
    narrower than the aperture, 2 pi/narrow.
    """
    a = np.exp(log_width)
    wide, beyond, p = 1.0 + a, 1.0 + a + narrow, 1.0 - growth
    g = wide * beyond**-p
    slope = a / wide - p * a / beyond
    curve = a / wide**2 - p * a * (beyond - a) / beyond**2
    return g, g * slope, g * (slope**2 + curve)


@dataclass(frozen=True, slots=True)
class CosineKernel:
    """``(alpha + 2)/(2 pi) cos_+(theta_s)^alpha cos(theta_o)``, that of the reciprocal lobe and of Phong."""

    low: ClassVar[float] = float(np.log(ALPHA_MIN))
    high: ClassVar[float] = float(np.log(ALPHA_MAX))
    degree: ClassVar[int] = 144
    negligible: ClassVar[float] = 40.0  # exp(-40) of the largest value in the band is rounding
    edge_alpha: ClassVar[float] = 30.0  # below, cos_+^alpha is seen to end at 90 deg
    edge_rad: ClassVar[float] = 1.2  # and is not smooth beyond this angle

    def dsf(self, shape: float, at: Directions) -> FloatArray:
        """Return the lobe with R = 1, 1/sr."""
        return np.asarray(lobe_brdf(shape, at.versine) * at.cos_o)

    def envelope(self, log_shape: FloatArray, solid_angle_sr: float, growth: float) -> tuple[FloatArray, ...]:
        """Return a smooth function like the largest reading, and its derivatives by log(alpha)."""
        return envelope(log_shape, 2.0 * np.pi / solid_angle_sr, growth)

    def live(self, shape: float, bands: Bands) -> CountArray:
        """Return the bands where the lobe exceeds exp(-60) of its peak."""
        low, high = self._inside(bands)
        nearest = np.abs(np.clip(0.0, low, high))
        seen = ((high > low) | bands.single) & (nearest < 0.5 * np.pi)
        log_lobe = shape * np.log1p(-2.0 * np.sin(0.5 * np.where(seen, nearest, 0.0)) ** 2)
        return np.flatnonzero(seen & (log_lobe > -60.0))

    def sizes(self, shape: float, bands: Bands, facets: int) -> tuple[CountArray, CountArray]:
        """Return the numbers of nodes: the more e-foldings a band spans, the more."""
        low, high = self._cut(shape, bands)
        nearest = np.clip(0.0, low, high)
        far = np.where(high - nearest > nearest - low, high, low)
        span = shape * np.abs(np.log(np.maximum(np.cos(far), 1e-300) / np.cos(nearest)))
        span = np.minimum(span, self.negligible)
        inside = (low < 0.0) & (high > 0.0)
        in_plane = 6.0 + 0.8 * facets * bands.part + np.where(inside, 0.9, 0.5) * span
        edge = self._edge(shape, bands)
        near, rim = (np.log1p((v / bands.distance_mm) ** 2) for v in (bands.from_mm, bands.to_mm))
        fall = np.minimum(0.5 * (shape + 2.0) * (rim - near), self.negligible)
        out = 3.5 + 0.3 * facets * np.minimum(bands.part_out, 1.0) + 0.5 * fall
        return _rounded(np.where(edge, 32.0, in_plane)), _rounded(out)

    def in_plane(self, shape: float, bands: Bands, count: int) -> tuple[FloatArray, FloatArray]:
        """Return nodes and weights over the part of the band that carries the value."""
        low, high = (x[:, None] for x in self._cut(shape, bands))
        nodes, weights = gauss_legendre(count)
        half = 0.5 * (high - low)
        u, w = 0.5 * (low + high) + half * nodes, half * weights
        edge = self._edge(shape, bands)
        if np.any(edge):  # equal steps of the sixth root of the angle to the end, as in gonio.brdf.quadrature
            side = np.where(high[edge] + low[edge] < 0.0, -1.0, 1.0)
            far = np.where(side > 0.0, high[edge], -low[edge])
            near = np.where(side > 0.0, low[edge], -high[edge])
            s0, s1 = (np.maximum(0.5 * np.pi - x, 0.0) ** (1.0 / 6.0) for x in (far, near))
            s = 0.5 * (s0 + s1) + 0.5 * (s1 - s0) * nodes
            u[edge] = side * (0.5 * np.pi - s**6)
            w[edge] = 0.5 * (s1 - s0) * weights * 6.0 * s**5
        return u, w

    def out_of_plane(
        self, shape: float, bands: Bands, u: FloatArray, distance_mm: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return nodes and weights up to the rim or to where the lobe ends."""
        nodes, weights = gauss_legendre(count)
        reach = np.sqrt(np.expm1(2.0 * self.negligible / (shape + 2.0))) if shape > 2.0 else np.inf
        foreshortened = np.cos(u + (bands.theta_i - bands.axis)[:, None])
        start, rim = bands.from_mm[:, None] / distance_mm, bands.to_mm[:, None] / distance_mm
        half = 0.5 * np.maximum(np.minimum(rim, reach / foreshortened) - start, 0.0)[..., None]
        return start[..., None] + half * (1.0 + nodes), half * weights

    def _inside(self, bands: Bands) -> tuple[FloatArray, FloatArray]:
        """Return the limits of the bands in u, cut where cos_+ ends."""
        edge = 0.5 * np.pi
        return np.maximum(bands.low - bands.theta_i, -edge), np.minimum(bands.high - bands.theta_i, edge)

    def _cut(self, shape: float, bands: Bands) -> tuple[FloatArray, FloatArray]:
        """Return the limits in u of what exceeds exp(-40) of the largest value in the band."""
        low, high = self._inside(bands)
        nearest = np.clip(0.0, low, high)
        versine = 2.0 * np.sin(0.5 * nearest) ** 2
        fall = -np.expm1(-self.negligible / shape)
        reach = 2.0 * np.arcsin(np.sqrt(np.minimum(0.5 * (versine + (1.0 - versine) * fall), 1.0)))
        return np.maximum(low, -reach), np.minimum(high, reach)

    def _edge(self, shape: float, bands: Bands) -> NDArray[np.bool_]:
        low, high = self._inside(bands)
        beside = (low >= 0.0) | (high <= 0.0)
        return beside & (np.maximum(-low, high) > self.edge_rad) & (shape < self.edge_alpha)


@dataclass(frozen=True, slots=True)
class GGXKernel:
    """``D G / (4 cos(theta_i))``, the microfacet lobe; its tails reach everywhere."""

    low: ClassVar[float] = float(np.log(1e-3))
    high: ClassVar[float] = 0.0
    degree: ClassVar[int] = 72

    def dsf(self, shape: float, at: Directions) -> FloatArray:
        """Return the lobe with R = 1, 1/sr."""
        return ggx_dsf(shape, at)

    def envelope(self, log_shape: FloatArray, solid_angle_sr: float, growth: float) -> tuple[FloatArray, ...]:
        """Return a smooth function like the largest reading, and its derivatives by log(roughness)."""
        # the peak at normal incidence is 1/(4 pi a^2) = (width)/(2 pi), width = 1/(2 a^2)
        g, slope, curve = envelope(-np.log(2.0) - 2.0 * log_shape, 2.0 * np.pi / solid_angle_sr, growth)
        return g, -2.0 * slope, 4.0 * curve

    def live(self, shape: float, bands: Bands) -> CountArray:
        """Return all bands above the sample plane."""
        return np.flatnonzero((bands.high > bands.low) | bands.single)

    def sizes(self, shape: float, bands: Bands, facets: int) -> tuple[CountArray, CountArray]:
        """Return the numbers of nodes: in proportion to the e-foldings from the lobe's width to the rim."""
        span, away = self._ends(shape, bands)
        in_plane = 6.0 + 0.8 * facets * bands.part + 5.5 * (span[1] - span[0])
        # a facet of slope a is masked where cos(theta_o) falls below a: a feature at the horizon
        rising = 0.5 * np.pi - np.maximum(np.abs(bands.low), np.abs(bands.high))
        in_plane = in_plane + np.where(rising < 0.2 * (bands.high - bands.low), 40.0, 0.0)
        in_plane = np.where(rising < 3.0 * (bands.high - bands.low), in_plane + 16.0, in_plane)
        narrow = np.hypot(2.0 * shape * np.cos(bands.theta_i), away * np.cos(bands.theta_i))
        start, rim = (
            np.arcsinh(v / bands.distance_mm / np.maximum(narrow, 1e-6)) for v in (bands.from_mm, bands.to_mm)
        )
        out = 3.5 + 0.3 * facets * np.minimum(bands.part_out, 1.0) + 5.5 * (rim - start)
        return _rounded(in_plane), _rounded(out)

    def in_plane(self, shape: float, bands: Bands, count: int) -> tuple[FloatArray, FloatArray]:
        """Return nodes at equal steps of asinh(u / width) about the peak, or its nearest point."""
        (first, last), away = self._ends(shape, bands)
        scale = self._scale(shape, away)[:, None]
        nodes, weights = gauss_legendre(count)
        half = 0.5 * (last - first)[:, None]
        x = 0.5 * (first + last)[:, None] + half * nodes
        return scale * np.sinh(x), scale * np.cosh(x) * half * weights

    def out_of_plane(
        self, shape: float, bands: Bands, u: FloatArray, distance_mm: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return nodes at equal steps of asinh(y / width)."""
        nodes, weights = gauss_legendre(count)
        i = bands.theta_i[:, None]
        middle = np.cos(i + 0.5 * u)
        scale = np.hypot(2.0 * shape * middle, 2.0 * middle * np.sin(0.5 * u))[..., None]
        scale = np.maximum(scale, 1e-9)
        start, rim = (
            np.arcsinh((v[:, None] / distance_mm)[..., None] / scale) for v in (bands.from_mm, bands.to_mm)
        )
        half = 0.5 * (rim - start)
        x = start + half * (1.0 + nodes)
        return scale * np.sinh(x), scale * np.cosh(x) * half * weights

    def _scale(self, shape: float, away: FloatArray) -> FloatArray:
        return np.hypot(2.0 * shape, away)

    def _ends(self, shape: float, bands: Bands) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
        """Return the limits in asinh(u / width), and how far the band lies from the peak."""
        low, high = bands.low - bands.theta_i, bands.high - bands.theta_i
        away = np.abs(np.clip(0.0, low, high))
        scale = self._scale(shape, away)
        return (np.arcsinh(low / scale), np.arcsinh(high / scale)), away

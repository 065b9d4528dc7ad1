"""How much of the beam the sample sends into the aperture: the ratio r for each position, polarization and
wavelength.

``r = rho_d D + rho_s sum_j w_j R(theta_j) L_j(alpha)``: D is the cosine integrated over the aperture, L_j the
lobe about the mirror direction of incidence direction j, both averaged over the footprint
(`gonio_simulators.bench.quadrature`).  Only alpha makes the integrals change with wavelength, so each new
position is tabulated once over the truth's own alpha.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gonio_simulators.bench.config import BenchConfig
from gonio_simulators.bench.footprint import Direction, directions, points
from gonio_simulators.bench.fresnel import reflectances
from gonio_simulators.bench.quadrature import diffuse_power, lobe_powers
from gonio_simulators.bench.truth import Truth
from gonio_simulators.bench.view import View, view

FloatArray = NDArray[np.float64]

TABLE_ERROR = 1e-9
"""Relative to a table's largest integral; its last three Chebyshev coefficients are below this."""

MOST_COEFFICIENTS = 256
POSITIONS_KEPT = 2048

GRAZING_COSINE = 1e-9
"""Below this the light passes along the surface and none falls on the sample."""


@dataclass(frozen=True, slots=True)
class Position:
    """The integrals of one pair of angles."""

    diffuse: float
    incident: tuple[Direction, ...]
    lobes: tuple[LobeTable, ...]  # one for each direction

    def r(self, rho_d: float, rho_s: float, alpha: float, n2: float, s_fraction: float) -> float:
        """Return reflected power in the aperture over incident power, for a fraction of S-polarized light."""
        specular = 0.0
        for direction, lobe in zip(self.incident, self.lobes, strict=True):
            r_s, r_p = reflectances(direction.cos_theta_i, n2)
            s = s_fraction * direction.s_share + (1.0 - s_fraction) * (1.0 - direction.s_share)
            specular += direction.weight * (s * r_s + (1.0 - s) * r_p) * lobe.at(alpha)
        return rho_d * self.diffuse + rho_s * specular


class LobeTable:
    """The lobe integral over alpha for one direction of incidence, as a Chebyshev series in log(1 + alpha).

    Beyond the tabulated range, and where the series does not settle, the quadrature itself answers.
    """

    def __init__(self, views: list[tuple[float, View]], low: float, high: float) -> None:
        self._views = views
        self._low, self._high = math.log1p(low), math.log1p(high)
        self._coefficients: list[float] = []
        if not views:
            return
        if low == high:
            self._coefficients = [float(self.direct(np.array([low]))[0])]
            return
        n = 10
        values = self._values(np.arange(n + 1), n)
        while n <= MOST_COEFFICIENTS:
            coefficients = _to_series(n) @ values
            size = float(np.max(np.abs(values)))
            if float(np.max(np.abs(coefficients[-3:]))) <= TABLE_ERROR * size:
                self._coefficients = coefficients.tolist()
                return
            finer = np.empty(2 * n + 1)
            finer[::2], finer[1::2] = values, self._values(np.arange(1, 2 * n, 2), 2 * n)
            n, values = 2 * n, finer

    def direct(self, alphas: FloatArray) -> FloatArray:
        """Return the quadrature for each alpha, shape (n_alpha,)."""
        return lobe_powers(self._views, alphas)

    def at(self, alpha: float) -> float:
        """Return the lobe integral."""
        if not self._views:
            return 0.0
        x = math.log1p(alpha)
        if not self._coefficients or not self._low <= x <= self._high:
            return float(self.direct(np.array([alpha]))[0])
        if len(self._coefficients) == 1:
            return self._coefficients[0]
        z = (2.0 * x - self._low - self._high) / (self._high - self._low)
        b0 = b1 = 0.0
        for c in reversed(self._coefficients):
            b0, b1 = c + 2.0 * z * b0 - b1, b0
        return b0 - z * b1

    def _values(self, k: NDArray[np.int_], n: int) -> FloatArray:
        """Integrals at the Chebyshev points cos(pi k / n)."""
        z = np.cos(np.pi * k / n)
        alphas = np.expm1(0.5 * (self._low + self._high) + 0.5 * (self._high - self._low) * z)
        return self.direct(np.maximum(alphas, 0.0))


@lru_cache(maxsize=8)
def _to_series(n: int) -> FloatArray:
    """Matrix from values at cos(pi k / n), k = 0...n, to Chebyshev coefficients."""
    k = np.arange(n + 1)
    halves = np.where((k == 0) | (k == n), 0.5, 1.0)
    return np.asarray(
        (2.0 / n) * halves[:, np.newaxis] * halves * np.cos(np.pi * np.outer(k, k) / n), dtype=np.float64
    )


class Scattering:
    """The sample in the goniometer."""

    def __init__(self, config: BenchConfig) -> None:
        self._aperture = config.aperture
        self._beam = config.simulation.beam
        self._sample = config.simulation.sample
        self.truth = Truth(config.simulation.truth)
        self._kept: OrderedDict[tuple[float, float], Position] = OrderedDict()

    def r(self, theta_i_deg: float, theta_mes_deg: float, s_fraction: float, wavelength_nm: float) -> float:
        """Return the power in the aperture over the power of the beam.

        Parameters
        ----------
        theta_i_deg
            Angle of the sample's normal from the incident beam.
        theta_mes_deg
            Angle of the arm from the incident beam.
        s_fraction
            1 for S, 0 for P, between them for a polarizer in between.
        wavelength_nm
            Of the light that falls on the sample.
        """
        return self.position(theta_i_deg, theta_mes_deg).r(*self.truth.at(wavelength_nm), s_fraction)

    def r_at_centre(
        self, theta_i_deg: float, theta_mes_deg: float, s_fraction: float, wavelength_nm: float
    ) -> float:
        """Return r as if the whole aperture were at its centre; for an arm that flies by."""
        theta_i, theta_o = math.radians(theta_i_deg), math.radians(theta_mes_deg - theta_i_deg)
        cos_i, cos_o = math.cos(theta_i), math.cos(theta_o)
        if cos_i <= GRAZING_COSINE or cos_o <= 0:
            return 0.0
        rho_d, rho_s, alpha, n2 = self.truth.at(wavelength_nm)
        r_s, r_p = reflectances(cos_i, n2)
        cos_s = math.cos(theta_o - theta_i)
        lobe = (alpha + 1.0) / (2.0 * math.pi) * cos_s**alpha if cos_s > 0 else 0.0
        solid_angle = self._aperture.width_mm * self._aperture.height_mm / self._aperture.distance_mm**2
        reflectance = s_fraction * r_s + (1.0 - s_fraction) * r_p
        return min(1.0, solid_angle * (rho_d / math.pi * cos_o + rho_s * reflectance * lobe))

    def position(self, theta_i_deg: float, theta_mes_deg: float) -> Position:
        """Return the integrals of a pair of angles, computed on first use."""
        key = (theta_i_deg, theta_mes_deg)
        found = self._kept.get(key)
        if found is None:
            found = self._integrate(theta_i_deg, theta_mes_deg)
            self._kept[key] = found
            if len(self._kept) > POSITIONS_KEPT:
                self._kept.popitem(last=False)
        return found

    def _integrate(self, theta_i_deg: float, theta_mes_deg: float) -> Position:
        theta_i, theta_o = math.radians(theta_i_deg), math.radians(theta_mes_deg - theta_i_deg)
        if math.cos(theta_i) <= GRAZING_COSINE:
            return Position(0.0, (), ())
        low, high = self.truth.alpha_range
        width = 1.0 / math.sqrt(high + 1.0)
        incident = directions(theta_i, self._beam, width)
        spots = points(
            theta_i,
            self._beam,
            self._sample,
            width * self._aperture.distance_mm,
            symmetric=self._beam.divergence_deg == 0,
        )
        lobes, diffuse = [], 0.0
        for direction in incident:
            views: list[tuple[float, View]] = []
            for spot in spots:
                seen = view(
                    width_mm=self._aperture.width_mm,
                    height_mm=self._aperture.height_mm,
                    distance_mm=self._aperture.distance_mm,
                    theta_o_rad=theta_o,
                    point_mm=(spot.x_mm, spot.y_mm),
                    mirror=direction.mirror,
                )
                if seen is not None:
                    views.append((spot.weight, seen))
            if direction is incident[0]:  # the same for all, as it does not know the mirror direction
                diffuse = diffuse_power(views) * sum(d.weight for d in incident)
            lobes.append(LobeTable(views, low, high))
        return Position(diffuse, tuple(incident), tuple(lobes))

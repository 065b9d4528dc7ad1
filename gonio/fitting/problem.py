"""The published lobe as the fit sees it: n positions, four unknowns per wavelength.

    r = rho_d D_i + k_n q_i(n2) L_i(log alpha)

`D` is the diffuse reading of a white Lambertian surface, `L` the part of the lobe that is received, ``q =
R(theta_i) / R(0)``, and ``k_n = rho_s R(0)`` the specular coefficient at normal incidence.  The published
`rho_s` diverges as n2 approaches 1 while k_n stays finite, and log(alpha) is nearer to normal than alpha: the
fit works in these **basic** parameters (rho_d, k_n, log_alpha, n2) and transforms at the end.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gonio import fresnel
from gonio.aperture import InstrumentFunction, Receiver
from gonio.brdf import PublishedLobe
from gonio.fitting.basins import best_descent, summits
from gonio.fitting.columns import BoolArray, Columns, FloatArray
from gonio.fitting.lobe_table import ALPHA_MAX, ALPHA_MIN, LobeTable

N2_MIN, N2_MAX = 1.001, 10.0
"""Range of the fit.  At its ends the angular trend of R no longer changes; a fit that ends there says so."""

_N2_STEP = 1e-5  # of the central difference of q'; it enters the second derivative alone
_POLARIZATIONS: tuple[fresnel.Polarization, fresnel.Polarization] = ("s", "p")
_TILTS = 3  # Legendre polynomials of R over the divergence; the next is below 1e-6 of R at 2 deg
_BLOCK = 256  # wavelengths worked on together: scratch arrays stay in the cache

_GRID_LOG_ALPHA = np.linspace(np.log(ALPHA_MIN), np.log(ALPHA_MAX), 97)
_GRID_N2 = 1.0 + np.geomspace(N2_MIN - 1.0, N2_MAX - 1.0, 10)
_GRID_N2 = np.unique(np.concatenate([_GRID_N2, np.arange(1.1, 2.05, 0.08), [2.3, 3.0, 4.0]]))


@dataclass(frozen=True, slots=True)
class Problem:
    """`gonio.fitting.columns.FitModel` of the published lobe; readings and weights are passed beside it."""

    name: ClassVar[str] = "published lobe"
    linear: ClassVar[tuple[str, ...]] = ("rho_d", "k_n")
    shape: ClassVar[tuple[str, ...]] = ("log_alpha", "n2")
    parameters: ClassVar[tuple[str, ...]] = ("rho_d", "rho_s", "alpha", "n2")
    low: ClassVar[FloatArray] = np.array([np.log(ALPHA_MIN), N2_MIN])
    high: ClassVar[FloatArray] = np.array([np.log(ALPHA_MAX), N2_MAX])

    diffuse: FloatArray  # (n,)
    lobe: LobeTable
    tilted: tuple[LobeTable, ...]  # the lobe times P_1, P_2 of the tilt of a divergent beam's light
    divergence_deg: float
    incidence: NDArray[np.intp]  # (n,) index into `groups`
    groups: tuple[tuple[float, bool], ...]  # distinct (theta_i, is_s)

    @classmethod
    def of(
        cls, receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray, is_s: BoolArray
    ) -> Problem:
        """Tabulate a receiver at n positions, (n,) each."""
        pairs, index = np.unique(
            np.stack([theta_i_deg, is_s.astype(np.float64)]), axis=1, return_inverse=True
        )
        divergence_deg = receiver.beam.divergence_deg if isinstance(receiver, InstrumentFunction) else 0.0
        if isinstance(receiver, InstrumentFunction) and divergence_deg > 0.0:
            lobe, *tilted = LobeTable.moments_of(receiver, theta_i_deg, theta_o_deg, _TILTS)
        else:
            lobe, tilted = LobeTable.of(receiver, theta_i_deg, theta_o_deg), []
        return cls(
            receiver.diffuse_integral(theta_o_deg, theta_i_deg),
            lobe,
            tuple(tilted),
            divergence_deg,
            index.ravel(),
            tuple((float(theta), bool(s)) for theta, s in pairs.T),
        )

    @staticmethod
    def scattering(published: FloatArray) -> PublishedLobe:
        """Return the surface with (rho_d, rho_s, alpha, n2), (m, 4)."""
        return PublishedLobe(*published.T)

    @staticmethod
    def published(basic: FloatArray) -> FloatArray:
        """Return (rho_d, rho_s, alpha, n2), (m, 4), from (rho_d, k_n, log_alpha, n2)."""
        rho_d, k_n, log_alpha, n2 = basic.T
        return np.stack([rho_d, k_n * ((n2 + 1.0) / (n2 - 1.0)) ** 2, np.exp(log_alpha), n2], axis=1)

    @staticmethod
    def published_jacobian(basic: FloatArray) -> FloatArray:
        """Return the derivatives of the published by the basic parameters, (m, 4, 4)."""
        n2 = basic[:, 3]
        published = Problem.published(basic)
        j = np.zeros((len(basic), 4, 4))
        j[:, 0, 0] = j[:, 3, 3] = 1.0
        j[:, 1, 1] = ((n2 + 1.0) / (n2 - 1.0)) ** 2
        j[:, 1, 3] = -4.0 * published[:, 1] / (n2**2 - 1.0)  # d log(1/R0) / d n2
        j[:, 2, 2] = published[:, 2]
        return j

    def ratio(self, n2: FloatArray) -> FloatArray:
        """Return q, (n, m), for m indices, the mean over the beam's directions."""
        return self._by_group(fresnel.reflectance_ratio, n2)[0]

    def _by_group(self, function: fresnel.RatioFunction, n2: FloatArray) -> list[FloatArray]:
        """Return the coefficients c_k, (n, m) each, of ``q(theta_i + a) = sum c_k P_k(2a / divergence)``.

        Light tilted out of the plane by b is a little more oblique, and its own plane of incidence is turned
        about the ray by nearly ``b / tan(theta_i)``: of what is S to the instrument the square of that is P
        to the sample, and the other way round.
        """
        out = np.deg2rad(self.divergence_deg) / np.sqrt(12.0)  # standard deviation of b
        tilts, legendre = _tilt_rule(len(self.tilted) + 1)
        rows = np.empty((len(tilts), len(self.groups), n2.size))
        for wanted in (True, False):
            pick = [k for k, (_, is_s) in enumerate(self.groups) if is_s is wanted]
            if not pick:
                continue
            own, other = _POLARIZATIONS if wanted else _POLARIZATIONS[::-1]
            theta = np.array([self.groups[k][0] for k in pick])[:, None]
            for node, tilt in enumerate(tilts.tolist()):
                at = np.abs(theta + 0.5 * self.divergence_deg * tilt)
                if out == 0.0:
                    rows[node, pick] = function(n2, at, own)
                    continue
                # light from beyond the horizon meets no sample
                at = np.rad2deg(np.arccos(np.clip(np.cos(np.deg2rad(at)) * np.cos(out), 0.0, 1.0)))
                turned = (np.sin(out) * np.cos(np.deg2rad(theta))) ** 2
                mixed = turned / (turned + np.sin(np.deg2rad(theta)) ** 2)
                rows[node, pick] = (1.0 - mixed) * function(n2, at, own) + mixed * function(n2, at, other)
        rows = np.einsum("kj,jgm->kgm", legendre, rows) if self.tilted else rows
        return [row[self.incidence] for row in rows]

    def _second(self, n2: FloatArray) -> list[FloatArray]:
        """Return the second derivatives of the coefficients by n2, by central difference."""
        high, low = (self._by_group(fresnel.reflectance_ratio_dn2, n2 + x) for x in (_N2_STEP, -_N2_STEP))
        return [(h - x) / (2.0 * _N2_STEP) for h, x in zip(high, low, strict=True)]

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        """Return the two columns at (log_alpha, n2), (m, 2), and their derivatives up to `order`."""
        tables = (self.lobe, *self.tilted)
        lobes = [table.evaluate(x[:, 0], derivatives=order) for table in tables]
        d, q = self.diffuse[:, None], self._by_group(fresnel.reflectance_ratio, x[:, 1])
        value = (d, _product(q, lobes, 0))
        if order == 0:
            return Columns(value)
        q_n = self._by_group(fresnel.reflectance_ratio_dn2, x[:, 1])
        first = ((None, None), (_product(q, lobes, 1), _product(q_n, lobes, 0)))
        if order == 1:
            return Columns(value, first)
        mixed, none = _product(q_n, lobes, 1), (None, None)
        curve = ((_product(q, lobes, 2), mixed), (mixed, _product(self._second(x[:, 1]), lobes, 0)))
        return Columns(value, first, ((none, none), curve))

    def start(self, y: FloatArray, w: FloatArray) -> FloatArray:
        """Return the best grid point (log_alpha, n2) of each wavelength, (m, 2).

        Incidences closer than half a degree share one Fresnel ratio here, so the cost is that of a few sums
        per group.  Where the grid has more than one summit, the search goes on from each, and the best is
        returned: few positions see a narrow lobe so seldom that an optimum may lie between grid points.
        """
        keys = {(round(2.0 * theta), s) for theta, s in self.groups}
        groups = sorted(keys)
        member = np.array([groups.index((round(2.0 * theta), s)) for theta, s in self.groups])[self.incidence]
        ratio = np.empty((len(groups), _GRID_N2.size))
        for g in range(len(groups)):
            first = int(np.flatnonzero(member == g)[0])
            ratio[g] = self.ratio(_GRID_N2)[first]
        (lobe,) = self.lobe.evaluate(_GRID_LOG_ALPHA)
        d = self.diffuse[:, None]
        best = np.empty((y.shape[1], 2))
        others: list[tuple[NDArray[np.intp], FloatArray]] = []
        for at in range(0, y.shape[1], _BLOCK):
            yb, wb = y[:, at : at + _BLOCK], w[:, at : at + _BLOCK]
            dd, dy = np.sum(wb * d**2, axis=0), np.sum(wb * d * yb, axis=0)
            sums = np.empty((3, len(groups), _GRID_LOG_ALPHA.size, yb.shape[1]))
            for g in range(len(groups)):
                rows = member == g
                part = lobe[rows].T
                sums[0, g] = part**2 @ wb[rows]
                sums[1, g] = part @ (wb[rows] * d[rows])
                sums[2, g] = part @ (wb[rows] * yb[rows])
            ss = np.tensordot(ratio.T**2, sums[0], 1)  # (n2, alpha, m)
            ds, sy = (np.tensordot(ratio.T, x, 1) for x in sums[1:])
            det = ss - ds**2 / dd
            gain = np.where(det > 1e-10 * ss, (sy - ds * dy / dd) ** 2 / np.where(det > 0.0, det, 1.0), 0.0)
            index = np.argmax(gain.reshape(-1, yb.shape[1]), axis=0)
            n2, alpha = np.unravel_index(index, gain.shape[:2])
            best[at : at + _BLOCK] = np.stack([_GRID_LOG_ALPHA[alpha], _GRID_N2[n2]], axis=1)
            for columns, alpha, n2 in summits(gain):
                others.append((at + columns, np.stack([_GRID_LOG_ALPHA[alpha], _GRID_N2[n2]], axis=1)))
        return best_descent(self, y, w, best, others)


def _product(q: list[FloatArray], lobes: list[tuple[FloatArray, ...]], order: int) -> FloatArray:
    """Return ``sum_k q_k L_k``, (n, m), with a derivative of the lobe."""
    total = q[0] * lobes[0][order]
    for coefficient, lobe in zip(q[1:], lobes[1:], strict=True):
        total += coefficient * lobe[order]
    return total


@functools.cache
def _tilt_rule(count: int) -> tuple[FloatArray, FloatArray]:
    """Return Gauss nodes (count,) and the matrix from values there to Legendre coefficients."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    vandermonde = np.polynomial.legendre.legvander(nodes, count - 1)
    return nodes, (2.0 * np.arange(count)[:, None] + 1.0) / 2.0 * (vandermonde * weights[:, None]).T

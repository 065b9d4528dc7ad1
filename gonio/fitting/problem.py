"""The published lobe as the fit sees it: n positions, four unknowns per wavelength.

    r = rho_d D_i + k_n q_i(n2) L_i(log alpha)

`D` is the diffuse reading of a white Lambertian surface, `L` the part of the lobe that is received, ``q =
R(theta_i) / R(0)``, and ``k_n = rho_s R(0)`` the specular coefficient at normal incidence.  The published
`rho_s` diverges as n2 approaches 1 while k_n stays finite, and log(alpha) is nearer to normal than alpha: the
fit works in these **basic** parameters (rho_d, k_n, log_alpha, n2) and transforms at the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gonio import fresnel
from gonio.aperture import Receiver
from gonio.brdf import PublishedLobe
from gonio.fitting.columns import BoolArray, Columns, FloatArray, jacobian, readings
from gonio.fitting.lobe_table import ALPHA_MAX, ALPHA_MIN, LobeTable

N2_MIN, N2_MAX = 1.001, 10.0
"""Range of the fit.  At its ends the angular trend of R no longer changes; a fit that ends there says so."""

_N2_STEP = 1e-5  # of the central difference of q'; it enters the second derivative alone
_BLOCK = 256  # wavelengths worked on together: scratch arrays stay in the cache

_GRID_LOG_ALPHA = np.linspace(np.log(ALPHA_MIN), np.log(ALPHA_MAX), 49)
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

    theta_i_deg: FloatArray  # (n,)
    is_s: BoolArray  # (n,)
    diffuse: FloatArray  # (n,)
    lobe: LobeTable
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
        return cls(
            theta_i_deg,
            is_s,
            receiver.diffuse_integral(theta_o_deg, theta_i_deg),
            LobeTable.of(receiver, theta_i_deg, theta_o_deg),
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
        """Return q, (n, m), for m indices."""
        return self._by_group(fresnel.reflectance_ratio, n2)

    def ratio_dn2(self, n2: FloatArray) -> FloatArray:
        """Return dq/dn2, (n, m)."""
        return self._by_group(fresnel.reflectance_ratio_dn2, n2)

    def ratio_d2n2(self, n2: FloatArray) -> FloatArray:
        """Return the second derivative of q, (n, m), by central difference."""
        high, low = self.ratio_dn2(n2 + _N2_STEP), self.ratio_dn2(n2 - _N2_STEP)
        return np.asarray((high - low) / (2.0 * _N2_STEP))

    def _by_group(self, function: fresnel.RatioFunction, n2: FloatArray) -> FloatArray:
        rows = np.empty((len(self.groups), n2.size))
        choices: tuple[tuple[fresnel.Polarization, bool], ...] = (("s", True), ("p", False))
        for polarization, wanted in choices:
            pick = [k for k, (_, is_s) in enumerate(self.groups) if is_s is wanted]
            theta = np.array([self.groups[k][0] for k in pick])[:, None]
            if pick:
                rows[pick] = function(n2, theta, polarization)
        return rows[self.incidence]

    def columns(self, x: FloatArray, order: int = 0) -> Columns:
        """Return the two columns at (log_alpha, n2), (m, 2), and their derivatives up to `order`."""
        lobes = self.lobe.evaluate(x[:, 0], derivatives=order)
        d, q = self.diffuse[:, None], self.ratio(x[:, 1])
        value = (d, q * lobes[0])
        if order == 0:
            return Columns(value)
        q_n = self.ratio_dn2(x[:, 1])
        first = ((None, None), (q * lobes[1], q_n * lobes[0]))
        if order == 1:
            return Columns(value, first)
        mixed, none = q_n * lobes[1], (None, None)
        curve = ((q * lobes[2], mixed), (mixed, self.ratio_d2n2(x[:, 1]) * lobes[0]))
        return Columns(value, first, ((none, none), curve))

    def start(self, y: FloatArray, w: FloatArray) -> FloatArray:
        """Return the best grid point (log_alpha, n2) of each wavelength, (m, 2).

        Incidences closer than half a degree share one Fresnel ratio here, so the cost is that of a few sums
        per group.
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
        return best

    def model(self, basic: FloatArray) -> FloatArray:
        """Return the readings, (n, m), of m sets of basic parameters (m, 4)."""
        return readings(self, basic)

    def jacobian(self, basic: FloatArray) -> FloatArray:
        """Return the derivatives of the readings by the basic parameters, (m, n, 4)."""
        return jacobian(self, basic)


published_from_basic, published_jacobian = Problem.published, Problem.published_jacobian

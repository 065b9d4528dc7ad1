"""The least-squares problem: m wavelengths that share n positions, four unknowns each.

    r = rho_d D_i + k_n q_i(n2) L_i(log alpha)

`D` is the diffuse reading of a white Lambertian surface, `L` the part of the lobe that is received, ``q =
R(theta_i) / R(0)``, and ``k_n = rho_s R(0)`` the specular coefficient at normal incidence.  The published
`rho_s` diverges as n2 approaches 1 while k_n stays finite, and log(alpha) is nearer to normal than alpha: the
fit works in these
**basic** parameters (rho_d, k_n, log_alpha, n2) and transforms at the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio import fresnel
from gonio.aperture import Receiver
from gonio.fitting.lobe_table import LobeTable

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

N2_MIN, N2_MAX = 1.001, 10.0
"""Range of the fit.  At its ends the angular trend of R no longer changes; a fit that ends there says so."""

_N2_STEP = 1e-5  # of the central difference of q'; it enters the second derivative alone


@dataclass(frozen=True, slots=True)
class Problem:
    """What the positions are; the readings and weights are passed beside it."""

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
            receiver.diffuse_integral(theta_o_deg),
            LobeTable.of(receiver, theta_i_deg, theta_o_deg),
            index.ravel(),
            tuple((float(theta), bool(s)) for theta, s in pairs.T),
        )

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

    def model(self, basic: FloatArray) -> FloatArray:
        """Return the readings, (n, m), of m sets of basic parameters (m, 4)."""
        (lobe,) = self.lobe.evaluate(basic[:, 2])
        return np.asarray(self.diffuse[:, None] * basic[:, 0] + basic[:, 1] * self.ratio(basic[:, 3]) * lobe)

    def jacobian(self, basic: FloatArray) -> FloatArray:
        """Return the derivatives of the readings by the basic parameters, (m, n, 4)."""
        lobe, slope = self.lobe.evaluate(basic[:, 2], derivatives=1)
        q, k = self.ratio(basic[:, 3]), basic[:, 1]
        j = np.empty((len(basic), self.diffuse.size, 4))
        j[:, :, 0] = self.diffuse
        j[:, :, 1] = (q * lobe).T
        j[:, :, 2] = (k * q * slope).T
        j[:, :, 3] = (k * self.ratio_dn2(basic[:, 3]) * lobe).T
        return j


def published_from_basic(basic: FloatArray) -> FloatArray:
    """Return (rho_d, rho_s, alpha, n2), (m, 4), from (rho_d, k_n, log_alpha, n2)."""
    rho_d, k_n, log_alpha, n2 = basic.T
    return np.stack([rho_d, k_n * ((n2 + 1.0) / (n2 - 1.0)) ** 2, np.exp(log_alpha), n2], axis=1)


def published_jacobian(basic: FloatArray) -> FloatArray:
    """Return the derivatives of the published by the basic parameters, (m, 4, 4)."""
    n2 = basic[:, 3]
    published = published_from_basic(basic)
    j = np.zeros((len(basic), 4, 4))
    j[:, 0, 0] = j[:, 3, 3] = 1.0
    j[:, 1, 1] = ((n2 + 1.0) / (n2 - 1.0)) ** 2
    j[:, 1, 3] = -4.0 * published[:, 1] / (n2**2 - 1.0)  # d log(1/R0) / d n2
    j[:, 2, 2] = published[:, 2]
    return j

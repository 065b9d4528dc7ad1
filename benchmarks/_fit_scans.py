"""Simulated scans for the benchmarks of the fit, integrated by the bench's own two-dimensional quadrature.

Nothing here uses the fit's aperture integral, its Fresnel formulae or its Jacobian.  The beam is a line of
light without width.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture
from gonio_simulators.bench.fresnel import reflectances
from gonio_simulators.bench.quadrature import diffuse_power, lobe_powers
from gonio_simulators.bench.truth import lobe_above_horizon
from gonio_simulators.bench.view import view

FloatArray = NDArray[np.float64]

ARTA = Aperture(26.0, 18.0, 95.2353)
PARAMETERS = ("rho_d", "rho_s", "alpha", "n2")
COEFFICIENTS = ("k_d", "k_s", "k_g")
SWEEPS = ((20.0, 105.0), (30.0, 114.0), (45.0, 126.0), (55.0, 141.0))
THETA_I_DEG = 8.0


@dataclass(frozen=True)
class Positions:
    """n positions: angles in degrees, ``"s"`` or ``"p"``."""

    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    polarization: NDArray[np.str_]

    def only(self, polarization: str) -> NDArray[np.bool_]:
        """Return the mask of the positions of ``"s"``, ``"p"`` or (``"joint"``) both."""
        return (
            np.full(len(self.polarization), True)
            if polarization == "joint"
            else (self.polarization == polarization)
        )

    def arguments(self) -> tuple[FloatArray, FloatArray, NDArray[np.str_]]:
        """Return the first three arguments of `gonio.fitting.fit_readings`."""
        return self.theta_i_deg, self.theta_o_deg, self.polarization


def paper_positions() -> Positions:
    """Return the paper's 146 positions in S, then the same in P."""
    theta_i, theta_o = [], []
    for incidence, end in SWEEPS:
        arm = np.arange(15.0, end + 1e-9, 3.0)
        theta_i += [incidence] * arm.size
        theta_o += list(arm - incidence)
    n = len(theta_i)
    return Positions(np.array(theta_i * 2), np.array(theta_o * 2), np.array(["s"] * n + ["p"] * n))


class Simulator:
    """Noiseless readings at fixed positions for any truth; integrals are kept by exponent."""

    def __init__(self, at: Positions, aperture: Aperture = ARTA) -> None:
        self.at = at
        pairs, self._index = np.unique(
            np.stack([at.theta_i_deg, at.theta_o_deg]), axis=1, return_inverse=True
        )
        self._views = [
            view(
                width_mm=aperture.width_mm,
                height_mm=aperture.height_mm,
                distance_mm=aperture.distance_mm,
                theta_o_rad=math.radians(o),
                point_mm=(0.0, 0.0),
                mirror=(math.sin(math.radians(i)), 0.0, math.cos(math.radians(i))),
            )
            for i, o in pairs.T.tolist()
        ]
        self._diffuse = np.array([0.0 if v is None else diffuse_power([(1.0, v)]) for v in self._views])
        self._lobes: dict[float, FloatArray] = {}

    def prepare(self, alphas: FloatArray) -> None:
        """Integrate the lobe for these exponents, which share their nodes."""
        new = np.array(sorted({float(a) for a in alphas} - self._lobes.keys()))
        if new.size:
            table = np.array(
                [np.zeros(new.size) if v is None else lobe_powers([(1.0, v)], new) for v in self._views]
            )
            self._lobes.update(zip(new.tolist(), table.T, strict=True))

    def readings(self, rho_d: float, rho_s: float, alpha: float, n2: float) -> FloatArray:
        """Return r, (n,)."""
        self.prepare(np.array([alpha]))
        fresnel = {
            theta: reflectances(math.cos(math.radians(theta)), n2)
            for theta in set(self.at.theta_i_deg.tolist())
        }
        both = np.array([fresnel[theta] for theta in self.at.theta_i_deg.tolist()])
        reflectance = np.where(self.at.polarization == "s", both[:, 0], both[:, 1])
        return np.asarray(
            rho_d * self._diffuse[self._index] + rho_s * reflectance * self._lobes[float(alpha)][self._index]
        )


def coefficients(rho_d: float, rho_s: float, alpha: float, n2: float) -> tuple[float, float, float]:
    """Return the true k_d, k_s, k_g at 8 degrees: mean of S and P, the lobe above the horizon."""
    r_s, r_p = reflectances(math.cos(math.radians(THETA_I_DEG)), n2)
    k_s = rho_s * 0.5 * (r_s + r_p) * lobe_above_horizon(THETA_I_DEG, alpha)
    return rho_d, k_s, rho_d + k_s

"""Simulated readings by a quadrature that shares nothing with the product's aperture integral."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture

FloatArray = NDArray[np.float64]

SWEEPS = ((20.0, 105.0), (30.0, 114.0), (45.0, 126.0), (55.0, 141.0))


@dataclass(frozen=True)
class Positions:
    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    polarization: NDArray[np.str_]

    def __getitem__(self, pick: object) -> Positions:
        return Positions(self.theta_i_deg[pick], self.theta_o_deg[pick], self.polarization[pick])


def paper_positions(step_deg: float = 3.0) -> Positions:
    """The paper's plan: 146 positions in S, then the same in P."""
    theta_i, theta_o = [], []
    for incidence, end in SWEEPS:
        arm = np.arange(15.0, end + 1e-9, step_deg)
        theta_i += [incidence] * arm.size
        theta_o += list(arm - incidence)
    n = len(theta_i)
    return Positions(np.array(theta_i * 2), np.array(theta_o * 2), np.array(["s"] * n + ["p"] * n))


def fresnel_textbook(n2: float, theta_i_deg: FloatArray, polarization: NDArray[np.str_]) -> FloatArray:
    """Equations 11 and 12 as printed."""
    c = np.cos(np.deg2rad(theta_i_deg))
    root = np.sqrt(1.0 - (np.sin(np.deg2rad(theta_i_deg)) / n2) ** 2)
    r_s = ((c - n2 * root) / (c + n2 * root)) ** 2
    r_p = ((root - n2 * c) / (root + n2 * c)) ** 2
    return np.where(polarization == "s", r_s, r_p)


def plane_quadrature(
    at: Positions, rho_d: float, rho_s: float, alpha: float, n2: float, aperture: Aperture, panels: int = 10
) -> FloatArray:
    """r of every position: the dsf summed over the plane of the aperture, solid angle R dA / |p|^3.

    Gauss-Legendre with 10 nodes per panel and direction; points under the sample plane receive nothing.
    """
    nodes, weights = np.polynomial.legendre.leggauss(10)

    def rule(*ends: float) -> tuple[FloatArray, FloatArray]:
        edges = np.concatenate(
            [np.linspace(a, b, panels + 1)[:-1] for a, b in itertools.pairwise(ends)] + [ends[-1:]]
        )
        half = 0.5 * np.diff(edges)[:, None]
        return ((edges[:-1, None] + half) + half * nodes).ravel(), (half * weights).ravel()

    y, wy = rule(-aperture.height_mm / 2.0, aperture.height_mm / 2.0)
    far = aperture.distance_mm
    reflectance = fresnel_textbook(n2, at.theta_i_deg, at.polarization)
    r = np.zeros(at.theta_i_deg.size)
    for k in range(r.size):
        o, i = np.deg2rad(at.theta_o_deg[k]), np.deg2rad(at.theta_i_deg[k])
        # the arm's axis is (sin o, 0, cos o); the aperture's in-plane direction (cos o, 0, -sin o).  The
        # horizon, below which nothing is, and the edge of cos_+ are lines x = const of the aperture: panels
        # end there.
        left, right = -aperture.width_mm / 2.0, aperture.width_mm / 2.0
        horizon, edge = (far / np.tan(angle) if angle != 0.0 else np.inf for angle in (o, o - i))
        left, right = (max(left, horizon), right) if o < 0.0 else (left, min(right, horizon))
        if right <= left:
            continue
        x, wx = rule(left, edge, right) if left < edge < right else rule(left, right)
        u, v = np.meshgrid(x, y, indexing="ij")
        length = np.sqrt(u**2 + v**2 + far**2)
        dx = (far * np.sin(o) + u * np.cos(o)) / length
        dz = (far * np.cos(o) - u * np.sin(o)) / length
        cosine = np.clip(dx * np.sin(i) + dz * np.cos(i), 0.0, None)
        dsf = rho_d / np.pi * dz + rho_s * reflectance[k] * (alpha + 1.0) / (2.0 * np.pi) * cosine**alpha
        r[k] = np.sum(np.outer(wx, wy) * far / length**3 * dsf)
    return r


def instrument_noise(r: FloatArray) -> FloatArray:
    """Standard deviation with a floor, a shot and a proportional part: white HPL is seen with about 0.5 %."""
    return np.sqrt(2e-5**2 + (4e-4) ** 2 * np.abs(r) + (2e-3 * r) ** 2)

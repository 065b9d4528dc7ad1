"""Does a model keep reciprocity and energy, and where does it fail worst?

Reciprocity (Helmholtz, Eq 7) is asked of the true BRDF: ``f(i -> o) = f(o -> i)``.  Energy (Eq 8) is asked of
the true directional albedo.  The published lobe breaks both; `check_model` says by how much and at which
angles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.angles import sin_deg
from gonio.brdf.protocol import ScatteringModel
from gonio.brdf.quadrature import gauss_legendre
from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ModelCheck:
    """Worst violations of a model over the angles that were tried.

    `reciprocity` is ``max |f(i,o) - f(o,i)| / (f(i,o) + f(o,i))`` (0 reciprocal ... 1 one-sided), found at
    `reciprocity_at_deg` = (theta_i, theta_o, azimuth); `albedo` is the largest true directional albedo, at
    `albedo_at_deg`, and `energy_from_deg` the incidence from which it exceeds 1 (NaN if nowhere).
    """

    model: str
    polarization: Polarization
    reciprocity: float
    reciprocity_at_deg: tuple[float, float, float]
    albedo: float
    albedo_at_deg: float
    energy_from_deg: float

    def __str__(self) -> str:
        energy = (
            f"creates energy from {self.energy_from_deg:.2f} deg on"
            if np.isfinite(self.energy_from_deg)
            else "conserves energy"
        )
        i, o, azimuth = self.reciprocity_at_deg
        return (
            f"{self.model} ({self.polarization}): {energy}, albedo up to {self.albedo:.4f} at "
            f"{self.albedo_at_deg:.1f} deg; reciprocity off by {100 * self.reciprocity:.1f} % at "
            f"theta_i {i:.0f}, theta_o {o:.0f}, azimuth {azimuth:.0f} deg"
        )


def check_model(
    model: ScatteringModel, polarization: Polarization = "unpolarized", *, step_deg: float = 2.5
) -> ModelCheck:
    """Return the worst reciprocity violation and albedo of a model with scalar parameters.

    Reciprocity: directions every `step_deg` from 0 to below 90 degrees and every 15 degrees of azimuth, and
    pairs a little off the mirror direction, 0.01...1 degree, where narrow lobes live.  Albedo: every degree
    up to 90, then every 0.1 degree about the largest and about where it first exceeds 1.

    Polarizer and detector do not change places with the directions: for a model whose diffuse light has lost
    its polarization (`gonio.brdf.coupled`) S or P alone is not reciprocal in this sense; ``"unpolarized"``,
    the mean of both, is the test of the surface.
    """
    i, o, azimuth = _pairs(step_deg)
    cos_i, cos_o = np.cos(np.deg2rad(i)), np.cos(np.deg2rad(o))
    there = model.dsf(i, o, polarization, azimuth) / cos_o
    back = model.dsf(o, i, polarization, azimuth) / cos_i
    violation = np.abs(there - back) / np.maximum(there + back, np.finfo(float).tiny)
    worst = int(np.argmax(violation))

    def albedo_at(incidence: FloatArray) -> FloatArray:
        return np.asarray(model.directional_albedo(incidence, polarization))

    incidence = np.linspace(0.0, 90.0, 91)
    albedo = albedo_at(incidence)
    turns = {int(np.argmax(albedo)), *np.flatnonzero(albedo > 1.0)[:1].tolist()}
    for turn in turns:
        near = np.round(incidence[turn] + np.arange(-0.9, 0.95, 0.1), 1)
        near = near[(near > 0.0) & (near < 90.0)]
        incidence, albedo = np.append(incidence, near), np.append(albedo, albedo_at(near))
    above = incidence[albedo > 1.0]
    top = int(np.argmax(albedo))
    return ModelCheck(
        model=model.name,
        polarization=polarization,
        reciprocity=float(violation[worst]),
        reciprocity_at_deg=(float(i[worst]), float(o[worst]), float(azimuth[worst])),
        albedo=float(albedo[top]),
        albedo_at_deg=float(incidence[top]),
        energy_from_deg=float(np.min(above)) if above.size else float("nan"),
    )


def _pairs(step_deg: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the (theta_i, theta_o, azimuth) that are tried, degrees."""
    theta = np.arange(0.0, 90.0, step_deg)
    grid = np.meshgrid(theta, theta, np.arange(0.0, 181.0, 15.0), indexing="ij")
    off = np.geomspace(0.01, 1.0, 9)
    mirror, beside = np.meshgrid(np.append(theta, [88.5, 89.5]), np.concatenate([-off, off]), indexing="ij")
    inside = (mirror + beside >= 0.0) & (mirror + beside < 90.0)
    flank = (mirror[inside], (mirror + beside)[inside], np.zeros(int(np.sum(inside))))
    i, o, azimuth = (np.concatenate([a.ravel(), b]) for a, b in zip(grid, flank, strict=True))
    return i, o, azimuth


def integrated_albedo(
    model: ScatteringModel, theta_i_deg: float, polarization: Polarization, *, nodes: int = 400
) -> float:
    """Return the hemispherical integral of the dsf by brute force: the check of every closed-form albedo.

    A product of Gauss-Legendre rules over theta_o and azimuth; lobes narrower than about ``alpha = 3000``
    need more `nodes`.
    """
    x, w = gauss_legendre(nodes)
    theta = 45.0 * (x + 1.0)
    azimuth = 90.0 * (x + 1.0)
    value = model.dsf(theta_i_deg, theta[:, None], polarization, azimuth[None, :])
    per_theta = 2.0 * np.deg2rad(90.0) * (value @ w)  # both halves of the azimuth
    return float(np.sum(w * per_theta * sin_deg(theta)) * np.deg2rad(45.0))

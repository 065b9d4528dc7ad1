"""How does a surface reflect in the simulation, and does that conserve energy?

The four parameters are band averages; `k_d` and `k_s` are what a surface returns of unpolarised light.  The
lobe as published ignores that the diffuse part and the lobe share one unit of energy; `energy` says what is
done about it (docs/decisions/facade-energy.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.errors import SceneError

FloatArray = NDArray[np.float64]
Energy = Literal["conserving", "published"]
Horizon = Literal["absorb", "renormalize"]


MIRROR_ALPHA = 1e9
"""Exponent that stands for a mirror: 95 % of the light within 0.0044 deg."""


class EnergyWarning(UserWarning):
    """A material as published returns more light than it receives at some incidence."""


@dataclass(frozen=True, slots=True)
class Optics:
    """Band-averaged parameters of the model; a Lambert surface has ``rho_s = 0``.

    With `constant` the lobe returns `rho_s` at every incidence, as two hemispherical coefficients say.

    Raises
    ------
    SceneError
        A value outside its range: ``0 <= rho_d <= 1``, ``rho_s >= 0``, ``0 <= alpha <= 1e9``, ``n2 >= 1``.
    """

    rho_d: float
    rho_s: float = 0.0
    alpha: float = 1.0
    n2: float = 1.0
    constant: bool = False

    def __post_init__(self) -> None:
        for name, low, high in (
            ("rho_d", 0.0, 1.0),
            ("rho_s", 0.0, math.inf),
            ("alpha", 0.0, 1e9),
            ("n2", 1.0, math.inf),
        ):
            value = getattr(self, name)
            if not (low <= value <= high and math.isfinite(value)):
                upper = f"{high:g}" if math.isfinite(high) else "a finite value"
                raise SceneError(
                    f"{name} = {value:g} is outside {low:g}...{upper}; correct the material or refit it"
                )

    @classmethod
    def from_material(cls, material: Any) -> Optics:
        """Return the single band of a `gonio.material.Material`; without a lobe its alpha is not used."""
        rho_d, rho_s, alpha, n2 = (
            float(np.asarray(getattr(material, name)).ravel()[0])
            for name in ("rho_d", "rho_s", "alpha", "n2")
        )
        if rho_s == 0.0:
            return cls(rho_d)
        return cls(rho_d, rho_s, alpha, n2)

    @classmethod
    def two_coefficients(cls, k_d: float, k_s: float) -> Optics:
        """Return a Lambert surface with a mirror, whose coefficients are the same at every incidence.

        `SceneError` if they add up to more than 1.
        """
        if k_d + k_s > 1.0:
            raise SceneError(
                f"k_d + k_s = {k_d:g} + {k_s:g} returns more light than arrives; they must not exceed 1"
            )
        return cls(k_d, k_s, MIRROR_ALPHA, 1.0, constant=True)

    def row(self) -> tuple[float, float, float, float, float]:
        """Return the row of `gonio.facade.layout.Geometry.materials`."""
        return self.rho_d, self.rho_s, self.alpha, self.n2, float(self.constant)

    def k_s(self, theta_i_deg: ArrayLike) -> FloatArray:
        """Return ``rho_s R(n2, theta_i)`` of unpolarised light (paper Eq 20): the lobe, horizon or not."""
        if self.rho_s == 0.0 or self.constant:
            return np.full(np.shape(theta_i_deg), self.rho_s)
        from gonio.fresnel import reflectance

        return np.asarray(self.rho_s * reflectance(self.n2, theta_i_deg, "unpolarized"))

    def excess(self) -> tuple[float, float] | None:
        """Return the incidence from which ``rho_d + k_s`` exceeds 1, and the largest excess below 89.9 deg.

        ``None`` if the published model conserves energy up to there.  R grows monotonically with incidence
        from the Brewster region on, so the angle is found to 0.1 deg on a grid.
        """
        theta_deg = np.linspace(0.0, 89.9, 900)
        over = self.rho_d + self.k_s(theta_deg) - 1.0
        if np.max(over) <= 0.0:
            return None
        return float(theta_deg[np.argmax(over > 0.0)]), float(np.max(over))


def excess_text(name: str, optics: Optics, energy: Energy) -> str | None:
    """Return one sentence about a material that creates energy as published, or ``None``."""
    found = optics.excess()
    if found is None:
        return None
    angle_deg, excess = found
    fact = (
        f"material '{name}': rho_d + k_s as published exceeds 1 from {angle_deg:.1f} deg incidence, "
        f"by up to {excess:.3f}"
    )
    if energy == "published":
        return f'{fact}; energy is created there (energy = "conserving" avoids it)'
    return f'{fact}; the diffuse part is reduced there (energy = "conserving")'

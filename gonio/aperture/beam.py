"""How wide is the beam that falls on the sample, and from how many directions does it come?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gonio.aperture.receiver import FloatArray
from gonio.errors import ConfigError

WIDEST_DIVERGENCE_DEG = 5.0
"""Full angle; beyond, the expansion about the mean direction no longer keeps its digits."""


@dataclass(frozen=True, slots=True)
class IncidentBeam:
    """A uniform rectangle across the beam, of parallel light or of a uniform square cone of directions.

    Parameters
    ----------
    width_mm, height_mm
        Full width across the beam in the plane of incidence, which lights ``width / cos(theta_i)`` of the
        sample, and full height out of the plane; 0 for a line of light without width.
    divergence_deg
        Full angle of the cone, in plane and out of it; 0 for parallel light.
    """

    width_mm: float = 0.0
    height_mm: float = 0.0
    divergence_deg: float = 0.0

    def __post_init__(self) -> None:
        for name in ("width_mm", "height_mm", "divergence_deg"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ConfigError(f"beam: {name} = {value} must be 0 or positive; measure it and correct it")
        if self.divergence_deg > WIDEST_DIVERGENCE_DEG:
            raise ConfigError(
                f"beam: divergence_deg = {self.divergence_deg:g} deg is more than the "
                f"{WIDEST_DIVERGENCE_DEG:g} deg (full angle) this program integrates; check it"
            )

    @property
    def is_line(self) -> bool:
        """Whether nothing of it has an extent: parallel light that meets the sample's axis."""
        return self.width_mm == 0.0 and self.height_mm == 0.0 and self.divergence_deg == 0.0

    def half_length_mm(self, theta_i_deg: ArrayLike) -> FloatArray:
        """Return half the length of the lit spot along the plane of incidence, ``w / (2 cos(theta_i))``."""
        cosine = np.cos(np.deg2rad(np.asarray(theta_i_deg, np.float64)))
        with np.errstate(divide="ignore"):
            half = 0.5 * self.width_mm / np.maximum(cosine, 0.0)
        return np.asarray(np.where(self.width_mm == 0.0, 0.0, half))

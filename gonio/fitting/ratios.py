"""How well do two detectors agree where both measured?  The ratio of their k_g at 8 deg, with its
uncertainty.

Each column has readings, dark and baseline of its own, so the two values are independent.  A ratio off 1
beyond its uncertainty is what the paper saw as a step of 10 % at 860 nm: a gain that does not cancel between
sample and baseline (stray light, a nonlinear detector, an aperture that one of them does not fill).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.overlap import pairs

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

FloatArray = NDArray[np.float64]

THETA_I_DEG = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class DetectorRatio:
    """k_g of the detector of longer wavelengths over that of shorter ones, at the k wavelengths of both.

    Attributes
    ----------
    lower, upper : indices of the two detectors
    wavelength_nm, ratio, se : (k,), the ratio and its standard uncertainty
    mean, mean_se : weighted mean; its uncertainty is widened if the ratios scatter more than theirs explain
    """

    lower: int
    upper: int
    wavelength_nm: FloatArray
    ratio: FloatArray
    se: FloatArray
    mean: float
    mean_se: float

    def text(self, names: Sequence[str] = ()) -> str:
        """Return the comparison as a sentence; `names` are the detectors', in the order of the rig file."""
        low, high = (names[i] if i < len(names) else f"detector {i}" for i in (self.lower, self.upper))
        count = len(self.wavelength_nm)
        where = f"{self.wavelength_nm.min():g} nm"
        if count > 1:
            where = f"{where[:-3]}-{self.wavelength_nm.max():g} nm, {count} wavelengths"
        return f"{high} over {low} ({where}): k_g ratio {self.mean:.4f} ± {2.0 * self.mean_se:.4f} (95 %)"


def detector_ratios(fit: FitResult) -> tuple[DetectorRatio, ...]:
    """Return the comparison of each two detectors that share fitted wavelengths; empty without overlap."""
    k_g = fit.hemispherical(THETA_I_DEG).k_g
    by_detectors: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for a, b in pairs(fit.wavelength_nm, fit.detector_index):
        if all(np.isfinite(k_g.se[i]) and k_g.value[i] > 0.0 for i in (a, b)):
            by_detectors.setdefault((int(fit.detector_index[a]), int(fit.detector_index[b])), []).append(
                (a, b)
            )
    found: list[DetectorRatio] = []
    for (lower, upper), columns in by_detectors.items():
        a, b = np.array(columns).T
        ratio = k_g.value[b] / k_g.value[a]
        se = ratio * np.hypot(k_g.se[a] / k_g.value[a], k_g.se[b] / k_g.value[b])
        weight = 1.0 / np.maximum(se, 1e-12) ** 2
        mean = float(np.sum(weight * ratio) / np.sum(weight))
        scatter = float(np.sum(weight * (ratio - mean) ** 2)) / max(len(ratio) - 1, 1)
        mean_se = float(np.sqrt(max(scatter, 1.0) / np.sum(weight)))
        found.append(DetectorRatio(lower, upper, fit.wavelength_nm[a], ratio, se, mean, mean_se))
    return tuple(found)

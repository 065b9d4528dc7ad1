"""What are k_d, k_s and k_g averaged over a band, and how uncertain is the average?

    <k> = sum_j a_j k_j,   u^2 = sum_j (a_j g_j)' C_j (a_j g_j) + sum over modes of (sum_j a_j g_j' s_j)^2

a_j the shares of the wavelengths (`gonio.spectral`), g_j the gradient of k by the basic parameters, C_j
their covariance without the modes, independent from wavelength to wavelength, and s_j the shift of the
parameters by one standard uncertainty of a cause that all wavelengths share.  The first part falls with the
number of wavelengths, the second does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import special

from gonio.fitting.means import mode_shifts
from gonio.fitting.quantity import COEFFICIENTS
from gonio.spectral import LEAST_COVERAGE, BandWeights, Weight, band_weights

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BandCoefficient:
    """One coefficient averaged over a band.

    Attributes
    ----------
    value, u
        And standard uncertainty; NaN where it is not determined at some wavelength of the band.
    u_random, u_common
        Its two parts: independent from wavelength to wavelength, and shared by all.
    dof
        Effective degrees of freedom (Welch-Satterthwaite; the common part has infinitely many).
    lower, upper
        Ends of the 95 % interval.
    """

    value: float
    u: float
    u_random: float
    u_common: float
    dof: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True, eq=False)
class BandAverage:
    """Hemispherical coefficients averaged over a band, S/P mean; as `gonio.fitting.Hemispherical`."""

    low_nm: float
    high_nm: float
    theta_i_deg: float
    weights: BandWeights
    description: str
    k_d: BandCoefficient
    k_s: BandCoefficient
    k_g: BandCoefficient
    k_s_published: BandCoefficient
    k_g_published: BandCoefficient

    def text(self) -> str:
        """Return the average as a few lines."""
        lines = [f"{self.description}; at {self.theta_i_deg:g} deg, S/P mean, lobe above the horizon"]
        for name in ("k_d", "k_s", "k_g"):
            c: BandCoefficient = getattr(self, name)
            lines.append(
                f"  {name} = {c.value:.5f}, u = {c.u:.5f} (random {c.u_random:.5f}, "
                f"common {c.u_common:.5f}), 95 %: {c.lower:.5f} ... {c.upper:.5f}"
            )
        return "\n".join(lines)


def band_average(
    fit: FitResult,
    low_nm: float,
    high_nm: float,
    *,
    weight: Weight = "am15g",
    theta_i_deg: float = 8.0,
    least_coverage: float = LEAST_COVERAGE,
) -> BandAverage:
    """Return k_d, k_s and k_g averaged over a band, with the fit's full covariance.

    Parameters
    ----------
    low_nm, high_nm, weight, least_coverage
        As `gonio.spectral.band_weights`.
    theta_i_deg
        Incidence.

    Raises
    ------
    GonioError
        The fit's wavelengths cover too little of the band's weight, see `gonio.spectral.band_weights`.

    Notes
    -----
    A wavelength that two detectors measured counts once (`gonio.overlap.home`).  What the fit holds for exact
    (an aperture without uncertainty) is in no part of u; `gonio.fitting.budget` adds it as modes.
    """
    kept = fit.only(fit.home)
    k = kept.hemispherical(theta_i_deg)
    weights = band_weights(
        kept.wavelength_nm,
        low_nm,
        high_nm,
        weight,
        use=np.isfinite(k.k_g.value),
        least_coverage=least_coverage,
    )
    used = np.flatnonzero(weights.share != 0.0)
    part = kept.only(weights.share != 0.0)
    k = part.hemispherical(theta_i_deg)
    averaged = {
        name: _average(
            part, weights.share[used], name, theta_i_deg, getattr(k, name).value, getattr(k, name).se
        )
        for name in COEFFICIENTS
    }
    return BandAverage(
        low_nm, high_nm, theta_i_deg, weights, weights.text(low_nm, high_nm, weight), **averaged
    )


def _average(
    fit: FitResult, share: FloatArray, name: str, theta_i_deg: float, value: FloatArray, se: FloatArray
) -> BandCoefficient:
    shifts = mode_shifts(fit, name, theta_i_deg)
    random = np.maximum(se**2 - np.sum(shifts**2, axis=0), 0.0) * share**2
    u_random, u_common = float(np.sqrt(np.sum(random))), float(np.sqrt(np.sum((shifts @ share) ** 2)))
    u = float(np.hypot(u_random, u_common))
    dof = np.where(fit.dof > 0, fit.dof, 1).astype(np.float64)
    spread = float(np.sum(random**2 / dof))
    effective = u**4 / spread if spread > 0.0 else np.inf
    mean = float(np.sum(share * value))
    half = u * (
        float(special.stdtrit(effective, 0.975)) if np.isfinite(effective) else float(special.ndtri(0.975))
    )
    return BandCoefficient(mean, u, u_random, u_common, float(effective), mean - half, mean + half)

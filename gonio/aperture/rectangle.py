"""How much of a lobe, and of diffuse light, does the detector's rectangular aperture catch?

The aperture is a plane rectangle `width_mm` (in the plane of incidence) x `height_mm` at `distance_mm` from
the spot, perpendicular to the arm.  A direction is described by t in plane and psi out of plane, both from
the arm's axis; then ``dOmega = cos(psi) dpsi dt``, the angle to the mirror direction has ``cos(theta_s) =
cos(t - delta) cos(psi)``, the angle to the normal ``cos(theta) = cos(theta_o + t) cos(psi)``, and the
aperture is ``|t| <= atan(w / 2R)``, ``|psi| <= psi_max(t) = atan(h cos(t) / 2R)``.  The sample plane, like
the edge of cos_+, is a line of constant t: both cut the range of t and nothing else.

All light comes from one point here; `gonio.aperture.instrument` adds the beam's width and divergence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from gonio.angles import cos_deg
from gonio.aperture.approximations import InPlaneAverage, PointReceiver
from gonio.aperture.boundary import lobe_derivative
from gonio.aperture.receiver import APERTURE_NAMES, ApertureName, FloatArray, Receiver
from gonio.brdf.quadrature import across_integral, band_integral, band_integral_table, gauss_legendre
from gonio.errors import ConfigError

WIDEST_HALF_ANGLE_DEG = 45.0
"""Beyond this the fixed quadratures no longer keep 1e-12."""


@dataclass(frozen=True, slots=True)
class Aperture:
    """The exact aperture.

    Parameters
    ----------
    width_mm, height_mm
        Full width in the plane of incidence and full height across it.
    distance_mm
        From the sample's axis to the aperture's plane.
    """

    width_mm: float
    height_mm: float
    distance_mm: float

    def __post_init__(self) -> None:
        for name in ("width_mm", "height_mm", "distance_mm"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ConfigError(
                    f"aperture: {name} = {value} must be a positive length; measure it and correct it"
                )
        widest = max(self.half_angles_deg)
        if widest > WIDEST_HALF_ANGLE_DEG:
            raise ConfigError(
                f"aperture: {self.width_mm} x {self.height_mm} mm at {self.distance_mm} mm spans "
                f"±{widest:.1f} deg, "
                f"more than the ±{WIDEST_HALF_ANGLE_DEG:.0f} deg this program integrates; check the distance"
            )

    @property
    def half_angles_deg(self) -> tuple[float, float]:
        """Half angles in plane and across it, degrees: ``atan(w / 2R)``, ``atan(h / 2R)``."""
        half = np.rad2deg(np.arctan2([self.width_mm, self.height_mm], 2.0 * self.distance_mm))
        return float(half[0]), float(half[1])

    @property
    def solid_angle_sr(self) -> float:
        """Exact solid angle of a centred rectangle: ``4 atan(w h / (4 R sqrt(R^2 + w^2/4 + h^2/4)))``."""
        w, h, r = self.width_mm, self.height_mm, self.distance_mm
        return float(4.0 * np.arctan2(w * h, 4.0 * r * np.sqrt(r * r + 0.25 * (w * w + h * h))))

    @property
    def lobe_growth(self) -> float:
        """Zero: a lobe narrower than the aperture is caught whole."""
        return 0.0

    def lobe_integral(
        self,
        alpha: ArrayLike,
        delta_deg: ArrayLike,
        theta_o_deg: ArrayLike | None = None,
        theta_i_deg: ArrayLike | None = None,
    ) -> FloatArray:
        """Return ∫ (alpha + 1)/(2 pi) cos_+(theta_s)^alpha dOmega over the aperture.

        Parameters
        ----------
        alpha
            Lobe exponent, 0...1e8, any shape.
        delta_deg
            Mirror direction minus detector direction in plane, degrees, broadcast against `alpha`.
        theta_o_deg
            Detector direction from the normal, degrees.  When given, the part of the aperture below the
            sample plane receives nothing; without it the sample plane is ignored.
        theta_i_deg
            Not used: all light comes from one point.

        Returns
        -------
        ndarray
            Fraction of the lobe's energy, in the broadcast shape; NaN where an argument is NaN.  Relative
            error below 1e-12, but for values under about 1e-250 times the peak, which may underflow.

        Notes
        -----
        ``∫ cos(psi)^(alpha + 1) dpsi`` over ``±psi_max`` is an incomplete beta function; what remains in t is
        one smooth integral, done on each side of the mirror direction by 64 Gauss-Legendre nodes placed over
        the part that carries the value.
        """
        return band_integral(alpha, delta_deg, self._half_width_rad, theta_o_deg, self._across)

    def lobe_integral_dlog_alpha(
        self,
        alpha: ArrayLike,
        delta_deg: ArrayLike,
        theta_o_deg: ArrayLike | None = None,
        *,
        order: Literal[1, 2] = 1,
    ) -> FloatArray:
        """Return the first or second derivative of `lobe_integral` by ``log(alpha)``; 0 at alpha 0.

        Exact, from the border of the aperture alone (`gonio.aperture.boundary`); arguments and shape as
        `lobe_integral`.
        """
        given = [
            np.asarray(x, np.float64) for x in (alpha, delta_deg, 0.0 if theta_o_deg is None else theta_o_deg)
        ]
        broadcast = np.broadcast_arrays(*given)
        a, delta, out = (x.ravel() for x in broadcast)
        size = (self._half_width_rad, self.height_mm / (2.0 * self.distance_mm))
        horizon = None if theta_o_deg is None else out
        value = a * lobe_derivative(1, a, delta, *size, horizon)
        if order == 2:
            value += a**2 * lobe_derivative(2, a, delta, *size, horizon)
        return value.reshape(broadcast[0].shape)

    def lobe_table(
        self,
        alpha: FloatArray,
        delta_deg: FloatArray,
        theta_o_deg: FloatArray,
        theta_i_deg: FloatArray | None = None,
    ) -> FloatArray:
        """Return `lobe_integral` of alpha (n_alpha,) at positions (n,), as (n_alpha, n), to 1e-13."""
        return band_integral_table(alpha, delta_deg, self._half_width_rad, theta_o_deg, self._across)

    @property
    def _half_width_rad(self) -> np.longdouble:
        """In-plane half angle, with the digits that the flank of a narrow lobe needs."""
        width, distance = np.longdouble(self.width_mm), np.longdouble(self.distance_mm)
        return np.longdouble(np.arctan(width / (2 * distance)))

    def _across(self, alpha: FloatArray, t: FloatArray) -> FloatArray:
        return across_integral(alpha, self.height_mm / (2.0 * self.distance_mm) * np.cos(t))

    def diffuse_integral(self, theta_o_deg: ArrayLike, theta_i_deg: ArrayLike | None = None) -> FloatArray:
        """Return ∫ cos(theta)/pi dOmega over the part of the aperture above the sample plane.

        `theta_o_deg` may have any shape; an aperture wholly below the sample plane gives 0.  Across the plane
        ``∫ cos(psi)^2 dpsi = psi_max + sin(psi_max) cos(psi_max)`` is exact; t by 48 Gauss-Legendre nodes.
        """
        theta_o = np.asarray(theta_o_deg, np.float64)
        half_t = np.deg2rad(self.half_angles_deg[0])
        # the horizon is where |theta_o + t| = 90 deg
        low = np.clip(np.deg2rad(-90.0 - theta_o), -half_t, half_t)
        high = np.clip(np.deg2rad(90.0 - theta_o), -half_t, half_t)
        nodes, weights = gauss_legendre(48)
        t = 0.5 * (low + high)[..., None] + 0.5 * (high - low)[..., None] * nodes
        tangent = self.height_mm / (2.0 * self.distance_mm) * np.cos(t)
        across = np.arctan(tangent) + tangent / (1.0 + tangent**2)
        value = np.sum(weights * across * cos_deg(theta_o[..., None] + np.rad2deg(t)), axis=-1)
        return np.asarray(value * 0.5 * (high - low) / np.pi)

    def variant(self, name: ApertureName) -> Receiver:
        """Return this aperture as one of the fit's four receivers.

        ``"exact"``; ``"eq22"`` (in-plane average with this aperture's true half-width and solid angle);
        ``"point"`` (Eq 18); ``"published"`` (in-plane average with the paper's pair, whatever this aperture
        is).
        """
        if name == "exact":
            return self
        if name == "eq22":
            return InPlaneAverage(self.half_angles_deg[0], self.solid_angle_sr)
        if name == "point":
            return PointReceiver(self.solid_angle_sr)
        if name == "published":
            return self.published()
        raise ConfigError(f"aperture = {name!r} is not known; use one of {', '.join(APERTURE_NAMES)}")

    @staticmethod
    def published() -> InPlaneAverage:
        """Return Eq 22 with the paper's own pair, ±13 degrees and 0.0516 sr.

        No 26 x 18 mm rectangle has both: 0.0516 sr needs a distance of 94.6 mm, where the half-width is 7.8
        degrees.
        """
        return InPlaneAverage(13.0, 0.0516)

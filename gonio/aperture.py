"""How much of a lobe, and of diffuse light, does the detector's rectangular aperture catch?

The aperture is a plane rectangle `width_mm` (in the plane of incidence) x `height_mm` at `distance_mm` from
the spot, perpendicular to the arm.  A direction is described by t in plane and psi out of plane, both from
the arm's axis; then ``dOmega = cos(psi) dpsi dt``, the angle to the mirror direction has ``cos(theta_s) =
cos(t - delta) cos(psi)``, the angle to the normal ``cos(theta) = cos(theta_o + t) cos(psi)``, and the
aperture is ``|t| <= atan(w / 2R)``, ``|psi| <= psi_max(t) = atan(h cos(t) / 2R)``.  The sample plane, like
the edge of cos_+, is a line of constant t: both cut the range of t and nothing else.

`Aperture` integrates exactly.  `InPlaneAverage` (Eq 22 of Raybaud et al. 2022) and `PointReceiver` (Eq 18)
are the approximations of that paper behind the same three methods, kept so that their bias can be shown.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.angles import cos_deg
from gonio.brdf.quadrature import across_integral, band_integral, band_integral_table, gauss_legendre
from gonio.errors import ConfigError

FloatArray = NDArray[np.float64]
ApertureName = Literal["exact", "eq22", "point", "published"]
APERTURE_NAMES: tuple[ApertureName, ...] = get_args(ApertureName)

WIDEST_HALF_ANGLE_DEG = 45.0
"""Beyond this the fixed quadratures no longer keep 1e-12."""


class Receiver(Protocol):
    """What turns a dsf into the reading r: the exact aperture or one of its approximations."""

    @property
    def solid_angle_sr(self) -> float:
        """The solid angle that multiplies a constant intensity."""
        ...

    @property
    def lobe_growth(self) -> float:
        """Exponent g of the peak reading, ``alpha^g``, for a lobe much narrower than the aperture."""
        ...

    def lobe_integral(
        self, alpha: ArrayLike, delta_deg: ArrayLike, theta_o_deg: ArrayLike | None = None
    ) -> FloatArray:
        """Return the received part of ``(alpha + 1)/(2 pi) cos_+(theta_s)^alpha``."""
        ...

    def lobe_table(self, alpha: FloatArray, delta_deg: FloatArray, theta_o_deg: FloatArray) -> FloatArray:
        """Return `lobe_integral` of every alpha with every position, (n_alpha, n_position)."""
        ...

    def diffuse_integral(self, theta_o_deg: ArrayLike) -> FloatArray:
        """Return the received part of ``cos(theta)/pi``."""
        ...


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
        self, alpha: ArrayLike, delta_deg: ArrayLike, theta_o_deg: ArrayLike | None = None
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

        Returns
        -------
        ndarray
            Fraction of the lobe's energy, in the broadcast shape; NaN where an argument is NaN.  Relative
            error below 1e-12, but for values under about 1e-250 times the peak, which may underflow.

        Notes
        -----
        ``∫ cos(psi)^(alpha + 1) dpsi`` over ``±psi_max`` is an incomplete beta function; what remains in t is
        one smooth integral, done by 64 Gauss-Legendre nodes placed over the part that carries the value.
        """
        half_t = np.deg2rad(self.half_angles_deg[0])
        return band_integral(alpha, delta_deg, half_t, theta_o_deg, self._across)

    def lobe_table(self, alpha: FloatArray, delta_deg: FloatArray, theta_o_deg: FloatArray) -> FloatArray:
        """Return `lobe_integral` of alpha (n_alpha,) at positions (n,), as (n_alpha, n), to 1e-13."""
        half_t = np.deg2rad(self.half_angles_deg[0])
        return band_integral_table(alpha, delta_deg, half_t, theta_o_deg, self._across)

    def _across(self, alpha: FloatArray, t: FloatArray) -> FloatArray:
        return across_integral(alpha, self.height_mm / (2.0 * self.distance_mm) * np.cos(t))

    def diffuse_integral(self, theta_o_deg: ArrayLike) -> FloatArray:
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


@dataclass(frozen=True, slots=True)
class InPlaneAverage:
    """Eq 22: the dsf averaged over the in-plane angle only, times a solid angle."""

    half_width_deg: float
    solid_angle_sr: float

    @property
    def lobe_growth(self) -> float:
        """One half: a lobe is averaged over one angle, and its peak grows with the other."""
        return 0.5

    def lobe_integral(
        self, alpha: ArrayLike, delta_deg: ArrayLike, theta_o_deg: ArrayLike | None = None
    ) -> FloatArray:
        """Return Eq 22's lobe term; arguments as `Aperture.lobe_integral`."""
        half = np.deg2rad(self.half_width_deg)
        return band_integral(alpha, delta_deg, half, theta_o_deg, self._per_angle)

    def lobe_table(self, alpha: FloatArray, delta_deg: FloatArray, theta_o_deg: FloatArray) -> FloatArray:
        """Return `lobe_integral` of every alpha (n_alpha,) at every position (n,), as (n_alpha, n)."""
        half = np.deg2rad(self.half_width_deg)
        return band_integral_table(alpha, delta_deg, half, theta_o_deg, self._per_angle)

    def _per_angle(self, alpha: FloatArray, t: FloatArray) -> FloatArray:
        per_radian = self.solid_angle_sr / (2.0 * np.deg2rad(self.half_width_deg))
        return np.broadcast_to(
            per_radian * (alpha + 1.0) / (2.0 * np.pi), np.broadcast_shapes(alpha.shape, t.shape)
        )

    def diffuse_integral(self, theta_o_deg: ArrayLike) -> FloatArray:
        """Return Eq 22's diffuse term, the in-plane mean of ``cos(theta)/pi`` above the sample plane."""
        theta_o = np.asarray(theta_o_deg, np.float64)
        low = np.clip(theta_o - self.half_width_deg, -90.0, 90.0)
        high = np.clip(theta_o + self.half_width_deg, -90.0, 90.0)
        # sin(high) - sin(low) without cancellation
        area = 2.0 * cos_deg(0.5 * (low + high)) * np.sin(np.deg2rad(0.5 * (high - low)))
        return np.asarray(self.solid_angle_sr / (2.0 * np.deg2rad(self.half_width_deg)) * area / np.pi)


@dataclass(frozen=True, slots=True)
class PointReceiver:
    """Eq 18: the dsf at the detector's axis, times a solid angle."""

    solid_angle_sr: float

    @property
    def lobe_growth(self) -> float:
        """One: the reading at the peak is the peak itself."""
        return 1.0

    def lobe_integral(
        self, alpha: ArrayLike, delta_deg: ArrayLike, theta_o_deg: ArrayLike | None = None
    ) -> FloatArray:
        """Return Eq 18's lobe term; arguments as `Aperture.lobe_integral`."""
        a, delta = np.asarray(alpha, np.float64), np.asarray(delta_deg, np.float64)
        log_cos = np.log1p(-2.0 * np.sin(np.deg2rad(0.5 * np.where(np.abs(delta) < 90.0, delta, 0.0))) ** 2)
        lobe = np.where(np.abs(delta) < 90.0, np.exp(a * log_cos), np.where(np.isnan(delta), np.nan, 0.0))
        if theta_o_deg is not None:
            lobe = np.where(np.abs(np.asarray(theta_o_deg, np.float64)) < 90.0, lobe, 0.0)
        return np.asarray(self.solid_angle_sr * (a + 1.0) / (2.0 * np.pi) * lobe)

    def lobe_table(self, alpha: FloatArray, delta_deg: FloatArray, theta_o_deg: FloatArray) -> FloatArray:
        """Return `lobe_integral` of every alpha (n_alpha,) at every position (n,), as (n_alpha, n)."""
        return self.lobe_integral(alpha[:, None], delta_deg, theta_o_deg)

    def diffuse_integral(self, theta_o_deg: ArrayLike) -> FloatArray:
        """Return Eq 18's diffuse term, ``cos(theta_o)/pi``, zero below the sample plane."""
        return np.asarray(self.solid_angle_sr * np.maximum(cos_deg(theta_o_deg), 0.0) / np.pi)

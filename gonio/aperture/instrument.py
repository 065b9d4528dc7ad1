"""The instrument function: the aperture as the light of a beam with width and divergence sees it.

A beam lights a spot, and each of its points sees the aperture elsewhere; each of its directions has its own
mirror direction.  The reading is the mean over both, exact, by the closed form of `gonio.aperture.across` out
of the plane of incidence and the quadrature of `gonio.aperture.along` in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.aperture.across import across_coefficients, widest_v
from gonio.aperture.along import PlaneGeometry, accepted_light, nodes_about_mirror
from gonio.aperture.beam import IncidentBeam
from gonio.aperture.receiver import ApertureName, FloatArray, Receiver
from gonio.aperture.rectangle import Aperture
from gonio.errors import ConfigError, RefusedError

LONGEST_SPOT = 0.5
"""Half length of the lit spot that is still integrated, as a fraction of the distance to the aperture."""

_CHUNK = 512  # alphas worked on together: bounds the scratch memory to a few MB


@dataclass(frozen=True, slots=True)
class InstrumentFunction:
    """`gonio.aperture.receiver.Receiver` of an aperture and a beam."""

    aperture: Aperture
    beam: IncidentBeam

    @property
    def solid_angle_sr(self) -> float:
        """Solid angle of the aperture from the sample's axis."""
        return self.aperture.solid_angle_sr

    @property
    def lobe_growth(self) -> float:
        """Zero, as for the aperture: a narrow lobe's reading levels off."""
        return 0.0

    def variant(self, name: ApertureName) -> Receiver:
        """Return this or, for a name other than ``"exact"``, the aperture's approximation without a beam."""
        return self if name == "exact" else self.aperture.variant(name)

    def lobe_integral(
        self,
        alpha: ArrayLike,
        delta_deg: ArrayLike,
        theta_o_deg: ArrayLike | None = None,
        theta_i_deg: ArrayLike | None = None,
    ) -> FloatArray:
        """Return the lobe's fraction that enters the aperture, mean over the beam.

        Parameters
        ----------
        alpha, delta_deg, theta_o_deg
            As `Aperture.lobe_integral`; `theta_o_deg` is needed if the beam has a width.
        theta_i_deg
            Incidence, which stretches the spot; by default ``theta_o + delta``, that of a mirror.

        Returns
        -------
        ndarray
            In the broadcast shape; error below 1e-10 of the largest value at that alpha.
        """
        if self.beam.is_line:
            return self.aperture.lobe_integral(alpha, delta_deg, theta_o_deg)
        if theta_o_deg is None and (self.beam.width_mm > 0.0 or self.beam.height_mm > 0.0):
            raise ConfigError("a beam with a width needs the detector's angle: give theta_o_deg")
        if theta_i_deg is None:
            theta_i_deg = np.asarray(delta_deg) + (0.0 if theta_o_deg is None else np.asarray(theta_o_deg))
        given = np.broadcast_arrays(
            *(
                np.asarray(x, np.float64)
                for x in (alpha, delta_deg, 0.0 if theta_o_deg is None else theta_o_deg, theta_i_deg)
            )
        )
        a, *angles = (x.ravel() for x in given)
        result = np.full(a.shape, np.nan)
        good = np.flatnonzero(np.isfinite(a + angles[0] + angles[1] + angles[2]))
        if good.size:
            alphas, which = np.unique(a[good], return_inverse=True)
            positions, where = np.unique(np.stack(angles)[:, good], axis=1, return_inverse=True)
            groups = [which.ravel()[where.ravel() == k] for k in range(positions.shape[1])]
            found = self._table(alphas, positions, theta_o_deg is not None, 1, groups)
            result[good] = found[0][which.ravel(), where.ravel()]
        return result.reshape(given[0].shape)

    def lobe_table(
        self,
        alpha: FloatArray,
        delta_deg: FloatArray,
        theta_o_deg: FloatArray,
        theta_i_deg: FloatArray | None = None,
    ) -> FloatArray:
        """Return `lobe_integral` of alpha (n_alpha,) at positions (n,), as (n_alpha, n)."""
        if self.beam.is_line:
            return self.aperture.lobe_table(alpha, delta_deg, theta_o_deg)
        moments = self.lobe_moments(alpha, delta_deg, theta_o_deg, theta_i_deg, count=1)
        return np.asarray(moments[0])

    def lobe_moments(
        self,
        alpha: FloatArray,
        delta_deg: FloatArray,
        theta_o_deg: FloatArray,
        theta_i_deg: FloatArray | None = None,
        *,
        count: int = 3,
    ) -> FloatArray:
        """Return the means of the lobe times ``P_k(2a / divergence)``, k = 0...3, (count, n_alpha, n).

        a is the in-plane tilt of the incident light: its incidence is ``theta_i + a``.  With the Fresnel
        reflectance expanded as ``R(theta_i + a) = sum c_k P_k``, the reading is ``sum c_k`` times these.
        """
        theta_i = delta_deg + theta_o_deg if theta_i_deg is None else theta_i_deg
        return self._table(alpha, np.stack([delta_deg, theta_o_deg, theta_i]), True, count, None)

    def diffuse_integral(self, theta_o_deg: ArrayLike, theta_i_deg: ArrayLike | None = None) -> FloatArray:
        """Return ∫ cos(theta)/pi dOmega over the aperture, mean over the spot lit at `theta_i_deg`."""
        parallel = IncidentBeam(self.beam.width_mm, self.beam.height_mm)
        if parallel.is_line:
            return self.aperture.diffuse_integral(theta_o_deg)
        if theta_i_deg is None:
            raise ConfigError("a beam with a width needs the incidence: give theta_i_deg")
        theta_o = np.asarray(theta_o_deg, np.float64)
        # a lobe of exponent 1 about the normal
        return InstrumentFunction(self.aperture, parallel).lobe_integral(1.0, -theta_o, theta_o, theta_i_deg)

    def _table(
        self,
        alpha: FloatArray,
        positions: FloatArray,
        horizon: bool,
        moments: int,
        groups: list[NDArray[np.intp]] | None,
    ) -> FloatArray:
        """Return (moments, n_alpha, n) at columns (delta, theta_o, theta_i) in degrees.

        `groups` names for each position the alphas wanted; the rest stays zero.
        """
        delta, theta_o, theta_i = positions
        spot = self.beam.half_length_mm(theta_i)
        distance = self.aperture.distance_mm
        too_long = spot > LONGEST_SPOT * distance
        if np.any(too_long):
            worst = int(np.argmax(spot))
            raise RefusedError(
                f"at theta_i = {theta_i[worst]:g} deg the beam of {self.beam.width_mm:g} mm lights "
                f"{2.0 * spot[worst]:g} mm of the sample, and the aperture is {distance:g} mm away; leave "
                f"out positions where the spot is longer than {2.0 * LONGEST_SPOT * distance:g} mm"
            )
        half_t = np.deg2rad(self.aperture.half_angles_deg[0])
        tilt = 0.5 * np.deg2rad(self.beam.divergence_deg)
        geometries = [
            PlaneGeometry(
                0.5 * self.aperture.width_mm,
                distance,
                float(np.deg2rad(theta_o[k])) if horizon else None,
                float(spot[k]),
                float(np.deg2rad(delta[k])),
                float(tilt),
            )
            for k in range(delta.size)
        ]
        breaks = [g.breaks() for g in geometries]
        reach = max((float(np.max(np.abs(b))) for b in breaks if b.size), default=half_t)
        lift = float(np.max(spot * np.abs(np.sin(np.deg2rad(theta_o))))) if horizon else 0.0
        tau_range = (float(np.cos(reach)) / (distance + lift), 1.0 / (distance - lift))
        coefficients = across_coefficients(
            alpha, tau_range, 0.5 * self.aperture.height_mm, 0.5 * self.beam.height_mm, float(tilt)
        )
        limit = widest_v(alpha)
        table = np.zeros((moments, alpha.size, delta.size))
        for k, (geometry, at) in enumerate(zip(geometries, breaks, strict=True)):
            rows = np.arange(alpha.size) if groups is None else np.unique(groups[k])
            if at.size == 0 or rows.size == 0:
                continue
            u, weight, log_cos = nodes_about_mirror(at, geometry, alpha[rows])
            if u.size == 0:
                continue
            light = accepted_light(at, geometry, u, tau_range, coefficients.shape[2], moments)
            for first in range(0, rows.size, _CHUNK):
                part = rows[first : first + _CHUNK]
                lobe = np.exp(alpha[part, None] * log_cos) * weight
                v = np.minimum(np.tan(u) ** 2, limit[part, None]) if tilt > 0.0 else np.zeros((1, 1))
                for m in range(moments):
                    mean = coefficients[-1][part] @ light[m]
                    for power in range(coefficients.shape[0] - 2, -1, -1):
                        mean = mean * v + coefficients[power][part] @ light[m]
                    table[m, part, k] = np.sum(lobe * mean, axis=1)
        return table

"""Which directions does a receiver see?  Bands of in-plane angle, each with an extent out of plane.

Angles are those of `gonio.aperture`: t in plane and psi out of plane, ``dOmega = cos(psi) dpsi dt``.  A ray
of direction (t, psi) crosses the aperture's plane at the height ``v = D tan(psi) / cos(t - axis)``, D the
distance from its origin.  The scattering models are symmetric in psi, so half an aperture, ``0 <= v <= h/2``,
is counted twice.  Eq 22 of Raybaud et al. (2022) is a band without extent, Eq 18 a single direction.

A beam of width w_b and height h_b lights ``|x| <= X = w_b / (2 cos(theta_i))``, ``|y| <= h_b/2`` of the
sample.  From x the aperture lies at ``D = R - x sin(theta_o)``, and light of direction t enters from an
interval of x, all of the spot or what the rims leave of it: three bands.  Of the heights y, the fraction that
enters at v is 1 up to ``(h - h_b)/2`` and falls linearly to 0 at ``(h + h_b)/2``: two parts.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture, IncidentBeam, InPlaneAverage, InstrumentFunction, PointReceiver, Receiver
from gonio.brdf.quadrature import gauss_legendre
from gonio.errors import FitError

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

_HORIZON = 0.5 * np.pi


@dataclass(frozen=True, slots=True)
class Bands:
    """Bands of n readings; a reading is the weighted sum of the integrals over its bands.

    Attributes
    ----------
    half_width_mm, distance_mm
        Of the aperture.
    flat
        The integral is over t alone, ``∫ dsf dt``, at psi = 0.
    single
        The value at `axis`, without any integral.
    position
        The reading that a band belongs to, (b,).
    theta_i, axis
        Incidence and the arm's direction from the normal, radians, (b,).
    low, high
        In-plane limits from the normal, radians, (b,), cut at the sample plane; empty where ``low >= high``,
        but for `single` directions.
    from_mm, to_mm
        Limits of v, (b,).
    level, slope
        The fraction of the heights y that enters at v is ``level + slope v``, (b,).
    spot_mm
        Half length of the lit spot, (b,); 0 for a line of light.
    node
        Where in the accepted interval of x this band is taken, -1...1, (b,).
    weight
        (b,)
    part, part_out
        Shares of the whole aperture that the band takes in plane and out of it, (b,).
    """

    half_width_mm: float
    distance_mm: float
    flat: bool
    single: bool
    position: IndexArray
    theta_i: FloatArray
    axis: FloatArray
    low: FloatArray
    high: FloatArray
    from_mm: FloatArray
    to_mm: FloatArray
    level: FloatArray
    slope: FloatArray
    spot_mm: FloatArray
    node: FloatArray
    weight: FloatArray
    part: FloatArray
    part_out: FloatArray

    @property
    def psi_most(self) -> FloatArray:
        """Largest psi of every band, (b,)."""
        nearest = self.distance_mm - self.spot_mm * np.abs(np.sin(self.axis))
        return np.asarray(np.arctan(self.to_mm / nearest))

    def pick(self, rows: IndexArray) -> Bands:
        """Return some of the bands."""
        values = (getattr(self, field.name) for field in dataclasses.fields(self))
        arrays = [value[rows] for value in values if isinstance(value, np.ndarray)]
        return Bands(self.half_width_mm, self.distance_mm, self.flat, self.single, *arrays)

    def accepted(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the share of the spot whose light enters at t, (b, k), and the distance D from there, mm."""
        if not np.any(self.spot_mm):
            return np.ones_like(t), np.full_like(t, self.distance_mm)
        axis, spot = self.axis[:, None], self.spot_mm[:, None]
        # |x cos(t) + R sin(t - axis)| <= w/2 cos(t - axis)
        centre = -self.distance_mm * np.sin(t - axis)
        side = self.half_width_mm * np.cos(t - axis)
        with np.errstate(divide="ignore", over="ignore"):
            low, high = (np.clip((centre + x) / np.cos(t), -spot, spot) for x in (-side, side))
        lit = np.where(spot > 0.0, 2.0 * spot, 1.0)
        share = np.where(spot > 0.0, np.maximum(high - low, 0.0) / lit, 1.0)
        x = 0.5 * (low + high) + 0.5 * (high - low) * self.node[:, None]
        return share, self.distance_mm - np.where(spot > 0.0, x, 0.0) * np.sin(axis)


def bands_of(receiver: Receiver, theta_i_deg: FloatArray, theta_o_deg: FloatArray) -> Bands:
    """Return the bands of a receiver at n positions, (n,) degrees each.

    Raises
    ------
    FitError
        A receiver that is not known here, or a divergent beam.
    """
    theta_i, axis = np.deg2rad(theta_i_deg), np.deg2rad(theta_o_deg)
    if isinstance(receiver, Aperture):
        return _rectangle(receiver, IncidentBeam(), theta_i, axis)
    if isinstance(receiver, InstrumentFunction):
        if receiver.beam.divergence_deg > 0.0:
            raise FitError(
                f"the beam diverges by {receiver.beam.divergence_deg:g} deg, and only the published lobe and "
                "Lambert are fitted with that; fit one of these, or give beam = False to take it as a line"
            )
        return _rectangle(receiver.aperture, receiver.beam, theta_i, axis)
    if isinstance(receiver, InPlaneAverage):
        half = np.deg2rad(receiver.half_width_deg)
        return _flat(theta_i, axis, float(half), float(receiver.solid_angle_sr / (2.0 * half)))
    if isinstance(receiver, PointReceiver):
        return _flat(theta_i, axis, 0.0, receiver.solid_angle_sr)
    raise FitError(
        f"{type(receiver).__name__} cannot be integrated over this scattering model; "
        "use the aperture or one of its variants, or fit the published lobe"
    )


def _flat(theta_i: FloatArray, axis: FloatArray, half: float, weight: float) -> Bands:
    zero, one = np.zeros(axis.size), np.ones(axis.size)
    return Bands(
        0.0,
        1.0,
        True,
        half == 0.0,
        np.arange(axis.size),
        theta_i,
        axis,
        np.maximum(axis - half, -_HORIZON),
        np.minimum(axis + half, _HORIZON),
        zero,
        zero,
        one,
        zero,
        zero,
        zero,
        weight * one,
        one,
        one,
    )


def _rectangle(aperture: Aperture, beam: IncidentBeam, theta_i: FloatArray, axis: FloatArray) -> Bands:
    half, far = 0.5 * aperture.width_mm, aperture.distance_mm
    spot = beam.half_length_mm(np.rad2deg(theta_i))
    # the directions in which the ends of the spot see the rims
    x = np.stack([-spot, spot], axis=1)[:, :, None]
    sides = np.array([-half, half]) - x * np.cos(axis)[:, None, None]
    rims = np.sort(np.arctan2(sides, far - x * np.sin(axis)[:, None, None]).reshape(axis.size, 4), axis=1)
    rims = np.clip(rims + axis[:, None], -_HORIZON, _HORIZON)
    count = _spot_nodes(float(np.max(spot, initial=0.0)) / far)
    nodes, weights = gauss_legendre(count)
    parts = []
    whole = np.maximum(rims[:, 3] - rims[:, 0], 1e-300)
    for zone in range(3):
        low, high = rims[:, zone], rims[:, zone + 1]
        rows = np.flatnonzero(high > low)
        for node, share in zip(nodes, weights, strict=True):
            for from_mm, to_mm, level, slope in _heights(aperture.height_mm, beam.height_mm):
                one = np.ones(rows.size)
                parts.append(
                    (
                        rows, theta_i[rows], axis[rows], low[rows], high[rows], from_mm * one, to_mm * one,
                        level * one, slope * one, spot[rows], node * one, share * one,
                        ((high - low) / whole)[rows], (to_mm - from_mm) / (0.5 * aperture.height_mm) * one,
                    )
                )  # fmt: skip
    arrays = [np.concatenate(column) for column in zip(*parts, strict=True)]
    # 2 halves in psi, and Gauss weights that add up to 2
    arrays[11] *= 2.0 / float(np.sum(weights))
    return Bands(half, far, False, False, *arrays)


def _heights(height: float, beam: float) -> list[tuple[float, float, float, float]]:
    """Return (from, to, level, slope) of the heights v, mm, that all or part of the beam's light reaches."""
    if beam == 0.0:
        return [(0.0, 0.5 * height, 1.0, 0.0)]
    full, end = 0.5 * abs(height - beam), 0.5 * (height + beam)
    parts = [(0.0, full, min(1.0, height / beam), 0.0), (full, end, end / beam, -1.0 / beam)]
    return [part for part in parts if part[1] > part[0]]


def _spot_nodes(ratio: float) -> int:
    """Nodes along the spot, from its half length over the distance: about 1e-10 of the reading is left."""
    return 1 if ratio == 0.0 else 2 if ratio < 0.01 else 3 if ratio < 0.03 else 5 if ratio < 0.1 else 10

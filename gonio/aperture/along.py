r"""Which part of the lit spot sends light of a direction into the aperture, and how much in all?

In the plane of incidence a point at x of the spot, ``|x| <= X``, sees the aperture's plane at distance
``D = R - x sin(theta_o)``, and its light of direction t from the arm's axis enters if ``|x cos(theta_o + t) +
R sin(t)| <= w/2 cos(t)``: for a given direction the accepted x are an interval.  So the integral over
directions comes last, with nodes graded about the mirror direction, between the directions at which that
interval begins or ceases to be cut by the ends of the spot; all alphas share them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.aperture.receiver import FloatArray
from gonio.brdf.quadrature import gauss_legendre

_RIM_ALPHA = 30.0  # from this exponent on cos_+^alpha is smooth where it ends
_RIM_NEAR_RAD = 0.6


@dataclass(frozen=True, slots=True)
class PlaneGeometry:
    """One position as its plane of incidence shows it; lengths in mm, angles in radians."""

    half_width: float  # of the aperture
    distance: float
    theta_o: float | None  # None: no sample plane cuts the aperture, and all light comes from its axis
    spot: float  # half length of the lit spot
    delta: float  # mirror direction minus detector direction
    tilt: float  # half angle of the cone of incidence

    def breaks(self) -> FloatArray:
        """Return the directions at which something begins or ends, ascending, (n,); empty if all is dark."""
        sin_o, cos_o = (0.0, 1.0) if self.theta_o is None else (np.sin(self.theta_o), np.cos(self.theta_o))
        x = np.array([-self.spot, self.spot]) if self.spot > 0.0 else np.zeros(1)
        sides = np.array([-self.half_width, self.half_width])[:, None] - x * cos_o
        found = np.arctan2(sides, self.distance - x * sin_o).ravel()
        low, high = np.min(found), np.max(found)
        if self.theta_o is not None:
            low = max(low, -0.5 * np.pi - self.theta_o)
            high = min(high, 0.5 * np.pi - self.theta_o)
        if low >= high:
            return np.empty(0)
        return np.unique(np.concatenate([[low, high], found[(found > low) & (found < high)]]))

    def accepted(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the accepted x, from and to, in the shape of t."""
        if self.spot == 0.0:
            return np.zeros_like(t), np.zeros_like(t)
        cosine = np.cos(t) if self.theta_o is None else np.cos(self.theta_o + t)
        centre, side = -self.distance * np.sin(t), self.half_width * np.cos(t)
        with np.errstate(divide="ignore", over="ignore"):
            low, high = (centre - side) / cosine, (centre + side) / cosine
        return np.clip(low, -self.spot, self.spot), np.clip(high, -self.spot, self.spot)


def nodes_about_mirror(
    breaks: FloatArray, geometry: PlaneGeometry, alpha: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return in-plane angles u to the mirror direction, their weights, and ``ln cos(u)``, (n,) each.

    Panels of 16 Gauss-Legendre nodes double in width away from the direction nearest to the mirror's,
    beginning with a lobe's width (in the flank, its decay length) of the largest alpha.  Near the rim of a
    wide lobe, where cos_+^alpha is not smooth, nodes are at equal steps of the sixth root of the angle to it.
    """
    jumps = breaks - geometry.delta
    if geometry.tilt > 0.0:
        jumps = np.concatenate([jumps - geometry.tilt, jumps + geometry.tilt])
    low, high = max(jumps.min(), -0.5 * np.pi), min(jumps.max(), 0.5 * np.pi)
    if low >= high:
        return np.empty(0), np.empty(0), np.empty(0)
    nearest = min(max(0.0, low), high)
    largest = float(np.max(alpha))
    finest = min(2.0 / np.sqrt(largest + 1.0), 8.0 / max(largest * np.tan(abs(nearest)), 1e-300), 0.25)
    steps = finest * 2.0 ** np.arange(0.0, 60.0)
    steps = np.concatenate([steps[steps < 0.25], np.arange(0.25, 3.3, 0.25)])
    edges = np.concatenate([nearest - steps, [nearest], nearest + steps, jumps, [low, high]])
    edges = np.unique(edges[(edges >= low) & (edges <= high)])
    keep = np.concatenate([[True], np.diff(edges) > 1e-15])
    edges = edges[keep]
    x, w = gauss_legendre(16)
    half = 0.5 * np.diff(edges)[:, None]
    u = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * x
    weight = half * w
    log_cos = np.log1p(-2.0 * np.sin(0.5 * u) ** 2)
    rim = 0.5 * np.pi - np.maximum(np.abs(edges[1:]), np.abs(edges[:-1])) < _RIM_NEAR_RAD
    if np.min(alpha) < _RIM_ALPHA and np.any(rim):
        ends = 0.5 * np.pi - np.abs(np.stack([edges[:-1], edges[1:]])[:, rim])
        s0, s1 = np.maximum(ends, 0.0)[:, :, None] ** (1.0 / 6.0)
        s = 0.5 * (s0 + s1) + 0.5 * (s1 - s0) * x
        y = s**6
        side = np.sign(0.5 * (edges[1:] + edges[:-1])[rim])[:, None]
        u[rim] = side * (0.5 * np.pi - y)
        weight[rim] = np.abs(0.5 * (s1 - s0)) * 6.0 * s**5 * w
        log_cos[rim] = np.log(np.sin(y))
    return u.ravel(), weight.ravel(), log_cos.ravel()


def accepted_light(
    breaks: FloatArray,
    geometry: PlaneGeometry,
    u: FloatArray,
    tau_range: tuple[float, float],
    degree: int,
    moments: int,
) -> FloatArray:
    """Return the means over the spot's length and the tilts in plane of ``P_k(a / tilt) T_q(tau)``.

    Shape (moments, degree, n_u); P_k are Legendre polynomials of the tilt a, over the accepted light only.
    """
    sin_o = 0.0 if geometry.theta_o is None else np.sin(geometry.theta_o)
    count = 1 if geometry.spot * abs(sin_o) == 0.0 else _spot_nodes(geometry.spot / geometry.distance)
    x, w = gauss_legendre(count)
    middle = 0.5 * sum(tau_range)
    half = 0.5 * (tau_range[1] - tau_range[0])
    result = np.zeros((moments, degree, u.size))

    def add(at: NDArray[np.intp], t: FloatArray, share: FloatArray, tilt: FloatArray) -> None:
        """Add directions t, (n, nodes), of weights `share`, for the u numbered `at`, (n,)."""
        low, high = geometry.accepted(t)
        if geometry.spot > 0.0:
            share = share * np.maximum(high - low, 0.0) / (2.0 * geometry.spot)
        spots = 0.5 * (low + high)[..., None] + 0.5 * (high - low)[..., None] * x
        tau = np.cos(t)[..., None] / (geometry.distance - spots * sin_o)
        z = np.clip((tau - middle) / half, -1.0, 1.0) if half > 0.0 else np.zeros_like(tau)
        legendre = [np.ones_like(tilt), tilt, 1.5 * tilt**2 - 0.5, 2.5 * tilt**3 - 1.5 * tilt]
        previous, current = np.ones_like(z), z
        for q in range(degree):
            basis = np.sum(previous * (0.5 * w), axis=-1)
            for k in range(moments):
                result[k, q, at] += np.sum(share * legendre[k] * basis, axis=-1)
            previous, current = current, 2.0 * z * current - previous

    everywhere = np.arange(u.size)
    if geometry.tilt == 0.0:
        t = (u + geometry.delta)[:, None]
        add(everywhere, t, np.ones_like(t), np.zeros_like(t))
        return result
    nodes, weights = gauss_legendre(8)
    direct = u + geometry.delta
    for start, end in itertools.pairwise(breaks):
        # tilts, not directions: where nothing is cut their range has all its digits, however small the cone
        low, high = np.maximum(-geometry.tilt, start - direct), np.minimum(geometry.tilt, end - direct)
        at = np.flatnonzero(high > low)
        if at.size:
            h = 0.5 * (high - low)[at, None]
            tilt = 0.5 * (high + low)[at, None] + h * nodes
            add(at, direct[at, None] + tilt, h * weights / (2.0 * geometry.tilt), tilt / geometry.tilt)
    return result


def _spot_nodes(ratio: float) -> int:
    """Nodes along the spot, from its half length over the distance."""
    return 4 if ratio < 0.01 else 6 if ratio < 0.05 else 10 if ratio < 0.2 else 20

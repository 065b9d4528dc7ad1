"""Readings of any scattering model, by a quadrature that shares nothing with the fit's tables."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture
from gonio.brdf import ScatteringModel
from gonio.fresnel import Polarization

FloatArray = NDArray[np.float64]

_RULE = np.polynomial.legendre.leggauss(10)


def _panels(edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    nodes, weights = _RULE
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half + half * nodes).ravel(), (half * weights).ravel()


def _graded(low: float, high: float, about: float, finest: float, panels: int) -> FloatArray:
    """Edges from low to high, geometrically finer towards `about`; `panels` equal ones for `finest` = 0."""
    if finest <= 0.0:
        return np.linspace(low, high, panels + 1)
    about = min(max(about, low), high)
    steps = np.concatenate([[0.0], np.geomspace(finest, max(high - low, 2.0 * finest), panels)])
    edges = np.concatenate([about - steps, about + steps, [low, high]])
    return np.unique(edges[(edges >= low) & (edges <= high)])


def surface_reading(
    model: ScatteringModel,
    theta_i_deg: float,
    theta_o_deg: float,
    polarization: Polarization,
    aperture: Aperture,
    *,
    panels: int = 12,
    finest_deg: float = 0.0,
    x_mm: float = 0.0,
    y_mm: float = 0.0,
) -> float:
    """The dsf summed over the plane of the aperture, solid angle R dA / |p|^3; nothing from below the sample.

    `finest_deg` > 0 grades the panels towards the mirror direction for narrow lobes.  `x_mm` and `y_mm` are
    the point of the sample that sends the light, along the plane of incidence and across it.
    """
    o, i = np.deg2rad(theta_o_deg), np.deg2rad(theta_i_deg)
    far = aperture.distance_mm - x_mm * np.sin(o)
    left, right = (side * aperture.width_mm / 2.0 - x_mm * np.cos(o) for side in (-1.0, 1.0))
    down, up = (side * aperture.height_mm / 2.0 - y_mm for side in (-1.0, 1.0))
    outermost = (left, right)
    if o != 0.0:  # the horizon is a line x = const of the aperture
        horizon = far / np.tan(o)
        left, right = (max(left, horizon), right) if o < 0.0 else (left, min(right, horizon))
    if right <= left:
        return 0.0
    finest = far * np.deg2rad(finest_deg)
    mirror = far * np.tan(np.clip(i - o, -1.5, 1.5))
    inner = {left, right}
    if abs(i - o) > 0.5 and left < (edge := -far / np.tan(i - o)) < right:
        inner.add(edge)  # where cos_+ ends
    ends = sorted(inner)
    parts = [_graded(a, b, mirror, finest, panels) for a, b in itertools.pairwise(ends)]
    # cos_+^alpha and the masking of facets end in corners: finer panels towards these
    corners = [x for x in ends if x not in outermost]
    parts += [_graded(left, right, x, 1e-5 * (right - left), 12) for x in corners]
    edges = np.unique(np.concatenate(parts))
    x, wx = _panels(edges)
    if y_mm == 0.0:
        y, wy = _panels(_graded(0.0, up, 0.0, finest, panels))
        wy = 2.0 * wy
    else:
        y, wy = _panels(_graded(down, up, 0.0, finest, panels))
    u, v = np.meshgrid(x, y, indexing="ij")
    length = np.sqrt(u**2 + v**2 + far**2)
    dx, dy = (far * np.sin(o) + u * np.cos(o)) / length, v / length
    dz = (far * np.cos(o) - u * np.sin(o)) / length
    out, azimuth = np.rad2deg(np.arctan2(np.hypot(dx, dy), dz)), np.rad2deg(np.arctan2(dy, dx))
    dsf = model.dsf(theta_i_deg, np.minimum(out, 90.0), polarization, azimuth)
    return float(np.sum(np.outer(wx, wy) * far / length**3 * dsf))

"""What would a bench read whose geometry is not quite what it is taken to be?

A plain quadrature over the plane of the aperture, with the directions of every point of it in the frame of
the sample as it really stands; it shares nothing with the aperture integral of `gonio.aperture` and takes any
scattering model.

The beam runs in the plane of incidence through the sample's axis, the origin.  With z along the nominal
normal, x on the specular side and y out of the plane, light comes from ``s = (-sin i, 0, cos i)``.  The
surface lies `offset` along its normal from the origin, so that the beam meets it at ``P = offset / (s'n) s``;
the normal is ``n = (0, sin tilt, cos tilt)``.  A point of the aperture at (u, v) of its plane is ``R a + u e
+ v y`` with the arm's axis ``a = (sin o, 0, cos o)`` and ``e = (cos o, 0, -sin o)``; it is seen from P along
d, with ``dOmega = (d'a) du dv / distance^2``.  The plane of incidence of a tilted surface is turned against
the polarizer, and sin^2 of that angle is light of the other polarization.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.aperture import Aperture
from gonio.brdf import ScatteringModel

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_NODES_PER_SIGMA = 1.2
_FEWEST = 4
_MOST_POINTS = 100_000  # at once: scratch arrays stay in the cache


@dataclass(frozen=True, slots=True)
class Bench:
    """A geometry, every field a number or (d,) draws.

    Attributes
    ----------
    width_mm, height_mm, distance_mm
        Of the aperture.
    arm_zero_deg, theta_i_zero_deg
        What is to be added to theta_mes and theta_i as read.
    tilt_deg, offset_mm
        Of the sample: its normal out of the plane of incidence, and its surface along the normal.
    """

    width_mm: ArrayLike
    height_mm: ArrayLike
    distance_mm: ArrayLike
    arm_zero_deg: ArrayLike = 0.0
    theta_i_zero_deg: ArrayLike = 0.0
    tilt_deg: ArrayLike = 0.0
    offset_mm: ArrayLike = 0.0

    @classmethod
    def nominal(cls, instrument: Aperture) -> Bench:
        """Return the bench as the fit takes it to be."""
        return cls(instrument.width_mm, instrument.height_mm, instrument.distance_mm)

    @property
    def draws(self) -> int:
        """How many there are."""
        return int(np.broadcast(*(getattr(self, name) for name in self.__slots__)).size)


def readings_on(
    bench: Bench,
    surfaces: tuple[ScatteringModel, ScatteringModel],
    theta_i_deg: FloatArray,
    theta_o_deg: FloatArray,
    is_s: BoolArray,
    *,
    sharpness: float,
) -> FloatArray:
    """Return the readings r, (n, d), of n positions on d benches.

    Parameters
    ----------
    surfaces
        What S and what P light meet, with scalar parameters or (d,) of them.
    theta_i_deg, theta_o_deg, is_s
        (n,) positions as they are read.
    sharpness
        Largest ``alpha`` of a lobe, which decides how many points the aperture is summed over: one or
        two per standard deviation of the lobe, ``1/sqrt(alpha + 1)``, and a few; 1e-6 of the largest reading.
    """
    far = float(np.min(np.asarray(bench.distance_mm)))
    half = [float(np.max(np.asarray(size))) / (2.0 * far) for size in (bench.width_mm, bench.height_mm)]
    nodes = [_FEWEST + int(np.ceil(_NODES_PER_SIGMA * 2.0 * x * np.sqrt(sharpness + 1.0))) for x in half]
    u, v, weight = _rule(*nodes)
    found = np.empty((theta_i_deg.size, bench.draws))
    step = max(1, _MOST_POINTS // (u.size * bench.draws))
    for own, other, chosen in ((0, 1, is_s), (1, 0, ~is_s)):
        rows = np.flatnonzero(chosen)
        for first in range(0, rows.size, step):
            pick = rows[first : first + step]
            found[pick] = _summed(
                bench, surfaces[own], surfaces[other], own == 0, theta_i_deg[pick], theta_o_deg[pick],
                u, v, weight,
            )  # fmt: skip
    return found


def _rule(across: int, along: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Gauss-Legendre points of the aperture in units of its half sides, (q, 1), and weights."""
    (x, wx), (y, wy) = (np.polynomial.legendre.leggauss(count) for count in (across, along))
    u, v = np.meshgrid(x, y, indexing="ij")
    return u.reshape(-1, 1), v.reshape(-1, 1), np.outer(wx, wy).reshape(-1, 1)


def _summed(
    bench: Bench,
    surface: ScatteringModel,
    crossed: ScatteringModel,
    is_s: bool,
    theta_i_deg: FloatArray,
    theta_o_deg: FloatArray,
    u: FloatArray,
    v: FloatArray,
    weight: FloatArray,
) -> FloatArray:
    """Return the readings, (n, d), of positions of one polarization; axes are (position, point, draw)."""
    i_zero, arm_zero = np.asarray(bench.theta_i_zero_deg), np.asarray(bench.arm_zero_deg)
    i = np.deg2rad(theta_i_deg[:, None, None] + i_zero)
    o = np.deg2rad(theta_o_deg[:, None, None] + arm_zero - i_zero)  # theta_mes - theta_i
    tilt = np.deg2rad(np.asarray(bench.tilt_deg, np.float64))
    far = np.asarray(bench.distance_mm, np.float64)
    half_u, half_v = 0.5 * np.asarray(bench.width_mm), 0.5 * np.asarray(bench.height_mm)
    sin_i, cos_i, sin_t, cos_t = np.sin(i), np.cos(i), np.sin(tilt), np.cos(tilt)
    facing = cos_i * cos_t  # s'n
    away = np.asarray(bench.offset_mm) / facing
    # from the lit point to a point of the aperture
    dx = far * np.sin(o) + half_u * u * np.cos(o) + away * sin_i
    dy = half_v * v + np.zeros_like(dx)
    dz = far * np.cos(o) - half_u * u * np.sin(o) - away * cos_i
    length = np.sqrt(dx**2 + dy**2 + dz**2)
    along_arm = dx * np.sin(o) + dz * np.cos(o)
    solid_angle = along_arm * half_u * half_v / length**3
    dx, dy, dz = dx / length, dy / length, dz / length
    # the sample's own frame: z its normal, x the specular side of its plane of incidence, y' = z x x
    side = np.sqrt(sin_i**2 + (cos_i * sin_t) ** 2)
    upright = side < 1e-12  # at normal incidence any plane will do
    safe = np.where(upright, 1.0, side)
    x1 = np.where(upright, 1.0, sin_i / safe)
    x2, x3 = facing * sin_t / safe, (facing * cos_t - cos_i) / safe
    y1, y2, y3 = sin_t * x3 - cos_t * x2, cos_t * x1, -sin_t * x1
    normal = dy * sin_t + dz * cos_t
    forward, aside = dx * x1 + dy * x2 + dz * x3, dx * y1 + dy * y2 + dz * y3
    polar = np.rad2deg(np.arctan2(np.hypot(forward, aside), normal))
    azimuth = np.rad2deg(np.arctan2(aside, forward))
    incidence = np.rad2deg(np.arctan2(side, facing))
    dsf = surface.dsf(incidence, polar, "s" if is_s else "p", azimuth)
    if np.any(tilt != 0.0):
        turned = np.where(upright, 0.0, sin_t / safe) ** 2
        mixed = crossed.dsf(incidence, polar, "p" if is_s else "s", azimuth)
        dsf = dsf + turned * (mixed - dsf)
    dsf = np.where(normal > 0.0, dsf, 0.0)
    return np.asarray(np.sum(weight * solid_angle * dsf, axis=1))

"""What came out?  Irradiance with standard errors, by contribution, and how far it can be trusted.

`gonio.facade.result_file` keeps it in HDF5, `gonio.facade.result_text` prints it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.facade.geometry import Vector

FloatArray = NDArray[np.float64]

CONTRIBUTIONS = ("direct", "sky", "diffuse", "specular")
"""Direct sun, direct view of the sky, reflected only diffusely, reflected by a lobe at least once."""

ORIGIN: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Estimate:
    """Irradiance and its standard error, W/m2, both of one shape."""

    value: FloatArray
    standard_error: FloatArray


@dataclass(frozen=True, slots=True)
class Receiver:
    """One gridded surface, or one mesh.

    Of a surface the arrays are (rows, columns), row 0 the lowest, columns along the street's azimuth.  Of a
    mesh they are (f,), one value for each face; `vertices_m` (k, 3) and `faces` (f, 3) say where they are,
    and the three vectors are zero.

    `mean` and `mean_contributions` are averages over the area, with standard errors of their own: patches
    share photons, so they do not follow from those of the patches.

    `discretisation_w_m2` bounds what exchange between patches of finite size adds to the error of the mean,
    W/m2; 0 where no patches stand between (paths of light followed one by one).
    """

    name: str
    origin_m: Vector
    u_m: Vector
    v_m: Vector
    total: Estimate
    contributions: Mapping[str, Estimate]
    mean: Estimate
    mean_contributions: Mapping[str, Estimate]
    discretisation_w_m2: float = 0.0
    vertices_m: FloatArray | None = None
    faces: NDArray[np.int64] | None = None

    @classmethod
    def on_mesh(
        cls,
        name: str,
        vertices_m: FloatArray,
        faces: NDArray[np.int64],
        *,
        total: Estimate,
        contributions: Mapping[str, Estimate],
        mean: Estimate,
        mean_contributions: Mapping[str, Estimate],
        discretisation_w_m2: float = 0.0,
    ) -> Receiver:
        """Return the receiver of a mesh: one value for each face."""
        return cls(
            name, ORIGIN, ORIGIN, ORIGIN, total, contributions, mean, mean_contributions,
            discretisation_w_m2, vertices_m, faces,
        )  # fmt: skip

    @property
    def is_mesh(self) -> bool:
        """Whether the values belong to the faces of a mesh."""
        return self.faces is not None

    @property
    def value(self) -> FloatArray:
        """Irradiance (rows, columns), of a mesh (f,), W/m2."""
        return self.total.value

    @property
    def standard_error(self) -> FloatArray:
        """Standard error of `value`, W/m2."""
        return self.total.standard_error

    @property
    def area_m2(self) -> FloatArray:
        """Area of each patch, of the shape of `value`, m2."""
        if self.vertices_m is not None and self.faces is not None:
            a, b, c = np.moveaxis(self.vertices_m[self.faces], 1, 0)
            return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))
        whole = float(np.linalg.norm(np.cross(self.u_m, self.v_m)))
        return np.full(self.value.shape, whole / max(self.value.size, 1))

    @property
    def row_centres_m(self) -> FloatArray:
        """Distance of the patch centres from the lower edge, (rows,), m."""
        rows = self.value.shape[0]
        return np.asarray((np.arange(rows) + 0.5) / rows * np.linalg.norm(self.v_m))

    @property
    def column_centres_m(self) -> FloatArray:
        """Distance of the patch centres from the first edge, (columns,), m."""
        columns = self.value.shape[1]
        return np.asarray((np.arange(columns) + 0.5) / columns * np.linalg.norm(self.u_m))


@dataclass(frozen=True, slots=True)
class EnergyBalance:
    """Where the power of the photons went, W; all zero without a glossy surface, which needs none.

    ``emitted + created = absorbed + escaped + handed + unfinished`` but for rounding.  `under_horizon_w` is
    the part of `absorbed_w` that the lobe sent below the surface, `handed_w` what the photons left to the
    exchange of diffuse light.
    """

    emitted_w: float
    created_w: float
    absorbed_w: float
    under_horizon_w: float
    escaped_w: float
    unfinished_w: float
    handed_w: float = 0.0

    @property
    def residual(self) -> float:
        """What is missing in the account, relative to what was emitted."""
        if self.emitted_w == 0.0:
            return 0.0
        out = self.absorbed_w + self.escaped_w + self.handed_w + self.unfinished_w
        return (self.emitted_w + self.created_w - out) / self.emitted_w


@dataclass(frozen=True, slots=True)
class ExchangeBalance:
    """What surfaces send out diffusely must arrive somewhere: on patches, or in the sky and on black backs.

    The parts are estimated from different rays, so they agree within `standard_error_w`, the standard error
    of ``emitted - received - escaped``.  `solver_residual` is what the linear solve leaves, relative to its
    right hand side.
    """

    emitted_w: float
    received_w: float
    escaped_w: float
    standard_error_w: float
    solver_residual: float

    @property
    def difference_w(self) -> float:
        """``emitted - received - escaped``, W."""
        return self.emitted_w - self.received_w - self.escaped_w


@dataclass(frozen=True, slots=True)
class Omission:
    """Something left out on purpose, and what it can change at most.

    `bound_percent` is of the mean of `receiver`; without a name the bound holds on every receiver.
    """

    what: str
    bound_w_m2: float
    bound_percent: float
    receiver: str = ""


@dataclass(frozen=True, slots=True)
class BandIrradiance:
    """The part of the irradiance in one band of wavelengths: sun and sky, and the mean of each receiver."""

    low_nm: float
    high_nm: float
    dni_w_m2: float
    dhi_w_m2: float
    means: Mapping[str, Estimate]


@dataclass(frozen=True, slots=True)
class ErrorParts:
    """Errors of one receiver, relative to its mean: ``total = sqrt(statistical^2 + omitted^2)``."""

    statistical: float
    omitted: float

    @property
    def total(self) -> float:
        """Statistical error and bounds together."""
        return float(np.hypot(self.statistical, self.omitted))


@dataclass(frozen=True, slots=True)
class Irradiance:
    """The result of `gonio.facade.simulate`.

    `relative_error` is held against `rel_tol`: the root mean square of the patches' standard errors over the
    mean irradiance, of the receiver where it is largest.  `converged` says whether it got there.

    Parameters
    ----------
    method
        ``"rows"``, ``"paths"`` or ``"backward"``.
    omissions
        What the planner left out, each with its bound; empty with ``full=True``.
    levels
        By material: ``"diffuse"``, ``"mirror"``, ``"lobe"`` or ``"polarised"``.
    bands
        The parts of the result, if it was computed in more than one band.
    exchange
        Account of the diffuse light; ``None`` where paths are followed one by one.
    interrupted, state
        Stopped before it was finished; arrays that `simulate` takes to go on as if nothing had happened.
    floor_w_m2
        Irradiance that stands for the mean of a receiver that is darker, in every relative error.
    versions, options, date
        Programs that took part, what was asked of them, and when (UTC, ISO 8601).
    """

    receivers: tuple[Receiver, ...]
    energy: EnergyBalance
    title: str
    scene_text: str
    seed: int
    rel_tol: float
    relative_error: float
    converged: bool
    rays: int
    duration_s: float
    notes: tuple[str, ...]
    omissions: tuple[Omission, ...] = ()
    method: str = "paths"
    levels: Mapping[str, str] = field(default_factory=dict)
    bands: tuple[BandIrradiance, ...] = ()
    exchange: ExchangeBalance | None = None
    interrupted: bool = False
    state: Mapping[str, NDArray[Any]] | None = None
    floor_w_m2: float = 0.0
    versions: Mapping[str, str] = field(default_factory=dict)
    options: Mapping[str, str] = field(default_factory=dict)
    date: str = ""

    def __getitem__(self, name: str) -> Receiver:
        """Return the receiver on the surface `name`; `KeyError` lists those there are."""
        for r in self.receivers:
            if r.name == name:
                return r
        raise KeyError(f"no receiver '{name}'; there are {', '.join(r.name for r in self.receivers)}")

    def error_of(self, name: str) -> ErrorParts:
        """Return the errors of a receiver relative to its mean (to `floor_w_m2` if that is larger).

        Statistical: root mean square of the patches' standard errors, weighted with their areas.  Omitted:
        the sum of all bounds that hold there, the discretisation's among them.  Both are 0 in the dark.
        """
        r = self[name]
        mean = max(float(r.mean.value), self.floor_w_m2)
        if not mean > 0.0:
            return ErrorParts(0.0, 0.0)
        area = r.area_m2
        statistical = float(np.sqrt(np.sum(area * r.standard_error**2) / np.sum(area)))
        omitted = r.discretisation_w_m2 + sum(
            o.bound_w_m2 for o in self.omissions if o.receiver in ("", name)
        )
        return ErrorParts(statistical / mean, omitted / mean)

    @property
    def worst(self) -> tuple[str, ErrorParts]:
        """Name and errors of the receiver whose total error is largest."""
        errors = [(r.name, self.error_of(r.name)) for r in self.receivers]
        return max(errors, key=lambda pair: pair[1].total)

    def table(self) -> str:
        """Return the means of the receivers, W/m2, with their standard errors, and how they were obtained."""
        from gonio.facade.result_text import table

        return table(self)

    def save(self, path: str | Path) -> None:
        """Write everything to an HDF5 file (NeXus groups, units on every array); an older one is replaced.

        The file appears whole or not at all, also if the process is killed.  `StoreError` if it cannot be
        written; then nothing is left behind.
        """
        from gonio.facade.result_file import save

        save(self, Path(path))


def load_irradiance(path: str | Path) -> Irradiance:
    """Return what `Irradiance.save` wrote.

    `StoreError` if there is no such file, or it holds no facade irradiance.
    """
    from gonio.facade.result_file import load

    return load(Path(path))


def area_mean(values: FloatArray, areas: FloatArray | Sequence[float]) -> FloatArray:
    """Return the mean of (patches, ...) over the patches, weighted with their areas."""
    weights = np.asarray(areas, np.float64)
    return np.asarray(np.tensordot(weights / weights.sum(), values, axes=1))

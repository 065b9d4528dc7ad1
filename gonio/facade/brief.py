"""How is a scene run with few points, always the same ones?  Pilots of the planner, by transport rows.

A run to a tolerance spends different numbers of points on two versions of a scene, and starts photons on
surfaces in proportion to what their lobes take.  Pilots do neither: points are fixed, and photons start on
all surfaces that have a lobe in any version, by one set of probabilities.  Versions then differ by their
materials alone, ray by ray.
"""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from gonio.facade import layout
from gonio.facade.bounds import quantile, standard_errors
from gonio.facade.engine import ENERGIES, Photons
from gonio.facade.engine import Engine as RowsEngine
from gonio.facade.geometry import Mesh
from gonio.facade.layout import FloatArray
from gonio.facade.pilot import TIERS, Outcome
from gonio.facade.result import Irradiance
from gonio.facade.rows_run import RowsRun
from gonio.facade.scene import Scene
from gonio.facade.starts import chances
from gonio.facade.transport import REPLICAS, Rows

_FIRST_ROWS = 8
"""Points of a row in the first tier, for each of its replicas; rows are common to all versions."""

_FIRST_LIGHT = 32
"""Photons of one material and source, for each replica, that show whether its lobes matter for certain."""


@dataclass
class Pilots:
    """Runs of one scene and its versions; `__call__` as `gonio.facade.pilot.Engine` says.

    Parameters
    ----------
    original
        Has every lobe that a version has.
    """

    original: Scene
    seed: int
    threads: int
    _starts: dict[int, FloatArray] = field(default_factory=dict)
    _base: RowsEngine = field(init=False)

    def __post_init__(self) -> None:
        engine = self._base = RowsEngine(self.original, self.seed, self.threads)
        table = self.original.materials
        average = np.array([table[name].row() for name in table], np.float64).reshape(-1, 5)
        g = engine.packed.geometry
        for source in (layout.SUN, layout.SKYLIGHT):
            total = np.zeros(2 * len(g.optics))
            for materials in (average, *(c.table for c in engine.channels)):
                found = chances(g._replace(materials=materials), engine.light, source, follow=False)
                if found is not None:
                    total = total + np.diff(found, prepend=0.0)
            if np.any(total):
                self._starts[source] = _cumulative(total)

    def __call__(self, scene: Scene, rel_tol: float, /) -> Outcome:
        """Run `scene` with the points of a tier."""
        started_s = time.monotonic()
        run = RowsRun(scene, seed=self.seed, threads=self.threads, progress=None)
        factor = 2 ** round(math.log2(TIERS[0] / rel_tol) * 4.0 / 3.0)
        photons = 0
        with ThreadPoolExecutor(self.threads) as pool:
            for part in run.engine.parts:
                points = _FIRST_ROWS if isinstance(part, Rows) else run.engine.first_points(part)
                if isinstance(part, Photons):
                    part.chance = self._starts[part.source]
                    photons = points * factor * REPLICAS
                run.engine.add_round([(part, points * factor)], pool)
        return outcome_of(run, rel_tol, photons=photons, duration_s=time.monotonic() - started_s)

    def first_light(self, material: str) -> FloatArray:
        """Return what the lobes of one material throw straight onto the receivers, at least, W/m2.

        (receivers,) lower bounds of the means, of light that comes from sun and sky, takes a lobe of the
        material, and lands, perhaps after further lobes; from a few hundred photons, average band.
        """
        from gonio.facade import kernels

        base = self._base
        names = list(self.original.materials)
        table = [self.original.materials[name].row() for name in names]
        g = base.packed.geometry._replace(materials=np.array(table, np.float64).reshape(-1, 5))
        own = np.repeat(g.optics == names.index(material), 2)
        patches = base.packed.patches
        arrived = np.zeros((REPLICAS, len(patches.area)))
        for source, chance in self._starts.items():
            part = np.where(own, np.diff(chance, prepend=0.0), 0.0)
            if not np.any(part > 0.0):
                continue
            tally = np.zeros_like(arrived)
            kernels.photons(
                g, base.light, patches, _cumulative(part), base.directions, np.uint64(self.seed), source,
                REPLICAS, False, False, 0, (0, REPLICAS, 0, _FIRST_LIGHT), tally, np.zeros_like(arrived),
                np.zeros((REPLICAS, ENERGIES)),
            )  # fmt: skip
            arrived += tally / _FIRST_LIGHT
        found = []
        first = 0
        receivers = [(s.area_m2, s.rows * s.columns) for s in self.original.receivers]
        receivers += [(_area(m), len(m.faces)) for m in self.original.meshes if m.receiver]
        for area, count in receivers:
            cells = (patches.receiver >= first) & (patches.receiver < first + count)
            mean = arrived[:, cells].sum(axis=1) / area
            found.append(float(mean.mean()) - quantile(REPLICAS) * float(standard_errors(mean)))
            first += count
        return np.asarray(np.maximum(np.array(found), 0.0))


def _cumulative(weight: FloatArray) -> FloatArray:
    """Return cumulative probabilities that end with 1 at the last positive weight."""
    chance = np.cumsum(weight)
    chance /= chance[-1]
    chance[np.flatnonzero(weight)[-1] :] = 1.0
    return np.asarray(chance)


def _area(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices_m[mesh.faces], 1, 0)
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def outcome_of(run: RowsRun, rel_tol: float, *, photons: int, duration_s: float) -> Outcome:
    """Return what a run says, cell by cell of the result."""
    patches = run.engine.packed.patches
    inside = np.flatnonzero(patches.receiver >= 0)
    cell, weight = patches.receiver[inside], run.solution.area[inside]
    cells = run.engine.packed.cells
    merged = run.solution.change(np.zeros(len(patches.area), np.int64), 1)[0][:, 0]
    whole = np.maximum(np.bincount(cell, weight, cells), 1e-300)
    change: FloatArray = np.asarray(np.bincount(cell, weight * merged[inside], cells) / whole, np.float64)
    reached = run.relative_error()
    irradiance = Irradiance(
        receivers=run.receivers(),
        energy=run.energy(),
        title=run.scene.title,
        scene_text=run.scene.text,
        seed=run.engine.seed,
        rel_tol=rel_tol,
        relative_error=reached,
        converged=reached <= rel_tol,
        rays=run.rays,
        duration_s=duration_s,
        notes=(),
        method="rows",
    )
    return Outcome(irradiance, run.replicas(), photons, change)

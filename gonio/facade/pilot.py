"""How is a scene run briefly, and what does the planner read from it?"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gonio.facade.bounds import MISS, Difference, difference, standard_errors

if TYPE_CHECKING:
    from gonio.facade.result import Irradiance
    from gonio.facade.scene import Scene

FloatArray = NDArray[np.float64]

TIERS = (0.5, 0.1, 0.02, 0.004)
"""Statistical tolerances of pilots, about; the first asks for the first points only."""


class Outcome(NamedTuple):
    """What one run of the engine gives the planner."""

    irradiance: Irradiance
    replicas: FloatArray
    """Total of each patch in each replica, W/m2, (cells, replicas), receiver after receiver."""
    photons: int = 0
    """Photons started at sun and sky in all replicas together; 0: none were needed, or it is not known."""
    change: FloatArray | None = None
    """(cells,) W/m2, what larger patches for the exchange change; None: there are none."""


class Engine(Protocol):
    """The engine without planner: the scene as it is, all its bands, `Scene.polarised` as it says.

    One seed for all calls of a plan, so that scenes that differ in their materials alone use the same points.
    """

    def __call__(self, scene: Scene, rel_tol: float, /) -> Outcome:
        """Run to the statistical tolerance `rel_tol`; 0.5 asks for no more than the first points."""


def compared(a: Outcome, b: Outcome) -> Difference:
    """Return ``a - b`` with its bounds, receiver by receiver.

    Where N photons share the power P and none arrives, the power that arrives is below ``-ln(1e-4) P / N``
    with the confidence of the other bounds, for independent photons; Sobol points do better.
    """
    cells = shares(a.irradiance)
    allowance = np.maximum(_unseen(a), _unseen(b))
    if a.change is not None and b.change is not None:
        change = (a.change - b.change) ** 2
        allowance = allowance + np.array([math.sqrt(weight @ change[here]) for here, weight in cells])
    return difference(a.replicas - b.replicas, cells, allowance)


def shares(irradiance: Irradiance) -> list[tuple[slice, FloatArray]]:
    """Return, receiver after receiver, where its cells are, and their parts of its area (adding up to 1)."""
    found = []
    first = 0
    for areas in receiver_areas(irradiance):
        found.append((slice(first, first + len(areas)), areas / areas.sum()))
        first += len(areas)
    return found


def receiver_areas(irradiance: Irradiance) -> list[FloatArray]:
    """Return the areas of each receiver's cells, m2."""
    return [r.area_m2.ravel() for r in irradiance.receivers]


def means(outcome: Outcome) -> tuple[FloatArray, FloatArray]:
    """Return the mean irradiance of each receiver and its standard error, W/m2, (receivers,) each."""
    per_replica = np.array([weight @ outcome.replicas[here] for here, weight in shares(outcome.irradiance)])
    return per_replica.mean(axis=1), standard_errors(per_replica)


def _unseen(outcome: Outcome) -> FloatArray:
    """Return what photons may have missed on each receiver, W/m2."""
    areas: Sequence[float] = [float(a.sum()) for a in receiver_areas(outcome.irradiance)]
    if outcome.photons == 0:
        return np.zeros(len(areas))
    power = outcome.irradiance.energy.emitted_w
    return -math.log(MISS) * power / outcome.photons / np.asarray(areas)


def engine(*, seed: int = 0, threads: int | None = None) -> Engine:
    """Return the engine of `gonio.facade.simulate` without its planner."""
    import importlib

    from gonio.facade.paths import MAX_RAYS, available_threads
    from gonio.facade.result import Irradiance

    module: Any = importlib.import_module("gonio.facade.simulate")  # the package gives the function that name

    def run(scene: Scene, rel_tol: float, /) -> Outcome:
        one = module.engine_of(scene, "auto", seed=seed, threads=threads or available_threads())
        started_s = time.monotonic()
        reached = one.until(rel_tol, MAX_RAYS)
        irradiance = Irradiance(
            receivers=one.receivers(), energy=one.energy(), title=scene.title, scene_text=scene.text,
            seed=seed, rel_tol=rel_tol, relative_error=reached, converged=reached <= rel_tol, rays=one.rays,
            duration_s=time.monotonic() - started_s, notes=(),
        )  # fmt: skip
        return Outcome(irradiance, one.replicas(), one.photons)

    return run


def pilots(scene: Scene, *, seed: int = 0, threads: int | None = None) -> Engine:
    """Return what runs versions of a scene briefly: transport rows, or paths where those are too many."""
    from gonio.facade.brief import Pilots
    from gonio.facade.paths import available_threads
    from gonio.facade.rows_run import suits

    if not suits(scene):
        return engine(seed=seed, threads=threads)
    return Pilots(scene, seed, threads or available_threads())


@runtime_checkable
class Screen(Protocol):
    """An engine that also says what the lobes of a material do for certain."""

    def first_light(self, material: str) -> FloatArray:
        """Return lower bounds of what its lobes throw straight onto the receivers, (receivers,) W/m2."""

"""How do paths carry a scene of several bands?  One run for each, added up."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields

import numpy as np

from gonio.facade.collect import Replicated, receivers_of
from gonio.facade.layout import FloatArray
from gonio.facade.lighting import light_of
from gonio.facade.pack import pack
from gonio.facade.paths import PathsRun, Progress
from gonio.facade.result import BandIrradiance, EnergyBalance, ExchangeBalance, Receiver
from gonio.facade.scene import Scene
from gonio.facade.state_file import State


class BandedPaths:
    """Paths through a scene of one band or several; the interface of `RowsRun`."""

    def __init__(
        self, scene: Scene, *, seed: int, threads: int, progress: Progress | None, whole: bool = False
    ) -> None:
        self.scene = scene
        self.method = "backward" if whole else "paths"
        self.runs: list[PathsRun] = []
        for number in range(max(1, len(scene.bands))):
            part = scene.in_band(number)
            packed = pack(part.surfaces, part.materials, meshes=part.meshes, periodic=part.infinite)
            self.runs.append(
                PathsRun(
                    part, packed, light_of(part), seed=seed, threads=threads, progress=progress, whole=whole
                )
            )

    def until(
        self,
        rel_tol: float,
        max_rays: int,
        between: Callable[[], None] = lambda: None,
        omitted: Mapping[str, float] | None = None,
    ) -> float:
        """Bring every band to the tolerance, and so their sum; return the relative error of the worst."""
        left_out = max((omitted or {}).values(), default=0.0)
        statistical = float(np.sqrt(max(rel_tol**2 - left_out**2, (0.1 * rel_tol) ** 2)))
        reached = 0.0
        for run in self.runs:
            reached = max(reached, run.until(statistical, max_rays // len(self.runs), between))
        return float(np.hypot(reached, left_out))

    def state(self) -> State:
        """Return what `restore` needs to go on."""
        return {f"band{i}.{k}": v for i, run in enumerate(self.runs) for k, v in run.state().items()}

    def restore(self, state: State) -> None:
        """Take over the points of an earlier run; `SceneError` if it was not a run of this scene."""
        for i, run in enumerate(self.runs):
            mark = f"band{i}."
            run.restore({k.removeprefix(mark): v for k, v in state.items() if k.startswith(mark)})

    @property
    def begun(self) -> bool:
        """Whether every band has points, so that there is a result."""
        return all(run.begun for run in self.runs)

    @property
    def rays(self) -> int:
        """Rays traced so far."""
        return sum(run.rays for run in self.runs)

    @property
    def photons(self) -> int:
        """Photons started at sun and sky, in the band that has fewest."""
        return min(run.photons for run in self.runs)

    @property
    def floor_w_m2(self) -> float:
        """Irradiance that stands for the mean of a receiver that is darker, W/m2."""
        return sum(run.floor_w_m2 for run in self.runs)

    def relative_error(self) -> float:
        """Return the relative error of the worst band."""
        return max(run.relative_error() for run in self.runs)

    def replicas(self) -> FloatArray:
        """Return the irradiance of every cell that each replica alone gives, (cells, replicas), W/m2."""
        return np.asarray(sum(run.replicas() for run in self.runs))

    def receivers(self) -> tuple[Receiver, ...]:
        """Return values and standard errors of all receivers."""
        first = self.runs[0]
        if len(self.runs) == 1:
            return first.receivers()
        each = [run.contributions() for run in self.runs]
        total = {
            name: Replicated.mean_of(np.asarray(sum(parts[name].each for parts in each))) for name in each[0]
        }
        return receivers_of(self.scene, first.patches, total, weight=first.seen_area())

    def bands(self) -> tuple[BandIrradiance, ...]:
        """Return the means of each band; nothing if there is but one."""
        return tuple(
            BandIrradiance(
                band.low_nm, band.high_nm, run.scene.direct_w_m2, run.scene.dhi_w_m2,
                {r.name: r.mean for r in run.receivers()},
            )
            for band, run in zip(self.scene.bands, self.runs, strict=False)
        )  # fmt: skip

    def exchange(self) -> ExchangeBalance | None:
        """Return nothing: paths carry the diffuse light one by one."""
        return None

    def energy(self) -> EnergyBalance:
        """Return the energy account of all photons, W."""
        parts = [run.energy() for run in self.runs]
        return EnergyBalance(*(sum(getattr(p, f.name) for p in parts) for f in fields(EnergyBalance)))

    def lost_w_m2(self) -> float:
        """Return what given-up paths may have carried at most, the worst patch, W/m2."""
        return sum(run.lost_w_m2() for run in self.runs)

"""What arrives on each patch, path by path?

Three estimators add up, each in 32 independent randomisations (replicas) of its points:

- backward paths from every patch: direct sun, direct sky, and all light reflected only diffusely;
- photons from the sun, and photons from the sky, that meet at least one lobe, tallied where they arrive.

Standard errors come from the scatter of the replicas, which holds for correlated (Sobol) points as well.  A
round doubles the points of the estimator that promises most variance less per ray, until for every receiver
the root mean square of its patches' standard errors, over its mean irradiance, is below the tolerance.  The
choice depends on counts, never on clocks or threads: a seed gives the same bits on one thread or many, and
on a run that was stopped and continued.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.facade import layout
from gonio.facade.collect import Replicated, added, energy_balance, receivers_of
from gonio.facade.layout import Light
from gonio.facade.pack import Packed
from gonio.facade.result import CONTRIBUTIONS, EnergyBalance, Receiver
from gonio.facade.scene import Scene
from gonio.facade.sobol import sobol_directions
from gonio.facade.starts import chances
from gonio.facade.state_file import DIGEST, State, check_digest, digest_of, pack_state

FloatArray = NDArray[np.float64]
Progress = Callable[[float, str], None]
"""Called as ``progress(fraction done, text)``, from the calling thread."""

REPLICAS = 32
DARK = 1e-3
"""A receiver with less than this part of DNI + DHI is held to ``rel_tol * DARK * (DNI + DHI)`` instead."""

MAX_RAYS = 2_000_000_000

_BATCH = 1 << 21  # paths between two looks at Ctrl-C and two reports of progress
_ENERGIES = 8


@dataclass(frozen=True, slots=True)
class _Part:
    """One estimator: points per replica wanted and done, their sums, and what they cost.

    A batch works on copies and its results replace the part as a whole, so whatever instant Ctrl-C comes the
    sums are those of `done` points.
    """

    points: int
    sums: FloatArray  # of backward paths (n * REPLICAS, 5), of photons (REPLICAS, n)
    done: int = 0
    rays: int = 0
    energy: FloatArray = field(default_factory=lambda: np.zeros((REPLICAS, _ENERGIES)))
    exposed: FloatArray = field(default_factory=lambda: np.zeros(0))  # points that are not hidden


class PathsRun:
    """A run of the estimators above; `whole`: backward paths follow lobes too, and there are no photons."""

    def __init__(
        self,
        scene: Scene,
        packed: Packed,
        light: Light,
        *,
        seed: int,
        threads: int,
        progress: Progress | None,
        whole: bool,
    ) -> None:
        self.scene, self.light = scene, light
        self.g, self.patches = packed.geometry, packed.patches
        self.seed = np.uint64(seed)
        self.threads = threads
        self.progress: Progress = progress or (lambda _done, _text: None)
        self.whole = whole
        self.directions = sobol_directions()
        n = len(self.patches.area)
        self.parts = {
            "back": _Part(16, np.zeros((n * REPLICAS, 5)), exposed=np.zeros(n * REPLICAS)),
        }
        self.chances: dict[str, FloatArray] = {}
        glossy = bool(np.any(self.g.materials[self.g.optics, layout.RHO_S] > 0.0)) and not whole
        for name, source, points in (("sun", layout.SUN, 4096), ("sky", layout.SKYLIGHT, 1024)):
            chance = chances(self.g, light, source, follow=True) if glossy else None
            if chance is not None:
                self.chances[name] = chance
                self.parts[name] = _Part(points, np.zeros((REPLICAS, n)))

    # -- spending rays

    def until(self, rel_tol: float, max_rays: int, between: Callable[[], None] = lambda: None) -> float:
        """Add points until the tolerance or the limit is reached; return the relative error.

        `between` is called after every batch, when a result can be read.  `KeyboardInterrupt` passes through
        and leaves the sums of whole batches.
        """
        from gonio.facade import kernels

        with ThreadPoolExecutor(self.threads) as pool:
            if not kernels.compiled_already():
                self.progress(0.0, "preparing the engine (compiled on the first use, then kept)")
                self._warm_up(kernels)
            reached = float("inf")
            while True:
                for name in self.parts:
                    self._add(pool, kernels, name, rel_tol, reached, between)
                relative = self._relative_variances()
                reached = float(np.sqrt(sum(relative)))
                self._tell(rel_tol, reached)
                if reached <= rel_tol or self.rays >= max_rays:
                    return reached
                gains = [v / max(p.rays, 1) for v, p in zip(relative, self.parts.values(), strict=True)]
                name = list(self.parts)[int(np.argmax(gains))]
                self.parts[name] = replace(self.parts[name], points=2 * self.parts[name].points)

    def _tell(self, rel_tol: float, reached: float) -> None:
        done = min(1.0, (rel_tol / reached) ** 2) if reached > 0.0 else 1.0
        known = f", ± {100 * reached:.2g} %" if np.isfinite(reached) else ""
        self.progress(done, f"{self.rays:.2g} rays{known}")

    def _warm_up(self, kernels: Any) -> None:
        """Compile in this thread, with empty windows: the compiler is locked, others would only wait."""
        nothing = (0, 0, 0, 0)
        self._backward(kernels, self.parts["back"], nothing)
        photons = _Part(0, np.zeros((REPLICAS, 1)))
        self._photons(kernels, photons, np.ones(1), layout.SUN, nothing)

    def _add(
        self,
        pool: ThreadPoolExecutor,
        kernels: Any,
        name: str,
        rel_tol: float,
        reached: float,
        between: Callable[[], None],
    ) -> None:
        """Bring a part from `done` to `points`, in batches short enough for Ctrl-C."""
        units = len(self.parts[name].sums)
        step = max(1, _BATCH // max(units, 1))
        size = max(1, units // (8 * self.threads))
        while (part := self.parts[name]).done < part.points:
            last = min(part.done + step, part.points)
            work = replace(
                part, sums=part.sums.copy(), energy=part.energy.copy(), exposed=part.exposed.copy()
            )
            windows = [(u, min(u + size, units), part.done, last) for u in range(0, units, size)]
            rays = sum(pool.map(lambda window, w=work: self._kernel(kernels, name, w, window), windows))
            self.parts[name] = replace(work, done=last, rays=part.rays + rays)
            if last < part.points:
                self._tell(rel_tol, reached)
            between()

    def _kernel(self, kernels: Any, name: str, part: _Part, window: tuple[int, int, int, int]) -> int:
        if name == "back":
            return self._backward(kernels, part, window)
        source = layout.SUN if name == "sun" else layout.SKYLIGHT
        return self._photons(kernels, part, self.chances[name], source, window)

    def _backward(self, kernels: Any, part: _Part, window: tuple[int, int, int, int]) -> int:
        return int(
            kernels.backward(
                self.g, self.light, self.patches, self.directions, self.seed, REPLICAS, window,
                self.whole, part.sums, part.exposed,
            )
        )  # fmt: skip

    def _photons(
        self, kernels: Any, part: _Part, chance: Any, source: int, window: tuple[int, int, int, int]
    ) -> int:
        return int(
            kernels.photons(
                self.g, self.light, self.patches, chance, self.directions, self.seed, source, REPLICAS, True,
                self.scene.polarised, 0, window, part.sums, part.sums, part.energy,
            )
        )  # fmt: skip

    # -- going on later

    def state(self) -> State:
        """Return what `restore` needs to go on."""
        values: dict[str, Any] = {DIGEST: self._digest()}
        for name, part in self.parts.items():
            for key in ("points", "done", "rays", "sums", "energy", "exposed"):
                values[f"{name}_{key}"] = getattr(part, key)
        return pack_state(**values)

    def restore(self, state: State) -> None:
        """Take over the points of an earlier run; `SceneError` if it was not a run of this scene."""
        check_digest(state, self._digest())
        self.parts = {
            name: _Part(
                points=int(state[f"{name}_points"]),
                sums=np.array(state[f"{name}_sums"], np.float64).reshape(part.sums.shape),
                done=int(state[f"{name}_done"]),
                rays=int(state[f"{name}_rays"]),
                energy=np.array(state[f"{name}_energy"], np.float64).reshape(part.energy.shape),
                exposed=np.array(state[f"{name}_exposed"], np.float64).reshape(part.exposed.shape),
            )
            for name, part in self.parts.items()
        }

    def _digest(self) -> NDArray[np.uint8]:
        from gonio.facade import kernels

        return digest_of(
            "paths", self.g, self.patches, self.light, int(self.seed), self.whole, self.scene.polarised,
            kernels.DIGEST,
        )  # fmt: skip

    @property
    def begun(self) -> bool:
        """Whether every estimator has points, so that there is a result."""
        return all(part.done > 0 for part in self.parts.values())

    # -- reading the sums

    @property
    def rays(self) -> int:
        """Rays traced so far."""
        return sum(p.rays for p in self.parts.values())

    def contributions(self) -> dict[str, Replicated]:
        """Return the irradiance of the patches by contribution."""
        gathered = self._gathered()
        each = dict(zip(CONTRIBUTIONS, np.moveaxis(gathered, 2, 0), strict=False))
        for name in self.chances:
            each["specular"] = each["specular"] + self._tallied(self.parts[name])
        return {name: Replicated.mean_of(values) for name, values in each.items()}

    def _gathered(self) -> FloatArray:
        """Return what backward paths collect, (patches, replicas, 5), W/m2; 0 where a patch is hidden."""
        back = self.parts["back"]
        exposed = np.maximum(back.exposed, 1.0)[:, None]
        return np.asarray((back.sums / exposed).reshape(-1, REPLICAS, 5))

    def _tallied(self, part: _Part) -> FloatArray:
        """Return what photons bring, (patches, replicas), W/m2 of the part of a patch that is not hidden."""
        area = self.seen_area()[:, None]
        brought = part.sums.T / part.done
        return np.asarray(np.divide(brought, area, out=np.zeros_like(brought), where=area > 0.0))

    def seen_area(self) -> FloatArray:
        """Return the area of each patch that no other surface covers, (n,), m2."""
        back = self.parts["back"]
        share = back.exposed.reshape(-1, REPLICAS).mean(axis=1) / max(back.done, 1)
        return np.asarray(self.patches.area * share)

    def _relative_variances(self) -> list[float]:
        """Return the square of the relative error of the receiver that needs most, by part of the engine."""
        total = added(self.contributions()).value
        own = [Replicated.mean_of(self._gathered()[:, :, :4].sum(axis=2))]
        own += [Replicated.mean_of(self._tallied(self.parts[name])) for name in self.chances]
        variances = [x.standard_error**2 for x in own]
        worst = [0.0 for _ in own]
        area = self.seen_area()
        for first, last in self._cells():
            here = (self.patches.receiver >= first) & (self.patches.receiver < last)
            weight = area[here] / max(float(area[here].sum()), 1e-300)
            mean = max(float(weight @ total[here]), self.floor_w_m2)
            if mean > 0.0:
                worst = max(worst, [float(weight @ v[here]) / mean**2 for v in variances], key=sum)
        return worst

    def _cells(self) -> list[tuple[int, int]]:
        """Return first and last + 1 cell of each receiver."""
        counts = [s.rows * s.columns for s in self.scene.receivers]
        counts += [len(m.faces) for m in self.scene.meshes if m.receiver]
        ends = np.cumsum(counts)
        return [(int(end) - count, int(end)) for end, count in zip(ends, counts, strict=True)]

    @property
    def floor_w_m2(self) -> float:
        """Irradiance that stands for the mean of a receiver that is darker, W/m2."""
        return DARK * (self.light.dni + self.light.dhi)

    def relative_error(self) -> float:
        """Return the relative error of the receiver that needs most."""
        return float(np.sqrt(sum(self._relative_variances())))

    def replicas(self) -> FloatArray:
        """Return the irradiance of every patch that each replica alone gives, (n, REPLICAS), W/m2."""
        return added(self.contributions()).each

    @property
    def photons(self) -> int:
        """Photons started so far."""
        return sum(self.parts[name].done * REPLICAS for name in self.chances)

    def receivers(self) -> tuple[Receiver, ...]:
        """Return values and standard errors of all receivers."""
        return receivers_of(self.scene, self.patches, self.contributions(), weight=self.seen_area())

    def energy(self) -> EnergyBalance:
        """Return the energy account of all photons, W."""
        total = np.zeros(_ENERGIES)
        for name in self.chances:
            part = self.parts[name]
            total += part.energy.sum(axis=0) / (part.done * REPLICAS)
        return energy_balance(total)

    def lost_w_m2(self) -> float:
        """Return what given-up paths may have carried at most, the worst patch, W/m2."""
        lost = self._gathered()[:, :, layout.LOST].mean(axis=1)
        photons = sum(
            float(p.energy[:, layout.UNFINISHED].sum()) / (p.done * REPLICAS) for p in self.parts.values()
        )
        return float(np.max(lost) + photons / np.min(self.patches.area))


def available_threads() -> int:
    """Return the number of processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1

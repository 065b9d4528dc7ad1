"""How are rays spent until the error is small enough?

Three estimators add up, each in 32 independent randomisations (replicas) of its points:

- backward paths from every patch: direct sun, direct sky, and all light reflected only diffusely;
- photons from the sun, and photons from the sky, that meet at least one lobe, tallied where they arrive.

Standard errors come from the scatter of the replicas, which holds for correlated (Sobol) points as well.  A
round doubles the points of the estimator that promises most variance less per ray, until for every receiver
the root mean square of its patches' standard errors, over its mean irradiance, is below the tolerance.  The
choice depends on counts, never on clocks or threads: a seed gives the same bits on one thread or many.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigError, SceneError
from gonio.facade import layout
from gonio.facade.lighting import light_notes, light_of
from gonio.facade.optics import EnergyWarning, excess_text
from gonio.facade.pack import pack
from gonio.facade.result import CONTRIBUTIONS, EnergyBalance, Estimate, Irradiance, Receiver
from gonio.facade.scene import Scene
from gonio.facade.sobol import sobol_directions
from gonio.facade.starts import chances

FloatArray = NDArray[np.float64]
Progress = Callable[[float, str], None]
"""Called as ``progress(fraction done, text)``, from the calling thread."""

REPLICAS = 32
MAX_RAYS = 2_000_000_000
DARK = 1e-3
"""A receiver with less than this part of DNI + DHI is held to ``rel_tol * DARK * (DNI + DHI)`` instead."""

_BATCH = 1 << 21  # paths between two looks at Ctrl-C and two reports of progress


def simulate(
    scene: Scene,
    *,
    rel_tol: float = 0.01,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
    estimator: Literal["split", "backward"] = "split",
    max_rays: int = MAX_RAYS,
) -> Irradiance:
    """Return the irradiance of every receiver patch with its standard error, by contribution.

    Parameters
    ----------
    scene
        From `load_scene`, or built from Python objects.
    rel_tol
        Wanted for every receiver: root mean square of its patches' standard errors over its mean, 1e-5...0.5.
    seed
        The same seed gives the same bits, whatever `threads`.
    threads
        Default: the processors this process may use.
    progress
        Called with the fraction done and a text; the first call of a program compiles the kernels (about ten
        seconds, kept on disk) and says so.
    estimator
        ``"split"``, or ``"backward"`` for everything by backward paths: an independent check for broad lobes,
        slow and with heavy tails for narrow ones.
    max_rays
        Stop here at the latest; the result then says that it has not converged.

    Raises
    ------
    ConfigError
        An option outside its range.
    SceneError
        ``estimator="backward"`` with ``horizon="renormalize"``, whose normalisation it does not know.
    """
    if not 1e-5 <= rel_tol <= 0.5:
        raise ConfigError(
            f"rel_tol = {rel_tol:g} is outside 1e-5...0.5; give a relative standard error such as 0.01"
        )
    if not 0 <= seed < 2**63:
        raise ConfigError(f"seed = {seed} is outside 0...2^63 - 1; choose another")
    if threads is not None and threads < 1:
        raise ConfigError(f"threads = {threads} is not a number of threads; give 1 or more, or leave it out")
    if estimator == "backward" and scene.horizon == "renormalize":
        raise SceneError(
            'estimator = "backward" cannot renormalize the lobe; use horizon = "absorb" or "split"'
        )
    notes = [*scene.notes, *(n for n in light_notes(scene) if n not in scene.notes)]
    if scene.energy == "published":
        for name, optics in scene.materials.items():
            sentence = excess_text(name, optics, scene.energy)
            if sentence is not None:
                warnings.warn(sentence, EnergyWarning, stacklevel=2)
                if sentence not in notes:
                    notes.append(sentence)
    started_s = time.monotonic()
    run = _Run(scene, seed, threads or available_threads(), progress, whole=estimator == "backward")
    reached = run.until(rel_tol, max_rays)
    if reached > rel_tol:
        notes.append(
            f"stopped after {run.rays:.3g} rays at a relative standard error of {reached:.2g}, above the "
            f"{rel_tol:g} asked; "
            "allow more rays or a larger rel_tol"
        )
    lost = run.lost_w_m2()
    if lost > 0.0:
        notes.append(
            f"paths of more than 10 000 reflections were given up; they carried at most {lost:.2g} W/m2"
        )
    return Irradiance(
        receivers=run.receivers(),
        energy=run.energy(),
        title=scene.title,
        scene_text=scene.text,
        seed=seed,
        rel_tol=rel_tol,
        relative_error=reached,
        converged=reached <= rel_tol,
        rays=run.rays,
        duration_s=time.monotonic() - started_s,
        notes=tuple(notes),
    )


def available_threads() -> int:
    """Return the number of processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


@dataclass
class _Part:
    """One estimator: points per replica wanted and done, their sums, and what they cost."""

    points: int
    sums: FloatArray
    done: int = 0
    rays: int = 0
    energy: FloatArray = field(default_factory=lambda: np.zeros((REPLICAS, 8)))


class _Run:
    def __init__(
        self, scene: Scene, seed: int, threads: int, progress: Progress | None, *, whole: bool
    ) -> None:
        self.scene = scene
        self.seed = np.uint64(seed)
        self.threads = threads
        self.progress: Progress = progress or (lambda _done, _text: None)
        self.whole = whole
        packed = pack(scene.surfaces, scene.materials, meshes=scene.meshes, periodic=scene.infinite)
        self.g, self.patches = packed.geometry, packed.patches
        self.light = light_of(scene)
        self.directions = sobol_directions()
        self.area_m2 = self.patches.area
        count = len(self.area_m2)
        self.back = _Part(16, np.zeros((count * REPLICAS, 5)))
        self.exposed = np.zeros(count * REPLICAS)
        self.sun_chance = chances(self.g, self.light, layout.SUN, follow=True)
        self.sky_chance = chances(self.g, self.light, layout.SKYLIGHT, follow=True)
        glossy = bool(np.any(self.g.materials[self.g.optics, layout.RHO_S] > 0.0)) and not whole
        self.sun = (
            _Part(4096, np.zeros((REPLICAS, count))) if glossy and self.sun_chance is not None else None
        )
        self.sky = (
            _Part(1024, np.zeros((REPLICAS, count))) if glossy and self.sky_chance is not None else None
        )

    # -- spending rays

    def until(self, rel_tol: float, max_rays: int) -> float:
        """Add points until the tolerance or the limit is reached; return the relative error."""
        from gonio.facade import kernels

        with ThreadPoolExecutor(self.threads) as pool:
            if not kernels.compiled_already():
                self.progress(0.0, "preparing the engine (compiled on the first use, then kept)")
                self._warm_up(kernels)
            for part in self._parts():
                self._add(pool, kernels, part)
            while True:
                relative = self._relative_variances()
                reached = float(np.sqrt(sum(relative)))
                self.progress(
                    min(1.0, (rel_tol / reached) ** 2 if reached > 0 else 1.0), f"{self.rays:.2g} rays"
                )
                if reached <= rel_tol or self.rays >= max_rays:
                    return reached
                gains = [v / p.rays if p.rays else 0.0 for v, p in zip(relative, self._parts(), strict=True)]
                part = self._parts()[int(np.argmax(gains))]
                part.points *= 2
                self._add(pool, kernels, part)

    def _warm_up(self, kernels: Any) -> None:
        """Compile in this thread, with empty windows: the compiler is locked, others would only wait."""
        self._backward(kernels, (0, 0, 0, 0))
        self._forward(kernels, _Part(0, np.zeros((REPLICAS, 1))), np.ones(1), layout.SUN, (0, 0, 0, 0))

    def _add(self, pool: ThreadPoolExecutor, kernels: Any, part: _Part) -> None:
        """Bring `part` from `done` to `points`, in batches short enough for Ctrl-C."""
        units = len(part.sums)
        step = max(1, _BATCH // units)
        size = max(1, units // (8 * self.threads))
        for first in range(part.done, part.points, step):
            last = min(first + step, part.points)
            windows = [(u, min(u + size, units), first, last) for u in range(0, units, size)]
            part.rays += sum(pool.map(lambda window: self._kernel(kernels, part, window), windows))
        part.done = part.points

    def _kernel(self, kernels: Any, part: _Part, window: tuple[int, int, int, int]) -> int:
        if part is self.back:
            return self._backward(kernels, window)
        if part is self.sun:
            return self._forward(kernels, part, self.sun_chance, layout.SUN, window)
        return self._forward(kernels, part, self.sky_chance, layout.SKYLIGHT, window)

    def _backward(self, kernels: Any, window: tuple[int, int, int, int]) -> int:
        return int(
            kernels.backward(
                self.g, self.light, self.patches, self.directions, self.seed, REPLICAS, window,
                self.whole, self.back.sums, self.exposed,
            )
        )  # fmt: skip

    def _forward(
        self, kernels: Any, part: _Part, chance: Any, source: int, window: tuple[int, int, int, int]
    ) -> int:
        return int(
            kernels.photons(
                self.g, self.light, self.patches, chance, self.directions, self.seed, source, REPLICAS, True,
                self.scene.polarised, 0, window, part.sums, part.sums, part.energy,
            )
        )  # fmt: skip

    # -- reading the sums

    def _parts(self) -> list[_Part]:
        return [p for p in (self.back, self.sun, self.sky) if p is not None]

    @property
    def rays(self) -> int:
        return sum(p.rays for p in self._parts())

    def _replicas(self) -> dict[str, FloatArray]:
        """Return each contribution per replica, (patches, replicas), W/m2."""
        sums = self._gathered()
        parts = dict(zip(CONTRIBUTIONS, np.moveaxis(sums, 2, 0), strict=False))
        specular = parts["specular"]
        for part in (self.sun, self.sky):
            if part is not None:
                specular = specular + self._tallied(part)
        return {**parts, "specular": specular}

    def _gathered(self) -> FloatArray:
        """Return what backward paths collect, (patches, replicas, 5), W/m2; 0 where a patch is hidden."""
        exposed = np.maximum(self.exposed, 1.0)[:, None]
        return np.asarray((self.back.sums / exposed).reshape(-1, REPLICAS, 5))

    def _tallied(self, part: _Part) -> FloatArray:
        return np.asarray(part.sums.T / part.done / self.area_m2[:, None])

    def _relative_variances(self) -> list[float]:
        """Return the square of the relative error of the receiver that needs most, by part of the engine."""
        total = np.asarray(sum(self._replicas().values())).mean(axis=1)
        own = [self._gathered()[:, :, :4].sum(axis=2)]
        own += [self._tallied(p) for p in (self.sun, self.sky) if p is not None]
        variances = [_standard_error(x) ** 2 for x in own]
        worst = [0.0 for _ in own]
        first = 0
        for s in self.scene.receivers:
            here = slice(first, first + s.rows * s.columns)
            first = here.stop
            mean = max(float(np.mean(total[here])), DARK * (self.light.dni + self.light.dhi))
            if mean > 0.0:
                worst = max(worst, [float(np.mean(v[here])) / mean**2 for v in variances], key=sum)
        return worst

    def receivers(self) -> tuple[Receiver, ...]:
        """Return values and standard errors of all receivers."""
        parts = self._replicas()
        parts["total"] = np.asarray(sum(parts.values()))
        found: list[Receiver] = []
        first = 0
        for s in self.scene.receivers:
            here = slice(first, first + s.rows * s.columns)
            first = here.stop
            shape = (s.rows, s.columns)
            patches = {
                k: Estimate(x[here].mean(axis=1).reshape(shape), _standard_error(x[here]).reshape(shape))
                for k, x in parts.items()
            }
            means = {
                k: x[here].mean(axis=0) for k, x in parts.items()
            }  # (replicas,): all patches have one area
            mean = {k: Estimate(np.asarray(x.mean()), _standard_error(x)) for k, x in means.items()}
            found.append(
                Receiver(
                    s.name, s.origin_m, s.u_m, s.v_m, patches.pop("total"), patches, mean.pop("total"), mean
                )
            )
        return tuple(found)

    def energy(self) -> EnergyBalance:
        """Return the energy account of all photons, W."""
        total = np.zeros(8)
        for part in (self.sun, self.sky):
            if part is not None:
                total += part.energy.sum(axis=0) / (part.done * REPLICAS)
        return EnergyBalance(
            emitted_w=float(total[layout.EMITTED]),
            created_w=float(total[layout.CREATED]),
            absorbed_w=float(total[layout.ABSORBED]),
            under_horizon_w=float(total[layout.UNDER_HORIZON]),
            escaped_w=float(total[layout.ESCAPED]),
            unfinished_w=float(total[layout.UNFINISHED]),
        )

    def lost_w_m2(self) -> float:
        """Return what given-up paths may have carried at most, the worst patch, W/m2."""
        sums = self._gathered()[:, :, layout.LOST]
        photons = sum(
            float(p.energy[:, layout.UNFINISHED].sum()) / (p.done * REPLICAS) for p in self._parts()
        )
        return float(np.max(sums.mean(axis=1)) + photons / np.min(self.area_m2))


def _standard_error(replicas: FloatArray) -> FloatArray:
    """Return the standard error of the mean over the last axis."""
    return np.asarray(replicas.std(axis=-1, ddof=1) / np.sqrt(replicas.shape[-1]))

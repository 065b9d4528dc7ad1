"""When has the engine of the estimator "rows" spent enough rays?

Patches are divided until merging them again changes no receiver by more than a part of the tolerance; then
the part of the engine that promises most variance less per ray gets more points, until for every receiver

    (rms of the patches' standard errors)^2 + (change by merging + what was left out)^2 <= (tolerance)^2,

all relative to its mean irradiance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gonio.facade import grids
from gonio.facade.collect import Replicated, added, energy_balance, receivers_of
from gonio.facade.engine import ENERGIES, Engine, Part, Photons
from gonio.facade.layout import FloatArray, IntArray
from gonio.facade.paths import DARK, Progress
from gonio.facade.result import BandIrradiance, EnergyBalance, ExchangeBalance, Receiver
from gonio.facade.scene import Scene
from gonio.facade.solution import Solution, solve
from gonio.facade.state_file import DIGEST, State, check_digest, digest_of
from gonio.facade.transport import REPLICAS, Rows

PREPARING = "preparing the engine (compiled on the first use, then kept)"

MOST_PATCHES = 20_000
"""Scenes that need more are for the estimator "paths"."""

_REFINED = 12_000  # no division goes beyond so many patches
_SHARE = 0.5  # of the tolerance that remains, for what patches of finite size leave out
_CLEAR = 0.3  # of the tolerance: statistical error at which a change by merging is no noise
_DOUBLINGS = 6
_LEAP = 8  # largest growth of a part in one round


@dataclass(frozen=True, slots=True)
class _Errors:
    """Of the receiver that needs most, relative to its mean."""

    variances: FloatArray  # (parts,)
    total: float


class RowsRun:
    """A run of the estimator "rows"."""

    method = "rows"

    def __init__(
        self,
        scene: Scene,
        *,
        seed: int,
        threads: int,
        progress: Progress | None,
    ) -> None:
        self.scene = scene
        self.progress: Progress = progress or (lambda _done, _text: None)
        self.engine = self._engine(seed, threads, {})
        self._solved: Solution | None = None
        self._changed: FloatArray | None = None
        self._average: sparse.csr_array | None = None

    def _engine(self, seed: int, threads: int, fineness: Mapping[str, int]) -> Engine:
        return Engine(self.scene, seed, threads, fineness=fineness, polarised=self.scene.polarised)

    # -- spending rays

    def until(
        self,
        rel_tol: float,
        max_rays: int,
        between: Callable[[], None] = lambda: None,
        omitted: Mapping[str, float] | None = None,
    ) -> float:
        """Add points until the tolerance or the limit is reached; return the relative error.

        `omitted` is what has been left out of each receiver, relative.  `KeyboardInterrupt` passes through
        and leaves the sums of whole rounds.
        """
        left_out = omitted or {}
        with ThreadPoolExecutor(self.engine.threads) as pool:
            self._prepare()
            self._begin(self.engine, 1, pool)
            self._forget()
            between()
            spent = max(left_out.values(), default=0.0)
            while True:
                finer = self._finer(_SHARE * max(rel_tol - spent, 0.0))
                if finer is not None:
                    rays = sum(r.rays for r in self.engine.rows)
                    self._begin(finer, rays // 2, pool)
                    self.engine = finer  # not before it has rays: what is stopped must have a result
                    self._forget()
                    between()
                    continue
                errors = self._errors(left_out)
                self._tell(rel_tol, errors.total)
                if errors.total <= rel_tol or self.engine.ray_count >= max_rays:
                    return errors.total
                statistical = float(np.sum(errors.variances))
                wanted = rel_tol**2 - (errors.total**2 - statistical)
                if wanted <= 0.0:  # rays alone cannot help, but they may show where finer patches would
                    if statistical <= (_CLEAR * rel_tol) ** 2:
                        return errors.total
                    wanted = 0.3 * statistical
                more = self._more(errors.variances, wanted, max_rays - self.engine.ray_count)
                if not more:
                    return errors.total
                self.engine.add_round(more, pool)
                self._forget()
                between()

    def _more(self, variances: FloatArray, wanted: float, most: int) -> list[tuple[Part, int]]:
        """Return which parts get how many points, so that the variances come down to `wanted` together.

        The variance v of scrambled Sobol points falls about as r^-1.5 with the rays r; the fewest rays are
        spent where v/r is the same for all parts.  Growth is rounded to powers of two, and halved until no
        more than `most` rays are needed.
        """
        parts = self.engine.parts
        rays = np.array([max(p.rays, 1) for p in parts], np.float64)
        low, high = float(np.max(variances / rays)) * 1e-12, float(np.max(variances / rays))
        for _ in range(30):  # bisection for the common v/r, on a logarithmic scale
            level = math.sqrt(low * high)
            growth = np.maximum(variances / rays / level, 1.0) ** 0.4
            if float(np.sum(variances * growth**-1.5)) > wanted:
                high = level
            else:
                low = level
        growth = np.minimum(2.0 ** np.rint(np.log2(np.maximum(variances / rays / low, 1.0) ** 0.4)), _LEAP)
        if np.all(growth == 1.0):
            growth[int(np.argmax(variances))] = 2.0
        while np.any(growth > 1.0) and float(rays @ (growth - 1.0)) > most:
            growth = np.maximum(growth / 2.0, 1.0)
        return [(p, p.points * int(k)) for p, k in zip(parts, growth, strict=True) if k > 1.0]

    def _prepare(self) -> None:
        from gonio.facade import kernels

        wanted = [kernels.rows, *([kernels.photons] if self.engine.photons else [])]
        if not all(k.signatures for k in wanted):
            self.progress(0.0, PREPARING)
            self.engine.warm_up()

    def _begin(self, engine: Engine, rays: int, pool: ThreadPoolExecutor) -> None:
        """Give every part that has none its first points; to rows about as many rays as given, if more."""
        least = sum(len(r.sums) * engine.first_points(r) for r in engine.rows)
        more = 2 ** max(0, round(math.log2(max(rays, 1) / max(least, 1))))
        fresh = [part for part in engine.parts if part.points == 0]
        engine.add_round(
            [(p, engine.first_points(p) * (more if isinstance(p, Rows) else 1)) for p in fresh], pool
        )

    def _finer(self, budget: float) -> Engine | None:
        """Return an engine with finer patches where it matters, ``None`` if the patches are fine enough.

        Divided are the surfaces whose own patches make up four fifths of the change on a receiver that
        changes too much.
        """
        e = self.engine
        names = e.names
        change, noise = self._merging(e.owner, len(names))
        total = self.totals().value
        fineness = {name: e.fineness.get(name, 1) for name in names}
        divided: dict[str, int] = {}
        for area in self._cells().values():
            weights = area / max(float(area.sum()), 1e-300)
            mean = max(float(weights @ total), self.floor_w_m2)
            whole = self._change(area)
            if whole <= max(budget * mean, 1.5 * self._change_noise(area)):
                continue
            own = np.sqrt(np.maximum(weights @ (change**2 - noise), 0.0))
            if not np.any(own > 0.0):
                continue
            order = np.argsort(-own, kind="stable")
            needed = int(np.searchsorted(np.cumsum(own[order]), 0.8 * own.sum())) + 1
            factor = 4 if whole > 4.0 * budget * mean else 2
            for k in order[:needed]:
                divided[names[k]] = max(factor, divided.get(names[k], 1))
        if not divided:
            return None
        for _ in range(_DOUBLINGS):  # cells of a receiver may be smaller than the usual patch
            fineness = {name: k * divided.get(name, 1) for name, k in fineness.items()}
            if grids.count(self.scene, fineness) > _REFINED:
                return None
            finer = self._engine(e.seed, e.threads, fineness)
            if finer.size > e.size:
                return finer
        return None

    def _forget(self) -> None:
        self._solved = self._changed = self._average = None

    def _tell(self, rel_tol: float, reached: float) -> None:
        done = min(1.0, (rel_tol / reached) ** 1.5) if reached > 0.0 else 1.0
        self.progress(done, f"{self.rays:.2g} rays, ± {100 * reached:.2g} %")

    # -- going on later

    def state(self) -> State:
        """Return what `restore` needs to go on."""
        return {DIGEST: self._digest(), **self.engine.state()}

    def restore(self, state: State) -> None:
        """Take over the points of an earlier run; `SceneError` if it was not a run of this scene."""
        check_digest(state, self._digest())
        e = self.engine
        fineness = dict(zip(e.names, (int(k) for k in state["fineness"]), strict=True))
        self.engine = self._engine(e.seed, e.threads, fineness)
        self.engine.restore(state)
        self._forget()

    def _digest(self) -> NDArray[np.uint8]:
        from gonio.facade import kernels

        whole = Engine(self.scene, self.engine.seed, 1)  # at the first fineness
        packed = whole.packed
        lights = [c.light for c in whole.channels]
        return digest_of(
            "rows", packed.geometry, packed.patches, lights, whole.table, whole.seed, self.scene.polarised,
            kernels.DIGEST,
        )  # fmt: skip

    @property
    def begun(self) -> bool:
        """Whether every part has points, so that there is a result."""
        return all(part.points > 0 for part in self.engine.parts)

    # -- reading the sums

    @property
    def rays(self) -> int:
        """Rays traced so far."""
        return self.engine.ray_count

    @property
    def photons(self) -> int:
        """Photons started at sun and sky, in all replicas together."""
        return sum(p.points * REPLICAS for p in self.engine.photons if isinstance(p, Photons))

    @property
    def solution(self) -> Solution:
        """What the rays traced so far say."""
        if self._solved is None:
            self._solved = solve(self.engine)
        return self._solved

    @property
    def floor_w_m2(self) -> float:
        """Irradiance that stands for the mean of a receiver that is darker, W/m2."""
        return DARK * (self.engine.light.dni + self.engine.light.dhi)

    def totals(self) -> Replicated:
        """Return the irradiance of the patches."""
        return added(self.solution.contributions)

    def replicas(self) -> FloatArray:
        """Return the irradiance of every cell that each replica alone gives, (cells, REPLICAS), W/m2."""
        patches = self.engine.packed.patches
        each = self._per_cell(self.totals().each)
        inside = np.flatnonzero(patches.receiver >= 0)
        found = np.zeros((self.engine.packed.cells, REPLICAS))
        found[patches.receiver[inside]] = each[inside]
        return found

    def relative_error(self) -> float:
        """Return the relative error of the receiver that needs most, without what was left out."""
        return float(np.sqrt(np.sum(self._errors({}).variances)))

    def _errors(self, omitted: Mapping[str, float]) -> _Errors:
        total = self.totals().value
        variances = np.stack([self._of(p) for p in range(len(self.engine.parts))])
        worst = _Errors(np.zeros(len(variances)), 0.0)
        for name, cells in self._cells().items():
            weights = cells / max(float(cells.sum()), 1e-300)
            found = float(weights @ total)
            mean = max(found, self.floor_w_m2)
            if mean <= 0.0:
                continue
            own = (variances @ weights) / mean**2
            if found < mean:
                own = own + self._unseen(cells > 0.0)
            change = self._change(cells) / mean
            sure = math.hypot(math.sqrt(float(own.sum())), change + omitted.get(name, 0.0))
            if sure >= worst.total:
                worst = _Errors(own, sure)
        return worst

    def _unseen(self, patches: NDArray[np.bool_]) -> FloatArray:
        """Return the square of what a dark receiver may have missed over its floor, (parts,).

        Of light that one ray in N would meet, N rays may all miss: their scatter says nothing about it.
        """
        missed = np.zeros(len(self.engine.parts))
        for number, part in enumerate(self.engine.parts):
            if isinstance(part, Rows):
                rays = part.points * REPLICAS * int(np.count_nonzero(patches[part.chosen]))
                missed[number] = (DARK * rays) ** -2.0 if rays else 0.0
        return missed

    def _of(self, number: int) -> FloatArray:
        """Return the variance of the mean of the patches' cells due to one part, (n,), W2/m4."""
        deviation = self.solution.deviations.get(number)
        if deviation is None:
            return np.zeros(self.engine.size)
        return np.asarray(self._per_cell(deviation).var(axis=1, ddof=1) / REPLICAS)

    def _per_cell(self, values: FloatArray) -> FloatArray:
        """Return the average over the cell of the result that each patch belongs to, shape of `values`."""
        if self._average is None:
            cell, area = self.engine.packed.patches.receiver, self.solution.area
            inside = np.flatnonzero(cell >= 0)
            whole = np.bincount(cell[inside], area[inside], self.engine.packed.cells)
            share = area[inside] / np.maximum(whole[cell[inside]], 1e-300)
            shape = (self.engine.packed.cells, self.engine.size)
            self._average = sparse.csr_array((share, (cell[inside], inside)), shape=shape)
        found = np.zeros_like(values)
        inside = np.flatnonzero(self.engine.packed.patches.receiver >= 0)
        found[inside] = (self._average @ values)[self.engine.packed.patches.receiver[inside]]
        return found

    def _change(self, cells: FloatArray) -> float:
        """Return the root mean square over a receiver of what merging patches changes, noise off, W/m2."""
        change, noise = self._squares(cells)
        return math.sqrt(max(change - noise, 0.0))

    def _change_noise(self, cells: FloatArray) -> float:
        """Return the root mean square of the noise of that change, W/m2."""
        return math.sqrt(self._squares(cells)[1])

    def _squares(self, cells: FloatArray) -> tuple[float, float]:
        """Return the mean squares over a receiver of the change by merging and of its noise, W2/m4."""
        if self._changed is None:
            change, noise = self._merging(np.zeros(self.engine.size, np.int64), 1)
            self._changed = np.concatenate([change**2, noise], axis=1)
        square, noise = (cells @ self._changed) / max(float(cells.sum()), 1e-300)
        return float(square), float(noise)

    def _merging(self, owner: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
        """Return the change of the cells by merging patches, (n, count), and the variance of its noise."""
        change, noise = self.solution.change(owner, count)
        deviations = self._per_cell(noise.reshape(len(owner), -1)).reshape(noise.shape)
        return self._per_cell(change), deviations.var(axis=2, ddof=1) / REPLICAS

    def _cells(self) -> dict[str, FloatArray]:
        """Return, by receiver, the area of the patches that belong to it, (n,), 0 for the others."""
        counts = {s.name: s.rows * s.columns for s in self.scene.receivers}
        counts |= {m.name: len(m.faces) for m in self.scene.meshes if m.receiver}
        found, first = {}, 0
        cell = self.engine.packed.patches.receiver
        for name, count in counts.items():
            found[name] = np.where((cell >= first) & (cell < first + count), self.solution.area, 0.0)
            first += count
        return found

    def receivers(self) -> tuple[Receiver, ...]:
        """Return values and standard errors of all receivers."""
        return self._receivers(self.solution.contributions)

    def _receivers(self, parts: Mapping[str, Replicated]) -> tuple[Receiver, ...]:
        return receivers_of(
            self.scene,
            self.engine.packed.patches,
            parts,
            weight=self.solution.area,
            discretisation_w_m2={name: self._change(cells) for name, cells in self._cells().items()},
        )

    def bands(self) -> tuple[BandIrradiance, ...]:
        """Return the means of each band; nothing if there is but one."""
        found = []
        n = self.engine.size
        nothing = Replicated.mean_of(np.zeros((n, REPLICAS)))
        for band, channel, total in zip(
            self.scene.bands, self.engine.channels, self.solution.bands, strict=False
        ):
            only = self._receivers({"direct": total, "sky": nothing, "diffuse": nothing, "specular": nothing})
            found.append(
                BandIrradiance(
                    band.low_nm, band.high_nm, channel.light.dni, channel.light.dhi,
                    {r.name: r.mean for r in only},
                )
            )  # fmt: skip
        return tuple(found)

    def exchange(self) -> ExchangeBalance:
        """Return the account of the diffuse light."""
        return self.solution.balance

    def energy(self) -> EnergyBalance:
        """Return the energy account of the light through lobes, W."""
        total = np.zeros(ENERGIES)
        for part in self.engine.photons:
            if isinstance(part, Photons):
                total += part.energy.sum(axis=0) / (max(part.points, 1) * REPLICAS)
            else:
                power = self.solution.band_exitance[part.band] * self.engine.packed.patches.area
                each = part.energy.reshape(len(part.chosen), REPLICAS, -1).sum(axis=1)
                total += power[part.chosen] @ each / (max(part.points, 1) * REPLICAS)
        return energy_balance(total)

    def lost_w_m2(self) -> float:
        """Return what given-up photons may have carried at most, the worst patch, W/m2."""
        area = self.engine.packed.patches.area
        return self.energy().unfinished_w / float(np.min(area)) if len(area) else 0.0


def suits(scene: Scene) -> bool:
    """Say whether the exchange of a scene needs no more patches than this estimator takes."""
    return grids.count(scene, {}) <= MOST_PATCHES

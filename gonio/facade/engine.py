"""Which rays have been traced?  The engine of the estimator "rows".

`rows_run` decides how many, `solution` says what they tell.

Independent parts add up, each in 16 randomised replicas:

- transport rows of the patches that belong to receivers, and of all others;
- photons that the sun, the sky, and the patches' own diffuse light send through lobes.

What a unit traces depends on seed, patch and point numbers alone: a seed gives the same bits on one thread or
many.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gonio.facade import grids, layout
from gonio.facade.layout import FloatArray, IntArray, Light
from gonio.facade.lighting import light_of
from gonio.facade.pack import Packed, pack
from gonio.facade.scene import Scene
from gonio.facade.sobol import sobol_directions
from gonio.facade.starts import chances
from gonio.facade.transport import REPLICAS, Matrix, Rows, Sparse, scaled, zeros

Window = tuple[int, int, int, int]
"""First and last unit, first and last point."""

ENERGIES = layout.EXPOSED + 1
"""Columns of the photons' account."""

_SETS = 8
_FIRST = 64  # points of each replica for a cell of the result

_ALWAYS = np.ones(1)
_TASK = 1 << 15  # rays of one task of a thread, about: Ctrl-C waits for no more than these


@dataclass(slots=True)
class Photons:
    """Light of one band that the sun (source 0) or the sky (1) sends through lobes.

    `tally` (REPLICAS, n) sums W that arrive at each patch, `tally_d` what of it is reflected diffusely.
    """

    source: int
    band: int
    tally: FloatArray
    tally_d: FloatArray
    energy: FloatArray  # (REPLICAS, 7)
    chance: FloatArray  # (2 m,)
    points: int = 0
    rays: int = 0


@dataclass(slots=True)
class Columns:
    """Light of one band that the patches emit diffusely and that then meets lobes.

    Of every round: for each unit (patch ``chosen[c]``, replica) and each patch where it arrives, sums of the
    parts of what was emitted, and of what of them is reflected diffusely.
    """

    band: int
    chosen: IntArray
    energy: FloatArray  # (c * REPLICAS, 7)
    points: int = 0
    rays: int = 0
    rounds: list[Sparse] = field(default_factory=list)

    source = layout.PATCH

    def emitted(self, column: int, power: FloatArray, width: int) -> FloatArray:
        """Return what arrives, (width, REPLICAS), W, if patch ``chosen[c]`` emits ``power[c]`` W."""
        units = len(self.energy)
        replica = np.tile(np.arange(REPLICAS), len(self.chosen))
        put = sparse.csr_array(
            (np.repeat(power, REPLICAS), (np.arange(units), replica)), shape=(units, REPLICAS)
        )
        total = np.zeros((width, REPLICAS))
        for part in self.rounds:
            total += (part.matrix(column, width).T @ put).toarray()
        return total / max(self.points, 1)

    def mean(self, column: int, width: int) -> Matrix:
        """Return the part of what each patch emits that arrives at the others, (c, width)."""
        total = zeros(len(self.chosen), width)
        for part in self.rounds:
            total = total + part.summed(column, width)
        return scaled(np.full(len(self.chosen), 1.0 / max(self.points * REPLICAS, 1)), total)


Part = Rows | Photons | Columns


@dataclass(slots=True)
class Channel:
    """One band: its materials and its share of the light."""

    table: FloatArray  # (materials, 5)
    light: Light


@dataclass
class Engine:
    """A scene, packed, with all rays traced so far."""

    scene: Scene
    seed: int
    threads: int
    fineness: Mapping[str, int] = field(default_factory=dict)
    polarised: bool = False
    packed: Packed = field(init=False)
    channels: list[Channel] = field(init=False)
    rows: list[Rows] = field(init=False)
    photons: list[Photons | Columns] = field(init=False)
    group: IntArray = field(init=False)

    def __post_init__(self) -> None:
        scene = self.scene
        chosen = grids.choose(scene, self.fineness)
        self.packed = pack(
            scene.surfaces, scene.materials, meshes=scene.meshes, periodic=scene.infinite, grids=chosen
        )
        self.group = grids.coarser(self.packed.geometry, self.packed.patches)
        self.light = light_of(scene)
        self.directions = sobol_directions()
        names = list(scene.materials)
        self.channels = []
        for number in range(max(1, len(scene.bands))):
            part = scene.in_band(number)
            table = np.array([part.materials[name].row() for name in names], np.float64).reshape(-1, 5)
            self.channels.append(Channel(table, light_of(part)))
        self.table = np.ascontiguousarray(np.stack([c.table for c in self.channels]))
        self.rows = [Rows.of(chosen, len(self.channels)) for chosen in self._sets()]
        self.photons = self._photons()

    @property
    def size(self) -> int:
        """Number of patches."""
        return len(self.packed.patches.area)

    @property
    def ray_count(self) -> int:
        """Rays traced so far."""
        return sum(p.rays for p in self.parts)

    @property
    def parts(self) -> list[Part]:
        """What can be refined independently."""
        return [*self.rows, *self.photons]

    def _sets(self) -> list[IntArray]:
        """Return the patches that are refined together: of each receiver, or of alike ones, and all others.

        Alike are receivers with about the same number of patches in a cell of the result.
        """
        cell = self.packed.patches.receiver
        inside = cell >= 0
        whole = np.bincount(cell[inside], minlength=self.packed.cells)
        owner = self.owner
        key = np.where(inside, owner, -1)
        if len(np.unique(key)) > _SETS:
            key = np.where(inside, np.ceil(np.log2(whole[cell])).astype(np.int64), -1)
        return [np.flatnonzero(key == k) for k in np.unique(key)]

    def first_points(self, part: Part) -> int:
        """Return the points of each unit with which a part begins.

        About a thousand rays for a cell of the result, and a few for patches that only reflect towards them.
        """
        if isinstance(part, Columns):
            return 4
        if isinstance(part, Photons):
            return 128
        cell = self.packed.patches.receiver
        inside = cell[part.chosen]
        if inside[0] < 0:
            return 4
        each = len(inside) / len(np.unique(inside))
        return int(2 ** np.clip(np.ceil(np.log2(_FIRST / each)), 2, 6))

    def _photons(self) -> list[Photons | Columns]:
        g, n = self.packed.geometry, self.size
        patches = self.packed.patches
        found: list[Photons | Columns] = []
        for band, channel in enumerate(self.channels):
            if not np.any(channel.table[g.optics, layout.RHO_S] > 0.0):
                continue
            own = g._replace(materials=channel.table)
            for source in (layout.SUN, layout.SKYLIGHT):
                chance = chances(own, channel.light, source, follow=False)
                if chance is not None:
                    tally, tally_d = np.zeros((REPLICAS, n)), np.zeros((REPLICAS, n))
                    energy = np.zeros((REPLICAS, ENERGIES))
                    found.append(Photons(source, band, tally, tally_d, energy, chance))
            matt = channel.table[g.optics[patches.primitive], layout.RHO_D] > 0.0
            chosen = np.flatnonzero(matt)
            if len(chosen):
                energy = np.zeros((len(chosen) * REPLICAS, ENERGIES))
                found.append(Columns(band, chosen, energy))
        return found

    @property
    def names(self) -> list[str]:
        """Names of all surfaces and meshes."""
        return [s.name for s in self.scene.surfaces] + [m.name for m in self.scene.meshes]

    @property
    def owner(self) -> IntArray:
        """Number, in `names`, of what each patch belongs to, (n,)."""
        faces = [len(m.faces) for m in self.scene.meshes]
        flat = len(self.scene.surfaces)
        declared = np.concatenate([np.arange(flat), flat + np.repeat(np.arange(len(faces)), faces)])
        g, patches = self.packed.geometry, self.packed.patches
        return np.asarray(declared[g.rank[patches.primitive]], np.int64)

    # -- spending rays

    def add_round(self, wanted: Sequence[tuple[Part, int]], pool: ThreadPoolExecutor) -> None:
        """Bring the points of every unit of each part to the number given.

        Interrupted, all parts are as before: what is stopped in the middle of a round goes on with the same
        round, and to the same bits.
        """
        before = [(part, _kept_of(part)) for part, _ in wanted]
        try:
            for part, points in wanted:
                self._add(part, points, pool)
        except BaseException:
            for part, kept in before:
                for key, value in kept.items():
                    setattr(part, key, value)
            raise

    def _add(self, part: Part, points: int, pool: ThreadPoolExecutor) -> None:
        if isinstance(part, Rows):
            self._add_rows(part, points, pool)
        elif isinstance(part, Columns):
            self._add_columns(part, points, pool)
        else:
            self._add_photons(part, points, pool)

    def _add_rows(self, part: Rows, points: int, pool: ThreadPoolExecutor) -> None:
        from gonio.facade import gray, kernels, strip

        first, last = part.points, points
        units, n = len(part.sums), self.size
        width = min(last - first, n)
        length = np.zeros(units, np.int64)
        index = np.empty((units, width), np.int32)
        count = np.empty((units, width))
        weight = np.empty((units, width, len(self.channels)))
        sums = part.sums.copy()
        reverse, angles = gray.reversed_directions(), strip.angle_table()

        def trace(window: Window) -> int:
            place = np.full(n, -1, np.int32)
            return int(
                kernels.rows(
                    self.packed.geometry, self.light, self.table, self.packed.patches, part.chosen, reverse,
                    angles, np.uint64(self.seed), REPLICAS, window, length, place, index, count,
                    weight, sums,
                )
            )  # fmt: skip

        rays = sum(pool.map(trace, self._windows(units, first, last)))
        used = np.arange(width) < length[:, None]
        data = np.concatenate([count[used][None], weight[used].T])
        start = np.concatenate([[0], np.cumsum(length)])
        part.rounds.append(Sparse(start, index[used].astype(np.int64), np.ascontiguousarray(data)))
        part.sums, part.points, part.rays = sums, last, part.rays + rays

    def _add_photons(self, part: Photons, points: int, pool: ThreadPoolExecutor) -> None:
        tally, tally_d, energy = part.tally.copy(), part.tally_d.copy(), part.energy.copy()

        def trace(window: Window) -> int:
            return self._photon_kernel(part, part.chance, 0, window, tally, tally_d, energy)

        rays = sum(pool.map(trace, self._windows(REPLICAS, part.points, points)))
        part.tally, part.tally_d, part.energy = tally, tally_d, energy
        part.points, part.rays = points, part.rays + rays

    def _add_columns(self, part: Columns, points: int, pool: ThreadPoolExecutor) -> None:
        energy = part.energy.copy()

        def trace(window: Window) -> tuple[int, sparse.csr_array, FloatArray]:
            tallies = np.zeros((2, window[1] - window[0], self.size))
            own = np.zeros((window[1] - window[0], ENERGIES))
            rays = self._photon_kernel(part, _ALWAYS, window[0], window, tallies[0], tallies[1], own)
            energy[window[0] : window[1]] += own
            found = sparse.csr_array(tallies[0])
            unit = np.repeat(np.arange(len(own)), np.diff(found.indptr))
            return rays, found, tallies[1][unit, found.indices]

        done = list(pool.map(trace, self._windows(len(energy), part.points, points)))
        length = np.concatenate([np.diff(matrix.indptr) for _, matrix, _ in done])
        data = np.stack([np.concatenate([m.data for _, m, _ in done]), np.concatenate([d for *_, d in done])])
        index = np.concatenate([m.indices for _, m, _ in done]).astype(np.int64)
        part.rounds.append(Sparse(np.concatenate([[0], np.cumsum(length)]), index, data))
        part.energy, part.points, part.rays = energy, points, part.rays + sum(rays for rays, *_ in done)

    def _photon_kernel(
        self,
        part: Photons | Columns,
        chance: FloatArray,
        base: int,
        window: Window,
        tally: FloatArray,
        tally_d: FloatArray,
        energy: FloatArray,
    ) -> int:
        from gonio.facade import kernels

        channel = self.channels[part.band]
        g = self.packed.geometry._replace(materials=channel.table)
        return int(
            kernels.photons(
                g, channel.light, self.packed.patches, chance, self.directions, np.uint64(self.seed),
                part.source, REPLICAS, False, self.polarised, base, window, tally, tally_d, energy,
            )
        )  # fmt: skip

    def warm_up(self) -> None:
        """Compile what this scene needs, kernel by kernel: the compiler is locked, threads would wait."""
        small = Engine(self.scene, self.seed, 1, polarised=self.polarised)
        with ThreadPoolExecutor(1) as pool:
            for kind in (Rows, Photons, Columns):
                part = next((p for p in small.parts if isinstance(p, kind)), None)
                if part is not None:
                    small.add_round([(part, 1)], pool)

    def _windows(self, units: int, first: int, last: int) -> list[Window]:
        size = max(1, min(_TASK // max(1, last - first), -(-units // (4 * self.threads))))
        return [(u, min(u + size, units), first, last) for u in range(0, units, size)]

    # -- keeping and restoring

    def state(self) -> dict[str, NDArray[Any]]:
        """Return all that was traced, as arrays by name."""
        found: dict[str, NDArray[Any]] = {
            "fineness": np.array([self.fineness.get(name, 1) for name in self.names])
        }
        for i, part in enumerate(self.parts):
            found[f"{i}.done"] = np.array([part.points, part.rays])
            for key in _KEPT[type(part)]:
                found[f"{i}.{key}"] = getattr(part, key)
            if not isinstance(part, Photons):
                for j, s in enumerate(part.rounds):
                    found |= {f"{i}.{j}.{key}": getattr(s, key) for key in _SPARSE}
        return found

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on from `state`, of an engine of the same scene, seed and fineness."""
        for i, part in enumerate(self.parts):
            part.points, part.rays = (int(x) for x in state[f"{i}.done"])
            for key in _KEPT[type(part)]:
                setattr(part, key, np.array(state[f"{i}.{key}"]))
            if not isinstance(part, Photons):
                part.rounds.clear()
                while f"{i}.{len(part.rounds)}.start" in state:
                    j = len(part.rounds)
                    part.rounds.append(Sparse(*(np.array(state[f"{i}.{j}.{key}"]) for key in _SPARSE)))


def _kept_of(part: Part) -> dict[str, Any]:
    """Return what a round changes: new arrays take the place of old ones, and lists grow."""
    kept = {key: getattr(part, key) for key in ("points", "rays", *_KEPT[type(part)])}
    if not isinstance(part, Photons):
        kept["rounds"] = list(part.rounds)
    return kept


_KEPT: dict[type, tuple[str, ...]] = {
    Rows: ("sums",),
    Photons: ("tally", "tally_d", "energy"),
    Columns: ("energy",),
}
_SPARSE = ("start", "index", "data")

"""How do the patches of a run become the receivers of its result?

An engine gives, for each contribution, its best value of every patch and what each replica alone says of it;
the scatter of the replicas is the standard error of the value, of any mean of values too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gonio.facade import layout
from gonio.facade.layout import FloatArray, Patches
from gonio.facade.result import CONTRIBUTIONS, EnergyBalance, Estimate, Receiver
from gonio.facade.scene import Scene


class Replicated(NamedTuple):
    """Values (n,) and the estimate of each replica (n, replicas), W/m2."""

    value: FloatArray
    each: FloatArray

    @classmethod
    def mean_of(cls, each: FloatArray) -> Replicated:
        """Return the plain average of replicas that are estimates of their own."""
        return cls(each.mean(axis=1), each)

    def averaged(self, weights: Any) -> Replicated:
        """Return the weighted means; `weights` (m, n), dense or sparse, has rows that sum to 1."""
        return Replicated(weights @ self.value, weights @ self.each)

    @property
    def standard_error(self) -> FloatArray:
        """Standard error of `value`, (n,), W/m2."""
        count = self.each.shape[1]
        return np.asarray(self.each.std(axis=1, ddof=1) / np.sqrt(count))


def added(parts: Mapping[str, Replicated]) -> Replicated:
    """Return the sum of all contributions."""
    return Replicated(
        np.asarray(sum(p.value for p in parts.values())), np.asarray(sum(p.each for p in parts.values()))
    )


def energy_balance(columns: FloatArray) -> EnergyBalance:
    """Return the photons' account from its columns (`gonio.facade.layout`), W."""
    return EnergyBalance(
        emitted_w=float(columns[layout.EMITTED]),
        created_w=float(columns[layout.CREATED]),
        absorbed_w=float(columns[layout.ABSORBED]),
        under_horizon_w=float(columns[layout.UNDER_HORIZON]),
        escaped_w=float(columns[layout.ESCAPED]),
        unfinished_w=float(columns[layout.UNFINISHED]),
        handed_w=float(columns[layout.HANDED]),
    )


def receivers_of(
    scene: Scene,
    patches: Patches,
    parts: Mapping[str, Replicated],
    *,
    weight: FloatArray | None = None,
    discretisation_w_m2: Mapping[str, float] | None = None,
) -> tuple[Receiver, ...]:
    """Return all receivers of a scene, surfaces in their order, then meshes.

    Parameters
    ----------
    parts
        Each of `CONTRIBUTIONS`, of the n patches.
    weight
        (n,) area of each patch that is not hidden, m2; default: its area.  A receiver's cell is the mean of
        its patches with these weights, 0 where all of it is hidden; so is the mean of the receiver.
    discretisation_w_m2
        By receiver, see `Receiver`.
    """
    area = patches.area if weight is None else weight
    everything = {**{name: parts[name] for name in CONTRIBUTIONS}, "total": added(parts)}
    shapes: list[tuple[int, ...]] = [(s.rows, s.columns) for s in scene.receivers]
    meshes = [m for m in scene.meshes if m.receiver]
    shapes += [(len(m.faces),) for m in meshes]
    found: list[Receiver] = []
    first = 0
    for i, shape in enumerate(shapes):
        count = int(np.prod(shape))
        here = np.flatnonzero((patches.receiver >= first) & (patches.receiver < first + count))
        cell = patches.receiver[here] - first
        first += count
        weights = _cell_weights(cell, area[here], count)
        whole = _normal(area[here])[None, :]
        cells: dict[str, Estimate] = {}
        means: dict[str, Estimate] = {}
        for name, all_patches in everything.items():
            own = Replicated(all_patches.value[here], all_patches.each[here])
            each = own if weights is None else own.averaged(weights)
            cells[name] = Estimate(each.value.reshape(shape), each.standard_error.reshape(shape))
            mean = own.averaged(whole)
            means[name] = Estimate(np.asarray(mean.value[0]), np.asarray(mean.standard_error[0]))
        name = scene.receivers[i].name if i < len(scene.receivers) else meshes[i - len(scene.receivers)].name
        bound = (discretisation_w_m2 or {}).get(name, 0.0)
        total, mean_total = cells.pop("total"), means.pop("total")
        if i < len(scene.receivers):
            s = scene.receivers[i]
            found.append(Receiver(name, s.origin_m, s.u_m, s.v_m, total, cells, mean_total, means, bound))
        else:
            mesh = meshes[i - len(scene.receivers)]
            found.append(
                Receiver.on_mesh(
                    name, mesh.vertices_m, mesh.faces, total=total, contributions=cells, mean=mean_total,
                    mean_contributions=means, discretisation_w_m2=bound,
                )
            )  # fmt: skip
    return tuple(found)


def _cell_weights(cell: NDArray[np.int64], area: FloatArray, count: int) -> Any:
    """Return how the patches of a receiver average to its cells, (cells, patches); ``None``: one each."""
    if len(cell) == count and np.array_equal(cell, np.arange(count)):
        return None
    total = np.bincount(cell, area, count)
    safe = np.where(total > 0.0, total, 1.0)
    return sparse.csr_array((area / safe[cell], (cell, np.arange(len(cell)))), shape=(count, len(cell)))


def _normal(area: FloatArray) -> FloatArray:
    total = float(area.sum())
    return area / total if total > 0.0 else np.zeros_like(area)

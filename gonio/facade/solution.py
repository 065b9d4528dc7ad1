"""What do the rays traced so far say?  Irradiance of every patch, replica by replica."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from gonio.facade import rows
from gonio.facade.collect import Replicated
from gonio.facade.engine import Columns, Engine, Photons
from gonio.facade.exchange import Exchange, averaged, merged
from gonio.facade.layout import FloatArray, IntArray
from gonio.facade.result import ExchangeBalance
from gonio.facade.transport import DENSE, REPLICAS, Matrix, Rows, doubted, spread


@dataclass(frozen=True, slots=True)
class Solution:
    """Irradiances of the n patches, W/m2.

    Attributes
    ----------
    contributions
        By name; values, and the estimate of each replica, whose scatter is the error.
    deviations
        By part of the engine: what the part alone contributes to the deviations of the total, (n, REPLICAS).
    uneven
        For each band, transport (n, n), what merging neighbours changes in the exitance, (n,), and how that
        scatters between replicas, (n, REPLICAS).
    bands
        Total of each band.
    exitance
        (n,) diffuse exitance, all bands.
    band_exitance
        (bands, n) diffuse exitance of each band.
    area
        (n,) m2, of what is not hidden.
    balance
        Account of the diffuse light.
    """

    contributions: dict[str, Replicated]
    deviations: dict[int, FloatArray]
    uneven: tuple[tuple[Matrix, FloatArray, FloatArray], ...]
    bands: tuple[Replicated, ...]
    exitance: FloatArray
    band_exitance: FloatArray
    area: FloatArray
    balance: ExchangeBalance

    def change(self, owner: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
        """Return what merging the patches of each owner changes in the total, W/m2.

        Returns
        -------
        tuple
            (n, count) change, and (n, count, REPLICAS) its deviations in each replica: noise of the
            exitances looks like unevenness, but more rays remove it and finer patches do not.
        """
        n = len(owner)
        found = np.zeros((n, count))
        noise = np.zeros((n, count, REPLICAS))
        for transport, jump, scatter in self.uneven:
            for k in range(count):
                mine = owner == k
                found[:, k] += transport @ np.where(mine, jump, 0.0)
                noise[:, k] += transport @ np.where(mine[:, None], scatter, 0.0)
        return found, noise


def solve(engine: Engine) -> Solution:
    """Return the solution of all bands together."""
    view = _View(engine)
    n = engine.size
    direct, sky = view.first(rows.SUN), view.first(rows.SKYLIGHT)
    direct_sum, sky_sum = _added(direct, n), _added(sky, n)
    diffuse = np.zeros((n, REPLICAS))
    deviations: dict[int, FloatArray] = {}
    uneven: list[tuple[Matrix, FloatArray, FloatArray]] = []
    bands: list[Replicated] = []
    exitance = np.zeros((len(engine.channels), n))
    residual = 0.0
    for band, channel in enumerate(engine.channels):
        dni = _share(channel.light.dni, engine.light.dni)
        dhi = _share(channel.light.dhi, engine.light.dhi)
        column = rows.FIRST_BAND + rows.PER_BAND * band
        from_sun, from_sky, seen, own_seen = (view.first(column + i) for i in range(rows.PER_BAND))
        given_e = {p: dni * (direct[p] + seen[p]) + dhi * sky[p] for p in direct}
        # sunlight is reflected where the rays look for it, not by the patches
        given_m = {p: dni * own_seen[p] + dhi * from_sky[p] for p in direct}
        lit = dni * _added(from_sun, n).mean(axis=1)
        d = view.mean(1 + band)
        system = only = _System(view, band, d, [], given_e, given_m, lit)
        diffuse += only.total() - dni * direct_sum - dhi * sky_sum
        lobes = [p for p in engine.photons if p.band == band]
        if lobes:
            system = _System(view, band, d, lobes, given_e, given_m, lit)
        bands.append(Replicated.mean_of(system.total()))
        for number, deviation in system.deviations.items():
            deviations[number] = deviations.get(number, 0.0) + deviation
        uneven.append((system.t, *system.jump()))
        residual = max(residual, system.exchange.residual(system.exitance, system.given))
        exitance[band] = system.exitance + lit
    total = sum(b.each for b in bands)
    specular = total - direct_sum - sky_sum - diffuse if engine.photons else np.zeros_like(diffuse)
    parts = {"direct": direct_sum, "sky": sky_sum, "diffuse": diffuse, "specular": specular}
    whole = exitance.sum(axis=0)
    return Solution(
        {name: Replicated.mean_of(each) for name, each in parts.items()},
        deviations,
        tuple(uneven),
        tuple(bands),
        whole,
        exitance,
        view.area,
        _balance(view, whole, residual),
    )


def _added(parts: dict[int, FloatArray], n: int) -> FloatArray:
    return np.zeros((n, REPLICAS)) + sum(parts.values())


def _balance(view: _View, exitance: FloatArray, residual: float) -> ExchangeBalance:
    """Compare what all patches emit with what their rays find, from different rays, again and away."""
    power = exitance * view.area
    received = np.einsum("n,nr->r", view.area, _added(view.applied(0, exitance), len(power)))
    away = [_added(view.first(column), len(power)) for column in (rows.FROM_SKY, rows.FROM_BLACK)]
    escaped = np.einsum("n,nr->r", power, away[0] + away[1])
    error = (received + escaped).std(ddof=1) / np.sqrt(REPLICAS)
    return ExchangeBalance(
        float(power.sum()), float(received.mean()), float(escaped.mean()), float(error), residual
    )


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else 0.0


class _View:
    """What all bands share: exposed areas and geometric rows."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        patches = engine.packed.patches
        self.whole = patches.area  # with the hidden parts, from which no photon starts
        self.area = patches.area.copy()
        for r in engine.rows:
            self.area[r.chosen] *= r.exposed().sum(axis=1) / max(r.points * REPLICAS, 1)

    def mean(self, column: int) -> Matrix:
        """Return transport between all patches, (n, n): counts (0) or weights of a band."""
        n = self.engine.size
        if n <= DENSE:
            full = np.zeros((n, n))
            for r in self.engine.rows:
                full[r.chosen] = np.asarray(r.mean(column, n))
            return full
        placed = sparse.csr_array((n, n))
        for r in self.engine.rows:
            put = sparse.csr_array(
                (np.ones(len(r.chosen)), (r.chosen, np.arange(len(r.chosen)))), shape=(n, len(r.chosen))
            )
            placed = placed + put @ sparse.csr_array(r.mean(column, n))
        return sparse.csr_array(placed)

    def first(self, column: int) -> dict[int, FloatArray]:
        """Return a column of the sums, by part, (n, REPLICAS): replicas' estimates, 0 outside the part."""
        found: dict[int, FloatArray] = {}
        for number, r in enumerate(self.engine.rows):
            full = np.zeros((self.engine.size, REPLICAS))
            each = spread(r.column(column), r.exposed())
            if column in (rows.SUN, rows.SKYLIGHT):
                each = doubted(each, self._step(r, column))
            full[r.chosen] = each
            found[number] = full
        return found

    def _step(self, r: Rows, column: int) -> FloatArray:
        """Return what one ray more of sun or sky changes in one replica, (c,), W/m2; 0 where all is seen."""
        points = r.exposed().sum(axis=1)
        total = r.column(column).sum(axis=1)
        if column == rows.SKYLIGHT:
            seen = r.column(rows.FROM_SKY).sum(axis=1)
            share = seen / np.maximum(points, 1.0)
        else:
            patches, light = self.engine.packed.patches, self.engine.light
            normal = self.engine.packed.geometry.normal[patches.primitive[r.chosen]]
            normal = np.where(patches.back[r.chosen, None] > 0, -normal, normal)
            whole = light.dni * np.maximum(normal @ light.sun, 0.0) * points
            # a patch that the middle of the disc does not light has only a part of the sun at best
            share = np.where(whole > 0.0, total / np.where(whole > 0.0, whole, 1.0), 0.5 * (total > 0.0))
            seen = share * points
        partly = (share > 0.0) & (share < 1.0 - 1e-6)
        ray = total / np.maximum(seen, 1.0)
        return np.where(partly, ray / np.maximum(points / REPLICAS, 1.0), 0.0)

    def applied(self, column: int, values: FloatArray) -> dict[int, FloatArray]:
        """Return transport applied to one value a patch, by part, (n, REPLICAS)."""
        found: dict[int, FloatArray] = {}
        for number, r in enumerate(self.engine.rows):
            full = np.zeros((self.engine.size, REPLICAS))
            full[r.chosen] = spread(r.applied(column, values), r.exposed())
            found[number] = full
        return found


class _System:
    """One band, with or without the light that lobes carry."""

    def __init__(
        self,
        view: _View,
        band: int,
        d: Matrix,
        lobes: list[Photons | Columns],
        given_e: dict[int, FloatArray],
        given_m: dict[int, FloatArray],
        lit: FloatArray,
    ) -> None:
        self.view, self.band, self.lit = view, band, lit
        engine = view.engine
        n = engine.size
        self.t = view.mean(0)
        self.operator = d
        e, m = dict(given_e), dict(given_m)
        columns: dict[int, Columns] = {}
        lit_given = np.zeros(n)  # sunlit patches light others through lobes too
        for p in lobes:
            number = len(engine.rows) + engine.photons.index(p)
            if isinstance(p, Photons):
                e[number] = self._landed(p.tally.T / max(p.points, 1))
                m[number] = self._landed(p.tally_d.T / max(p.points, 1))
            else:
                columns[number] = p
                through = self._columns(p, 1)
                self.t = self.t + self._columns(p, 0)
                self.operator = self.operator + through
                lit_given = lit_given + through @ lit
        self.exchange = Exchange(self.operator)
        self.given = lit_given + np.asarray(sum(x.mean(axis=1) for x in m.values()))
        self.exitance = self.exchange.solve(self.given)
        e_transport, m_transport = (view.applied(c, self.exitance) for c in (0, 1 + band))
        for number, x in e_transport.items():
            e[number] = e[number] + x
            m[number] = m[number] + m_transport[number]
        for number, p in columns.items():
            e[number] = self._emitted(p, 0)
            m[number] = self._emitted(p, 1)
        self.mean = np.asarray(sum(x.mean(axis=1) for x in e.values()))
        numbers = list(e)
        # each part's residual, amplified by the exchange: what the part alone would change
        residual = np.concatenate([m[k] - m[k].mean(axis=1, keepdims=True) for k in numbers], axis=1)
        amplified = self.exchange.amplified(residual)
        self.scatter = np.asarray(amplified.reshape(n, -1, REPLICAS).sum(axis=1))
        influence = self.t @ amplified
        self.deviations = {
            k: e[k] - e[k].mean(axis=1, keepdims=True) + influence[:, i * REPLICAS : (i + 1) * REPLICAS]
            for i, k in enumerate(numbers)
        }

    def total(self) -> FloatArray:
        """Return the irradiance of the patches, (n, REPLICAS)."""
        return np.asarray(self.mean[:, None] + sum(self.deviations.values()))

    def jump(self) -> tuple[FloatArray, FloatArray]:
        """Return by how much the exitance differs from that of merged patches, and the scatter of that."""
        group, area = self.view.engine.group, np.maximum(self.view.area, 1e-300)
        if len(group) == 0 or int(group.max()) + 1 == len(group):
            return np.zeros(len(group)), np.zeros((len(group), REPLICAS))
        coarse = Exchange(merged(self.operator, group, area)).solve(averaged(self.given, group, area))
        smooth = np.stack([averaged(x, group, area) for x in self.scatter.T], axis=1)
        return self.exitance - coarse[group], self.scatter - smooth[group]

    def _landed(self, power: FloatArray) -> FloatArray:
        """Return irradiance from power, both (n, REPLICAS)."""
        return power / np.maximum(self.view.area, 1e-300)[:, None]

    def _columns(self, p: Columns, column: int) -> Matrix:
        """Return what a unit of exitance of each patch adds to the irradiance of the others, (n, n)."""
        n = len(self.view.area)
        receiving = 1.0 / np.maximum(self.view.area, 1e-300)
        mean = p.mean(column, n)
        if isinstance(mean, np.ndarray):
            full = np.zeros((n, n))
            full[:, p.chosen] = receiving[:, None] * mean.T * self.view.whole[p.chosen]
            return full
        c = np.arange(len(p.chosen))
        put = sparse.csr_array((self.view.whole[p.chosen], (c, p.chosen)), shape=(len(c), n))
        return sparse.csr_array(sparse.diags_array(receiving) @ mean.T @ put)

    def _emitted(self, p: Columns, column: int) -> FloatArray:
        """Return what the exitance of the patches adds through lobes, (n, REPLICAS)."""
        power = ((self.exitance + self.lit) * self.view.whole)[p.chosen]
        return self._landed(p.emitted(column, power, self.view.engine.size))

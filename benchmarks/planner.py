"""Do the planner's bounds hold, how loose are they, and what does planning save?

    python benchmarks/planner.py [--scenes 60] [--first 0] [--tolerances 0.05,0.01,0.003]
    python benchmarks/planner.py --survey

Random scenes (streets with and without ends, boxes, modules; suns from the zenith to grazing; lobes of
alpha 1 to 1e6, windows, several bands) are planned and run at each tolerance, and compared with everything
(all bands, every lobe, polarised) in a longer run with other random numbers. For every receiver the root
mean square of the patches' differences and the difference of the means must be below the sum of the bounds,
the discretisation that both runs state, and 3 combined standard errors. The looseness compares the bound
with the omitted part itself, which a pair of long runs with common random numbers shows. The survey prints
where a lobe matters. Times are CPU seconds of the process.
"""

from __future__ import annotations

import argparse
import collections
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gonio.facade import Optics, Scene, Sun, Surface, box, street
from gonio.facade.bands import Band
from gonio.facade.levels import compare_levels
from gonio.facade.pilot import Engine, Outcome, compared, engine, means, shares
from gonio.facade.planner import DARK, choose, full
from gonio.facade.reduce import Level
from gonio.facade.sky import Sky

WINDOW = Optics(0.0, 1.0, 1e6, 1.5)


def random_scene(seed: int) -> Scene:
    """Return a scene: what stands where, of which materials, in which light, all drawn from `seed`."""
    rng = np.random.default_rng([2026, seed])
    infinite = bool(rng.random() < 0.25)
    azimuth = float(rng.choice([0.0, 90.0, rng.uniform(0.0, 360.0)]))
    height, other = rng.uniform(4.0, 40.0, 2)
    width, length = rng.uniform(6.0, 30.0), rng.uniform(15.0, 80.0)
    surfaces = street(
        width_m=width, length_m=length, height_left_m=height, height_right_m=other, azimuth_deg=azimuth,
        left="left", right="right", ground="ground",
    )  # fmt: skip
    rows, columns = (int(x) for x in rng.integers(1, 7, 2))
    surfaces = tuple(replace(s, rows=rows, columns=1 if infinite else columns) for s in surfaces)
    if not infinite and rng.random() < 0.5:
        for number in range(int(rng.integers(1, 3))):
            across, along = (float(x) for x in rng.uniform(2.0, 0.3 * width, 2))
            size = (across, along, float(rng.uniform(2.0, 15.0)))
            place = (float(rng.uniform(-0.2, 0.2) * width), float(rng.uniform(-0.3, 0.3) * length), 0.0)
            turned = float(rng.uniform(0.0, 90.0))
            faces = box(f"box{number}", centre_m=place, size_m=size, azimuth_deg=turned, material="box")
            surfaces += faces
    if not infinite and rng.random() < 0.3:
        tilt = math.radians(rng.uniform(10.0, 60.0))
        module = Surface(
            "module", (0.0, 0.0, max(height, other) + 1.0), (2.0, 0.0, 0.0),
            (0.0, math.cos(tilt), math.sin(tilt)), "box", 1, 2,
        )  # fmt: skip
        surfaces += (module,)
    names = dict.fromkeys(s.material for s in surfaces)
    materials = {name: _material(rng) for name in names}
    sun = Sun(*_sun(rng, azimuth), float(rng.choice([0.0, 0.533])))
    dni, dhi = rng.uniform(0.0, 950.0), rng.uniform(5.0, 350.0)
    if rng.random() < 0.1:
        dni = 0.0
    if rng.random() < 0.1:
        dhi = 0.0
    bands: tuple[Band, ...] = ()
    if rng.random() < 0.4:
        bands, materials = _bands(rng, materials)
    sky = Sky(str(rng.choice(["isotropic", "cie_clear", "perez"])))
    return Scene(
        surfaces, materials, sun, float(dni), float(dhi), title=f"random scene {seed}", infinite=infinite,
        bands=bands, sky=sky, horizon=str(rng.choice(["absorb", "renormalize"])),  # type: ignore[arg-type]
    )  # fmt: skip


def _material(rng: np.random.Generator) -> Optics:
    kind = rng.random()
    if kind < 0.3:
        return Optics(float(rng.uniform(0.05, 0.85)))
    if kind < 0.45:
        return WINDOW
    rho_s = float(rng.choice([rng.uniform(0.0, 2.0), 10.0 ** rng.uniform(-3.0, -0.5)]))
    return Optics(
        float(rng.uniform(0.0, 0.85)),
        rho_s,
        float(10.0 ** rng.uniform(0.0, 6.0)),
        float(rng.uniform(1.2, 1.8)),
    )


def _sun(rng: np.random.Generator, street_deg: float) -> tuple[float, float]:
    kind = rng.random()
    if kind < 0.25:  # low
        return float(rng.uniform(0.0, 360.0)), float(rng.uniform(0.5, 8.0))
    if kind < 0.4:  # along the street: grazing on both facades
        return street_deg + float(rng.choice([-0.5, -3.0, 2.0])), float(rng.uniform(2.0, 40.0))
    return float(rng.uniform(0.0, 360.0)), float(rng.uniform(5.0, 75.0))


def _bands(
    rng: np.random.Generator, materials: Mapping[str, Optics]
) -> tuple[tuple[Band, ...], dict[str, Optics]]:
    """Return 2 to 4 bands whose albedos differ, little or much, and the average over the direct light."""
    count = int(rng.integers(2, 5))
    direct = rng.dirichlet(np.full(count, 5.0))
    diffuse = rng.dirichlet(np.full(count, 5.0))
    direct[-1], diffuse[-1] = 1.0 - direct[:-1].sum(), 1.0 - diffuse[:-1].sum()
    spread = float(rng.choice([0.01, 0.1, 0.5]))
    edges = np.linspace(380.0, 2500.0, count + 1)
    tables = [
        {
            n: replace(m, rho_d=min(m.rho_d * (1.0 + spread * rng.uniform(-1.0, 1.0)), 1.0))
            for n, m in materials.items()
        }
        for _ in range(count)
    ]
    bands = tuple(
        Band(float(edges[i]), float(edges[i + 1]), float(direct[i]), float(diffuse[i]), tables[i])
        for i in range(count)
    )
    average = {
        n: replace(m, rho_d=float(sum(direct[i] * tables[i][n].rho_d for i in range(count))))
        for n, m in materials.items()
    }
    return bands, average


def _varied(rng: np.random.Generator, albedo: float, spread: float) -> float:
    return min(albedo * (1.0 + spread * float(rng.uniform(-1.0, 1.0))), 1.0)


@dataclass(frozen=True)
class Proof:
    """One scene at one tolerance; arrays over the receivers, W/m2."""

    bound: np.ndarray
    true: np.ndarray  # rms of the omitted part, noise taken off
    held: bool
    excess: float  # of the worst receiver, in units of what is allowed
    reached: bool  # within the tolerance as a whole
    plan_s: float
    run_s: float
    full_s: float
    levels: Mapping[str, Level]
    bands: bool


def prove(scene: Scene, tolerances: list[float], seed: int) -> list[Proof]:
    """Return one proof for each tolerance."""
    exact_tol = 0.3 * min(tolerances)
    everything = full(scene, exact_tol).scene
    run, other = engine(seed=seed), engine(seed=seed + 1000)
    exact = other(everything, exact_tol)
    proofs = []
    for tolerance in tolerances:
        start = time.process_time()
        choice = choose(scene, tolerance, seed=seed)
        planned = time.process_time()
        result = run(choice.scene, choice.stat_tol)
        done = time.process_time()
        run(everything, tolerance)
        whole = time.process_time()
        names = [r.name for r in exact.irradiance.receivers]
        bound = np.array([sum(o.bound_w_m2 for o in choice.omissions if o.receiver == n) for n in names])
        same = choice.scene == everything
        omitted = compared(exact if same else other(choice.scene, exact_tol), exact)
        true = np.sqrt(np.maximum(omitted.rms**2 - (omitted.noise / 4.0) ** 2, 0.0))
        excess = _excess(result, exact, bound)
        light = DARK * (scene.direct_w_m2 + scene.dhi_w_m2)
        reached = _rms(result, exact) <= 2.0 * tolerance * np.maximum(means(exact)[0], light)
        proofs.append(
            Proof(
                bound,
                true,
                excess <= 1.0,
                excess,
                bool(np.all(reached)),
                planned - start,
                done - planned,
                whole - done,
                choice.levels,
                bool(choice.scene.bands),
            )
        )
    return proofs


def _rms(a: Outcome, b: Outcome) -> np.ndarray:
    d = a.replicas.mean(axis=1) - b.replicas.mean(axis=1)
    return np.array([math.sqrt(w @ d[here] ** 2) for here, w in shares(b.irradiance)])


def _excess(a: Outcome, b: Outcome, bound: np.ndarray) -> float:
    """Return the largest difference over what is allowed, of patches (rms) and of means."""
    variance = sum(o.replicas.var(axis=1, ddof=1) / o.replicas.shape[1] for o in (a, b))
    noise = np.array([math.sqrt(w @ variance[here]) for here, w in shares(b.irradiance)])
    (x, sx), (y, sy) = means(a), means(b)
    # what patches of finite size change is an error of the engine, with the planner or without
    known = bound + sum(
        np.array([r.discretisation_w_m2 for r in o.irradiance.receivers], np.float64) for o in (a, b)
    )
    patches = _rms(a, b) / np.maximum(known + 3.0 * noise, 1e-9)
    whole = np.abs(x - y) / np.maximum(known + 3.0 * np.hypot(sx, sy), 1e-9)
    return float(max(np.max(patches), np.max(whole)))


def report(proofs: Mapping[float, list[Proof]]) -> None:
    """Print one line for each tolerance."""
    head = f"{'tolerance':<11}{'scenes':>7}{'held':>6}{'worst':>8}{'loose':>8}{'plan s':>9}{'run s':>9}"
    print(head + f"{'full s':>9}{'saved %':>9}  levels of materials")
    for tolerance, found in proofs.items():
        ratios = [
            b / t for p in found for b, t in zip(p.bound, p.true, strict=True) if t > 0.02 * b and b > 0.0
        ]
        plan, run, whole = (sum(getattr(p, k) for p in found) for k in ("plan_s", "run_s", "full_s"))
        levels = collections.Counter(level for p in found for level in p.levels.values())
        print(
            f"{tolerance:<11g}{len(found):>7}{sum(p.held for p in found):>6}"
            f"{max(p.excess for p in found):>8.2f}"
            f"{np.median(ratios) if ratios else math.nan:>8.1f}{plan:>9.2f}{run:>9.2f}{whole:>9.2f}"
            f"{100.0 * (1.0 - (plan + run) / whole):>9.0f}  "
            + ", ".join(f"{k} {v}" for k, v in sorted(levels.items()))
            + f"; bands kept {sum(p.bands for p in found)}"
        )


def survey() -> None:
    """Print where the lobe matters: sun elevation, alpha and windows, one street."""
    head = f"{'material':<34}{'sun':>6}{'receiver':>10}{'lobe W/m2':>11}"
    print(head + f"{'diffuse %':>11}{'two %':>9}{'unpol. %':>9}")
    materials = {
        "HPL: 0.72, rho_s 1, alpha 80": Optics(0.72, 1.0, 80.0, 1.5),
        "HPL, alpha 5": Optics(0.72, 1.0, 5.0, 1.5),
        "HPL, alpha 1e4": Optics(0.72, 1.0, 1e4, 1.5),
        "window: 0, rho_s 1, mirror": WINDOW,
    }
    run = engine(seed=1)
    for name, optics in materials.items():
        for elevation in (60.0, 30.0, 10.0, 3.0):
            for slant in (0.0, 80.0):
                scene = _surveyed(optics, elevation, slant)
                table = compare_levels(scene, rel_tol=0.003, run=run)
                polarised, lobe = table["polarised"], table["lobe"]
                for i, receiver in enumerate(table.receivers):
                    base = max(float(polarised.value[i]), table.floor_w_m2)
                    percent = [100.0 * table[k].difference[i] / base for k in ("diffuse", "mirror", "lobe")]
                    where = f"{elevation:g}/{slant:g}"
                    print(
                        f"{name:<34}{where:>6}{receiver:>10}{lobe.value[i]:>11.1f}"
                        f"{percent[0]:>+11.2f}{percent[1]:>+9.2f}{percent[2]:>+9.2f}"
                    )


def _surveyed(optics: Optics, elevation_deg: float, slant_deg: float) -> Scene:
    surfaces = street(
        width_m=12.0, length_m=60.0, height_left_m=12.0, height_right_m=18.0, azimuth_deg=0.0, left="clad",
        right="clad", ground="ground",
    )  # fmt: skip
    return Scene(
        tuple(replace(s, rows=4, columns=6) for s in surfaces),
        {"clad": optics, "ground": Optics(0.2)},
        Sun(270.0 - slant_deg, elevation_deg),
        800.0 * min(1.0, elevation_deg / 15.0 + 0.2),
        90.0,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--tolerances", default="0.05,0.01,0.003")
    parser.add_argument("--survey", action="store_true")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    if options.survey:
        survey()
        return
    tolerances = [float(x) for x in options.tolerances.split(",")]
    warm: Engine = engine()
    warm(full(random_scene(0), 0.5).scene, 0.5)
    proofs: dict[float, list[Proof]] = {t: [] for t in tolerances}
    for number in range(options.first, options.first + options.scenes):
        for tolerance, proof in zip(tolerances, prove(random_scene(number), tolerances, number), strict=True):
            proofs[tolerance].append(proof)
            if options.verbose or not proof.held:
                kind = "held" if proof.held else "FAILED"
                print(
                    f"scene {number} at {tolerance:g}: {kind}, {proof.excess:.2f} of what is allowed; "
                    f"bound {proof.bound}, omitted {proof.true}; {dict(proof.levels)}; "
                    f"{proof.plan_s:.3f} + {proof.run_s:.3f} s, full {proof.full_s:.3f} s",
                    flush=True,
                )
    report(proofs)
    print(
        f"{sum(p.held for f in proofs.values() for p in f)} of {sum(map(len, proofs.values()))} bounds held"
    )


if __name__ == "__main__":
    main()

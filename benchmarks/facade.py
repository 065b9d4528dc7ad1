"""Facade engine: seconds and error of ours, Mitsuba 3 and Radiance, in one run.

    python benchmarks/facade.py [--threads N] [--seeds N] [--quick] [--only canyons lobe latency coverage]

Canyons: 20 facade bands of endless matte canyons (walls 0.72, ground 0.2).  The error is the RMS over the
bands of value / truth - 1, the truth a radiosity with exact view factors.  "Time to 1 %" is the time at which
the median of the measured errors over several seeds is 1 %: each engine gets more samples until it is below,
and between the last two settings the time is interpolated on logarithmic scales.  What an engine claims does
not count, and is printed beside.  Compilation is not in these times; it has a table of its own.

Lobe: sun on a glossy wall, 10 bands opposite, against a quadrature of the one reflection; the error is the
RMS over the mean.  Coverage: standard errors claimed against errors measured, over many seeds.

Wall seconds mean something on a quiet machine only; the processor seconds of all threads stand beside them,
and ratios are of those.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import get_args

import _root  # noqa: F401
import numpy as np
from numpy.typing import NDArray

from benchmarks import _facade_cases as cases
from benchmarks._facade_cases import Run
from gonio.facade.simulate import Estimator, available_threads
from tests.core.facade.peers import mitsuba_peer, radiance_peer

FloatArray = NDArray[np.float64]
TARGETS = (0.01, 0.001)
TOLERANCES = tuple(0.02 * 2.0 ** (-0.5 * i) for i in range(15))
MITSUBA_PATHS = tuple(1024 * 4**i for i in range(5))
KINDS = tuple(k for k in ("rows", "paths") if k in get_args(Estimator))
RADIANCE_POINTS = (1, 4, 16, 64, 256)


class Line:
    """One engine's runs in one scene, from few samples to many."""

    def __init__(self, name: str, error: Callable[[FloatArray], float]) -> None:
        self.name, self.error = name, error
        self.rungs: list[tuple[float, float, float, float]] = []  # error, wall s, cpu s, claimed; medians

    def add(self, runs: Sequence[Run]) -> float:
        """Take the runs of one setting and return the median of their errors."""
        middle = np.median([(self.error(r.bands), r.seconds, r.cpu_seconds, r.claimed) for r in runs], axis=0)
        self.rungs.append(tuple(middle.tolist()))
        return float(middle[0])

    def to(self, target: float) -> tuple[float, float, float, float] | None:
        """Return error, wall seconds, processor seconds and claim where the error is `target`, or None.

        With an error below it at the first setting, that setting counts: nothing less was run.
        """
        for i, rung in enumerate(self.rungs):
            if rung[0] <= target:
                if i == 0 or self.rungs[i - 1][0] <= target:
                    return rung
                before = self.rungs[i - 1]
                part = np.log(before[0] / target) / np.log(before[0] / rung[0])
                wall, cpu = (before[k] * (rung[k] / before[k]) ** part for k in (1, 2))
                return target, float(wall), float(cpu), rung[3]
        return None


def climb(
    line: Line, settings: Sequence[float], seeds: int, run: Callable[[float, int], Run], until: float
) -> Line:
    """Run one setting after the other until the median error is below `until`."""
    for setting in settings:
        if line.add([run(setting, seed) for seed in range(1, seeds + 1)]) <= until:
            break
    return line


def canyons(seeds: int, threads: int, quick: bool) -> None:
    """Print the table of the four canyons."""
    llvm = mitsuba_peer.find_llvm()
    variant = "LLVM" if llvm else "scalar"
    targets = TARGETS[:1] if quick else TARGETS
    paths = list(MITSUBA_PATHS[: 3 if quick else 5] if llvm else MITSUBA_PATHS[: 2 if quick else 3])
    scenes = [cases.canyon(*c[1:]) for c in cases.CANYONS]
    traced = {"independent": cases.mitsuba([(s, paths[:3]) for s in scenes], 3, "independent", llvm)}
    if llvm:  # its best sampler here; the plain one would need minutes to 0.1 %
        traced["orthogonal"] = cases.mitsuba([(s, paths) for s in scenes], 3, "orthogonal", llvm)
    print(f"{'canyon':<11}{'engine':<27}{'to %':>6}{'error %':>9}{'claimed %':>11}{'wall s':>9}{'cpu s':>9}"
          f"{'theirs : ours':>15}")  # fmt: skip
    for number, (name, *numbers) in enumerate(cases.CANYONS):
        true, scene = cases.truth(*numbers), scenes[number]

        def error(bands: FloatArray, true: FloatArray = true) -> float:
            return cases.rms(bands, true)

        for kind in KINDS:  # the compiler and the caches are warm then
            cases.ours(scene, 0.05, 0, threads=threads, estimator=kind)
        lines = [
            climb(Line("ours", error), TOLERANCES, seeds,
                  lambda t, seed, scene=scene: cases.ours(scene, t, seed, threads=threads), targets[-1]),
            climb(Line("ours, Sobol paths", error), TOLERANCES, min(seeds, 3),
                  lambda t, seed, scene=scene: cases.ours(
                      scene, t, seed, threads=threads, estimator="paths"), targets[-1]),
            climb(Line("ours, plain Monte Carlo", error), [2.0**k for k in range(12, 24, 2)], min(seeds, 3),
                  lambda n, seed, scene=scene: cases.plain(
                      scene, int(n), seed, threads=threads), targets[-1]),
        ]  # fmt: skip
        for sampler, found in traced.items():
            line = Line(f"Mitsuba {variant}, {sampler}", error)
            for rung in found[number]:
                line.add(rung)
            lines.append(line)
        for title, options, points in (
            ("Radiance, brute", radiance_peer.BRUTE, RADIANCE_POINTS[: 3 if quick else 5]),
            ("Radiance, typical", radiance_peer.TYPICAL, (16,)),
        ):
            few = 3 if title.endswith("brute") else 1
            lines.append(
                climb(Line(title, error), points, few,
                      lambda p, seed, scene=scene, options=options: cases.radiance(
                          scene, int(p), 1, options, threads, seed)[0], targets[-1])
            )  # fmt: skip
        for target in targets:
            _print_target(name, lines, target)
        print(flush=True)


def _print_target(name: str, lines: Sequence[Line], target: float) -> None:
    reference = lines[0].to(target)
    for line in lines:
        reached = line.to(target)
        best = reached or min(line.rungs)
        claimed = "" if np.isnan(best[3]) else f"{100 * best[3]:.3f}"
        ratio = f"{best[2] / reference[2]:.1f}" if reference and line is not lines[0] else ""
        if reached is None:
            ratio = f"> {ratio}" if ratio else "not reached"
        print(
            f"{name:<11}{line.name:<27}{100 * target:>6g}{100 * best[0]:>9.3f}{claimed:>11}{best[1]:>9.4f}"
            f"{best[2]:>9.4f}{ratio:>15}"
        )


def lobe(seeds: int, threads: int) -> None:
    """Print the table of the glossy wall."""
    print("sun -> glossy wall -> 10 bands opposite, to 1 %")
    print(f"{'alpha':>9}{'error %':>10}{'claimed %':>11}{'wall s':>9}{'cpu s':>9}")
    for alpha in cases.ALPHAS:
        true, scene = cases.glossy_truth(alpha), cases.glossy(alpha)

        def error(bands: FloatArray, true: FloatArray = true) -> float:
            return float(np.sqrt(np.mean((bands - true) ** 2)) / true.mean())

        cases.ours(scene, 0.1, 0, threads=threads, over_mean=True)
        line = climb(Line("ours", error), TOLERANCES, seeds,
                     lambda t, seed, scene=scene: cases.ours(
                         scene, t, seed, threads=threads, over_mean=True), 0.01)  # fmt: skip
        best = line.to(0.01) or min(line.rungs)
        print(
            f"{alpha:>9g}{100 * best[0]:>10.3f}{100 * best[3]:>11.3f}{best[1]:>9.4f}{best[2]:>9.4f}",
            flush=True,
        )
    print()


_FIRST = """
import sys, time
start = time.perf_counter()
from benchmarks import _facade_cases as cases
loaded = time.perf_counter()
scene = cases.canyon(1.0, 1.0, 0.15) if sys.argv[1] == "matte" else cases.glossy(100.0)
said = []
ready = time.perf_counter()
cases.simulate(scene, rel_tol=0.01, progress=lambda done, text: said.append(text))
first = time.perf_counter()
cases.simulate(scene, rel_tol=0.01)
print(loaded - start, first - ready, time.perf_counter() - first, time.process_time(), said[0], sep="|")
"""


def latency() -> None:
    """Print what a first call costs, with and without the compiled code on disk."""
    print("first call in a new process")
    print(
        f"{'scene':<9}{'cache':<8}{'import s':>9}{'first call s':>14}{'second s':>10}{'cpu s':>8}  "
        "first message"
    )
    root = str(Path(__file__).resolve().parents[1])
    for kind in ("matte", "glossy"):
        with tempfile.TemporaryDirectory() as folder:
            for cache in ("empty", "warm"):
                environment = dict(os.environ) | {"NUMBA_CACHE_DIR": folder, "PYTHONPATH": root}
                done = subprocess.run([sys.executable, "-c", _FIRST, kind], env=environment, cwd=root,
                                      capture_output=True, text=True, check=True)  # fmt: skip
                *numbers, said = done.stdout.strip().split("|")
                loaded, first, second, cpu = (float(x) for x in numbers)
                print(
                    f"{kind:<9}{cache:<8}{loaded:>9.2f}{first:>14.2f}{second:>10.3f}{cpu:>8.2f}  {said}",
                    flush=True,
                )
    print()


def coverage(seeds: int, threads: int) -> None:
    """Print how often the truth is within one and two standard errors."""
    print(f"coverage of the standard errors, {seeds} seeds (68.3 and 95.4 % for a normal distribution)")
    print(
        f"{'scene':<18}{'estimator':<11}{'asked %':>8}{'|z| < 1':>9}{'|z| < 2':>9}"
        f"{'rms z':>8}{'bias / se':>11}"
    )
    todo: list[tuple[str, object, FloatArray, str, float]] = []
    for name, *numbers in cases.CANYONS:
        true = cases.truth(*numbers)
        todo += [(name, cases.canyon(*numbers), true, kind, 0.02) for kind in KINDS]
        todo.append((name, cases.canyon(*numbers), true, KINDS[0], 0.002))
    for alpha in (1.0, 100.0, 1e4):
        true = cases.glossy_truth(alpha)
        todo += [(f"lobe, alpha {alpha:g}", cases.glossy(alpha), true, kind, 0.02) for kind in KINDS]
    for name, scene, true, kind, tolerance in todo:
        z = []
        lit = true > 1e-3 * true.max()
        for seed in range(seeds):
            result = cases.simulate(
                scene, rel_tol=tolerance, seed=1000 + seed, threads=threads, estimator=kind
            )  # type: ignore[arg-type]
            value, se = cases.flat(result)
            with np.errstate(divide="ignore", invalid="ignore"):
                z.append(((value - true) / se)[lit & (se > 0.0)])
        every = np.concatenate(z)
        inside = [100.0 * float(np.mean(np.abs(every) < k)) for k in (1.0, 2.0)]
        spread = float(np.sqrt(np.mean(every**2)))
        print(f"{name:<18}{kind:<11}{100 * tolerance:>8g}{inside[0]:>8.1f}%{inside[1]:>8.1f}%{spread:>8.2f}"
              f"{float(np.mean(every)):>11.3f}", flush=True)  # fmt: skip
    print()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--threads", type=int, default=available_threads())
    parser.add_argument("--seeds", type=int, default=7)
    parser.add_argument("--coverage-seeds", type=int, default=200)
    parser.add_argument("--quick", action="store_true", help="to 1 %% only")
    parser.add_argument("--only", nargs="*", choices=("canyons", "lobe", "latency", "coverage"))
    chosen = parser.parse_args()
    parts = {
        "canyons": lambda: canyons(chosen.seeds, chosen.threads, chosen.quick),
        "lobe": lambda: lobe(chosen.seeds, chosen.threads),
        "latency": latency,
        "coverage": lambda: coverage(chosen.coverage_seeds, chosen.threads),
    }
    print(f"{chosen.threads} threads\n")
    for name in chosen.only or parts:
        parts[name]()


if __name__ == "__main__":
    main()

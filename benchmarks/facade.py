"""Facade engine: seconds and error, in one run.

    python benchmarks/facade.py [--threads N]

Canyons: 30 bands of an endless diffuse canyon (walls 0.72, ground 0.2, H/W = 1) against the radiosity
reference of the tests; the error is the RMS over the bands of value / reference - 1.  Lobe: sun on a glossy
wall, receivers opposite; the error is that of the mean specular irradiance against another, more exact run.
"""

from __future__ import annotations

import argparse
import csv
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from gonio.facade import Irradiance, Optics, Scene, Sun, simulate, street

REFERENCE = Path(__file__).parents[1] / "tests" / "core" / "facade" / "canyon.csv"
NAMES = {"wall0": "left", "wall1": "right", "ground": "ground"}


def canyon(dni: float, dhi: float, *, receivers: int = 10, wall: Optics | None = None) -> Scene:
    """Return an endless canyon of width and height 1 along north, 10 bands a surface."""
    surfaces = street(
        width_m=1.0,
        length_m=1.0,
        height_left_m=1.0,
        height_right_m=1.0,
        azimuth_deg=0.0,
        left="wall",
        right="glossy" if wall else "wall",
        ground="ground",
    )
    return Scene(
        surfaces=tuple(replace(s, rows=receivers, columns=1) for s in surfaces),
        materials={"wall": Optics(0.72), "ground": Optics(0.2), "glossy": wall or Optics(0.72)},
        sun=Sun(60.0 if wall is None else 280.0, 50.0 if wall is None else 35.0, 0.0),
        dni_w_m2=dni,
        dhi_w_m2=dhi,
        infinite=True,
    )


def reference(case: str) -> np.ndarray:
    with REFERENCE.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    found = {(r["surface"], int(r["band"])): float(r["irradiance"]) for r in rows if r["case"] == case}
    return np.array([found[surface, band] for surface in NAMES for band in range(10)])


def line(name: str, result: Irradiance, error: float, claimed: float) -> None:
    speed = result.rays / result.duration_s / 1e6
    numbers = f"{100 * error:>11.3f}{100 * claimed:>11.3f}{result.rays:>12.3g}{speed:>9.1f}"
    print(f"{name:<42}{result.duration_s:>9.3f}{numbers}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=None)
    threads = parser.parse_args().threads

    started_s = time.perf_counter()
    simulate(canyon(1.0, 0.15), rel_tol=0.3, threads=threads)
    print(f"first call (compilation, or the cache on disk): {time.perf_counter() - started_s:.2f} s\n")
    print(f"{'case, asked':<42}{'seconds':>9}{'error %':>11}{'claimed %':>11}{'rays':>12}{'Mray/s':>9}")
    for case, dni, dhi in (("sky", 0.0, 1.0), ("sun", 1.0, 0.15)):
        for tolerance in (0.01, 0.001):
            result = simulate(canyon(dni, dhi), rel_tol=tolerance, seed=1, threads=threads)
            value = np.concatenate([r.value.ravel() for r in result.receivers])
            error = float(np.sqrt(np.mean((value / reference(case) - 1.0) ** 2)))
            line(f"diffuse canyon, {case}, {100 * tolerance:g} %", result, error, result.relative_error)
    for alpha in (1.0, 100.0, 1e4, 1e6):
        scene = canyon(800.0, 0.0, wall=Optics(0.0, 1.0, alpha, 1.5))
        exact = simulate(scene, rel_tol=0.002, seed=2, threads=threads)["left"].mean_contributions["specular"]
        result = simulate(scene, rel_tol=0.01, seed=1, threads=threads)
        found = result["left"].mean_contributions["specular"]
        error = abs(float(found.value) / float(exact.value) - 1.0)
        line(
            f"sun on a glossy wall, alpha {alpha:g}, 1 %",
            result,
            error,
            float(found.standard_error / found.value),
        )


if __name__ == "__main__":
    main()

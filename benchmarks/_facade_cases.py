"""The scenes of `facade.py`, what is true in them, and how each engine is asked."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio import fresnel
from gonio.facade import Irradiance, Optics, Scene, Sun, simulate, street
from tests.core.facade.peers import mitsuba_peer, radiance_peer, radiosity, single_reflection
from tests.core.facade.peers.description import describe

FloatArray = NDArray[np.float64]

WALL, GROUND = 0.72, 0.2
CANYONS = (("H/W 1 sky", 1.0, 0.0, 1.0), ("H/W 2 sky", 2.0, 0.0, 1.0), ("H/W 1 sun", 1.0, 1.0, 0.15),
           ("H/W 2 sun", 2.0, 1.0, 0.15))  # fmt: skip
"""Name, height over width, DNI, DHI."""


@dataclass(frozen=True, slots=True)
class Run:
    """One answer: bands of both walls, what it claims to err by, and what it cost."""

    bands: FloatArray
    claimed: float
    seconds: float
    cpu_seconds: float


def canyon(height: float, dni: float, dhi: float) -> Scene:
    """Return an endless matte canyon along north, 10 bands on each facade."""
    surfaces = street(
        width_m=1.0, length_m=1.0, height_left_m=height, height_right_m=height, azimuth_deg=0.0,
        left="wall", right="wall", ground="ground",
    )  # fmt: skip
    return Scene(
        surfaces=tuple(replace(s, rows=10, columns=1) if s.name != "ground" else s for s in surfaces),
        materials={"wall": Optics(WALL), "ground": Optics(GROUND)},
        sun=Sun(60.0, 50.0, 0.0),
        dni_w_m2=dni,
        dhi_w_m2=dhi,
        infinite=True,
    )


def truth(height: float, dni: float, dhi: float) -> FloatArray:
    """Return the irradiance of the 20 facade bands, to better than 1e-6."""
    return radiosity.bands(height, walls=WALL, ground=GROUND, dni=dni, dhi=dhi)[:20]


def rms(bands: FloatArray, true: FloatArray) -> float:
    """Return the root mean square of the bands' relative errors."""
    return float(np.sqrt(np.mean((bands / true - 1.0) ** 2)))


GLOSSY_SUN = Sun(280.0, 35.0, 0.0)
ALPHAS = (1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6)


def glossy(alpha: float) -> Scene:
    """Return a canyon where the sun shines on a glossy right wall and everything else is black."""
    left, right, ground = street(
        width_m=1.0, length_m=1.0, height_left_m=1.0, height_right_m=1.0, azimuth_deg=0.0, left="black",
        right="glossy", ground="black",
    )  # fmt: skip
    return Scene(
        surfaces=(replace(left, rows=10, columns=1), right, ground),
        materials={"black": Optics(0.0), "glossy": Optics(0.0, 1.0, alpha, 1.5)},
        sun=GLOSSY_SUN,
        dni_w_m2=800.0,
        dhi_w_m2=0.0,
        infinite=True,
    )


def glossy_truth(alpha: float) -> FloatArray:
    """Return the irradiance of the left wall's 10 bands, to about 1e-4 of its mean."""
    sun = GLOSSY_SUN.direction
    theta_i_deg = float(np.degrees(np.arccos(-sun[0])))
    return single_reflection.irradiance(
        width=1.0, left_height=1.0, right_height=1.0, bands=10, sun=sun, dni=800.0,
        k_s=float(fresnel.reflectance(1.5, theta_i_deg, "unpolarized")), alpha=alpha,
    )  # fmt: skip


def flat(result: Irradiance) -> tuple[FloatArray, FloatArray]:
    """Return values and standard errors of all patches."""
    return (
        np.concatenate([r.value.ravel() for r in result.receivers]),
        np.concatenate([r.standard_error.ravel() for r in result.receivers]),
    )


def timed(work: Callable[[], Irradiance]) -> tuple[Irradiance, float, float]:
    """Return a result, wall seconds and processor seconds of all threads."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = work()
    return result, time.perf_counter() - wall_s, time.process_time() - cpu_s


def ours(scene: Scene, rel_tol: float, seed: int, *, over_mean: bool = False, **options: object) -> Run:
    """Run the product; it claims the RMS of the bands' relative errors, or of their errors over the mean."""
    result, wall_s, cpu_s = timed(lambda: simulate(scene, rel_tol=rel_tol, seed=seed, **options))  # type: ignore[arg-type]
    value, se = flat(result)
    claimed = float(
        np.sqrt(np.mean(se**2)) / value.mean() if over_mean else np.sqrt(np.mean((se / value) ** 2))
    )
    return Run(value, claimed, wall_s, cpu_s)


def plain(scene: Scene, paths: int, seed: int, *, threads: int) -> Run:
    """Run plain Monte Carlo through the product's tracer: every path has random numbers of its own.

    Each replica draws one point, which its own key scrambles: nothing is left of Sobol's order.
    """
    from concurrent.futures import ThreadPoolExecutor

    from gonio.facade import kernels
    from gonio.facade.lighting import light_of
    from gonio.facade.pack import pack
    from gonio.facade.sobol import sobol_directions

    packed = pack(scene.surfaces, scene.materials, meshes=scene.meshes, periodic=scene.infinite)
    light, directions, count = light_of(scene), sobol_directions(), len(packed.patches.area)
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    chunk = min(paths, 8192)

    def part(number: int) -> tuple[FloatArray, FloatArray]:
        out, exposed = np.zeros((count * chunk, 5)), np.zeros(count * chunk)
        own = np.uint64(seed * 1_000_003 + number)
        kernels.backward(
            packed.geometry, light, packed.patches, directions, own, chunk, (0, count * chunk, 0, 1), False,
            out, exposed,
        )  # fmt: skip
        each = out[:, :4].sum(axis=1).reshape(count, chunk)
        return each.sum(axis=1), (each**2).sum(axis=1)

    with ThreadPoolExecutor(threads) as pool:
        parts = list(pool.map(part, range(-(-paths // chunk))))
    total = chunk * len(parts)
    mean, square = (sum(p[i] for p in parts) / total for i in range(2))
    relative = np.sqrt(np.maximum(square - mean**2, 0.0) / total) / mean
    claimed = float(np.sqrt(np.mean(relative**2)))
    return Run(mean, claimed, time.perf_counter() - wall_s, time.process_time() - cpu_s)


def mitsuba(
    scenes: list[tuple[Scene, list[int]]], seeds: int, sampler: str, llvm: str | None
) -> list[list[list[Run]]]:
    """Run Mitsuba on scenes, each with a ladder of paths per band; return runs[scene][rung][seed].

    The first batch of a rung compiles and is not counted.  The sky below the horizon cannot be seen in these
    canyons, so it is Mitsuba's `constant` emitter, which is quicker than an image of the sky.
    """
    jobs = [
        mitsuba_peer.Job(
            mitsuba_peer.plain(describe(scene)) | {"constant_sky": True}, n, seeds + 1, 100 * i, sampler
        )
        for scene, ladder in scenes
        for i, n in enumerate(ladder)
    ]
    answers = iter(mitsuba_peer.trace(jobs, llvm=llvm))
    found = []
    for _, ladder in scenes:
        rungs = []
        for _ in ladder:
            a = next(answers)
            rungs.append(
                [
                    Run(a.batches[i], float("nan"), float(a.seconds[i]), float(a.cpu_seconds[i]))
                    for i in range(1, seeds + 1)
                ]
            )
        found.append(rungs)
    return found


def radiance(
    scene: Scene, points: int, runs: int, options: tuple[str, ...], threads: int, seed: int
) -> list[Run]:
    """Run Radiance's rtrace; its surfaces reflect on both sides, which no ray can see here."""
    a = radiance_peer.trace(
        describe(scene), points=points, batches=runs, seed=seed, options=options, processes=threads,
        one_sided=False,
    )  # fmt: skip
    return [
        Run(a.batches[i], float("nan"), float(a.seconds[i]), float(a.cpu_seconds[i])) for i in range(runs)
    ]

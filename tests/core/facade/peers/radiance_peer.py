"""What does Radiance say?  Irradiance of patches by `rtrace -I`, from the programs in pyradiance's wheel.

Only matte scenes: Radiance's function materials for a lobe are not sampled by its indirect calculation.
Every batch draws new points on the patches, and with ``-u+`` the ambient rays are drawn at random too, so
batches scatter as much as they err.
"""

from __future__ import annotations

import importlib.util
import math
import os
import resource
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BRUTE = ("-ab", "30", "-ad", "256", "-as", "0", "-aa", "0", "-lw", "1e-3", "-lr", "-30", "-u+")
"""Path tracing without the ambient cache; roulette instead of an end, so that it has no bias.

Of the settings tried in the canyons (-ad 64 to 1024, -lw 1e-3 to 5e-3, -u- and -u+) the quickest to an error.
"""

TYPICAL = ("-ab", "5", "-ad", "1024", "-as", "512", "-aa", "0.1", "-ar", "256", "-lw", "1e-3")
"""What guides for daylighting recommend: the ambient cache interpolates."""

_SKY = """gamma_cosine = Dx*A8 + Dy*A9 + Dz*A10;
gamma = Acos(gamma_cosine);
Acos(x) = if(x - 1, 0, if(-1 - x, PI, acos(x)));
up = if(Dz - 0.01, Dz, 0.01);
plus(x) = if(x, x, 0);
skybright = if(Dz, plus(A1*(1 + A2*exp(A3/up))
    * (A4 + A5*exp(A6*gamma) + A7*gamma_cosine*gamma_cosine)), 0);
"""


@dataclass(frozen=True, slots=True)
class Answer:
    """Batches (batches, patches) W/m2, and the wall and processor seconds of each."""

    batches: FloatArray
    seconds: FloatArray
    cpu_seconds: FloatArray

    @property
    def value(self) -> FloatArray:
        """Mean of the batches, (patches,) W/m2."""
        return np.asarray(self.batches.mean(axis=0))

    @property
    def standard_error(self) -> FloatArray:
        """Standard error of `value`, (patches,) W/m2."""
        return np.asarray(self.batches.std(axis=0, ddof=1) / math.sqrt(len(self.batches)))


def home() -> Path:
    """Return the folder of pyradiance, which holds `bin` and `lib`.

    Raises
    ------
    RuntimeError
        pyradiance is not installed.
    """
    found = importlib.util.find_spec("pyradiance")
    if found is None or not found.submodule_search_locations:
        raise RuntimeError("pyradiance is not installed; pip install pyradiance")
    return Path(found.submodule_search_locations[0])


def trace(
    d: Any,
    *,
    points: int,
    batches: int,
    seed: int = 0,
    options: Sequence[str] = BRUTE,
    processes: int = 1,
    one_sided: bool = True,
) -> Answer:
    """Return the irradiance of the patches of a `Description`.

    Parameters
    ----------
    points
        Of each patch in each batch, stratified.
    one_sided
        The backs of one-sided surfaces are black, which costs a function call at every hit; without it they
        reflect as their fronts, which is the same where no ray can see them.

    Raises
    ------
    ValueError
        The scene has a glossy material.
    RuntimeError
        A program of Radiance failed.
    """
    if np.any(d.materials[:, 1] > 0.0):
        raise ValueError("Radiance has no such lobe: give it matte scenes")
    rng = np.random.default_rng(seed)
    environment = dict(os.environ) | {"RAYPATH": f".{os.pathsep}{home() / 'lib'}"}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sky.cal").write_text(_SKY)
        (folder / "scene.rad").write_text(scene_text(d, one_sided=one_sided))
        octree = _run(["oconv", "scene.rad"], folder, environment, b"")
        (folder / "scene.oct").write_bytes(octree)
        rows, seconds, cpu = [], [], []
        command = ["rtrace", "-h", "-I", "-fdd", "-n", str(processes), *options]
        command += ["-dj", "1", "-ds", "0", "-dt", "0", "-dc", "1", "scene.oct"]
        for _ in range(batches):
            rays = _starts(d, points, rng)
            wall_s, cpu_s = time.perf_counter(), _children_s()
            out = _run(command, folder, environment, rays.tobytes())
            cpu.append(_children_s() - cpu_s)
            seconds.append(time.perf_counter() - wall_s)
            rgb = np.frombuffer(out, np.float64).reshape(-1, points, 3)
            rows.append(rgb[:, :, 0].mean(axis=1))
    return Answer(np.array(rows), np.array(seconds), np.array(cpu))


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _run(command: list[str], folder: Path, environment: dict[str, str], data: bytes) -> bytes:
    program = str(home() / "bin" / command[0])
    done = subprocess.run(
        [program, *command[1:]], input=data, capture_output=True, cwd=folder, env=environment, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"{command[0]} ended with {done.returncode}: {done.stderr.decode()[-1000:]}")
    return done.stdout


def _starts(d: Any, points: int, rng: np.random.Generator) -> FloatArray:
    """Return (patches * points, 6): places a hair above the patches, and their normals."""
    p = d.patches
    n = len(p.origin)
    rank = np.argsort(rng.random((n, points)), axis=1)  # Latin squares: both coordinates are stratified
    a = (np.arange(points)[None, :] + rng.random((n, points))) / points
    b = (rank + rng.random((n, points))) / points
    over = p.triangle[:, None] & (a + b > 1.0)
    a, b = np.where(over, 1.0 - a, a), np.where(over, 1.0 - b, b)
    place = p.origin[:, None] + a[..., None] * p.u[:, None] + b[..., None] * p.v[:, None]
    place = place + (1e-5 * d.extent) * p.normal[:, None]
    normal = np.broadcast_to(p.normal[:, None], place.shape)
    return np.concatenate([place, normal], axis=2).reshape(-1, 6)


def scene_text(d: Any, *, one_sided: bool) -> str:
    """Return the scene in Radiance's language."""
    lines = ["void plastic black 0 0 5 0 0 0 0 0"]
    for i, row in enumerate(d.materials):
        lines.append(f"void plastic matte{i} 0 0 5 {row[0]:.12g} {row[0]:.12g} {row[0]:.12g} 0 0")
        lines.append(f"void mixfunc front{i} 4 matte{i} black if(Rdot,1,0) . 0 0")
    for i, (corners, material, both) in enumerate(zip(d.corners, d.material, d.two_sided, strict=True)):
        name = f"matte{material}" if both or not one_sided else f"front{material}"
        numbers = " ".join(f"{x:.12g}" for x in corners.ravel())
        lines.append(f"{name} polygon p{i} 0 0 9 {numbers}")
    if d.sky[0] > 0.0:
        uniform = d.sky[1] == d.sky[4] == d.sky[6] == 0.0
        level = d.sky[0] * d.sky[3] if uniform else 1.0
        if not uniform:
            numbers = " ".join(f"{x:.12g}" for x in (*d.sky, *d.sun))
            lines.append(f"void brightfunc skyfunc 2 skybright sky.cal 0 10 {numbers}")
        glow = (
            f"{'void' if uniform else 'skyfunc'} glow skyglow 0 0 4 {level:.12g} {level:.12g} {level:.12g} 0"
        )
        lines += [glow, "skyglow source sky 0 0 4 0 0 1 180"]
    if d.dni > 0.0:
        angle = max(math.degrees(d.sun_diameter), 0.01)
        level = d.dni / (math.pi * math.sin(math.radians(angle) / 2.0) ** 2)
        direction = " ".join(f"{x:.12g}" for x in d.sun)
        lines += [f"void light sunlight 0 0 3 {level:.12g} {level:.12g} {level:.12g}"]
        lines += [f"sunlight source sun 0 0 4 {direction} {angle:.12g}"]
    return "\n".join(lines) + "\n"

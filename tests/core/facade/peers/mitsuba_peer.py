"""What does Mitsuba 3 say?  Irradiance of patches by its path tracer, in a process of its own.

Mitsuba traces, samples the emitters and the diffuse BSDFs and follows the paths (`path` integrator); ours are
only the starting points on the patches, and a BSDF plugin for the published lobe, which no renderer has.

The worker is this file run as a program: jobs come pickled through standard input, answers leave through a
file.  It imports nothing of gonio.  A process of its own, because LLVM aborts the whole process when it
is too old, and because foreign warnings and allocations then cannot meet those of the tests.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import math
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

OLDEST_LLVM = 17
"""Older ones end the process: "cannot select fmaximum"."""


@dataclass(frozen=True, slots=True)
class Job:
    """Trace `batches` independent runs of `samples` paths per patch."""

    description: Any  # a Description as a dict, `plain`
    samples: int
    batches: int
    seed: int = 0
    sampler: str = "independent"


@dataclass(frozen=True, slots=True)
class Answer:
    """What came back: `batches` (batches, patches) W/m2 and the seconds each batch took."""

    batches: FloatArray
    seconds: FloatArray
    cpu_seconds: FloatArray
    samples: int  # what the sampler made of those asked
    variant: str
    notes: tuple[str, ...] = field(default=())

    @property
    def value(self) -> FloatArray:
        """Mean of the batches, (patches,) W/m2."""
        return np.asarray(self.batches.mean(axis=0))

    @property
    def standard_error(self) -> FloatArray:
        """Standard error of `value`, (patches,) W/m2."""
        return np.asarray(self.batches.std(axis=0, ddof=1) / math.sqrt(len(self.batches)))


def find_llvm() -> str | None:
    """Return an LLVM library that Mitsuba can use: what DRJIT_LIBLLVM_PATH says, or the newest.

    ``None``: there is none, and Mitsuba runs its scalar variant.
    """
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named:
        return named
    found = [p for n in range(OLDEST_LLVM, 40) if (p := ctypes.util.find_library(f"LLVM-{n}"))]
    rustc = shutil.which("rustc")  # the Rust compiler brings an LLVM of its own
    if rustc is not None:
        root = subprocess.run(
            [rustc, "--print", "sysroot"], capture_output=True, text=True, check=False
        ).stdout
        found += sorted(str(p) for p in (Path(root.strip()) / "lib").glob("libLLVM.so*"))
    versions = [(v, p) for p in found if (v := _llvm_version(p)) >= OLDEST_LLVM]
    return max(versions)[1] if versions else None


def _llvm_version(path: str) -> int:
    major = ctypes.c_uint(0)
    code = (
        "import ctypes, sys; n = ctypes.c_uint(); "
        "ctypes.CDLL(sys.argv[1]).LLVMGetVersion(ctypes.byref(n), None, None); print(n.value)"
    )
    done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=False)
    major.value = int(done.stdout) if done.returncode == 0 and done.stdout.strip().isdigit() else 0
    return int(major.value)


def plain(description: Any) -> dict[str, Any]:
    """Return a `Description` as a dict of arrays, which the worker can read without gonio."""
    fields = {name: getattr(description, name) for name in type(description).__slots__}
    patches = fields.pop("patches")
    return fields | {f"patch_{name}": getattr(patches, name) for name in type(patches).__slots__}


def trace(jobs: Sequence[Job], *, llvm: str | None, timeout_s: float = 600.0) -> list[Answer]:
    """Return one answer per job, all from one worker process.

    Raises
    ------
    RuntimeError
        The worker failed; its last lines of output are in the message.
    """
    environment = dict(os.environ)
    if llvm is not None:
        environment["DRJIT_LIBLLVM_PATH"] = llvm
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "answers.pickle"
        done = subprocess.run(
            [sys.executable, __file__, "llvm" if llvm is not None else "scalar", str(out)],
            input=pickle.dumps([(j.description, j.samples, j.batches, j.seed, j.sampler) for j in jobs]),
            capture_output=True,
            env=environment,
            timeout=timeout_s,
            check=False,
        )
        if done.returncode != 0:
            raise RuntimeError(
                f"the Mitsuba worker ended with {done.returncode}:\n{done.stderr.decode()[-3000:]}"
            )
        return [Answer(*a) for a in pickle.loads(out.read_bytes())]


# -- in the worker


def _worker(kind: str, out: str) -> None:
    import mitsuba as mi

    variant = "llvm_ad_rgb" if kind == "llvm" else "scalar_rgb"
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    answers = []
    for description, samples, batches, seed, sampler in pickle.load(sys.stdin.buffer):
        run = _Vectorised(mi, description) if kind == "llvm" else _Scalar(mi, description)
        rows, seconds, cpu, used = [], [], [], samples
        for batch in range(batches):
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            row, used = run.batch(samples, seed + batch, sampler)
            rows.append(row)
            seconds.append(time.perf_counter() - wall_s)
            cpu.append(time.process_time() - cpu_s)
        answers.append((np.array(rows), np.array(seconds), np.array(cpu), used, variant))
    Path(out).write_bytes(pickle.dumps(answers))


def _sky(d: dict[str, Any], directions: FloatArray) -> FloatArray:
    scale, a, b, k, c, d_, e = d["sky"]
    cosine = np.clip(directions @ d["sun"], -1.0, 1.0)
    up = directions[..., 2]
    gradation = 1.0 + a * np.exp(b / np.maximum(up, 0.01))
    value = scale * gradation * (k + c * np.exp(d_ * np.arccos(cosine)) + e * cosine**2)
    return np.where(up > 0.0, np.maximum(value, 0.0), 0.0)


def _sky_image(d: dict[str, Any], rows: int = 1024) -> FloatArray:
    """Return the sky as a latitude-longitude image (rows, 2 rows + 1, 3) for `envmap`, whose up is +y.

    Rows are even, so the horizon lies between two of them: linear interpolation smears it by a fifth of a
    degree, the same amount up and down.
    """
    columns = 2 * rows if d["sky"][4] != 0.0 or d["sky"][6] != 0.0 else 4
    theta = np.arange(rows) / (rows - 1) * math.pi
    phi = np.arange(columns) / columns * 2.0 * math.pi
    t, p = np.meshgrid(theta, phi, indexing="ij")
    # The map's direction is (sin phi sin theta, cos theta, -cos phi sin theta); turned by 90 deg about x,
    # which takes +y to +z and +z to -y, it is (sin phi sin theta, cos phi sin theta, cos theta).
    directions = np.stack([np.sin(p) * np.sin(t), np.cos(p) * np.sin(t), np.cos(t)], axis=-1)
    return np.repeat(_sky(d, directions)[..., None], 3, axis=2).astype(np.float32)


def _sun_directions(d: dict[str, Any]) -> FloatArray:
    """Return directions (n, 3) towards points spread evenly over the disc (a spiral of equal areas)."""
    sun = np.asarray(d["sun"])
    if d["sun_diameter"] == 0.0:
        return sun[None, :]
    n = 16
    i = np.arange(n) + 0.5
    radius = np.tan(d["sun_diameter"] / 2.0) * np.sqrt(i / n)
    angle = i * math.pi * (3.0 - math.sqrt(5.0))
    side = np.cross(sun, [1.0, 0.0, 0.0] if abs(sun[0]) < 0.5 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(sun, side)
    found = sun + (radius * np.cos(angle))[:, None] * side + (radius * np.sin(angle))[:, None] * other
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])


def _load(mi: Any, d: dict[str, Any]) -> Any:
    """Return Mitsuba's scene: one mesh for each pair of material and sidedness."""
    scene: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": -1, "rr_depth": 5}}
    for number, row in enumerate(d["materials"]):
        for sided in (False, True):
            chosen = np.flatnonzero((d["material"] == number) & (d["two_sided"] == sided))
            if not len(chosen):
                continue
            bsdf: dict[str, Any]
            if row[1] > 0.0:
                bsdf = {"type": "published_lobe", "row": ",".join(repr(float(x)) for x in row)}
                bsdf["conserving"] = bool(d["conserving"])
            else:
                bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": float(row[0])}}
            if sided:
                bsdf = {"type": "twosided", "bsdf": bsdf}
            properties = mi.Properties()
            properties["bsdf"] = mi.load_dict(bsdf)
            mesh = mi.Mesh(f"mesh{number}{sided}", 3 * len(chosen), len(chosen), props=properties)
            parameters = mi.traverse(mesh)
            parameters["vertex_positions"] = d["corners"][chosen].astype(np.float32).ravel()
            parameters["faces"] = np.arange(3 * len(chosen), dtype=np.uint32)
            parameters.update()
            scene[f"mesh{number}{int(sided)}"] = mesh
    if d.get("constant_sky"):
        scene["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": float(d["sky"][0])}}
    elif d["sky"][0] > 0.0:
        turn = mi.ScalarTransform4f().rotate([1, 0, 0], 90.0)
        scene["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(_sky_image(d)), "to_world": turn}
    if d["dni"] > 0.0:
        towards = _sun_directions(d)
        for i, t in enumerate(towards):
            scene[f"sun{i}"] = {
                "type": "directional",
                "direction": [-float(x) for x in t],
                "irradiance": {"type": "rgb", "value": float(d["dni"]) / len(towards)},
                "sampling_weight": 1.0 / len(towards),
            }
    if not any(key.startswith(("sky", "sun")) for key in scene):
        scene["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": 0.0}}
    return mi.load_dict(scene)


class _Vectorised:
    """All paths of a batch at once, compiled by Dr.Jit."""

    def __init__(self, mi: Any, d: dict[str, Any]) -> None:
        import drjit as dr

        self.mi, self.dr, self.d = mi, dr, d
        _register_lobe(mi, dr)
        self.scene = _load(mi, d)
        self.sun = _sun_directions(d)
        self.sun_tables = [mi.Float(np.ascontiguousarray(self.sun[:, i], np.float32)) for i in range(3)]
        self.tables = {
            key: [mi.Float(np.ascontiguousarray(d[f"patch_{key}"][:, i], np.float32)) for i in range(3)]
            for key in ("origin", "u", "v", "normal")
        }
        self.folded = mi.Bool(np.ascontiguousarray(d["patch_triangle"]))
        self.first_sight = True

    def batch(self, samples: int, seed: int, kind: str) -> tuple[FloatArray, int]:
        mi, dr, d = self.mi, self.dr, self.d
        patches = len(d["patch_origin"])
        sampler = mi.load_dict({"type": kind, "sample_count": samples})
        samples = sampler.sample_count()
        count = patches * samples
        sampler.set_samples_per_wavefront(samples)
        sampler.seed(seed, count)
        patch = dr.arange(mi.UInt32, count) // samples

        def of(key: str) -> Any:
            return [dr.gather(mi.Float, table, patch) for table in self.tables[key]]

        at = sampler.next_2d()
        a, b = at.x, at.y
        over = dr.gather(mi.Bool, self.folded, patch) & (a + b > 1.0)
        a, b = dr.select(over, 1.0 - a, a), dr.select(over, 1.0 - b, b)
        normal = mi.Normal3f(*of("normal"))
        point = mi.Point3f(*of("origin")) + a * mi.Vector3f(*of("u")) + b * mi.Vector3f(*of("v"))
        point += normal * (1e-5 * d["extent"])
        away = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
        radiance, _, _ = self.scene.integrator().sample(
            self.scene, sampler, mi.RayDifferential3f(point, away)
        )
        irradiance = dr.pi * mi.luminance(radiance)
        if d["dni"] > 0.0:
            which = mi.UInt32(sampler.next_1d() * len(self.sun))
            towards = mi.Vector3f(*(dr.gather(mi.Float, t, which) for t in self.sun_tables))
            cosine = dr.dot(normal, towards)
            free = (cosine > 0.0) & ~self.scene.ray_test(mi.Ray3f(point, towards), cosine > 0.0)
            irradiance += dr.select(free, d["dni"] * cosine, 0.0)
        mean = dr.block_sum(irradiance, samples) / samples
        return np.array(mean, np.float64), samples


class _Scalar:
    """One path after the other, from Python: for machines without LLVM."""

    def __init__(self, mi: Any, d: dict[str, Any]) -> None:
        if np.any(d["materials"][:, 1] > 0.0):
            raise ValueError("the lobe needs the LLVM variant: a BSDF in Python is too slow path by path")
        self.mi, self.d = mi, d
        self.scene = _load(mi, d)
        self.sun = _sun_directions(d)

    def batch(self, samples: int, seed: int, kind: str) -> tuple[FloatArray, int]:
        mi, d = self.mi, self.d
        sampler = mi.load_dict({"type": kind, "sample_count": samples})
        samples = sampler.sample_count()
        integrator = self.scene.integrator()
        found = np.zeros(len(d["patch_origin"]))
        for i in range(len(found)):
            sampler.seed(seed * len(found) + i)
            origin, u, v, n = (d[f"patch_{key}"][i] for key in ("origin", "u", "v", "normal"))
            frame = mi.Frame3f(list(n))
            total = 0.0
            for _ in range(samples):
                at, w = sampler.next_2d(), sampler.next_2d()
                a, b = at.x, at.y
                if d["patch_triangle"][i] and a + b > 1.0:
                    a, b = 1.0 - a, 1.0 - b
                point = mi.Point3f(*(origin + a * u + b * v + n * (1e-5 * d["extent"])))
                away = frame.to_world(mi.warp.square_to_cosine_hemisphere(w))
                radiance, _, _ = integrator.sample(self.scene, sampler, mi.RayDifferential3f(point, away))
                total += math.pi * mi.luminance(radiance)
                if d["dni"] > 0.0:
                    towards = self.sun[int(sampler.next_1d() * len(self.sun))]
                    cosine = float(n @ towards)
                    if cosine > 0.0 and not self.scene.ray_test(mi.Ray3f(point, mi.Vector3f(*towards))):
                        total += d["dni"] * cosine
                sampler.advance()
            found[i] = total / samples
        return found, samples


def _register_lobe(mi: Any, dr: Any) -> None:
    """Give Mitsuba the published model as a BSDF, ``f cos = dsf(light side -> eye) cos(light) / cos(eye)``.

    The dsf is an intensity per incident power, so the BSDF is dsf / cos(theta_o) with theta_i where the light
    comes from: in Mitsuba that is `wo`, the direction a path from the eye goes on to.
    """

    class PublishedLobe(mi.BSDF):  # type: ignore[misc, name-defined]
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.row = [float(x) for x in props["row"].split(",")]
            self.conserving = bool(props["conserving"])
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags

        def coefficients(self, cosine: Any) -> Any:
            rho_d, rho_s, _, n2, constant = self.row
            k_s = mi.Float(rho_s)
            if not constant:
                c = dr.clip(cosine, 0.0, 1.0)
                q = dr.sqrt(n2 * n2 - 1.0 + c * c)
                s, p = (c - q) / (c + q), (n2 * n2 * c - q) / (n2 * n2 * c + q)
                k_s = rho_s * 0.5 * (s * s + p * p)
            k_d = mi.Float(rho_d)
            if self.conserving:
                k_s = dr.minimum(k_s, 1.0)
                k_d = dr.minimum(k_d, 1.0 - k_s)
            return k_d, k_s

        def density(self, wi: Any, wo: Any) -> Any:
            alpha = self.row[2]
            cosine = dr.dot(mi.reflect(wi), wo)
            power = dr.exp(alpha * dr.log(dr.clip(cosine, 1e-30, 1.0)))
            return dr.select(cosine > 0.0, (alpha + 1.0) / (2.0 * dr.pi) * power, 0.0)

        def value(self, wi: Any, wo: Any) -> Any:
            k_d, k_s = self.coefficients(wo.z)
            f = k_d / dr.pi * wo.z + k_s * self.density(wi, wo) * wo.z / wi.z
            return mi.Color3f(dr.select((wi.z > 0.0) & (wo.z > 0.0), f, 0.0))

        def both(self, wi: Any, wo: Any) -> Any:
            p = 0.5 * wo.z / dr.pi + 0.5 * self.density(wi, wo)
            return dr.select((wi.z > 0.0) & (wo.z > 0.0), p, 0.0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            e = dr.log(dr.maximum(sample2.x, 1e-30)) / (self.row[2] + 1.0)
            # sin^2 = 1 - exp(2 e), written so that a narrow lobe keeps its digits in float32
            half = dr.sinh(e)
            sine = dr.sqrt(dr.maximum(-2.0 * half * dr.exp(e), 0.0))
            phi = 2.0 * dr.pi * sample2.y
            local = mi.Vector3f(sine * dr.cos(phi), sine * dr.sin(phi), dr.exp(e))
            lobe = mi.Frame3f(mi.Normal3f(mi.reflect(si.wi))).to_world(local)
            wo = dr.select(sample1 < 0.5, mi.warp.square_to_cosine_hemisphere(sample2), lobe)
            pdf = self.both(si.wi, wo)
            active &= pdf > 0.0
            bs = mi.BSDFSample3f(wo)
            bs.pdf = pdf
            bs.eta = 1.0
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            bs.sampled_component = mi.UInt32(0)
            weight = dr.select(active, self.value(si.wi, wo) / pdf, 0.0)
            return bs, mi.Color3f(weight)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.value(si.wi, wo)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.both(si.wi, wo)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.value(si.wi, wo), self.both(si.wi, wo)

        def to_string(self) -> str:
            return f"PublishedLobe{self.row}"

    mi.register_bsdf("published_lobe", PublishedLobe)


if __name__ == "__main__":
    _worker(sys.argv[1], sys.argv[2])

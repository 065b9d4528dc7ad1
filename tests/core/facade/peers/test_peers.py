"""Do Mitsuba 3 and Radiance find the same irradiance in scenes that no one has chosen?"""

from __future__ import annotations

import importlib.util
import math

import numpy as np
import pytest
from scipy import stats

from gonio.facade import Irradiance, Scene, simulate

from . import mitsuba_peer, radiance_peer, scenes
from .description import describe, sky_radiance

pytestmark = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("mitsuba", "pyradiance")),
    reason="mitsuba and pyradiance are not installed; both are in the dev extra",
)

MATTE = (0, 1, 2, 3)
"""An endless street, one with ends, one with boxes, one with tilted modules and a mesh."""
BATCHES = 16


def flat(result: Irradiance) -> tuple[np.ndarray, np.ndarray]:
    """Return values and standard errors of all patches, receiver after receiver."""
    return (
        np.concatenate([r.value.ravel() for r in result.receivers]),
        np.concatenate([r.standard_error.ravel() for r in result.receivers]),
    )


def assert_agree(scene: Scene, peer: mitsuba_peer.Answer | radiance_peer.Answer, name: str) -> None:
    """Compare patch by patch: the worst difference, and their sum of squares.

    A peer's standard error comes from 16 batches, so a difference over its standard error is at worst
    Student's t with 15 degrees of freedom; a worse one than the limit comes up once in 2000 scenes.
    Patches share light, so the sum of squares counts a quarter of them as independent.
    """
    value, se = flat(simulate(scene, rel_tol=0.004, seed=11))
    assert value.shape == peer.value.shape
    floor = 1e-6 * (scene.dni_w_m2 + scene.dhi_w_m2)  # float32 of a peer, in the dark
    z = (value - peer.value) / np.sqrt(se**2 + peer.standard_error**2 + floor**2)
    n = z.size
    worst = float(stats.t.ppf(1.0 - 0.5 * 5e-4 / n, BATCHES - 1))
    assert np.max(np.abs(z)) < worst, f"{name}: {np.round(z, 1)}"
    t_variance = (BATCHES - 1) / (BATCHES - 3)
    assert np.mean(z**2) < t_variance * (1.0 + 4.0 * math.sqrt(2.0 / (n / 4.0))), f"{name}: {np.round(z, 1)}"
    relative = np.sqrt(np.mean((value - peer.value) ** 2)) / np.mean(value)
    assert relative < 0.02, f"{name}: {relative:.3f}"  # so that agreement within large errors does not count


@pytest.fixture(scope="module")
def mitsuba() -> dict[str, mitsuba_peer.Answer]:
    """Trace all scenes in one worker, which is most of the time of this module."""
    llvm = mitsuba_peer.find_llvm()
    named = [scenes.matte(seed) for seed in MATTE] + ([scenes.glossy(1)] if llvm else [])
    samples = 1024 if llvm else 128
    jobs = [
        mitsuba_peer.Job(mitsuba_peer.plain(describe(n.scene)), samples, BATCHES, 5, "multijitter")
        for n in named
    ]
    answers = mitsuba_peer.trace(jobs, llvm=llvm)
    return {n.name: a for n, a in zip(named, answers, strict=True)}


@pytest.mark.parametrize("seed", MATTE)
def test_mitsuba_in_random_matte_scenes(seed: int, mitsuba: dict[str, mitsuba_peer.Answer]) -> None:
    named = scenes.matte(seed)
    assert_agree(named.scene, mitsuba[named.name], named.name)


def test_mitsuba_with_the_published_lobe(mitsuba: dict[str, mitsuba_peer.Answer]) -> None:
    named = scenes.glossy(1)
    if named.name not in mitsuba:
        pytest.skip(
            "Mitsuba's scalar variant would call the lobe, a BSDF in Python, path by path: needs LLVM >= 17"
        )
    assert_agree(named.scene, mitsuba[named.name], named.name)
    specular = [r.mean_contributions["specular"].value for r in simulate(named.scene, rel_tol=0.05).receivers]
    assert max(float(x) for x in specular) > 1.0


@pytest.mark.parametrize("seed", [1, 4])
def test_radiance_in_random_matte_scenes(seed: int) -> None:
    named = scenes.matte(seed)
    options = ("-ab", "30", "-ad", "128", "-as", "0", "-aa", "0", "-lw", "2e-3", "-lr", "-30", "-u+")
    peer = radiance_peer.trace(describe(named.scene), points=4, batches=BATCHES, seed=3, options=options)
    assert_agree(named.scene, peer, named.name)


@pytest.mark.parametrize("seed", [0, 2, 4, 5, 9])
def test_the_sky_the_peers_are_given_makes_the_dhi(seed: int) -> None:
    scene = scenes.matte(seed).scene
    d = describe(scene)
    x, w = np.polynomial.legendre.leggauss(200)
    up = 0.5 * (x + 1.0)  # cosine of the zenith angle
    phi = (np.arange(400) + 0.5) / 400 * 2.0 * math.pi
    z, p = np.meshgrid(up, phi, indexing="ij")
    s = np.sqrt(1.0 - z**2)
    directions = np.stack([s * np.cos(p), s * np.sin(p), z], -1).reshape(-1, 3)
    radiance = sky_radiance(d.sky, d.sun, directions).reshape(z.shape)
    horizontal = np.sum(radiance * z * (0.5 * w)[:, None]) * 2.0 * math.pi / 400
    assert horizontal == pytest.approx(scene.dhi_w_m2, rel=2e-4)

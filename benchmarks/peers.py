"""Random scenes against Mitsuba 3 and Radiance: patch by patch, in standard errors.

    python benchmarks/peers.py [--matte 12] [--glossy 6] [--first 0] [--samples 2048] [--rel-tol 0.003]

For each scene and peer: number of patches, the worst difference and the root mean square of all differences
in combined standard errors (a peer's come from 16 batches: rms near 1.07 is what is expected), the root mean
square of the differences over the mean irradiance, and processor seconds of all threads (a peer's without
compilation).
"""

from __future__ import annotations

import argparse
import time

import _root  # noqa: F401
import numpy as np

from benchmarks._facade_cases import flat
from gonio.facade import simulate
from tests.core.facade.peers import mitsuba_peer, radiance_peer, scenes
from tests.core.facade.peers.description import describe

BATCHES = 16


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--matte", type=int, default=12)
    parser.add_argument("--glossy", type=int, default=6)
    parser.add_argument("--first", type=int, default=0, help="first seed of the scenes")
    parser.add_argument("--samples", type=int, default=2048, help="Mitsuba's paths per patch and batch")
    parser.add_argument("--rel-tol", type=float, default=0.003)
    chosen = parser.parse_args()
    llvm = mitsuba_peer.find_llvm()
    seeds = range(chosen.first, chosen.first + chosen.matte)
    named = [scenes.matte(seed) for seed in seeds]
    if llvm is None:
        print("no LLVM: Mitsuba runs its scalar variant, without the scenes that have a lobe")
    else:
        named += [scenes.glossy(seed) for seed in range(chosen.first, chosen.first + chosen.glossy)]
    print(
        f"{'scene':<66}{'patches':>8}{'peer':>10}{'worst z':>9}{'rms z':>7}{'rms %':>7}{'ours s':>8}"
        f"{'peer s':>8}"
    )
    over = total = 0
    for item in named:
        d = describe(item.scene)
        cpu_s = time.process_time()
        value, se = flat(simulate(item.scene, rel_tol=chosen.rel_tol, seed=1))
        cpu_s = time.process_time() - cpu_s
        job = mitsuba_peer.Job(mitsuba_peer.plain(d), chosen.samples, BATCHES, 7, "multijitter")
        answers = [("Mitsuba", mitsuba_peer.trace([job], llvm=llvm)[0])]
        if not np.any(d.materials[:, 1] > 0.0):
            answers.append(("Radiance", radiance_peer.trace(d, points=16, batches=BATCHES, seed=7)))
        for peer, a in answers:
            floor = 1e-6 * (item.scene.dni_w_m2 + item.scene.dhi_w_m2)
            z = (value - a.value) / np.sqrt(se**2 + a.standard_error**2 + floor**2)
            relative = float(np.sqrt(np.mean((value - a.value) ** 2)) / value.mean())
            over, total = over + int(np.sum(np.abs(z) > 3.0)), total + z.size
            theirs_s = float(np.median(a.cpu_seconds)) * len(a.cpu_seconds)
            print(
                f"{item.name:<66}{len(z):>8}{peer:>10}{np.max(np.abs(z)):>9.2f}{np.sqrt(np.mean(z**2)):>7.2f}"
                f"{100 * relative:>7.2f}{cpu_s:>8.2f}{theirs_s:>8.2f}",
                flush=True,
            )
    print(f"{over} of {total} differences are above 3 standard errors ({100 * over / max(total, 1):.2f} %; ")
    print("Student's t of 15 degrees of freedom has 0.90 %, a normal distribution 0.27 %)")


if __name__ == "__main__":
    main()

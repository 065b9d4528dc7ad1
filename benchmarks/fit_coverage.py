"""Do 95 % intervals cover 95 %?  Simulated scans over a range of truths and noise levels.

    python benchmarks/fit_coverage.py [--scans 2000]

Readings come from a quadrature over the plane of the aperture, not from the fit's integral.  Each scan has
its own reading noise (floor, shot, proportional), a baseline error per polarization and one dark error.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from gonio.aperture import Aperture
from gonio.brdf import PublishedLobe
from gonio.fitting import fit_readings

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "core" / "fit"))

from simulated_readings import instrument_noise, paper_positions, plane_quadrature

TRUTHS = (
    (0.72, 1.0, 90.0, 1.5),
    (0.72, 1.0, 10.0, 1.5),
    (0.30, 0.2, 50.0, 1.3),
    (0.50, 2.0, 300.0, 1.8),
    (0.72, 1.0, 2000.0, 1.4),
)
LEVELS = (0.2, 1.0, 10.0)  # of a noise of about 0.5 %


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--scans", type=int, default=2000)
    m = options.parse_args().scans
    aperture, at = Aperture(26.0, 18.0, 95.2353), paper_positions()
    gain, offset = 1e-3, 1e-5
    print(f"{m} scans each; one standard deviation of a coverage is {100 * np.sqrt(0.95 * 0.05 / m):.2f} %")
    print("  rho_d  rho_s  alpha     n2  noise | coverage in %:  rho_d  rho_s  alpha     n2    k_g | bias/se")
    rng = np.random.default_rng(2022)
    for truth in TRUTHS:
        r = plane_quadrature(at, *truth, aperture, panels=6 if truth[2] < 300 else 12)
        k_g = float(PublishedLobe(*truth).directional_albedo(8.0, "unpolarized"))
        for level in LEVELS:
            y = r[:, None] + level * instrument_noise(r)[:, None] * rng.standard_normal((r.size, m))
            for which in ("s", "p"):
                y[at.polarization == which] *= 1.0 + gain * rng.standard_normal(m)
            y += offset * rng.standard_normal(m)
            fit = fit_readings(
                at.theta_i_deg, at.theta_o_deg, at.polarization, y,
                instrument=aperture, gain_u=gain, offset_u=offset,
            )  # fmt: skip
            covered = np.mean((fit.lower <= truth) & (truth <= fit.upper), axis=0)
            ends = fit.hemispherical(8.0).k_g
            all_covered = [*covered, np.mean((ends.lower <= k_g) & (k_g <= ends.upper))]
            bias = np.nanmean((fit.value - truth) / fit.se, axis=0)
            print(
                "".join(f"{x:>7g}" for x in truth)
                + f"{0.5 * level:>6.1f} % |              "
                + "".join(f"{100 * c:>7.1f}" for c in all_covered)
                + f" | {bias[np.argmax(np.abs(bias))]:+.2f}"
            )


if __name__ == "__main__":
    main()

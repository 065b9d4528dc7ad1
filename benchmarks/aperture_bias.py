"""What each aperture model makes of the same lobe: bias against alpha, as a table and as a figure.

    python benchmarks/aperture_bias.py [--scans 200] [--figure docs/images/aperture-bias.png]

rho_d 0.72, rho_s 1, n2 1.5, the paper's 146 positions in S and in P, 26 x 18 mm at 95.2353 mm, 0.5 % noise.
Readings come from the simulated bench's two-dimensional quadrature; every model fits the same scans, without
weights (as PHYSICS.md's table was made) and with the true ones.  A bias is the mean over the scans, of alpha
the median, with its standard error.  `--figure` writes .png or .svg; "-" in a table: no lobe was seen.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import _one_core
import numpy as np
from _fit_scans import ARTA, COEFFICIENTS, PARAMETERS, Simulator, coefficients, paper_positions
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from gonio.aperture import ApertureName
from gonio.fitting import fit_readings
from gonio.report.style import BLACK, BLUE, ORANGE, PURPLE, new_figure, place, png_bytes, styled, svg_bytes

FloatArray = NDArray[np.float64]

TRUTH = {"rho_d": 0.72, "rho_s": 1.0, "n2": 1.5}
NOISE = 0.005
VARIANTS: tuple[ApertureName, ...] = ("point", "published", "eq22", "exact")
PHYSICS = {  # k_s(8) as PHYSICS.md prints it, of one scan each, with 0.0516 sr for point and Eq 22
    30.0: (0.0410, 0.0286, 0.0376, 0.0398),
    100.0: (0.0453, 0.0301, 0.0344, 0.0401),
    300.0: (0.0517, 0.0439, 0.0270, 0.0398),
    1000.0: (0.0552, 0.0528, 0.0167, 0.0400),
}
QUANTITIES = (*PARAMETERS, *COEFFICIENTS)
LABELS = {
    "point": "point (Eq 18)",
    "published": "Eq 22, ±13°, 0.0516 sr",
    "eq22": "Eq 22, ±7.77°, 0.0509 sr",
    "exact": "exact",
}
LOOKS = {  # colour, marker, dashes: told apart in grey too; the number of the first marker, so that none hide
    "point": (PURPLE, "^", (0, (1, 1.2)), 0),
    "published": (ORANGE, "s", (0, (5, 1.5)), 2),
    "eq22": (BLUE, "D", (0, (4, 1.2, 1, 1.2)), 1),
    "exact": (BLACK, "o", "-", 0),
}


def estimates(simulator: Simulator, alpha: float, scans: int, weights: str) -> dict[str, FloatArray]:
    """Return the fitted `QUANTITIES` of every variant, (scans, 7) each."""
    at = simulator.at
    r = simulator.readings(TRUTH["rho_d"], TRUTH["rho_s"], alpha, TRUTH["n2"])[:, None]
    rng = np.random.default_rng(round(1000.0 * np.log(alpha)))
    y = r * (1.0 + NOISE * rng.standard_normal((r.size, scans)))
    found = {}
    for name in VARIANTS:
        fit = fit_readings(
            *at.arguments(), y, instrument=ARTA, aperture=name,
            r_sd=NOISE * r, weights="none" if weights == "none" else "r_sd",
        )  # fmt: skip
        k = fit.hemispherical(8.0)
        found[name] = np.column_stack([fit.value, k.k_d.value, k.k_s.value, k.k_g.value])
    return found


def middle(values: FloatArray, median: bool) -> tuple[float, float]:
    """Return the mean of the finite values, or their median, and its standard error."""
    values = np.sort(values[np.isfinite(values)])
    n = values.size
    if n < 5:
        return np.nan, np.nan
    if not median:
        return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(n))
    low, high = round(n / 2 - np.sqrt(n) / 2), round(n / 2 + np.sqrt(n) / 2)
    return float(np.median(values)), float(0.5 * (values[min(high, n - 1)] - values[max(low, 0)]))


def truth_at(alpha: float) -> FloatArray:
    values = (TRUTH["rho_d"], TRUTH["rho_s"], alpha, TRUTH["n2"])
    return np.array([*values, *coefficients(*values)])


def physics_table(simulator: Simulator, scans: int) -> None:
    """Print k_s(8) beside PHYSICS.md's: one scan with its own noise there, the mean here."""
    print(f"k_s(8), truth 0.0400, without weights: mean of {scans} scans; in brackets what PHYSICS.md says")
    print("(its point and Eq 22 columns with 0.0516 sr: ours are scaled to that here)")
    print(f"{'alpha':>7}" + "".join(f"{name:>28}" for name in VARIANTS))
    at = QUANTITIES.index("k_s")
    worst = 0.0
    for alpha, printed in PHYSICS.items():
        found = estimates(simulator, alpha, scans, "none")
        line = f"{alpha:>7g}"
        for name, expected in zip(VARIANTS, printed, strict=True):
            scale = ARTA.solid_angle_sr / 0.0516 if name in ("point", "eq22") else 1.0
            values = scale * found[name][:, at]
            k_s, se = middle(values, median=False)
            worst = max(worst, abs(k_s - expected) / float(np.hypot(np.std(values), 5e-5)))
            line += f"{f'{k_s:.5f} ± {se:.5f} ({expected:.4f})':>28}"
        print(line)
    print(f"largest difference: {worst:.1f} standard deviations of one scan and of the printed digits\n")


def sweep(simulator: Simulator, alphas: FloatArray, scans: int, weights: str) -> dict[str, FloatArray]:
    """Return middle and standard error over the truth, (n_alpha, 7, 2), by variant."""
    result = {name: np.empty((alphas.size, len(QUANTITIES), 2)) for name in VARIANTS}
    for row, alpha in enumerate(alphas.tolist()):
        found = estimates(simulator, alpha, scans, weights)
        for name in VARIANTS:
            for column, true in enumerate(truth_at(alpha).tolist()):
                ratio = found[name][:, column] / true
                result[name][row, column] = middle(ratio, QUANTITIES[column] == "alpha")
    return result


def print_sweep(alphas: FloatArray, result: dict[str, FloatArray], title: str) -> None:
    print(f"bias in % of the truth, {title}")
    for quantity in ("k_s", "k_d", "k_g", "n2", "alpha"):
        column = QUANTITIES.index(quantity)
        print(f"{quantity:>7}" + "".join(f"{name:>20}" for name in VARIANTS))
        for row, alpha in enumerate(alphas.tolist()):
            cells = [
                f"{100.0 * (value - 1.0):+.2f} ± {100.0 * se:.2f}" if np.isfinite(value) else "-"
                for value, se in (result[name][row, column].tolist() for name in VARIANTS)
            ]
            print(f"{alpha:>7.0f}" + "".join(f"{cell:>20}" for cell in cells))
    print()


def figure_of(alphas: FloatArray, result: dict[str, FloatArray]) -> Figure:
    figure = new_figure(7.2, 5.4)
    panels = figure.subplots(2, 2, sharex=True)
    shown = (
        ("k_s", "specular coefficient k_s(8°)"), ("rho_d", "diffuse coefficient rho_d"),
        ("n2", "refractive index n2"), ("alpha", "lobe exponent alpha"),
    )  # fmt: skip
    for axes, (quantity, title) in zip(panels.flat, shown, strict=True):
        column = QUANTITIES.index(quantity)
        for name in VARIANTS:
            colour, marker, dashes, first = LOOKS[name]
            value, se = result[name][:, column].T
            if quantity != "alpha":
                value, se = 100.0 * (value - 1.0), 100.0 * se
            axes.fill_between(alphas, value - se, value + se, color=colour, alpha=0.25, linewidth=0.0)
            axes.plot(
                alphas, value, color=colour, marker=marker, linestyle=dashes, label=LABELS[name],
                markevery=(first, 3), markersize=4.0, zorder=2.4 if name == "exact" else 2.5,
            )  # fmt: skip
        axes.set_xscale("log")
        axes.set_title(title, loc="left")
        if quantity == "alpha":
            axes.set_yscale("log")
            axes.set_ylabel("fitted / true")
            axes.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        else:
            axes.set_ylabel("bias / %")
    for axes in panels[1]:
        axes.set_xlabel("true alpha")
    place(figure, left_in=0.72, right_in=0.15, bottom_in=0.5, top_in=0.62, gap_x_in=0.75, gap_y_in=0.42)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=4, bbox_to_anchor=(0.5, 1.0))
    return figure


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--scans", type=int, default=200)
    options.add_argument("--steps", type=int, default=31, help="exponents from 10 to 10 000")
    options.add_argument("--figure", type=Path, help="write this .png or .svg")
    chosen = options.parse_args()
    simulator = Simulator(paper_positions())
    physics_table(simulator, chosen.scans)
    alphas = np.geomspace(10.0, 1e4, chosen.steps)
    simulator.prepare(alphas)
    unweighted = sweep(simulator, alphas, chosen.scans, "none")
    every = slice(None, None, max(1, (chosen.steps - 1) // 10))
    weighted = sweep(simulator, alphas[every], chosen.scans, "true")
    print_sweep(alphas[every], {name: x[every] for name, x in unweighted.items()}, "without weights")
    print_sweep(alphas[every], weighted, "with the true weights")
    print(_one_core.machine())
    if chosen.figure is not None:
        with styled():
            drawn = figure_of(alphas, unweighted)
            svg = chosen.figure.suffix == ".svg"
            chosen.figure.write_bytes(svg_bytes(drawn) if svg else png_bytes(drawn))


if __name__ == "__main__":
    main()

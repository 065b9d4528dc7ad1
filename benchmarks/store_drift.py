"""Does the stated uncertainty of the baseline cover a lamp that drifts?

A lamp follows a line, a curve, a ramp in the middle, a step of 2 % at a random time, a random walk, or an
Ornstein-Uhlenbeck process that forgets within the stated part of the time between two references, together
with the references' own scatter.  For 2 to 17 references the table shows how many readings lie within twice
the stated uncertainty (95 % wanted), the largest error in units of it, and the median uncertainty.

A walk seen by two references only is not covered: one change tells its rate too poorly.  Plan more.

Run: python benchmarks/store_drift.py [--scans N] [--seed S]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gonio.store.records import ReferenceRecord
from gonio.store.reduction import Reduction

FloatArray = NDArray[np.float64]
Lamp = Callable[[np.random.Generator, FloatArray], FloatArray]

DURATION_S = 10_000.0
M = 40  # wavelengths of one detector
SCATTER = 2e-4  # relative, of one reading of the direct beam
AVERAGES = 4
SIZE = 0.02  # of a drift over the whole scan, relative
N_REFERENCES = (2, 3, 5, 9, 17)


def line(rng: np.random.Generator, t_s: FloatArray) -> FloatArray:
    return SIZE * rng.uniform(-1.0, 1.0) * t_s / DURATION_S


def curve(rng: np.random.Generator, t_s: FloatArray) -> FloatArray:
    """Warming up: most of the change at the beginning, or at the end."""
    x = t_s / DURATION_S
    steepness = rng.uniform(1.0, 8.0)
    rise = np.expm1(-steepness * x) / np.expm1(-steepness)
    return SIZE * np.asarray(rise if rng.random() < 0.5 else 1.0 - np.interp(1.0 - x, x, rise))


def ramp(rng: np.random.Generator, t_s: FloatArray) -> FloatArray:
    start, length = rng.uniform(0.0, 1.0), rng.uniform(0.02, 0.3)
    return SIZE * np.clip((t_s / DURATION_S - start) / length, 0.0, 1.0)


def step(rng: np.random.Generator, t_s: FloatArray) -> FloatArray:
    return np.where(t_s > rng.uniform(0.0, DURATION_S), SIZE, 0.0)


def walk(rng: np.random.Generator, t_s: FloatArray) -> FloatArray:
    pieces = rng.standard_normal(len(t_s)) * SIZE * np.sqrt(np.diff(t_s, prepend=0.0) / DURATION_S)
    return np.asarray(np.cumsum(pieces))


def ornstein_uhlenbeck(part: float) -> Lamp:
    """Return a process of standard deviation 0.5 % that forgets within a part of the references' distance."""

    def lamp(rng: np.random.Generator, t_s: FloatArray, n_references: int = 2) -> FloatArray:
        keep = np.exp(-np.diff(t_s) / (part * DURATION_S / (n_references - 1)))
        kicks = rng.standard_normal(len(t_s))
        values = np.empty(len(t_s))
        values[0] = kicks[0]
        for i in range(1, len(t_s)):
            values[i] = keep[i - 1] * values[i - 1] + np.sqrt(1.0 - keep[i - 1] ** 2) * kicks[i]
        return 0.005 * values

    return lamp


LAMPS: dict[str, Lamp] = {
    "line": line,
    "curve": curve,
    "ramp": ramp,
    "step": step,
    "random walk": walk,
    "O-U, 3 x": ornstein_uhlenbeck(3.0),
    "O-U, 1 x": ornstein_uhlenbeck(1.0),
    "O-U, 0.1 x": ornstein_uhlenbeck(0.1),
}


def errors(lamp: Lamp, n_references: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return the errors of the baseline of one scan and their stated uncertainties, relative, (n, m)."""
    t_s = np.linspace(0.0, DURATION_S, 16 * (n_references - 1) + 1)
    power = 1.0 + (
        lamp(rng, t_s, n_references) if lamp.__name__ == "lamp" else lamp(rng, t_s)  # type: ignore[call-arg]
    )
    colour = np.linspace(1.0, 2.0, M)
    references = [_reference("dark", 0.0, np.zeros((AVERAGES, M)))]
    for i in range(0, len(t_s), 16):
        readings = power[i] * colour * (1.0 + SCATTER * rng.standard_normal((AVERAGES, M)))
        references.append(_reference("baseline", t_s[i], readings))
    at = np.setdiff1d(np.arange(len(t_s)), np.arange(0, len(t_s), 16))
    time_s = np.repeat(t_s[at, None], M, axis=1)
    blank = np.full(time_s.shape, np.nan)
    reduction = Reduction(references, np.zeros(M, dtype=np.uint8))
    found = reduction.apply(np.ones(time_s.shape), blank, np.ones(len(at), int), time_s, ["s"] * len(at))
    true = power[at, None] * colour
    return (found.baseline_v - true) / found.baseline_v, found.gain_u


def _reference(kind: str, t_s: float, readings: FloatArray) -> ReferenceRecord:
    return ReferenceRecord(
        kind=kind,  # type: ignore[arg-type]
        when="",
        polarization="any" if kind == "dark" else "s",
        theta_i_deg=90.0,
        theta_mes_deg=180.0,
        averages=AVERAGES,
        unix_s=0.0,
        wavelength_nm=np.linspace(400.0, 800.0, M),
        signal_v=readings.mean(axis=0),
        signal_sd_v=readings.std(axis=0, ddof=1),
        time_s=np.full(M, t_s),
        quality=np.zeros(M, dtype=np.uint16),
    )


def coverage(lamp: Lamp, n_references: int, scans: int, seed: int) -> tuple[float, float, float]:
    """Return the part of the readings within 2 u, the largest error over u, and the median u."""
    rng = np.random.default_rng(seed)
    ratios, stated = [], []
    for _ in range(scans):
        error, u = errors(lamp, n_references, rng)
        ratios.append(np.abs(error) / u)
        stated.append(np.median(u))
    ratio = np.concatenate(ratios)
    return float(np.mean(ratio <= 2.0)), float(ratio.max()), float(np.median(stated))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scans", type=int, default=400, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    options = parser.parse_args()
    print(f"{'lamp':<14}" + "".join(f"{f'{k} references':>26}" for k in N_REFERENCES))
    print(f"{'':<14}" + f"{'in 2 u':>10}{'worst':>7}{'u':>9}" * len(N_REFERENCES))
    for name, lamp in LAMPS.items():
        cells = ""
        for n_references in N_REFERENCES:
            within, worst, u = coverage(lamp, n_references, options.scans, options.seed)
            cells += f"{100 * within:9.1f}%{min(worst, 999):7.2f}{100 * u:8.3f}%"
        print(f"{name:<14}{cells}", flush=True)


if __name__ == "__main__":
    main()

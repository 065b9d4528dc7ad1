"""Speed and error of the aperture integral and of the instrument function, beside plain quadratures.

    python benchmarks/aperture.py

Aperture: error is the largest relative difference from 30-digit values over random lobes that the aperture
sees; time is per integral, for arrays.

Beam: the paper's 146 positions at 144 exponents, what a fit tabulates.  Error is the largest difference from
the converged values over the largest value at that exponent; the peers sum the exact aperture over points of
the spot (Gauss-Legendre), as one does who has no instrument function.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import mpmath as mp
import numpy as np

from gonio.aperture import Aperture, IncidentBeam, InstrumentFunction

ARTA = Aperture(26.0, 18.0, 95.2353)


def exact(alpha: float, delta_deg: float) -> float:
    """Gauss-Legendre panels around the lobe in both angles, 30 digits."""
    mp.mp.dps = 30
    a, d = mp.mpf(alpha), mp.radians(mp.mpf(delta_deg))
    half = mp.atan(mp.mpf(13) / mp.mpf(95.2353))
    width = 1 / mp.sqrt(a + 1)
    nearest = min(max(d, -half), half)
    low, high = max(-half, nearest - 14 * width), min(half, nearest + 14 * width)

    def across(t: mp.mpf) -> mp.mpf:
        top = min(mp.atan(mp.mpf(9) / mp.mpf(95.2353) * mp.cos(t)), 14 * width)
        points = [mp.mpf(0), *[k * width for k in (2, 5, 9) if k * width < top], top]
        return 2 * mp.quad(lambda psi: mp.cos(psi) ** (a + 1), points, method="gauss-legendre", maxdegree=4)

    points = [low, *[c for c in (d + k * width for k in (-9, -5, -2, 0, 2, 5, 9)) if low < c < high], high]
    value = mp.quad(lambda t: mp.cos(t - d) ** a * across(t), points, method="gauss-legendre", maxdegree=4)
    return float((a + 1) / (2 * mp.pi) * value)


def plane_rule(nodes: int) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A fixed Gauss-Legendre product rule over the plane of the aperture."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    u, v = np.meshgrid(13.0 * x, 9.0 * x, indexing="ij")
    length = np.sqrt(u**2 + v**2 + ARTA.distance_mm**2)
    omega = 117.0 * np.outer(w, w) * ARTA.distance_mm / length**3

    def integral(alpha: np.ndarray, delta_deg: np.ndarray) -> np.ndarray:
        result = np.empty(alpha.size)
        for k, (a, d) in enumerate(zip(alpha, np.deg2rad(delta_deg), strict=True)):
            cosine = np.clip((u * np.sin(d) + ARTA.distance_mm * np.cos(d)) / length, 0.0, None)
            result[k] = np.sum(omega * cosine**a) * (a + 1.0) / (2.0 * np.pi)
        return result

    return integral


def shifted(beam: IncidentBeam, count: int) -> Callable[..., np.ndarray]:
    """The aperture summed over points along the spot: moved and turned as each of them sees it."""
    nodes, weights = np.polynomial.legendre.leggauss(count)

    def table(alpha: np.ndarray, theta_i: np.ndarray, theta_o: np.ndarray) -> np.ndarray:
        total = np.zeros((alpha.size, theta_i.size))
        for node, weight in zip(nodes, weights, strict=True):
            for k, (i, o) in enumerate(zip(theta_i, theta_o, strict=True)):
                x = node * float(beam.half_length_mm(i))
                # the rectangle from x: nearer by x sin(theta_o), its centre x cos(theta_o) to the side
                far = ARTA.distance_mm - x * np.sin(np.deg2rad(o))
                sides = np.arctan((np.array([-13.0, 13.0]) - x * np.cos(np.deg2rad(o))) / far)
                turn = float(np.rad2deg(np.mean(sides)))
                half = 0.5 * float(sides[1] - sides[0])
                seen = Aperture(2.0 * far * np.tan(half), ARTA.height_mm, far)
                row = seen.lobe_table(alpha, np.array([i - o - turn]), np.array([o + turn]))
                total[:, k] += 0.5 * weight * row[:, 0]
        return total

    return table


def beams() -> None:
    """Tabulate the lobe through a beam."""
    starts, counts = (20.0, 30.0, 45.0, 55.0), (31, 34, 38, 43)
    theta_i = np.repeat(starts, counts)
    theta_o = np.concatenate([15.0 + 3.0 * np.arange(n) - i for i, n in zip(starts, counts, strict=True)])
    alpha = np.geomspace(0.1, 1e6, 144)
    start = time.perf_counter()
    ARTA.lobe_table(alpha, theta_i - theta_o, theta_o)
    print(f"\n{'beam':<24}{'method':<18}{'s per table':>12}{'error':>10}")
    print(f"{'a line':<24}{'gonio':<18}{time.perf_counter() - start:>12.3f}")
    for beam, peers in (
        (IncidentBeam(1.0, 0.0), (3, 8, 24)),
        (IncidentBeam(1.0, 1.0), ()),
        (IncidentBeam(0.0, 0.0, 1.0), ()),
        (IncidentBeam(1.0, 1.0, 1.0), ()),
    ):
        name = f"{beam.width_mm:g} x {beam.height_mm:g} mm, {beam.divergence_deg:g} deg"
        instrument = InstrumentFunction(ARTA, beam)
        start = time.perf_counter()
        table = instrument.lobe_table(alpha, theta_i - theta_o, theta_o, theta_i)
        seconds = time.perf_counter() - start
        few = slice(0, None, 24)
        single = instrument.lobe_integral(alpha[few, None], theta_i - theta_o, theta_o, theta_i)
        size = np.max(single, axis=1, keepdims=True)
        print(f"{name:<24}{'gonio':<18}{seconds:>12.3f}{np.max(np.abs(table[few] - single) / size):>10.1e}")
        for count in peers:
            start = time.perf_counter()
            plain = shifted(beam, count)(alpha, theta_i, theta_o)
            seconds = time.perf_counter() - start
            size = np.max(table, axis=1, keepdims=True)
            error = np.max(np.abs(plain - table) / size)
            print(f"{name:<24}{f'{count} points':<18}{seconds:>12.3f}{error:>10.1e}")


def main() -> None:
    rng = np.random.default_rng(1)
    print("                        alpha    us per integral    largest relative error")
    for low, high in ((0.0, 10.0), (10.0, 1e3), (1e3, 1e5), (1e5, 1e8)):
        alpha = np.exp(rng.uniform(np.log(low + 0.01), np.log(high), 10))
        delta = rng.uniform(-1.0, 1.0, 10) * (7.7 + np.minimum(60.0, 150.0 / np.sqrt(alpha + 1.0)))
        expected = np.array([exact(a, d) for a, d in zip(alpha, delta, strict=True)])
        methods = {
            "gonio": lambda a, d: ARTA.lobe_integral(a, d),
            "16 x 16": plane_rule(16),
            "64 x 64": plane_rule(64),
        }
        for name, method in methods.items():
            many = (
                np.tile(alpha, 200 if name == "gonio" else 20),
                np.tile(delta, 200 if name == "gonio" else 20),
            )
            method(alpha, delta)
            start = time.perf_counter()
            method(*many)
            each_us = 1e6 * (time.perf_counter() - start) / many[0].size
            error = np.max(np.abs(method(alpha, delta) / expected - 1.0))
            print(f"{name:<10}{low:>9g} ...{high:>8g}{each_us:>15.1f}{error:>22.1e}")
    beams()


if __name__ == "__main__":
    main()

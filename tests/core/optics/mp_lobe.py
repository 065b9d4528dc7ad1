"""The lobe integral in 30 digits, for the tests of the aperture: a series in one angle, sums in the other."""

from __future__ import annotations

import itertools

import mpmath as mp

from gonio.aperture import Aperture

_DIGITS = 30
_DARK = 80  # exp(-90) of the largest value is nothing


def _incomplete_beta(b: mp.mpf, x: mp.mpf) -> mp.mpf:
    """Return ``∫_0^x s^(-1/2) (1 - s)^(b - 1) ds`` by its series of positive terms (DLMF 8.17.8)."""
    term = total = mp.mpf(1)
    n = 0
    while term > total * mp.mpf(10) ** -_DIGITS:
        term *= x * (b + mp.mpf(1) / 2 + n) / (mp.mpf(3) / 2 + n)
        total += term
        n += 1
    return 2 * mp.sqrt(x) * mp.exp(b * mp.log1p(-x)) * total


def lobe_integral_mp(
    aperture: Aperture, alpha: float | mp.mpf, delta_deg: float, theta_o_deg: float | None = None
) -> mp.mpf:
    """Return ∫ (alpha + 1)/(2 pi) cos_+(theta_s)^alpha dOmega above the horizon."""
    with mp.workdps(_DIGITS):
        a, delta, far = mp.mpf(alpha), mp.radians(mp.mpf(delta_deg)), mp.mpf(aperture.distance_mm)
        half = mp.atan(mp.mpf(aperture.width_mm) / (2 * far))
        low, high = max(-half, delta - mp.pi / 2), min(half, delta + mp.pi / 2)
        if theta_o_deg is not None:
            out = mp.radians(mp.mpf(theta_o_deg))
            low, high = max(low, -mp.pi / 2 - out), min(high, mp.pi / 2 - out)
        if high <= low:
            return mp.mpf(0)
        width, ratio = 1 / mp.sqrt(a + 1), mp.mpf(aperture.height_mm) / (2 * far)

        b = (a + 2) / 2
        whole = mp.beta(mp.mpf(1) / 2, b)

        def across(t: mp.mpf) -> mp.mpf:
            square = (ratio * mp.cos(t)) ** 2
            x = square / (1 + square)
            return _incomplete_beta(b, x) if b * x < _DARK else whole

        def log_lobe(t: mp.mpf) -> mp.mpf:
            cosine = mp.cos(t - delta)
            return a * mp.log(cosine) if cosine > 0 else mp.mpf("-1e9") * (a > 0)

        nearest = min(max(delta, low), high)
        slope = a * abs(mp.tan(nearest - delta))
        scale = min(width, 1 / slope) if slope > 0 else width
        cuts = [
            point
            for k in (0.5, 1, 2, 3, 4.5, 6, 8, 11, 15, 20, 28, 38, 50, 70)
            for side in (-1, 1)
            for point in (nearest + side * k * scale, delta + side * k * width * mp.mpf("0.7"))
            if low < point < high
        ]
        wide = a < 100  # then a few pieces do, and tanh-sinh takes the rim of cos_+^a in its stride
        edges = mp.linspace(low, high, 4) if wide else [low, *sorted(cuts), high]
        largest, total = log_lobe(nearest), mp.mpf(0)  # mpmath's tolerance is absolute: integrate ratios
        for first, last in itertools.pairwise(edges):
            if log_lobe(min(max(nearest, first), last)) < largest - _DARK:
                continue
            total += mp.quad(
                lambda t: mp.exp(log_lobe(t) - largest) * across(t),
                [first, last],
                method="tanh-sinh" if wide else "gauss-legendre",
                maxdegree=6 if wide else 4,
            )
        return mp.re((a + 1) / (2 * mp.pi) * mp.exp(largest) * total)

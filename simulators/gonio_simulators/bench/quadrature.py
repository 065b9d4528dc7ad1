"""Power into the aperture from points of the sample, by direct two-dimensional quadrature.

The integrand is the differential scattering function with the full angle to the mirror direction in three
dimensions; what lies behind the sample's plane gets nothing (`gonio_simulators.bench.view` has the geometry).
The closed form that the fit uses appears nowhere here.

Nodes follow the lobe: the domain is first cut to where the lobe exceeds exp(-45) of its largest value in the
aperture, then divided into Gauss-Legendre panels of at most six lobe widths ``1/sqrt(alpha + 1)``, in the
angles ``gamma = atan(s)`` and ``kappa = atan(t)``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gonio_simulators.bench.view import View, cut_by_cone, largest_cosine, rim_crossings, rim_near

FloatArray = NDArray[np.float64]

NODES = 16
PANEL_RAD = 0.5
PANEL_LOBE_WIDTHS = 6.0
NEGLIGIBLE = 45.0  # exp(-45) = 3e-20
EDGE_POWER = 6
"""Nodes near the rim of the lobe follow ``x = y**EDGE_POWER``: cos_+^alpha is not smooth there."""

SMOOTH_RIM_ALPHA = 30.0
"""From this exponent on the rim carries nothing."""

SHARED_NODES = 3.0
"""Ratio of alpha + 1 up to which exponents share their nodes."""

DARK = 120.0
"""Where the lobe is below exp(-120) = 1e-52 all over the aperture, it is taken as nothing."""

MOST_VALUES = 200_000
"""Views are integrated together up to this many nodes, which then still fit a processor's cache."""


_Side = tuple[float, float]
_Member = tuple[float, View, tuple[_Side, _Side]]  # weight, view, and its domain in gamma and kappa


def diffuse_power(views: Sequence[tuple[float, View]]) -> float:
    """Return the weighted sum over views of the integral of cos(theta)/pi: what rho_d = 1 sends in.

    Parameters
    ----------
    views
        Weight and view of each point of the sample.
    """
    total = 0.0
    for batch, counts in _batches([(w, v, _whole(v)) for w, v in views], PANEL_RAD):
        weights, gamma, w_gamma, kappa, w_kappa = _nodes(batch, counts)
        s, t = np.tan(gamma), np.tan(kappa)
        one_s, one_t = 1.0 + s * s, 1.0 + t * t
        length2 = one_s + t * t
        cos_u, cos_a = _columns([(seen.cos_u, seen.cos_a) for _, seen, _ in batch])
        # one more length than the solid angle's three halves, from cos(theta) = p_z / |p|
        inner = (cos_a + cos_u * s) * (weights * one_s * w_gamma) / (length2 * length2)
        total += float(np.sum(inner * (one_t * w_kappa)))
    return total / math.pi


def lobe_power(seen: View, alpha: float) -> float:
    """Return the integral of (alpha + 1)/(2 pi) cos_+(theta_s)^alpha over the aperture.

    Parameters
    ----------
    seen
        The aperture from one point of the sample.
    alpha
        Exponent of the lobe, 0...1e8; relative error below 1e-10 for values above 1e-30.
    """
    return float(lobe_powers([(1.0, seen)], np.array([alpha]))[0])


def lobe_powers(views: Sequence[tuple[float, View]], alphas: FloatArray) -> FloatArray:
    """Return the weighted sum of `lobe_power` over views (weight, view) for each exponent, shape (n_alpha,).

    Exponents of like size share their nodes, and views of like domains are evaluated together.
    """
    result = np.zeros(len(alphas))
    peaks = [(weight, seen, largest_cosine(seen)) for weight, seen in views]
    peaks = [p for p in peaks if p[2] > 0]
    order = np.argsort(alphas)
    start = 0
    while peaks and start < len(order):
        first = float(alphas[order[start]])
        group = [i for i in order[start:] if alphas[i] + 1.0 <= SHARED_NODES * (first + 1.0)]
        result[group] = _group_powers(peaks, np.asarray(alphas, dtype=np.float64)[group])
        start += len(group)
    return result


def _group_powers(peaks: Sequence[tuple[float, View, float]], alphas: FloatArray) -> FloatArray:
    """Ascending exponents on the domain of the broadest lobe and the panels of the narrowest."""
    broad, narrow = float(alphas[0]), float(alphas[-1])
    panel = min(PANEL_RAD, PANEL_LOBE_WIDTHS / math.sqrt(narrow + 1.0))
    powers = np.zeros(len(alphas))
    smooth: list[_Member] = []
    for weight, seen, peak in peaks:
        if broad * math.log(peak) < -DARK:
            continue
        sides = _domain(seen, peak, broad)
        if broad < SMOOTH_RIM_ALPHA and seen.mirror[0] != 0 and rim_near(seen):
            kappa, w_kappa = _panels_between_cuts(sides[1], panel, rim_crossings(seen))
            gamma, w_gamma = _up_to_rim(seen, np.tan(kappa), sides[0])
            rows = kappa[:, np.newaxis], w_kappa[:, np.newaxis]
            powers += _sum((gamma, weight * w_gamma, *rows), seen.mirror, alphas)
        else:
            smooth.append((weight, seen, sides))
    for batch, counts in _batches(smooth, panel):
        weights, gamma, w_gamma, kappa, w_kappa = _nodes(batch, counts)
        mirror = _columns([seen.mirror for _, seen, _ in batch])
        powers += _sum((gamma, weights * w_gamma, kappa, w_kappa), mirror, alphas)
    return powers * (alphas + 1.0) / (2.0 * math.pi)


def _sum(
    nodes: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    mirror: tuple[FloatArray | float, ...],
    alphas: FloatArray,
) -> FloatArray:
    """Sum of weight * dOmega * cos_+^alpha over all nodes for each exponent; the arrays broadcast."""
    gamma, w_gamma, kappa, w_kappa = nodes
    m_u, m_v, m_a = mirror
    s, t = np.tan(gamma), np.tan(kappa)
    one_s, one_t = 1.0 + s * s, 1.0 + t * t
    length2 = one_s + t * t
    length = np.sqrt(length2)
    weight = (one_s * w_gamma) * (one_t * w_kappa) / (length2 * length)
    # 1 - cos(theta_s) = |omega - m|^2 / 2 keeps the digits of a narrow lobe
    versine = 0.5 * ((s / length - m_u) ** 2 + (t / length - m_v) ** 2 + (1.0 / length - m_a) ** 2)
    inside = versine < 1.0
    log_cosine = np.log1p(-np.where(inside, versine, 0.0))
    weight *= inside  # the lobe's half space is open: even cos^0 is nothing outside
    return np.array([np.vdot(weight, np.exp(alpha * log_cosine)) for alpha in alphas])


def _domain(seen: View, peak: float, alpha: float) -> tuple[_Side, _Side]:
    """Angles gamma and kappa between which the lobe is not negligible against its largest value."""
    m_u, m_v, m_a = seen.mirror
    log_low = math.log(peak) - NEGLIGIBLE / alpha if alpha > 0 else -math.inf
    sin_reach = math.sqrt(-math.expm1(2.0 * log_low))
    return cut_by_cone(seen.s, m_u, m_a, sin_reach), cut_by_cone(seen.t, m_v, m_a, sin_reach)


def _whole(seen: View) -> tuple[_Side, _Side]:
    (s0, s1), (t0, t1) = seen.s, seen.t
    return (math.atan(s0), math.atan(s1)), (math.atan(t0), math.atan(t1))


def _batches(members: Sequence[_Member], panel: float) -> Iterator[tuple[list[_Member], tuple[int, int]]]:
    """Views whose domains need as many panels, with these numbers, in batches that fit the cache."""
    alike: dict[tuple[int, int], list[_Member]] = {}
    for member in members:
        gamma, kappa = member[2]
        alike.setdefault((_count(gamma, panel), _count(kappa, panel)), []).append(member)
    for counts, group in alike.items():
        size = max(1, MOST_VALUES // (counts[0] * counts[1] * NODES**2))
        for k in range(0, len(group), size):
            yield group[k : k + size], counts


def _nodes(batch: Sequence[_Member], counts: tuple[int, int]) -> tuple[FloatArray, ...]:
    """Weights of the views, gamma and its weights, kappa and its, to broadcast as (view, kappa, gamma)."""
    weights = np.array([weight for weight, _, _ in batch])[:, np.newaxis, np.newaxis]
    gamma, w_gamma = _panels([sides[0] for _, _, sides in batch], counts[0])
    kappa, w_kappa = _panels([sides[1] for _, _, sides in batch], counts[1])
    across, down = (slice(None), np.newaxis, slice(None)), (slice(None), slice(None), np.newaxis)
    return weights, gamma[across], w_gamma[across], kappa[down], w_kappa[down]


def _columns(rows: Sequence[tuple[float, ...]]) -> tuple[FloatArray, ...]:
    """One array (view, 1, 1) for each place of the rows."""
    return tuple(np.array(rows).T[:, :, np.newaxis, np.newaxis])


def _up_to_rim(seen: View, t: FloatArray, side: _Side) -> tuple[FloatArray, FloatArray]:
    """Nodes (n_t, n_gamma) and weights where the lobe's rim cuts the rectangle: one row for each t."""
    m_u, m_v, m_a = seen.mirror
    low, high = side
    rim = np.arctan(-(m_a + t * m_v) / m_u)[:, np.newaxis]
    start, end = np.clip(rim, low, high), high if m_u > 0 else low
    y, w = _gauss(2 * NODES)
    y, w = 0.5 * (1.0 + y), 0.5 * w
    gamma = start + (end - start) * y**EDGE_POWER
    return gamma, np.abs(end - start) * EDGE_POWER * y ** (EDGE_POWER - 1) * w


def _count(side: _Side, panel: float) -> int:
    return max(1, math.ceil((side[1] - side[0]) / panel))


def _panels(sides: Sequence[_Side], n: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of n Gauss-Legendre panels on each of several sides, each (n_side, n * NODES)."""
    x, w = _gauss(NODES)
    low, high = np.array(sides).T
    half = (0.5 * (high - low) / n)[:, np.newaxis, np.newaxis]
    middles = low[:, np.newaxis, np.newaxis] + half * (2.0 * np.arange(n) + 1.0)[:, np.newaxis]
    shape = len(sides), n * NODES
    return (middles + half * x).reshape(shape), np.broadcast_to(half * w, (len(sides), n, NODES)).reshape(
        shape
    )


def _panels_between_cuts(side: _Side, panel: float, cuts: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of panels on one side that is also cut at `cuts`, each (n,)."""
    edges = [side[0], *sorted(c for c in cuts if side[0] < c < side[1]), side[1]]
    parts = [_panels([part], _count(part, panel)) for part in itertools.pairwise(edges)]
    return np.concatenate([p[0][0] for p in parts]), np.concatenate([p[1][0] for p in parts])


@lru_cache(maxsize=8)
def _gauss(n: int) -> tuple[FloatArray, FloatArray]:
    x, w = np.polynomial.legendre.leggauss(n)
    return x, w

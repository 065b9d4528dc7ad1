"""In which direction does light leave a lobe, and how much of the lobe is above the horizon?"""

from __future__ import annotations

import math
from typing import Any

from gonio.facade.sampling import compiled, lobe_direction, sobol, uniform
from gonio.facade.tracing import exponent
from gonio.facade.vectors import dot, mirrored

_TRIES = 200


@compiled
def pair(directions: Any, index: Any, dimension: int, key: Any, draws: Any, at: int) -> Any:
    """Return two numbers in (0, 1): of Sobol point `index` as long as it has dimensions, then hashed ones."""
    if dimension + 1 < directions.shape[0]:
        return sobol(directions, index, dimension, key), sobol(directions, index, dimension + 1, key)
    return uniform(draws, at), uniform(draws, at + 1)


@compiled
def off_the_lobe(
    g: Any, k: int, n: Any, incoming: Any, u: float, w: float, renormalize: bool, draws: Any
) -> Any:
    """Return ``(direction, mirror direction, above the horizon)`` of light that takes the lobe of `k`.

    Renormalised, what would go under the horizon draws again.  The accepted directions have exactly the
    density of the lobe cut by the horizon.  At least one half of a lobe is above, whatever alpha and
    incidence: for a direction d of the lobe about m its image d' = 2 (d.m) m - d is as likely, and
    (d + d').n = 2 (d.m)(m.n) >= 0, so that not both are below.  All 200 tries fail once in 2^200 photons.
    """
    m = mirrored(incoming, n)
    alpha = exponent(g, k)
    d = lobe_direction(m[0], m[1], m[2], alpha, u, w)
    if renormalize:
        for attempt in range(_TRIES):
            if dot(n, d) > 0.0:
                break
            at = 1000 + 2 * attempt
            d = lobe_direction(m[0], m[1], m[2], alpha, uniform(draws, at), uniform(draws, at + 1))
    return d, m, dot(n, d) > 0.0


@compiled
def above_horizon(alpha: float, cosine: float) -> float:
    """Return the part of a lobe that is above the horizon at incidence `cosine`: 1 at normal, 1/2 at grazing.

    ``(1 + I_x(1/2, (alpha + 1)/2))/2`` with ``x = cosine^2``, as `gonio.brdf.lobe.lobe_above_horizon`.
    """
    x = min(max(cosine * cosine, 0.0), 1.0)
    b = 0.5 * (alpha + 1.0)
    if x == 0.0:
        return 0.5
    if x == 1.0:
        return 1.0
    # x^(1/2) (1-x)^b / B(1/2, b); what is left of I_x is a continued fraction.
    front = math.sqrt(x / math.pi) * _gamma_half(b) * math.exp(b * math.log1p(-x))
    if x < 1.5 / (b + 2.5):
        return 0.5 + front * _beta_fraction(0.5, b, x)
    return 1.0 - 0.5 * front / b * _beta_fraction(b, 0.5, 1.0 - x)


@compiled
def _gamma_half(b: float) -> float:
    """Return ``Gamma(b + 1/2) / Gamma(b)`` for b > 0, to 1e-13 (DLMF 5.11.13 from b = 30 on)."""
    factor = 1.0
    while b < 30.0:
        factor *= b / (b + 0.5)
        b += 1.0
    y = 1.0 / b
    series = 1.0 + y * (-1 / 8 + y * (1 / 128 + y * (5 / 1024 + y * (-21 / 32768 - y * (399 / 262144)))))
    return factor * math.sqrt(b) * series


@compiled
def _beta_fraction(a: float, b: float, x: float) -> float:
    """Return ``a B(a, b) I_x(a, b) / (x^a (1-x)^b)`` for x < (a+1)/(a+b+2): DLMF 8.17.22, Lentz' method."""
    c = 1.0
    d = 0.0
    value = 1.0
    for j in range(1, 1000):
        m = j // 2
        if j % 2 == 0:
            term = m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m))
        else:
            term = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0))
        d = 1.0 / (1.0 + term * d)
        c = 1.0 + term / c
        value *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return 1.0 / value

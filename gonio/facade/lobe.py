"""In which direction does light leave a lobe, and how much of the lobe is above the horizon?"""

from __future__ import annotations

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

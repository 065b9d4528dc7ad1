"""How much light arrives through at least one lobe, by photons followed from the first lit surface?"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gonio.facade.intersect import nearest, occluded
from gonio.facade.layout import ABSORBED, CREATED, EMITTED, ESCAPED, UNDER_HORIZON, UNFINISHED
from gonio.facade.sampling import (
    MIX_A,
    MIX_B,
    compiled,
    cosine_direction,
    key_of,
    lobe_direction,
    mix,
    sobol,
    sun_direction,
    uniform,
)
from gonio.facade.skylight import sky_radiance
from gonio.facade.tracing import MAX_BOUNCES, coefficients, exponent, facing, hidden, on_surface, patch_at
from gonio.facade.vectors import along, dot, mirrored, negative, row


@compiled
def _first_light(g: Any, light: Any, directions: Any, i: int, key: Any, chance: Any, from_sky: bool) -> Any:
    """Return ``(power, primitive, point, normal, direction towards the light)`` of point `i`; 0 in the shade.

    Points are drawn on the primitives' sides with the cumulative probabilities `chance` (2 m,): side 0 and 1
    of the first, of the second, ...
    """
    u = sobol(directions, i, 0, key)
    at = np.searchsorted(chance, u, side="right")
    at = min(at, chance.shape[0] - 1)
    below = chance[at - 1] if at > 0 else 0.0
    share = chance[at] - below
    a = (u - below) / share  # what is left of the number that chose the side is uniform again
    b = sobol(directions, i, 1, key)
    k = at // 2
    if g.triangle[k] == 1 and a + b > 1.0:
        a = 1.0 - a
        b = 1.0 - b
    p = on_surface(g, k, a, b)
    n = row(g.normal, k)
    if at % 2 == 1:
        n = negative(n)
    v = sobol(directions, i, 2, key)
    w = sobol(directions, i, 3, key)
    if from_sky:
        d = cosine_direction(n, v, w)
        power = math.pi * sky_radiance(light, d) * g.area[k] / share
    else:
        d = sun_direction(light, v, w)
        power = light.dni * dot(n, d) * g.area[k] / share
    if power <= 0.0 or d[2] <= 0.0 or dot(n, d) <= 0.0:
        return 0.0, k, p, n, d
    if hidden(g, k, p) or occluded(g, p, d, k):
        power = 0.0
    return power, k, p, n, d


@compiled
def _reflected_by_lobe(
    g: Any, light: Any, k: int, n: Any, incoming: Any, u: float, w: float, draws: Any
) -> Any:
    """Return ``(direction, above the horizon)`` of light that arrives along `incoming` and takes the lobe."""
    m = mirrored(incoming, n)
    alpha = exponent(g, k)
    d = lobe_direction(m[0], m[1], m[2], alpha, u, w)
    if light.renormalize:
        # At least half of the lobe is above the horizon, so this ends after two tries or so.
        for attempt in range(200):
            if dot(n, d) > 0.0:
                break
            at = 1000 + 2 * attempt
            d = lobe_direction(m[0], m[1], m[2], alpha, uniform(draws, at), uniform(draws, at + 1))
    return d, dot(n, d) > 0.0


@compiled
def _follow(
    g: Any, light: Any, k: int, p: Any, d: Any, power: float, draws: Any, tally: Any, energy: Any
) -> int:
    """Follow one photon that has left a lobe, tally it wherever it arrives, and return the number of rays."""
    rays = 0
    while rays < MAX_BOUNCES:
        rays += 1
        hit, t, a, b = nearest(g, p, d, k)
        if hit < 0:
            energy[ESCAPED] += power
            return rays
        n, back = facing(g, hit, d)
        if back < 0:
            energy[ABSORBED] += power
            return rays
        cosine = -dot(n, d)
        patch = patch_at(g, hit, back, a, b)
        if patch >= 0:
            tally[patch] += power
        p = along(p, t, d)
        k = hit
        k_d, k_s = coefficients(g, k, cosine, light.conserving)
        total = k_d + k_s
        if total > 1.0:  # energy="published" only
            energy[CREATED] += power * (total - 1.0)
            power *= total
            k_s /= total
            k_d /= total
            total = 1.0
        at = 5 * rays + 16
        choice = uniform(draws, at)
        if choice >= total:
            energy[ABSORBED] += power
            return rays
        u, w = uniform(draws, at + 1), uniform(draws, at + 2)
        if choice < k_s:
            d, above = _reflected_by_lobe(g, light, k, n, d, u, w, mix(draws ^ np.uint64(at)))
            if not above:
                energy[ABSORBED] += power
                energy[UNDER_HORIZON] += power
                return rays
        else:
            d = cosine_direction(n, u, w)
    energy[UNFINISHED] += power
    return rays


@compiled
def forward_photons(
    g: Any,
    light: Any,
    chance: Any,
    directions: Any,
    seed: Any,
    stream: Any,
    from_sky: bool,
    window: Any,
    tally: Any,
    energy: Any,
) -> int:
    """Add photons ``window[2] <= i < window[3]`` of replicas ``window[0] <= r < window[1]``; return the rays.

    Until its first lobe a photon is split at every reflection: one part takes the lobe and is followed and
    tallied to its end, the rest goes on diffusely.  Every path with at least one lobe is therefore counted
    once, and the powers of all parts add up: emitted + created = absorbed + escaped + unfinished, but for
    rounding.  `tally` (replicas, patches) and `energy` (replicas, 6) collect W, to be divided by the number
    of photons.
    """
    rays = 0
    for replica in range(window[0], window[1]):
        key = key_of(seed, stream, replica)
        own_tally = tally[replica]
        own_energy = energy[replica]
        for i in range(window[2], window[3]):
            rays += 1
            power, k, p, n, towards = _first_light(g, light, directions, i, key, chance, from_sky)
            if power == 0.0:
                continue
            own_energy[EMITTED] += power
            draws = mix(key ^ np.uint64(i) * MIX_B)
            d = (-towards[0], -towards[1], -towards[2])
            bounce = 0
            while True:
                k_d, k_s = coefficients(g, k, -dot(n, d), light.conserving)
                at = 8 * bounce
                child = mix(draws + np.uint64(at) * MIX_A)
                if k_s > 0.0:
                    if bounce == 0:
                        u, w = sobol(directions, i, 4, key), sobol(directions, i, 5, key)
                    else:
                        u, w = uniform(child, 1), uniform(child, 2)
                    out, above = _reflected_by_lobe(g, light, k, n, d, u, w, child)
                    if above:
                        rays += _follow(g, light, k, p, out, power * k_s, child, own_tally, own_energy)
                    else:
                        own_energy[ABSORBED] += power * k_s
                        own_energy[UNDER_HORIZON] += power * k_s
                rest = max(1.0 - k_s, k_d)
                own_energy[CREATED] += power * (k_s + rest - 1.0)
                power *= rest
                if k_d == 0.0 or uniform(child, 3) * rest >= k_d:
                    own_energy[ABSORBED] += power
                    break
                bounce += 1
                if bounce > MAX_BOUNCES:
                    own_energy[UNFINISHED] += power
                    break
                if bounce == 1:
                    u, w = sobol(directions, i, 6, key), sobol(directions, i, 7, key)
                else:
                    u, w = uniform(child, 4), uniform(child, 5)
                d = cosine_direction(n, u, w)
                rays += 1
                hit, t, _, _ = nearest(g, p, d, k)
                if hit < 0:
                    own_energy[ESCAPED] += power
                    break
                n, back = facing(g, hit, d)
                if back < 0:
                    own_energy[ABSORBED] += power
                    break
                p = along(p, t, d)
                k = hit
    return rays

"""How much light arrives through at least one lobe, by photons that start where light meets surfaces?"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gonio.facade.gray import coordinate, scramblings
from gonio.facade.intersect import nearest, occluded
from gonio.facade.layout import (
    ABSORBED,
    CONSTANT,
    CREATED,
    EMITTED,
    ESCAPED,
    EXPOSED,
    HANDED,
    N2,
    PATCH,
    SKYLIGHT,
    UNDER_HORIZON,
    UNFINISHED,
)
from gonio.facade.lobe import off_the_lobe, pair
from gonio.facade.sampling import (
    MIX_A,
    MIX_B,
    compiled,
    cosine_direction,
    key_of,
    mix,
    reversed32,
    sun_direction,
    uniform,
)
from gonio.facade.skylight import sky_radiance
from gonio.facade.stokes import amplitudes, carried, into_plane, perpendicular, reflected
from gonio.facade.tracing import (
    MAX_BOUNCES,
    coefficients,
    facing,
    glossy,
    hidden,
    on_surface,
    patch_at,
    point_of,
    shared,
)
from gonio.facade.vectors import along, dot, negative, row

STREAM = 1 << 40
"""Sun, and one more for the sky: the streams of random numbers, beyond every patch number."""

_PATCH_STREAM = 1 << 41
_ONE = np.uint64(1)
_LIGHT = 0.05  # of its first weight: below it a photon no longer splits, it goes one way

# Sobol dimensions: 0, 1 place; 2, 3 direction and 4, 5 first lobe (the other way round for the sun, whose
# disc needs the good ones least); from 6 on whatever comes next.
_NEXT = 6
_HASHED = 1 << 20


@compiled
def _stepped(directions: Any, x: Any, bit: int) -> Any:
    """Return six coordinates, as reversed bits, after direction number `bit` of each is added."""
    return (
        x[0] ^ reversed32(directions[0, bit]),
        x[1] ^ reversed32(directions[1, bit]),
        x[2] ^ reversed32(directions[2, bit]),
        x[3] ^ reversed32(directions[3, bit]),
        x[4] ^ reversed32(directions[4, bit]),
        x[5] ^ reversed32(directions[5, bit]),
    )


@compiled
def _point(directions: Any, index: Any) -> Any:
    """Return the first six coordinates of the Sobol point `index`, as reversed bits."""
    zero = np.uint64(0)
    x = (zero, zero, zero, zero, zero, zero)
    bit = 0
    while index != zero:
        if index & _ONE:
            x = _stepped(directions, x, bit)
        index >>= _ONE
        bit += 1
    return x


@compiled
def _first_light(g: Any, light: Any, x: Any, scrambling: Any, chance: Any, source: int) -> Any:
    """Return ``(power, primitive, point, normal, direction towards the light)``; no power in the shade.

    Points are drawn on the primitives' sides with the cumulative probabilities `chance` (2 m,): side 0 and 1
    of the first, of the second, ...
    """
    u = coordinate(x[0], scrambling[0])
    at = np.searchsorted(chance, u, side="right")
    at = min(at, chance.shape[0] - 1)
    below = chance[at - 1] if at > 0 else 0.0
    share = chance[at] - below
    a = (u - below) / share  # what is left of the number that chose the side is uniform again
    b = coordinate(x[1], scrambling[1])
    k = at // 2
    if g.triangle[k] == 1 and a + b > 1.0:
        a = 1.0 - a
        b = 1.0 - b
    p = on_surface(g, k, a, b)
    n = row(g.normal, k)
    if at % 2 == 1:
        n = negative(n)
    if source == SKYLIGHT:
        d = cosine_direction(n, coordinate(x[2], scrambling[2]), coordinate(x[3], scrambling[3]))
        power = math.pi * sky_radiance(light, d) * g.area[k] / share
    else:
        d = sun_direction(light, coordinate(x[4], scrambling[4]), coordinate(x[5], scrambling[5]))
        power = light.dni * dot(n, d) * g.area[k] / share
    if power <= 0.0 or d[2] <= 0.0 or dot(n, d) <= 0.0:
        return 0.0, k, p, n, d
    if hidden(g, k, p) or occluded(g, p, d, k):
        power = 0.0
    return power, k, p, n, d


@compiled
def _interface(g: Any, k: int, q: float, u: float, cosine: float) -> Any:
    """Return ``(R, q, u)`` of polarised light at primitive `k`, q and u referred to s.

    A constant lobe is a mirror that keeps the polarisation, as a good metal does.
    """
    m = g.optics[k]
    if g.materials[m, CONSTANT] > 0.0:
        return 1.0, q, -u
    r_s, r_p = amplitudes(cosine, g.materials[m, N2])
    return reflected(q, u, r_s, r_p)


@compiled
def _follow(
    g: Any,
    light: Any,
    directions: Any,
    index: Any,
    key: Any,
    draws: Any,
    v: float,
    w: float,
    dimension: int,
    to_the_end: bool,
    polarised: bool,
    k: int,
    p: Any,
    n: Any,
    d: Any,
    power: float,
    tally: Any,
    tally_d: Any,
    energy: Any,
) -> int:
    """Follow light that arrives at `k` along `d`, unpolarised, and of which `power` takes the lobe.

    The first lobe takes the numbers `v` and `w`, what comes next the Sobol dimensions from `dimension` on.
    Return the number of rays.
    """
    rays = 0
    through_lobe = True
    light_weight = math.inf if to_the_end else _LIGHT * power
    q = 0.0
    u = 0.0
    e = n
    if polarised:
        q, u, e = into_plane(q, u, perpendicular(d), d, n)
        _, q, u = _interface(g, k, q, u, -dot(n, d))
    while True:
        at = 8 * rays + 16
        if rays > 0:
            v, w = pair(directions, index, dimension, key, draws, at)
            dimension += 2
        if through_lobe:
            d, m, above = off_the_lobe(g, k, n, d, v, w, light.renormalize, mix(draws ^ np.uint64(at)))
            if not above:
                energy[ABSORBED] += power
                energy[UNDER_HORIZON] += power
                return rays
            if polarised:
                e = carried(e, m, d)
        else:
            d = cosine_direction(n, v, w)
            q = 0.0
            u = 0.0
        if rays == MAX_BOUNCES:
            energy[UNFINISHED] += power
            return rays
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
        if polarised:
            if not through_lobe:
                e = perpendicular(d)
            q, u, e = into_plane(q, u, e, d, n)
            r, q, u = _interface(g, k, q, u, cosine)
            k_d, k_s = shared(g, k, r, light.conserving)
        else:
            k_d, k_s = coefficients(g, k, cosine, light.conserving)
        total = k_d + k_s
        if total > 1.0:  # energy="published" only
            energy[CREATED] += power * (total - 1.0)
        through_lobe = True
        handed = 0.0
        if power >= light_weight:
            # Split: the diffuse part is handed over, the lobe goes on.
            handed = power * k_d
            energy[ABSORBED] += power * max(1.0 - total, 0.0)
            power *= k_s
            ends = power == 0.0
        else:
            # One way only, with the whole power.
            power *= max(total, 1.0)
            choice = uniform(draws, at + 2) * max(total, 1.0)
            through_lobe = choice < k_s
            ends = choice >= total
            if ends:
                energy[ABSORBED] += power
            elif not through_lobe and not to_the_end:
                handed = power
                ends = True
        if handed > 0.0:
            if patch >= 0:
                energy[HANDED] += handed
                tally_d[patch] += handed
            else:  # nothing takes it over
                energy[UNFINISHED] += handed
        if ends:
            return rays


@compiled
def photons(
    g: Any,
    light: Any,
    patches: Any,
    chance: Any,
    directions: Any,
    seed: Any,
    source: int,
    replicas: int,
    follow: bool,
    polarised: bool,
    base: int,
    window: Any,
    tally: Any,
    tally_d: Any,
    energy: Any,
) -> int:
    """Add the photons ``window[2] <= i < window[3]`` of units ``window[0] <= unit < window[1]``.

    Return the number of rays.  A unit is a replica of the sun (`source` 0) or of the sky (1), or
    ``patch * replicas + replica`` of unit power that leaves a patch diffusely (2).

    Parameters
    ----------
    chance
        (2 m,) cumulative probabilities of the sides to start on, from `gonio.facade.starts.chances`; of
        length 1 and not used for patches.
    follow
        ``False``: only what takes a lobe at the first surface is followed, from lobe to lobe.  Wherever it
        lands, the diffuse part is handed over in `tally_d` to the exchange between the patches.  ``True``:
        a photon is split at every reflection until its first lobe, one part takes the lobe and is followed to
        its end through lobes and diffuse reflections, the rest goes on diffusely.  Either way every path with
        at least one lobe is counted once.
    polarised
        Light keeps its polarisation from lobe to lobe (`gonio.facade.stokes`).
    tally, tally_d
        (units from `base` on, patches) float64, W, or 1 for patches: what arrives, and what of it is
        reflected diffusely.  To be divided by the number of points, for patches by that of `EXPOSED`
        ones.
    energy
        (units from `base` on, 8) float64, columns in `gonio.facade.layout`: emitted + created = absorbed +
        escaped + handed + unfinished, but for rounding.  Emitted is all light that meets a surface if
        `follow`, else the part of it that takes the lobe.
    """
    rays = 0
    for unit in range(window[0], window[1]):
        own_tally = tally[unit - base]
        own_diffuse = tally_d[unit - base]
        own = energy[unit - base]
        patch = 0
        back = 0
        if source == PATCH:
            patch = unit // replicas
            back = patches.back[patch]
            key = key_of(seed, _PATCH_STREAM + patch, unit % replicas)
        else:
            key = key_of(seed, STREAM + source, unit)
        scrambling = scramblings(key)
        for i in range(window[2], window[3]):
            number = np.uint64(i)
            index = number ^ (number >> _ONE)
            if i == window[2]:
                x = _point(directions, index)
            else:
                bit = 0
                while not number & _ONE:
                    number >>= _ONE
                    bit += 1
                x = _stepped(directions, x, bit)
            draws = mix(key ^ np.uint64(i) * MIX_B)
            lit = True
            v, w = coordinate(x[2], scrambling[2]), coordinate(x[3], scrambling[3])
            if source == PATCH:
                k = patches.primitive[patch]
                p, covered = point_of(
                    g, patches, patch, coordinate(x[0], scrambling[0]), coordinate(x[1], scrambling[1])
                )
                if covered:
                    continue
                own[EXPOSED] += 1.0
                n = row(g.normal, k)
                if back == 1:
                    n = negative(n)
                power = 1.0
                d = n
                lit = False
            else:
                rays += 1
                if source == SKYLIGHT:
                    v, w = coordinate(x[4], scrambling[4]), coordinate(x[5], scrambling[5])
                power, k, p, n, towards = _first_light(g, light, x, scrambling, chance, source)
                if power == 0.0:
                    continue
                d = negative(towards)
            if follow:
                own[EMITTED] += power
            bounce = 0
            while True:
                child = mix(draws + np.uint64(8 * bounce) * MIX_A)
                if lit:
                    k_d, k_s = coefficients(g, k, -dot(n, d), light.conserving)
                    if k_s > 0.0:
                        if not follow:
                            own[EMITTED] += power * k_s
                        rays += _follow(
                            g, light, directions, index, key, child, v, w, _NEXT if bounce == 0 else _HASHED,
                            follow, polarised, k, p, n, d, power * k_s, own_tally, own_diffuse, own,
                        )  # fmt: skip
                    if not follow:
                        break
                    rest = max(1.0 - k_s, k_d)
                    own[CREATED] += power * (k_s + rest - 1.0)
                    power *= rest
                    if k_d == 0.0 or uniform(child, 3) * rest >= k_d:
                        own[ABSORBED] += power
                        break
                    bounce += 1
                    if bounce > MAX_BOUNCES:
                        own[UNFINISHED] += power
                        break
                if lit:
                    v, w = pair(directions, index, _NEXT if bounce == 1 else _HASHED, key, child, 4)
                d = cosine_direction(n, v, w)
                if lit:
                    v, w = uniform(child, 1), uniform(child, 2)
                else:
                    v, w = coordinate(x[4], scrambling[4]), coordinate(x[5], scrambling[5])
                lit = True
                rays += 1
                hit, t, _, _ = nearest(g, p, d, k)
                if hit < 0:
                    if follow:
                        own[ESCAPED] += power
                    break
                n, side = facing(g, hit, d)
                if side < 0 or (not follow and not glossy(g, hit)):
                    if follow:
                        own[ABSORBED] += power
                    break
                p = along(p, t, d)
                k = hit
    return rays

"""How much light arrives, by paths traced from the receivers' patches back to sky and sun?"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gonio.facade.layout import DIFFUSE, DIRECT, LOST, SKY, SPECULAR
from gonio.facade.sampling import (
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
from gonio.facade.tracing import (
    MAX_BOUNCES,
    along,
    coefficients,
    dot,
    lobe_density,
    mirrored,
    nearest,
    on_surface,
    row,
)

_LOBE_SHARE = 0.2  # of paths that try the lobe at a glossy surface


@compiled
def backward_paths(
    g: Any,
    light: Any,
    owner: Any,
    cell: Any,
    directions: Any,
    seed: Any,
    replicas: int,
    window: Any,
    lobe: bool,
    out: Any,
) -> int:
    """Add paths of the units ``window[0] <= unit < window[1]`` to `out`; return the number of rays.

    A unit is one patch and one replica (``unit = patch * replicas + replica``) and takes the points
    ``window[2] <= i < window[3]``.  `out` (units, 5) float64 collects irradiances in W/m2, one column per
    kind.  `owner` (patches,) is the surface and `cell` (patches, 4) the rectangle ``a0, b0, da, db`` of each
    patch.

    Without `lobe` only diffuse reflections are followed and no path weighs more than one.  With it the lobe
    is evaluated on the reversed path: its weight cos(theta_i)/cos(theta_o) has no bound at grazing exit, so
    this is a check for broad lobes and not the way of choice.
    """
    rays = 0
    for unit in range(window[0], window[1]):
        patch = unit // replicas
        start = owner[patch]
        key = key_of(seed, patch, unit % replicas)
        n0 = row(g.normal, start)
        for i in range(window[2], window[3]):
            draws = mix(key ^ np.uint64(i) * MIX_B)
            counter = 0
            a = cell[patch, 0] + cell[patch, 2] * sobol(directions, i, 0, key)
            b = cell[patch, 1] + cell[patch, 3] * sobol(directions, i, 1, key)
            p = on_surface(g, start, a, b)
            if light.dni > 0.0:
                s = sun_direction(light, sobol(directions, i, 4, key), sobol(directions, i, 5, key))
                facing = dot(n0, s)
                if facing > 0.0 and s[2] > 0.0:
                    rays += 1
                    if nearest(g, light.periodic, p, s, start, True)[0] < 0:
                        out[unit, DIRECT] += light.dni * facing
            d = cosine_direction(n0, sobol(directions, i, 2, key), sobol(directions, i, 3, key))
            k = start
            weight = 1.0
            kind = SKY
            bounce = 0
            while True:
                rays += 1
                hit, t, _, _ = nearest(g, light.periodic, p, d, k, False)
                if hit < 0:
                    if d[2] > 0.0:
                        out[unit, kind] += weight * light.dhi
                    break
                n = row(g.normal, hit)
                cos_o = -dot(n, d)
                if cos_o <= 0.0:
                    break  # the black side
                bounce += 1
                if bounce > MAX_BOUNCES:
                    out[unit, LOST] += weight * (light.dhi + light.dni)
                    break
                k = hit
                p = along(p, t, d)
                alpha = g.material[k, 2]
                mirror = mirrored(d, n)
                if kind == SKY:
                    kind = DIFFUSE
                glossy = lobe and g.material[k, 1] > 0.0
                if light.dni > 0.0:
                    counter += 2
                    s = sun_direction(light, uniform(draws, counter), uniform(draws, counter + 1))
                    facing = dot(n, s)
                    if facing > 0.0 and s[2] > 0.0:
                        rays += 1
                        if nearest(g, light.periodic, p, s, k, True)[0] < 0:
                            k_d, k_s = coefficients(g, k, facing, light.conserving)
                            out[unit, kind] += weight * light.dni * facing * k_d
                            if glossy:
                                dsf = k_s * lobe_density(dot(mirror, s), alpha)
                                out[unit, SPECULAR] += weight * light.dni * facing * math.pi * dsf / cos_o
                if bounce == 1:
                    u, w = sobol(directions, i, 6, key), sobol(directions, i, 7, key)
                else:
                    counter += 2
                    u, w = uniform(draws, counter), uniform(draws, counter + 1)
                counter += 2
                if glossy:
                    if uniform(draws, counter) < _LOBE_SHARE:
                        d = lobe_direction(mirror[0], mirror[1], mirror[2], alpha, u, w)
                        facing = dot(n, d)
                        if facing <= 0.0:
                            break
                        k_s = coefficients(g, k, facing, light.conserving)[1]
                        weight *= k_s * facing / cos_o / _LOBE_SHARE
                        kind = SPECULAR
                        continue
                    weight /= 1.0 - _LOBE_SHARE
                d = cosine_direction(n, u, w)
                k_d = coefficients(g, k, dot(n, d), light.conserving)[0]
                if bounce <= 2:  # the first reflections carry most of the light: weigh, do not gamble
                    weight *= k_d
                    if weight == 0.0:
                        break
                elif uniform(draws, counter + 1) >= k_d:
                    break
    return rays

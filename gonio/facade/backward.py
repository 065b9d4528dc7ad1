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
        for i in range(window[2], window[3]):
            draws = mix(key ^ np.uint64(i) * MIX_B)
            counter = 0
            a = cell[patch, 0] + cell[patch, 2] * sobol(directions, i, 0, key)
            b = cell[patch, 1] + cell[patch, 3] * sobol(directions, i, 1, key)
            k = start
            p = on_surface(g, k, a, b)
            n = row(g.normal, k)
            d = n  # the direction the path arrived in; the patch has none
            weight = 1.0
            kind = SKY
            bounce = 0
            while True:
                glossy = lobe and bounce > 0 and g.material[k, 1] > 0.0
                mirror = mirrored(d, n)
                cos_o = -dot(n, d)
                counter += 6
                if light.dni > 0.0:
                    if bounce == 0:
                        u, w = sobol(directions, i, 4, key), sobol(directions, i, 5, key)
                    else:
                        u, w = uniform(draws, counter), uniform(draws, counter + 1)
                    s = sun_direction(light, u, w)
                    facing = dot(n, s)
                    if facing > 0.0 and s[2] > 0.0:
                        rays += 1
                        if nearest(g, light.periodic, p, s, k, True)[0] < 0:
                            power = weight * light.dni * facing
                            if bounce == 0:
                                out[unit, DIRECT] += power
                            else:
                                k_d, k_s = coefficients(g, k, facing, light.conserving)
                                out[unit, kind] += power * k_d
                                if glossy:
                                    dsf = k_s * lobe_density(dot(mirror, s), g.material[k, 2])
                                    out[unit, SPECULAR] += power * math.pi * dsf / cos_o
                if bounce == 0:
                    u, w = sobol(directions, i, 2, key), sobol(directions, i, 3, key)
                elif bounce == 1:
                    u, w = sobol(directions, i, 6, key), sobol(directions, i, 7, key)
                else:
                    u, w = uniform(draws, counter + 2), uniform(draws, counter + 3)
                if glossy and uniform(draws, counter + 4) < _LOBE_SHARE:
                    d = lobe_direction(mirror[0], mirror[1], mirror[2], g.material[k, 2], u, w)
                    facing = dot(n, d)
                    if facing <= 0.0:
                        break
                    k_s = coefficients(g, k, facing, light.conserving)[1]
                    weight *= k_s * facing / cos_o / _LOBE_SHARE
                    kind = SPECULAR
                else:
                    if glossy:
                        weight /= 1.0 - _LOBE_SHARE
                    d = cosine_direction(n, u, w)
                    k_d = 1.0 if bounce == 0 else coefficients(g, k, dot(n, d), light.conserving)[0]
                    if bounce <= 2:  # the first reflections carry most of the light: weigh, do not gamble
                        weight *= k_d
                    elif uniform(draws, counter + 5) >= k_d:
                        weight = 0.0
                if weight == 0.0:
                    break
                rays += 1
                hit, t, _, _ = nearest(g, light.periodic, p, d, k, False)
                if hit < 0:
                    if d[2] > 0.0:
                        out[unit, kind] += weight * light.dhi
                    break
                n = row(g.normal, hit)
                if dot(n, d) >= 0.0:
                    break  # the black side
                bounce += 1
                if bounce > MAX_BOUNCES:
                    out[unit, LOST] += weight * (light.dhi + light.dni)
                    break
                k = hit
                p = along(p, t, d)
                if kind == SKY:
                    kind = DIFFUSE
    return rays

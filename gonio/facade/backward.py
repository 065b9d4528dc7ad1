"""How much light arrives, by paths traced from the receivers' patches back to sky and sun?"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gonio.facade.intersect import nearest, occluded
from gonio.facade.layout import DIFFUSE, DIRECT, LOST, RHO_D, SKY, SPECULAR
from gonio.facade.lobe import above_horizon
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
from gonio.facade.skylight import sky_radiance
from gonio.facade.tracing import MAX_BOUNCES, coefficients, exponent, facing, glossy, lobe_density, point_of
from gonio.facade.vectors import along, dot, mirrored, negative, row

_LEAST_SHARE = 0.1  # of paths that try the lobe at a glossy surface, and of those that do not


@compiled
def backward_paths(
    g: Any,
    light: Any,
    patches: Any,
    directions: Any,
    seed: Any,
    replicas: int,
    window: Any,
    lobe: bool,
    out: Any,
    exposed: Any,
) -> int:
    """Add paths of the units ``window[0] <= unit < window[1]`` to `out`; return the number of rays.

    A unit is one patch and one replica (``unit = patch * replicas + replica``) and takes the points
    ``window[2] <= i < window[3]``.  `out` (units, 5) float64 collects irradiances in W/m2, one column per
    kind, and `exposed` (units,) counts the points that no coplanar primitive hides; only those have a value.

    Without `lobe` only diffuse reflections are followed and no path weighs more than one.  With it the lobe
    is evaluated on the reversed path, for unpolarised light: its weight cos(theta_i)/cos(theta_o) has no
    bound at grazing exit, so this is a check and not the way of choice.  The sun in the lobe is found both by
    rays to the sun and by rays that took the lobe, weighed by the balance heuristic (Veach and Guibas 1995).
    """
    rays = 0
    for unit in range(window[0], window[1]):
        patch = unit // replicas
        start = patches.primitive[patch]
        key = key_of(seed, patch, unit % replicas)
        for i in range(window[2], window[3]):
            draws = mix(key ^ np.uint64(i) * MIX_B)
            counter = 0
            k = start
            p, covered = point_of(
                g, patches, patch, sobol(directions, i, 0, key), sobol(directions, i, 1, key)
            )
            if covered:
                continue
            exposed[unit] += 1.0
            n = row(g.normal, k)
            if patches.back[patch] == 1:
                n = negative(n)
            d = n  # the direction the path arrived in; the patch has none
            weight = 1.0
            kind = SKY
            bounce = 0
            while True:
                shiny = lobe and bounce > 0 and glossy(g, k)
                mirror = mirrored(d, n)
                cos_o = -dot(n, d)
                counter += 6
                share = 0.0
                if shiny:
                    k_d, k_s = coefficients(g, k, cos_o, light.conserving)
                    share = 1.0
                    if g.materials[g.optics[k], RHO_D] > 0.0:
                        share = min(max(k_s / max(k_d + k_s, 1e-9), _LEAST_SHARE), 1.0 - _LEAST_SHARE)
                if light.dni > 0.0:
                    if bounce == 0:
                        u, w = sobol(directions, i, 4, key), sobol(directions, i, 5, key)
                    else:
                        u, w = uniform(draws, counter), uniform(draws, counter + 1)
                    s = sun_direction(light, u, w)
                    cosine = dot(n, s)
                    if cosine > 0.0 and s[2] > 0.0:
                        rays += 1
                        if not occluded(g, p, s, k):
                            power = weight * light.dni * cosine
                            if bounce == 0:
                                out[unit, DIRECT] += power
                            else:
                                k_d, k_s = coefficients(g, k, cosine, light.conserving)
                                out[unit, kind] += power * k_d
                                if shiny:
                                    alpha = exponent(g, k)
                                    density = lobe_density(dot(mirror, s), alpha)
                                    if light.renormalize:
                                        k_s /= above_horizon(alpha, cosine)
                                    # over the density of rays to the sun, 1/(2 pi disc)
                                    other = share * density * 2.0 * math.pi * light.disc
                                    power *= math.pi * k_s * density / (cos_o * (1.0 + other))
                                    out[unit, SPECULAR] += power
                if bounce == 0:
                    u, w = sobol(directions, i, 2, key), sobol(directions, i, 3, key)
                elif bounce == 1:
                    u, w = sobol(directions, i, 6, key), sobol(directions, i, 7, key)
                else:
                    u, w = uniform(draws, counter + 2), uniform(draws, counter + 3)
                lobed = shiny and uniform(draws, counter + 4) < share
                alpha = 0.0
                if lobed:
                    alpha = exponent(g, k)
                    d = lobe_direction(mirror[0], mirror[1], mirror[2], alpha, u, w)
                    cosine = dot(n, d)
                    if cosine <= 0.0:
                        break
                    k_s = coefficients(g, k, cosine, light.conserving)[1]
                    if light.renormalize:
                        k_s /= above_horizon(alpha, cosine)
                    weight *= k_s * cosine / (cos_o * share)
                    kind = SPECULAR
                else:
                    if shiny:
                        weight /= 1.0 - share
                    d = cosine_direction(n, u, w)
                    k_d = 1.0 if bounce == 0 else coefficients(g, k, dot(n, d), light.conserving)[0]
                    if bounce <= 2:  # the first reflections carry most of the light: weigh, do not gamble
                        weight *= k_d
                    elif uniform(draws, counter + 5) >= k_d:
                        weight = 0.0
                if weight == 0.0:
                    break
                rays += 1
                hit, t, _, _ = nearest(g, p, d, k)
                if hit < 0:
                    out[unit, kind] += weight * math.pi * sky_radiance(light, d)
                    if lobed and d[2] > 0.0 and 1.0 - dot(d, light.sun) < light.disc:
                        other = share * lobe_density(dot(mirror, d), alpha) * 2.0 * math.pi * light.disc
                        sun_radiance = light.dni / (2.0 * math.pi * light.disc)
                        out[unit, SPECULAR] += weight * math.pi * sun_radiance * other / (1.0 + other)
                    break
                n, back = facing(g, hit, d)
                if back < 0:
                    break
                bounce += 1
                if bounce > MAX_BOUNCES:
                    out[unit, LOST] += weight * (light.dhi + light.dni)
                    break
                k = hit
                p = along(p, t, d)
                if kind == SKY:
                    kind = DIFFUSE
    return rays

"""What does each patch see?  One cosine-distributed ray a point: sun, sky, or another patch.

A ray that leaves patch i in a cosine-distributed direction and meets patch j is a sample of the form factor
from i to j, so counting rays gives a row of the transport matrix; infinitely many diffuse reflections are
then a linear system (`gonio.facade.exchange`) and no path is followed further than one flight.
"""

from __future__ import annotations

import math
from typing import Any

from gonio.facade.gray import coordinate, first_state, next_state, scramblings
from gonio.facade.intersect import nearest, occluded
from gonio.facade.layout import CONSTANT, N2, RHO_D, RHO_S
from gonio.facade.sampling import compiled, key_of, sun_direction
from gonio.facade.skylight import sky_radiance
from gonio.facade.strip import strip_direction
from gonio.facade.tracing import facing, fresnel_mean, patch_at, point_of
from gonio.facade.vectors import along as along_ray
from gonio.facade.vectors import cross, dot, negative, row

EXPOSED, SUN, SKYLIGHT, FROM_SKY, FROM_BLACK, FIRST_BAND = 0, 1, 2, 3, 4, 5
"""Columns of `sums`: points that are not hidden; irradiance of sun and sky, W/m2 summed over points; rays
that met the sky, and something black.  From `FIRST_BAND` on, `PER_BAND` for each band, in the same units: k_d
times sun, k_d times sky; sunlight that rays see on what they meet, reflected once, and k_d times that."""

PER_BAND = 4
OWN_SUN, OWN_SKY, SEEN, OWN_SEEN = 0, 1, 2, 3


@compiled
def diffuse_part(table: Any, band: int, material: int, cosine: float, conserving: bool) -> float:
    """Return k_d of a material in a band at one incidence; `table` is (bands, materials, 5)."""
    k_d = table[band, material, RHO_D]
    k_s = table[band, material, RHO_S]
    if k_s > 0.0 and conserving:
        if table[band, material, CONSTANT] == 0.0:
            k_s *= fresnel_mean(cosine, table[band, material, N2])
        k_d = min(k_d, 1.0 - min(k_s, 1.0))
    return k_d  # type: ignore[no-any-return]


@compiled
def trace_rows(
    g: Any,
    light: Any,
    table: Any,
    patches: Any,
    chosen: Any,
    reverse: Any,
    angles: Any,
    seed: Any,
    replicas: int,
    window: Any,
    length: Any,
    place: Any,
    index: Any,
    count: Any,
    weight: Any,
    sums: Any,
) -> int:
    """Trace the points ``window[2] <= i < window[3]`` of the units ``window[0] <= unit < window[1]``.

    Where a ray meets a patch it looks for the sun, instead of leaving that light to the averages of patches:
    shadows are then as sharp as they are.

    Parameters
    ----------
    table
        (bands, materials, 5): the materials of every band; `g.materials` is not used.
    chosen
        (c,) patches; ``unit = c * replicas + replica``.
    reverse
        From `gray.reversed_directions`.
    angles
        From `strip.angle_table`.
    length
        (units,) int64, out: number of different patches met.
    place
        (patches,) int32, all -1: a note pad of the calling thread's own, left as it was.
    index, count
        (units, width) int32 and float64, out: those patches and how many rays met each; ``width >=
        min(points, patches)``.
    weight
        (units, width, bands) float64, out: sums over these rays of k_d of the emitting patch at the ray's
        angle, which is what it reflects diffusely of light that arrives along the ray.
    sums
        (units, FIRST_BAND + PER_BAND bands) float64, added to; columns above.

    Returns
    -------
    int
        Number of rays.
    """
    rays = 0
    bands = table.shape[0]
    for unit in range(window[0], window[1]):
        i = chosen[unit // replicas]
        k = patches.primitive[i]
        material = g.optics[k]
        n = row(g.normal, k)
        if patches.back[i] == 1:
            n = negative(n)
        along = row(g.u, k)
        scale = 1.0 / math.sqrt(dot(along, along))
        along = along[0] * scale, along[1] * scale, along[2] * scale
        across = cross(n, along)
        key = key_of(seed, i, unit % replicas)
        scramble = scramblings(key)
        bits = first_state(reverse, window[2])
        met = 0
        for at in range(window[2], window[3]):
            if at > window[2]:
                bits = next_state(reverse, bits, at)
            # the first two coordinates fill the plane best: the place up the wall, and the direction across
            a, b = coordinate(bits[3], scramble[3]), coordinate(bits[0], scramble[0])
            p, covered = point_of(g, patches, i, a, b)
            if covered:
                continue
            sums[unit, EXPOSED] += 1.0
            s = n
            if light.dni > 0.0:
                s = sun_direction(light, coordinate(bits[4], scramble[4]), coordinate(bits[5], scramble[5]))
                cosine = dot(n, s)
                if cosine > 0.0 and s[2] > 0.0:
                    rays += 1
                    if not occluded(g, p, s, k):
                        sums[unit, SUN] += light.dni * cosine
                        for band in range(bands):
                            k_d = diffuse_part(table, band, material, cosine, light.conserving)
                            sums[unit, FIRST_BAND + PER_BAND * band + OWN_SUN] += light.dni * cosine * k_d
            a, b = coordinate(bits[1], scramble[1]), coordinate(bits[2], scramble[2])
            d = strip_direction(angles, n, along, across, a, b)
            rays += 1
            hit, t, a, b = nearest(g, p, d, k)
            if hit < 0:
                radiance = sky_radiance(light, d)
                if d[2] > 0.0:
                    sums[unit, FROM_SKY] += 1.0
                else:
                    sums[unit, FROM_BLACK] += 1.0
                sums[unit, SKYLIGHT] += math.pi * radiance
                if radiance > 0.0:
                    cosine = dot(n, d)
                    for band in range(bands):
                        k_d = diffuse_part(table, band, material, cosine, light.conserving)
                        sums[unit, FIRST_BAND + PER_BAND * band + OWN_SKY] += math.pi * radiance * k_d
                continue
            m, back = facing(g, hit, d)
            other = patch_at(g, hit, back, a, b) if back >= 0 else -1
            if other < 0:
                sums[unit, FROM_BLACK] += 1.0
                continue
            slot = place[other]
            if slot < 0:
                slot = met
                place[other] = slot
                index[unit, slot] = other
                count[unit, slot] = 0.0
                weight[unit, slot, :] = 0.0
                met += 1
            count[unit, slot] += 1.0
            cosine = dot(m, s)
            seen = 0.0
            if light.dni > 0.0 and cosine > 0.0 and s[2] > 0.0:
                rays += 1
                if not occluded(g, along_ray(p, t, d), s, hit):
                    seen = light.dni * cosine
            if seen > 0.0:
                for band in range(bands):
                    own = diffuse_part(table, band, material, dot(n, d), light.conserving)
                    lit = seen * diffuse_part(table, band, g.optics[hit], cosine, light.conserving)
                    sums[unit, FIRST_BAND + PER_BAND * band + SEEN] += lit
                    sums[unit, FIRST_BAND + PER_BAND * band + OWN_SEEN] += lit * own
            cosine = dot(n, d)
            for band in range(bands):
                weight[unit, slot, band] += diffuse_part(table, band, material, cosine, light.conserving)
        length[unit] = met
        for slot in range(met):
            place[index[unit, slot]] = -1
    return rays

"""Readings with a beam of width and divergence, by the simulated bench's own two-dimensional quadrature."""

from __future__ import annotations

import math

import numpy as np
from simulated_readings import FloatArray, Positions, fresnel_textbook

from gonio.aperture import Aperture, IncidentBeam
from gonio_simulators.bench.config import BeamTable, SampleTable
from gonio_simulators.bench.footprint import Point, directions, points
from gonio_simulators.bench.quadrature import diffuse_power, lobe_powers
from gonio_simulators.bench.view import View, view

_SAMPLE = SampleTable(width_mm=1000.0, height_mm=1000.0)


def bench_quadrature(
    at: Positions,
    rho_d: float,
    rho_s: float,
    alpha: float,
    n2: float,
    aperture: Aperture,
    beam: IncidentBeam,
) -> FloatArray:
    """Return r at every position, (n,)."""
    table = BeamTable(width_mm=beam.width_mm, height_mm=beam.height_mm, divergence_deg=beam.divergence_deg)
    width = 1.0 / math.sqrt(alpha + 1.0)

    def views(
        theta_o_rad: float, spot: list[Point], mirror: tuple[float, float, float]
    ) -> list[tuple[float, View]]:
        seen = [
            (
                p.weight,
                view(
                    width_mm=aperture.width_mm,
                    height_mm=aperture.height_mm,
                    distance_mm=aperture.distance_mm,
                    theta_o_rad=theta_o_rad,
                    point_mm=(p.x_mm, p.y_mm),
                    mirror=mirror,
                ),
            )
            for p in spot
        ]
        return [(w, v) for w, v in seen if v is not None]

    diffuse: dict[tuple[float, float], float] = {}
    lobes: dict[tuple[float, float], list[tuple[float, float, float, float]]] = {}
    r = np.empty(at.theta_i_deg.size)
    for k in range(r.size):
        theta_i, theta_o = math.radians(at.theta_i_deg[k]), math.radians(at.theta_o_deg[k])
        key = (theta_i, theta_o)
        if key not in diffuse:
            halved, whole = (
                points(theta_i, table, _SAMPLE, width * aperture.distance_mm, symmetric=x)
                for x in (True, False)
            )
            straight = (math.sin(theta_i), 0.0, math.cos(theta_i))
            diffuse[key] = diffuse_power(views(theta_o, halved, straight))
            lobes[key] = []
            for ray in directions(theta_i, table, width):
                seen = views(theta_o, halved if ray.mirror[1] == 0.0 else whole, ray.mirror)
                caught = float(lobe_powers(seen, np.array([alpha]))[0])
                lobes[key].append((ray.weight * caught, math.acos(ray.cos_theta_i), ray.s_share, caught))
        total = rho_d * diffuse[key]
        for caught, incidence, s_share, _ in lobes[key]:
            own = s_share if at.polarization[k] == "s" else 1.0 - s_share
            r_s, r_p = (
                float(fresnel_textbook(n2, np.array([math.degrees(incidence)]), np.array([x]))[0])
                for x in "sp"
            )
            total += rho_s * caught * (own * r_s + (1.0 - own) * r_p)
        r[k] = total
    return r

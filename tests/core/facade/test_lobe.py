"""Reflection by the lobe: mirror images, energy, and photons against backward paths."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from gonio import fresnel
from gonio.brdf.lobe import lobe_above_horizon
from gonio.facade import EnergyWarning, Optics, Scene, Sun, Surface, lobe, simulate, street
from gonio.facade.pack import pack

BLACK = Optics(0.0)


def reflectance(n2: float, theta_i_deg: float) -> float:
    return float(fresnel.reflectance(n2, theta_i_deg, "unpolarized"))


def opposite(right: Optics, *, elevation_deg: float, slant_deg: float, rows: int = 24) -> Scene:
    """Sun over a 12 m facade on a 30 m glossy one, 10 m apart, street north; the rest is black."""
    left, wall, ground = street(
        width_m=10.0, length_m=4000.0, height_left_m=12.0, height_right_m=30.0, azimuth_deg=0.0, left="black",
        right="glossy", ground="black",
    )  # fmt: skip
    return Scene(
        surfaces=(replace(left, rows=rows, columns=1), wall, replace(ground, rows=10, columns=1)),
        materials={"black": BLACK, "glossy": right},
        sun=Sun(270.0 - slant_deg, elevation_deg, 0.0),
        dni_w_m2=1000.0,
        dhi_w_m2=0.0,
        infinite=True,
    )


@pytest.mark.parametrize(
    ("elevation_deg", "slant_deg"), [(20.0, 0.0), (35.0, 20.0), (30.0, 60.0), (50.0, 75.0)]
)
def test_a_mirror_makes_the_image_of_the_sun(elevation_deg: float, slant_deg: float) -> None:
    result = simulate(
        opposite(Optics(0.0, 1.0, 1e6, 1.5), elevation_deg=elevation_deg, slant_deg=slant_deg),
        rel_tol=0.01,
        seed=3,
    )
    elevation, slant = math.radians(elevation_deg), math.radians(slant_deg)
    cosine = math.cos(elevation) * math.cos(slant)
    r = reflectance(1.5, math.degrees(math.acos(cosine)))
    drop = 10.0 * math.tan(elevation) / math.cos(slant)  # metres a ray falls while it crosses the street
    top, bottom = 30.0 - drop, max(12.0 - drop, 0.0) - drop  # of the reflected beam at the left wall
    left = result["left"]
    lower, upper = np.arange(24) / 2.0, np.arange(1, 25) / 2.0
    inside = (lower > bottom + 0.3) & (upper < top - 0.3)
    outside = (upper < bottom - 0.3) | (lower > top + 0.3)
    specular = left.contributions["specular"]
    assert np.count_nonzero(inside | outside) >= 18
    assert np.all(specular.value[outside, 0] == 0.0)
    if np.any(inside):
        z = (specular.value[inside, 0] - 1000.0 * r * cosine) / specular.standard_error[inside, 0]
        assert np.max(np.abs(z)) < 4.0
        assert specular.value[inside, 0].mean() == pytest.approx(1000.0 * r * cosine, rel=0.01)
    # What passes under the left wall's foot falls on the ground: the same beam, seen from above.
    reach = np.clip([top, bottom], -1e9, 0.0)
    lit_ground_m = (reach[0] - reach[1]) / drop * 10.0
    expected = 1000.0 * r * math.sin(elevation) * lit_ground_m / 10.0
    ground = result["ground"].mean_contributions["specular"]
    assert float(ground.value) == pytest.approx(expected, abs=4.0 * float(ground.standard_error) + 1e-9)


def one_wall(optics: Optics, theta_i_deg: float, **options: str) -> Scene:
    """A horizontal plate of 6 m2 alone in the sun."""
    plate = Surface("plate", (0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 3.0, 0.0), "m", 1, 1)
    sun = Sun(40.0, 90.0 - theta_i_deg, 0.0)
    return Scene((plate,), {"m": optics}, sun, 500.0, 0.0, **options)  # type: ignore[arg-type]


def retained(alpha: float, theta_i_deg: float) -> float:
    """Part of the lobe above the horizon, by quadrature over the hemisphere of the surface."""
    t = math.radians(theta_i_deg)

    def density(phi: float, theta: float) -> float:
        c = math.cos(theta) * math.cos(t) + math.sin(theta) * math.sin(t) * math.cos(phi)
        return (alpha + 1) / (2 * math.pi) * max(c, 0.0) ** alpha * math.sin(theta)

    half, _ = integrate.dblquad(density, 0.0, math.pi / 2, 0.0, math.pi, epsabs=1e-6)
    return 2.0 * half


@pytest.mark.parametrize(("alpha", "theta_i_deg"), [(1.0, 40.0), (10.0, 75.0), (10.0, 85.0), (100.0, 55.0)])
@pytest.mark.parametrize("horizon", ["absorb", "renormalize"])
def test_the_lobe_returns_k_s_above_the_horizon(alpha: float, theta_i_deg: float, horizon: str) -> None:
    optics = Optics(0.0, 1.0, alpha, 1.5)
    energy = simulate(
        one_wall(optics, theta_i_deg, horizon=horizon), rel_tol=0.01, seed=2, full=True, estimator="paths"
    ).energy
    power = 500.0 * 6.0 * math.cos(math.radians(theta_i_deg))
    assert energy.emitted_w == pytest.approx(power, rel=1e-9)
    k_s = reflectance(1.5, theta_i_deg)
    part = retained(alpha, theta_i_deg) if horizon == "absorb" else 1.0
    assert energy.escaped_w / power == pytest.approx(k_s * part, rel=0.005)
    assert energy.under_horizon_w / power == pytest.approx(k_s * (1.0 - part), rel=0.02, abs=1e-5)
    assert abs(energy.residual) < 1e-12


def test_energy_is_conserved_to_rounding_with_everything_glossy(canyon: Callable[..., Scene]) -> None:
    scene = canyon(
        wall=Optics(0.72, 1.0, 30.0, 1.5), ground=Optics(0.3, 2.0, 5.0, 1.33), dni=700.0, dhi=90.0, rows=3
    )
    result = simulate(scene, rel_tol=0.01, seed=5, full=True, estimator="paths")
    assert result.energy.created_w == 0.0
    assert result.energy.unfinished_w == 0.0
    assert abs(result.energy.residual) < 1e-12
    for r in result.receivers:
        parts = sum(r.contributions[name].value for name in r.contributions)
        assert r.value == pytest.approx(parts, rel=1e-13)


@pytest.mark.parametrize("theta_i_deg", [30.0, 80.0, 89.9])
def test_diffuse_part_takes_what_the_lobe_leaves(theta_i_deg: float) -> None:
    optics = Optics(0.72, 1.0, 1e8, 1.5)  # narrow enough to stay above the horizon at 89.9 deg
    k_s = reflectance(1.5, theta_i_deg)
    power = 500.0 * 6.0 * math.cos(math.radians(theta_i_deg))
    energy = simulate(
        one_wall(optics, theta_i_deg), rel_tol=0.01, seed=1, full=True, estimator="paths"
    ).energy
    assert energy.escaped_w / power == pytest.approx(k_s + min(0.72, 1.0 - k_s), rel=0.02)
    assert energy.escaped_w <= power * (1 + 1e-12)
    assert energy.created_w == 0.0


def test_published_energy_warns_with_angle_and_excess() -> None:
    scene = one_wall(Optics(0.72, 1.0, 1e6, 1.5), 85.0, energy="published")
    with pytest.warns(EnergyWarning, match=r"exceeds 1 from 76\.\d deg incidence, by up to 0\.7"):
        result = simulate(scene, rel_tol=0.01, full=True, estimator="paths")
    excess = 0.72 + reflectance(1.5, 85.0) - 1.0
    assert result.energy.created_w / result.energy.emitted_w == pytest.approx(excess, rel=1e-6)
    assert abs(result.energy.residual) < 1e-12
    assert any("76." in note for note in result.notes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(
            one_wall(Optics(0.5, 0.2, 50.0, 1.5), 60.0, energy="published"),
            rel_tol=0.01,
            full=True,
            estimator="paths",
        )


@pytest.mark.parametrize("sky_only", [False, True])
def test_photons_and_backward_paths_agree_for_a_broad_lobe(
    canyon: Callable[..., Scene], sky_only: bool, bands
) -> None:  # type: ignore[no-untyped-def]
    light = {"dni": 0.0, "dhi": 100.0} if sky_only else {"dni": 800.0, "dhi": 0.0}
    scene = canyon(wall=Optics(0.5, 4.0, 50.0, 1.5), ground=Optics(0.2), rows=4, **light)
    forward = simulate(scene, rel_tol=0.004, seed=1, full=True, estimator="paths")
    backward = simulate(scene, rel_tol=0.012, seed=2, estimator="backward", max_rays=60_000_000)
    assert forward.energy.emitted_w > 0.0
    assert backward.energy.emitted_w == 0.0
    for name in ("left", "right", "ground"):
        for part in ("sky", "diffuse", "specular"):
            a, b = forward[name].mean_contributions[part], backward[name].mean_contributions[part]
            se = math.hypot(float(a.standard_error), float(b.standard_error))
            assert abs(float(a.value) - float(b.value)) < 3.0 * se + 1e-12, (name, part)
    (x, sx), (y, sy) = bands(forward), bands(backward)
    assert np.max(np.abs(x - y) / np.hypot(sx, sy)) < 3.6
    assert sum(float(r.mean_contributions["specular"].value) for r in forward.receivers) > 5.0


def test_matte_scenes_need_no_photons(canyon: Callable[..., Scene]) -> None:
    result = simulate(canyon(dni=800.0, dhi=100.0), rel_tol=0.05, full=True, estimator="paths")
    assert result.energy.emitted_w == 0.0
    assert not np.any(result["left"].contributions["specular"].value)


def test_a_lobe_of_alpha_0_and_index_1_reflects_nothing(canyon: Callable[..., Scene]) -> None:
    glossy = simulate(
        canyon(wall=Optics(0.5, 3.0, 0.0, 1.0), dni=1.0), rel_tol=0.02, full=True, estimator="paths"
    )
    assert not np.any(glossy["left"].contributions["specular"].value)


@pytest.mark.parametrize("alpha", [1.0, 100.0, 1e4, 1e6])
def test_glossy_wall_to_receiver_is_not_noisier_for_a_narrow_lobe(alpha: float) -> None:
    scene = opposite(Optics(0.0, 1.0, alpha, 1.5), elevation_deg=20.0, slant_deg=30.0)
    result = simulate(scene, rel_tol=0.02, seed=1, max_rays=30_000_000)
    assert result.converged
    assert float(result["left"].mean_contributions["specular"].value) > 0.5


ALPHAS = [0.0, 1.0, 80.0, 1e4, 1e8]


@pytest.mark.parametrize("alpha", ALPHAS)
def test_part_above_the_horizon_in_the_kernels_is_that_of_the_fit(alpha: float) -> None:
    for theta_deg in (0.0, 5.0, 55.0, 75.0, 85.0, 89.9, 89.9999, 90.0):
        cosine = 0.0 if theta_deg == 90.0 else math.cos(math.radians(theta_deg))
        expected = float(lobe_above_horizon(alpha, theta_deg))
        assert lobe.above_horizon(alpha, cosine) == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("theta_i_deg", [20.0, 80.0, 89.99])
def test_a_renormalised_lobe_is_the_lobe_cut_by_the_horizon(alpha: float, theta_i_deg: float) -> None:
    # sin^2 of a lobe direction is distributed as 1 - (1 - sin^2)^((alpha+1)/2): with t = that value, t is
    # uniform for the whole lobe; cut, its density is the part of the circle about m that is above.
    packed = pack(
        (Surface("plate", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), "m"),),
        {"m": Optics(0.0, 1.0, alpha, 1.5)},
    )
    t_i = math.radians(theta_i_deg)
    incoming = (math.sin(t_i), 0.0, -math.cos(t_i))
    mirror = (incoming[0], 0.0, -incoming[2])
    normal = (0.0, 0.0, 1.0)
    n = 4096
    random = np.random.default_rng(5)
    first = (np.arange(n) + random.random(n)) / n
    second = (np.arange(n) * 0.6180339887498949 + random.random()) % 1.0
    count, ranks = 0, []
    for i in range(n):
        u, w = float(first[i]), float(second[i])
        _, _, above = lobe.off_the_lobe(packed.geometry, 0, normal, incoming, u, w, False, np.uint64(i))
        count += above
        d, m, above = lobe.off_the_lobe(packed.geometry, 0, normal, incoming, u, w, True, np.uint64(i))
        assert above
        assert m == pytest.approx(mirror, abs=1e-15)
        sine2 = float(np.sum(np.square(np.cross(d, m))))
        ranks.append(-math.expm1(0.5 * (alpha + 1.0) * math.log1p(-min(sine2, 1.0 - 1e-16))))
    part = float(lobe_above_horizon(alpha, theta_i_deg))
    assert count / n == pytest.approx(part, abs=0.006)
    # mean of t over the cut lobe by the midpoint rule
    t = (np.arange(20_000) + 0.5) / 20_000
    tan = np.sqrt(np.expm1(-2.0 * np.log1p(-t) / (alpha + 1.0)))
    circle = 1.0 - np.arccos(np.clip(1.0 / np.maximum(tan * math.tan(t_i), 1.0), 0.0, 1.0)) / math.pi
    assert np.mean(circle) == pytest.approx(part, abs=2e-3)
    expected = float(np.sum(t * circle) / np.sum(circle))
    assert np.mean(ranks) == pytest.approx(expected, abs=0.015)


@pytest.mark.parametrize("alpha", [0.0, 1.0, 10.0, 100.0])
@pytest.mark.parametrize("horizon", ["absorb", "renormalize"])
def test_forward_and_reverse_agree(canyon: Callable[..., Scene], alpha: float, horizon: str) -> None:
    scene = canyon(
        wall=Optics(0.4, 1.0, alpha, 1.5), ground=Optics(0.2, 0.5, 20.0, 1.4), rows=2, dni=800.0, dhi=100.0,
        height=0.7, horizon=horizon,
    )  # fmt: skip
    forward = simulate(scene, rel_tol=0.003, seed=1, estimator="paths", max_rays=2_000_000)
    reverse = simulate(scene, rel_tol=0.003, seed=2, estimator="backward", max_rays=2_000_000)
    z = []
    for name in ("left", "right", "ground"):
        a, b = forward[name].contributions["specular"], reverse[name].contributions["specular"]
        z.append((a.value - b.value) / np.hypot(a.standard_error, b.standard_error))
        assert np.all(a.standard_error < 0.05 * a.value)
    assert np.max(np.abs(z)) < 3.8
    assert np.sqrt(np.mean(np.square(z))) < 1.9

"""r of the whole bench against ray tracing, point limits and symmetries; the table against the quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gonio_simulators.bench.fresnel import reflectances
from gonio_simulators.bench.scattering import Scattering

POINT_BEAM = {"simulation.beam": {"width_mm": 0.0, "height_mm": 0.0}}


def test_fresnel_closed_forms() -> None:
    for n2 in (1.0, 1.24, 1.5, 3.0):
        r_s, r_p = reflectances(1.0, n2)
        assert r_s == pytest.approx(((n2 - 1) / (n2 + 1)) ** 2, rel=1e-14)
        assert r_p == pytest.approx(r_s, rel=1e-13)
        assert reflectances(0.0, n2) == ((1.0, 1.0) if n2 > 1 else (0.0, 0.0))
        brewster = math.atan(n2)
        assert reflectances(math.cos(brewster), n2)[1] == pytest.approx(0.0, abs=1e-28)
    # 45 deg: R_p = R_s^2, for any index
    r_s, r_p = reflectances(math.sqrt(0.5), 1.6)
    assert r_p == pytest.approx(r_s**2, rel=1e-13)


def ray_traced(
    *, theta_i_deg, theta_o_deg, alpha, beam, sample, divergence_deg, aperture, rays, seed
) -> tuple[float, float, float, float]:
    """Shares of the beam in the aperture by following rays: diffuse, lobe, each with its standard error."""
    rng = np.random.default_rng(seed)
    theta_i, theta_o = math.radians(theta_i_deg), math.radians(theta_o_deg)
    # the beam's cross-section, projected along the nominal direction on the sample
    x = rng.uniform(-0.5, 0.5, rays) * beam[0] / math.cos(theta_i)
    y = rng.uniform(-0.5, 0.5, rays) * beam[1]
    hits = (abs(x) <= sample[0] / 2) & (abs(y) <= sample[1] / 2)
    half = math.radians(divergence_deg) / 2
    tilt, out = theta_i + rng.uniform(-half, half, rays), rng.uniform(-half, half, rays)
    m = np.stack([np.sin(tilt) * np.cos(out), -np.sin(out), np.cos(tilt) * np.cos(out)])

    def caught(w: np.ndarray) -> tuple[float, float]:
        a = np.array([math.sin(theta_o), 0.0, math.cos(theta_o)])
        u = np.array([math.cos(theta_o), 0.0, -math.sin(theta_o)])
        width, height, distance = aperture
        ahead = a @ w
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (distance - x * a[0]) / ahead
            at = np.stack([x + length * w[0], y + length * w[1], length * w[2]])
        inside = (ahead > 0) & (length > 0) & (w[2] > 0) & hits
        inside &= (abs(u @ at) <= width / 2) & (abs(at[1]) <= height / 2)
        share = float(np.mean(inside))
        return share, math.sqrt(share * (1 - share) / rays)

    phi = rng.uniform(0, 2 * math.pi, rays)
    sin2 = rng.uniform(0, 1, rays)
    diffuse = np.stack([np.sqrt(sin2) * np.cos(phi), np.sqrt(sin2) * np.sin(phi), np.sqrt(1 - sin2)])
    cosine = rng.uniform(0, 1, rays) ** (1.0 / (alpha + 1.0))
    sine = np.sqrt(1 - cosine**2)
    side = np.stack([m[2], np.zeros(rays), -m[0]])
    side /= np.linalg.norm(side, axis=0)
    other = np.cross(m, side, axis=0)
    lobe = cosine * m + sine * (np.cos(phi) * side + np.sin(phi) * other)
    return *caught(diffuse), *caught(lobe)


@pytest.mark.parametrize(
    ("theta_i_deg", "theta_o_deg", "alpha", "beam", "sample", "divergence_deg"),
    [
        (30.0, 34.0, 60.0, (1.0, 1.0), (100.0, 100.0), 0.0),
        (45.0, 52.0, 20.0, (16.0, 10.0), (100.0, 100.0), 0.0),
        (60.0, 70.0, 90.0, (12.0, 12.0), (14.0, 8.0), 0.0),  # overfills the sample on both sides
        (20.0, 37.0, 2000.0, (2.0, 3.0), (50.0, 50.0), 8.0),  # divergence wider than the lobe
    ],
)
def test_against_ray_tracing(
    make_config, theta_i_deg, theta_o_deg, alpha, beam, sample, divergence_deg
) -> None:
    aperture = (60.0, 40.0, 95.0)  # large, so that rays find it
    changes = {
        "aperture": {"width_mm": aperture[0], "height_mm": aperture[1], "distance_mm": aperture[2]},
        "simulation.beam": {"width_mm": beam[0], "height_mm": beam[1], "divergence_deg": divergence_deg},
        "simulation.sample": {"width_mm": sample[0], "height_mm": sample[1]},
        "simulation.truth": {"rho_d": 1.0, "rho_s": 1.0, "alpha": alpha, "n2": 1.5},
    }
    bench = Scattering(make_config(changes))
    theta_mes_deg = theta_i_deg + theta_o_deg
    position = bench.position(theta_i_deg, theta_mes_deg)
    diffuse, diffuse_se, lobe, lobe_se = ray_traced(
        theta_i_deg=theta_i_deg,
        theta_o_deg=theta_o_deg,
        alpha=alpha,
        beam=beam,
        sample=sample,
        divergence_deg=divergence_deg,
        aperture=aperture,
        rays=400_000,
        seed=11,
    )
    assert position.diffuse == pytest.approx(diffuse, abs=4.5 * diffuse_se)
    whole_lobe = sum(
        d.weight * table.at(alpha) for d, table in zip(position.incident, position.lobes, strict=True)
    )
    assert whole_lobe == pytest.approx(lobe, abs=4.5 * lobe_se)


def test_small_aperture_sees_the_scattering_function_itself(make_config) -> None:
    truth = {"rho_d": 0.7, "rho_s": 0.9, "alpha": 40.0, "n2": 1.5}
    small = {"width_mm": 0.02, "height_mm": 0.02, "distance_mm": 100.0}
    bench = Scattering(make_config({**POINT_BEAM, "aperture": small, "simulation.truth": truth}))
    solid_angle = (0.02 / 100.0) ** 2
    for theta_i_deg, theta_mes_deg in ((20.0, 45.0), (55.0, 120.0), (30.0, 15.0)):
        theta_i, theta_o = math.radians(theta_i_deg), math.radians(theta_mes_deg - theta_i_deg)
        lobe = 41.0 / (2.0 * math.pi) * math.cos(theta_o - theta_i) ** 40
        for s_fraction, reflectance in zip((1.0, 0.0), reflectances(math.cos(theta_i), 1.5), strict=True):
            dsf = 0.7 / math.pi * math.cos(theta_o) + 0.9 * reflectance * lobe
            r = bench.r(theta_i_deg, theta_mes_deg, s_fraction, 500.0)
            assert r == pytest.approx(dsf * solid_angle, rel=1e-6)
            flying = bench.r_at_centre(theta_i_deg, theta_mes_deg, s_fraction, 500.0)
            assert flying == pytest.approx(r, rel=1e-6)


def test_the_polarizer_in_between_mixes_s_and_p(make_config) -> None:
    bench = Scattering(make_config())
    s, p, mixed = (bench.r(45.0, 88.0, f, 600.0) for f in (1.0, 0.0, 0.25))
    assert mixed == pytest.approx(0.25 * s + 0.75 * p, rel=1e-13)
    assert s > p


@pytest.mark.parametrize("alpha_range", [(70.0, 110.0), (0.0, 3.0), (1.0, 1e6)])
def test_table_over_alpha_is_the_quadrature(make_config, alpha_range: tuple[float, float]) -> None:
    low, high = alpha_range
    alpha = {"wavelength_nm": [300.0, 1500.0], "value": [low, high]}
    bench = Scattering(make_config({**POINT_BEAM, "simulation.truth.alpha": alpha}))
    rng = np.random.default_rng(3)
    for theta_i_deg, theta_mes_deg in ((20.0, 40.0), (45.0, 81.0), (55.0, 15.0), (55.0, 139.5)):
        (table,) = bench.position(theta_i_deg, theta_mes_deg).lobes
        alphas = np.exp(rng.uniform(math.log1p(low), math.log1p(high), 40)) - 1.0
        direct = table.direct(alphas)
        read = np.array([table.at(a) for a in alphas.tolist()])
        assert np.max(np.abs(read - direct)) <= 1e-8 * np.max(direct)


def test_alpha_beyond_the_table_is_integrated(make_config) -> None:
    bench = Scattering(make_config({"simulation.truth.alpha": 50.0}))
    (table,) = bench.position(30.0, 61.0).lobes
    assert table.at(50.0) == pytest.approx(float(table.direct(np.array([50.0]))[0]), rel=1e-14)
    assert table.at(400.0) == pytest.approx(float(table.direct(np.array([400.0]))[0]), rel=1e-14)


def test_left_and_right_are_alike(make_config) -> None:
    bench = Scattering(make_config({"simulation.beam": {"width_mm": 4.0, "height_mm": 2.0}}))
    for theta_i_deg, theta_mes_deg in ((20.0, 38.0), (55.0, 15.0), (45.0, 130.0)):
        one = bench.r(theta_i_deg, theta_mes_deg, 0.3, 700.0)
        assert bench.r(-theta_i_deg, -theta_mes_deg, 0.3, 700.0) == pytest.approx(one, rel=1e-12)


def test_nothing_comes_from_an_edge_on_or_reversed_sample(make_config) -> None:
    bench = Scattering(make_config())
    assert bench.r(90.0, 120.0, 1.0, 500.0) == 0.0
    assert bench.r(95.0, 120.0, 1.0, 500.0) == 0.0
    assert bench.r(30.0, 180.0, 1.0, 500.0) == 0.0  # the arm is behind the sample

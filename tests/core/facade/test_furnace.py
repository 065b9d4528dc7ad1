"""White furnaces: where nothing absorbs, everything comes back, photon by photon."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from gonio.facade import Optics, Scene, Surface, kernels, layout
from gonio.facade.layout import Light
from gonio.facade.pack import Packed, pack
from gonio.facade.sobol import sobol_directions
from gonio.facade.starts import chances

REPLICAS = 16
WHITE = Optics(1.0, 1.0, 30.0, 1.5)


def uniform_sky(radiance: float = 1.0, **how: bool) -> Light:
    return Light(
        sun=np.array([0.0, 0.0, 1.0]),
        disc=0.0,
        dni=0.0,
        dhi=math.pi * radiance,
        sky=np.array([radiance, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        conserving=how.get("conserving", True),
        renormalize=how.get("renormalize", True),
    )


def fly(
    packed: Packed, light: Light, source: int, points: int, *, follow: bool, polarised: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return tally, diffusely reflected part, and energy account of each unit, per photon."""
    n = len(packed.patches.area)
    units = REPLICAS * (n if source == layout.PATCH else 1)
    chance = np.ones(1) if source == layout.PATCH else chances(packed.geometry, light, source, follow=follow)
    tally, tally_d, energy = np.zeros((units, n)), np.zeros((units, n)), np.zeros((units, 8))
    kernels.photons(
        packed.geometry, light, packed.patches, chance, sobol_directions(), np.uint64(3), source, REPLICAS,
        follow, polarised, 0, (0, units, 0, points), tally, tally_d, energy,
    )  # fmt: skip
    return tally / points, tally_d / points, energy / points


def canyon_of(
    canyon: Callable[..., Scene], wall: Optics, ground: Optics, rows: int, height: float = 1.0
) -> Packed:
    scene = canyon(wall=wall, ground=ground, rows=rows, height=height)
    return pack(scene.surfaces, scene.materials, periodic=True)


@pytest.mark.parametrize(
    "optics", [WHITE, Optics(1.0, 0.4, 3.0, constant=True), Optics(0.0, 1.0, 5.0, constant=True)]
)
@pytest.mark.parametrize("polarised", [False, True])
def test_a_white_canyon_returns_all_light_to_the_sky(
    canyon: Callable[..., Scene], optics: Optics, polarised: bool
) -> None:
    packed = canyon_of(canyon, optics, optics, 2, height=2.0)
    _, _, energy = fly(packed, uniform_sky(), layout.SKYLIGHT, 256, follow=True, polarised=polarised)
    total = energy.sum(axis=0)
    assert total[layout.ABSORBED] == pytest.approx(0.0, abs=1e-12 * total[layout.EMITTED])
    assert total[layout.UNFINISHED] == 0.0
    assert total[layout.ESCAPED] == pytest.approx(total[layout.EMITTED], rel=1e-12)


@pytest.mark.parametrize("source", [layout.SKYLIGHT, layout.PATCH])
def test_what_takes_the_lobe_in_a_white_canyon_is_handed_on_or_leaves(
    canyon: Callable[..., Scene], source: int
) -> None:
    packed = canyon_of(canyon, WHITE, WHITE, 3)
    _, _, energy = fly(packed, uniform_sky(), source, 256, follow=False)
    total = energy.sum(axis=0)
    assert total[layout.ABSORBED] == pytest.approx(0.0, abs=1e-13 * total[layout.EMITTED])
    assert total[layout.HANDED] + total[layout.ESCAPED] == pytest.approx(total[layout.EMITTED], rel=1e-12)


def test_in_a_sealed_room_light_is_handed_over_and_never_lost() -> None:
    side = 2.0
    corners = {
        "floor": ((0, 0, 0), (side, 0, 0), (0, side, 0)),
        "ceiling": ((0, 0, side), (0, side, 0), (side, 0, 0)),
        "west": ((0, 0, 0), (0, side, 0), (0, 0, side)),
        "east": ((side, 0, 0), (0, 0, side), (0, side, 0)),
        "south": ((0, 0, 0), (0, 0, side), (side, 0, 0)),
        "north": ((0, side, 0), (side, 0, 0), (0, 0, side)),
    }
    surfaces = tuple(Surface(name, *map(tuple, c), "m", 1, 1) for name, c in corners.items())
    packed = pack(surfaces, {"m": Optics(0.3, 3.0, 200.0, 1.5)})
    tally, tally_d, energy = fly(packed, uniform_sky(), layout.PATCH, 64, follow=False)
    total = energy.sum(axis=0)
    assert total[layout.EMITTED] > 0.0
    assert total[layout.ESCAPED] == 0.0
    assert total[layout.UNFINISHED] == 0.0
    assert total[layout.HANDED] + total[layout.ABSORBED] == pytest.approx(total[layout.EMITTED], rel=1e-12)
    assert tally_d.sum() == pytest.approx(total[layout.HANDED], rel=1e-12)
    assert tally.sum() > tally_d.sum()


def test_a_patch_sends_its_view_factor_into_the_lobes_it_sees(canyon: Callable[..., Scene]) -> None:
    packed = canyon_of(canyon, Optics(0.5, 0.25, 20.0, constant=True), Optics(0.2), 4)
    _, _, energy = fly(packed, uniform_sky(renormalize=False), layout.PATCH, 1024, follow=False)
    total = energy.sum(axis=0)
    ends = total[layout.ABSORBED] + total[layout.ESCAPED] + total[layout.HANDED] + total[layout.UNFINISHED]
    assert ends == pytest.approx(total[layout.EMITTED], rel=1e-13)
    # H/W 1: a band of a wall sees the other wall, on average sqrt(2) - 1 of its light, and k_s is 1/4
    per_patch = energy.reshape(-1, REPLICAS, 8).sum(axis=1)[:, layout.EMITTED] / REPLICAS
    normal = packed.geometry.normal[packed.patches.primitive]
    walls = np.abs(normal[:, 0]) > 0.5
    assert per_patch[walls].mean() == pytest.approx(0.25 * (math.sqrt(2.0) - 1.0), rel=2e-3)
    assert per_patch[~walls].mean() == pytest.approx(0.25 * (2.0 - math.sqrt(2.0)), rel=2e-3)


def test_exchange_of_the_diffuse_part_and_followed_photons_agree(canyon: Callable[..., Scene]) -> None:
    """Sun on a glossy wall that is not matte; the ground is matte, lies in the shade and sees the wall again.

    What the photons hand over leaves the ground and meets lobes again: on the ground, which no diffuse light
    reaches without a lobe, E = E_lobe + G M with M = M_lobe + G_d M.
    """
    sun = Light(
        sun=np.array([0.8, 0.0, 0.6]),
        disc=0.0,
        dni=1000.0,
        dhi=0.0,
        sky=np.zeros(7),
        conserving=True,
        renormalize=False,
    )
    scene = canyon(
        wall=Optics(0.0, 0.8, 1.0, constant=True),
        right=Optics(0.0),
        ground=Optics(0.6, 1.5, 40.0, 1.4),
        rows=12,
    )
    packed = pack(scene.surfaces, scene.materials, periodic=True)
    area = packed.patches.area
    n = len(area)
    followed, _, _ = fly(packed, sun, layout.SUN, 4096, follow=True)
    lobe, lobe_d, _ = fly(packed, sun, layout.SUN, 4096, follow=False)
    column, column_d, _ = fly(packed, sun, layout.PATCH, 256, follow=False)
    gain, gain_d = (
        (x.reshape(n, REPLICAS, n).mean(axis=1) * area[:, None] / area).T for x in (column, column_d)
    )
    matte = np.isclose(packed.geometry.materials[packed.geometry.optics[packed.patches.primitive], 0], 0.6)
    exitance = np.linalg.solve(np.eye(n) - gain_d, lobe_d.mean(axis=0) / area)
    assert np.all(exitance[~matte] == 0.0)
    irradiance = (lobe.mean(axis=0) / area + gain @ exitance)[matte]
    expected = (followed.mean(axis=0) / area)[matte]
    error = (followed.std(axis=0, ddof=1) / area)[matte] / math.sqrt(REPLICAS)
    assert irradiance.sum() == pytest.approx(expected.sum(), rel=2e-3)
    assert np.all(np.abs(irradiance - expected) < 4.5 * error + 0.003 * expected)
    assert (gain @ exitance)[matte].sum() > 0.01 * expected.sum()  # five times the tolerance

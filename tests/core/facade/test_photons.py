"""The photon kernel by itself: energy account, what it hands to the exchange, emission from patches."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from gonio.facade import Optics, Surface, kernels, layout
from gonio.facade.layout import Light
from gonio.facade.pack import Packed, pack
from gonio.facade.sobol import sobol_directions
from gonio.facade.starts import chances

REPLICAS = 4


def light(
    direction: tuple[float, float, float], *, dni: float = 0.0, radiance: float = 0.0, **how: Any
) -> Light:
    """Sun without a disc in `direction`, and a sky of constant `radiance`."""
    return Light(
        sun=np.array(direction) / np.linalg.norm(direction),
        disc=0.0,
        dni=dni,
        dhi=radiance * math.pi,
        sky=np.array([radiance, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        conserving=how.get("conserving", True),
        renormalize=how.get("renormalize", False),
    )


def fly(
    packed: Packed, sun: Light, source: int, *, points: int, follow: bool = False, polarised: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return tallies, diffusely reflected part and energy account per unit and photon."""
    n = len(packed.patches.area)
    units = REPLICAS * (n if source == layout.PATCH else 1)
    chance = np.ones(1) if source == layout.PATCH else chances(packed.geometry, sun, source, follow=follow)
    tally, tally_d, energy = np.zeros((units, n)), np.zeros((units, n)), np.zeros((units, 8))
    kernels.photons(
        packed.geometry, sun, packed.patches, chance, sobol_directions(), np.uint64(7), source, REPLICAS,
        follow, polarised, 0, (0, units, 0, points), tally, tally_d, energy,
    )  # fmt: skip
    return tally / points, tally_d / points, energy / points


def corner(wall: Optics, floor: Optics, *, rows: int = 1) -> Packed:
    """A wall of 1 m x 1 m that faces +x, and a floor of 1 m x 1 m that it stands on."""
    return pack(
        (
            Surface("wall", (0, 0, 0), (0, 1, 0), (0, 0, 1), "wall", rows, rows),
            Surface("floor", (0, 0, 0), (1, 0, 0), (0, 1, 0), "floor", rows, rows),
        ),
        {"wall": wall, "floor": floor},
    )


def balance(energy: np.ndarray) -> np.ndarray:
    total = energy.sum(axis=0)
    ends = (layout.ABSORBED, layout.ESCAPED, layout.HANDED, layout.UNFINISHED)
    return total[layout.EMITTED] + total[layout.CREATED] - sum(total[i] for i in ends)


@pytest.mark.parametrize("energy_rule", ["conserving", "published"])
@pytest.mark.parametrize("source", [layout.SUN, layout.SKYLIGHT, layout.PATCH])
def test_what_takes_a_lobe_ends_somewhere(source: int, energy_rule: str) -> None:
    packed = corner(Optics(0.6, 3.0, 8.0, 1.5), Optics(0.3, 9.0, 200.0, 1.3), rows=3)
    sun = light((0.4, 0.1, 0.3), dni=800.0, radiance=30.0, conserving=energy_rule == "conserving")
    _, tally_d, energy = fly(packed, sun, source, points=512)
    assert abs(balance(energy)) < 1e-13 * energy[:, layout.EMITTED].sum()
    assert energy[:, layout.EMITTED].sum() > 0.0
    assert energy[:, layout.UNFINISHED].sum() == 0.0
    assert tally_d.sum() == pytest.approx(energy[:, layout.HANDED].sum(), rel=1e-12)
    if energy_rule == "conserving":
        assert energy[:, layout.CREATED].sum() == 0.0


def test_a_mirror_wall_hands_its_image_of_the_sun_to_the_floor() -> None:
    # The sun's ray (-0.6, 0, -0.8) turns at the wall into (0.6, 0, -0.8) and lands at x = 0.75 z.
    packed = corner(Optics(0.0, 1.0, 1e8, 1.5), Optics(0.4))
    tally, tally_d, energy = fly(packed, light((0.6, 0.0, 0.8), dni=1000.0), layout.SUN, points=64)
    r_s, r_p = reflectances(1.5, 0.6)
    power = 1000.0 * 0.6 * 0.5 * (r_s + r_p)
    floor = 1 if packed.geometry.normal[packed.patches.primitive[1], 2] == 1.0 else 0
    assert tally.mean(axis=0)[floor] == pytest.approx(power, rel=1e-9)
    assert tally_d.mean(axis=0)[floor] == pytest.approx(0.4 * power, rel=1e-9)
    assert energy[:, layout.EMITTED] == pytest.approx(np.full(REPLICAS, power), rel=1e-12)


def reflectances(n2: float, cosine: float) -> tuple[float, float]:
    q = math.sqrt(n2 * n2 - 1.0 + cosine * cosine)
    return ((cosine - q) / (cosine + q)) ** 2, ((n2**2 * cosine - q) / (n2**2 * cosine + q)) ** 2


def test_followed_to_the_end_or_handed_over_the_first_landing_is_the_same() -> None:
    packed = corner(Optics(0.0, 1.0, 40.0, 1.5), Optics(0.0))
    sun = light((0.6, 0.2, 0.5), dni=1000.0)
    one, _, _ = fly(packed, sun, layout.SUN, points=4096)
    two, _, energy = fly(packed, sun, layout.SUN, points=4096, follow=True)
    assert one.mean(axis=0) == pytest.approx(two.mean(axis=0), rel=0.01)
    assert abs(balance(energy)) < 1e-13 * energy[:, layout.EMITTED].sum()

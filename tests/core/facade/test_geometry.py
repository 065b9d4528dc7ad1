from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from gonio.errors import SceneError
from gonio.facade import Optics, Scene, Sun, Surface, box, street
from gonio.facade.geometry import heading
from gonio.facade.intersect import nearest, occluded
from gonio.facade.layout import Geometry, Patches
from gonio.facade.pack import pack

MATT = {"matt": Optics(0.5)}


def unpacked(surfaces: Sequence[Surface]) -> tuple[Geometry, Patches, np.ndarray, int]:
    packed = pack(surfaces, MATT)
    return packed.geometry, packed.patches, packed.centre_m, packed.cells


def nearest_by_hand(surfaces: list[Surface], p: np.ndarray, d: np.ndarray) -> tuple[str, float]:
    """Solve each 3 x 3 system p + t d = o + a u + b v directly."""
    best = ("", np.inf)
    for s in surfaces:
        u, v = np.array(s.u_m), np.array(s.v_m)
        a, b, t = np.linalg.solve(np.column_stack([u, v, -d]), p - np.array(s.origin_m))
        if 0 <= a <= 1 and 0 <= b <= 1 and 0 < t < best[1]:
            best = (s.name, float(t))
    return best


@pytest.mark.parametrize("shift_m", [0.0, 5e5])
def test_tree_finds_what_solving_every_surface_finds(shift_m: float) -> None:
    rng = np.random.default_rng(5)
    surfaces: list[Surface] = []
    for i in range(40):
        x, y = rng.uniform(-100, 100, 2) + shift_m
        size = tuple(float(c) for c in rng.uniform(2, 25, 3))
        surfaces += box(
            f"b{i}", centre_m=(x, y, 0.0), size_m=size, azimuth_deg=rng.uniform(0, 360), material="matt"
        )
    g, _, centre, _ = unpacked(surfaces)
    assert sorted(g.rank) == list(range(240))
    hits = 0
    for _ in range(400):
        p = np.append(rng.uniform(-120, 120, 2) + shift_m, rng.uniform(1, 40))
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        k, t, a, b = nearest(g, tuple(p - centre), tuple(d), -1)
        name, expected_t = nearest_by_hand(surfaces, p, d)
        assert (surfaces[g.rank[k]].name if k >= 0 else "") == name
        assert occluded(g, tuple(p - centre), tuple(d), -1) == (name != "")
        if name:
            hits += 1
            assert t == pytest.approx(expected_t, rel=1e-9)
            point = centre + g.origin[k] + a * g.u[k] + b * g.v[k]
            assert point == pytest.approx(p + t * d, abs=1e-9 * max(1.0, shift_m))
    assert hits > 50


def test_rays_along_the_axes_see_walls_whose_planes_they_do_not_lie_in() -> None:
    surfaces = box("b", centre_m=(0, 0, 0), size_m=(2, 2, 2), azimuth_deg=0, material="matt")
    g, _, centre, _ = unpacked(surfaces)
    k, t, _, _ = nearest(g, tuple(np.array((0.5, -5.0, 1.0)) - centre), (0.0, 1.0, 0.0), -1)
    assert surfaces[g.rank[k]].name == "b.back"
    assert t == pytest.approx(4.0)
    k, t, _, _ = nearest(g, tuple(np.array((0.0, 0.0, 9.0)) - centre), (0.0, 0.0, -1.0), -1)
    assert surfaces[g.rank[k]].name == "b.top"
    assert t == pytest.approx(7.0)


@pytest.mark.parametrize("azimuth_deg", [0.0, 20.0, 123.0, 340.0])
def test_faces_look_outwards_and_facades_at_each_other(azimuth_deg: float) -> None:
    centre = np.array([3.0, -4.0, 1.0])
    for s in box("b", centre_m=tuple(centre), size_m=(4, 6, 8), azimuth_deg=azimuth_deg, material="matt"):
        middle = np.array(s.origin_m) + 0.5 * np.array(s.u_m) + 0.5 * np.array(s.v_m)
        assert s.normal @ (middle - (centre + np.array([0, 0, 4]))) > 0
    front = box("b", centre_m=(0, 0, 0), size_m=(4, 6, 8), azimuth_deg=azimuth_deg, material="matt")[0]
    assert front.normal == pytest.approx(np.array(heading(azimuth_deg)), abs=1e-12)

    left, right, ground = street(
        width_m=10, length_m=50, height_left_m=8, height_right_m=12, azimuth_deg=azimuth_deg, left="matt",
        right="matt", ground="matt",
    )  # fmt: skip
    to_right = np.array(heading(azimuth_deg + 90.0))
    assert left.normal == pytest.approx(to_right, abs=1e-12)
    assert right.normal == pytest.approx(-to_right, abs=1e-12)
    assert ground.normal == pytest.approx([0, 0, 1], abs=1e-12)
    for s in (left, right, ground):
        assert np.array(s.u_m) == pytest.approx(50 * np.array(heading(azimuth_deg)), abs=1e-12)
    assert (left.area_m2, right.area_m2, ground.area_m2) == pytest.approx((400, 600, 500))


def test_compass_is_exact_at_its_points() -> None:
    assert [heading(a)[:2] for a in (0, 90, 180, 270, 360, -90)] == [
        (0, 1), (1, 0), (0, -1), (-1, 0), (0, 1), (-1, 0)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"v_m": (2.0, 0.0, 0.0)}, "area of 0 m2"),
        ({"origin_m": (np.nan, 0.0, 0.0)}, "not a finite number"),
        ({"material": "gold"}, "not among the materials"),
        ({"columns": 0}, "2 x 0 patches"),
    ],
)
def test_surfaces_that_cannot_be_traced_are_refused(change: dict[str, object], message: str) -> None:
    good = {"name": "s", "origin_m": (0.0, 0.0, 0.0), "u_m": (1.0, 0.0, 0.0), "v_m": (0.0, 1.0, 0.0),
            "material": "matt", "rows": 2, "columns": 2}  # fmt: skip
    with pytest.raises(SceneError, match=message):
        Scene((Surface(**(good | change)),), MATT, Sun(0.0, 45.0), 1.0, 1.0)  # type: ignore[arg-type]

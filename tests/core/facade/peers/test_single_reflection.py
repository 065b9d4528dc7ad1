"""Sun, one lobe, receivers: against a quadrature that uses none of the engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gonio import fresnel
from gonio.facade import Optics, Scene, Sun, simulate, street

from .single_reflection import irradiance


@pytest.mark.parametrize("alpha", [0.0, 3.0, 100.0, 1e4, 1e6, 1e8])
def test_sun_on_a_glossy_wall(alpha: float) -> None:
    sun = Sun(265.0, 28.0, 0.0)
    left, right, ground = street(
        width_m=7.0, length_m=1.0, height_left_m=6.0, height_right_m=9.0, azimuth_deg=0.0, left="black",
        right="glossy", ground="black",
    )  # fmt: skip
    optics = Optics(0.0, 0.9, alpha, 1.6)
    scene = Scene(
        surfaces=(replace(left, rows=8, columns=1), right, ground),
        materials={"black": Optics(0.0), "glossy": optics},
        sun=sun,
        dni_w_m2=850.0,
        dhi_w_m2=0.0,
        infinite=True,
    )
    theta_i_deg = float(np.degrees(np.arccos(-sun.direction[0])))
    expected = irradiance(
        width=7.0, left_height=6.0, right_height=9.0, bands=8, sun=sun.direction, dni=850.0,
        k_s=0.9 * float(fresnel.reflectance(1.6, theta_i_deg, "unpolarized")), alpha=alpha, nodes=600,
    )  # fmt: skip
    found = simulate(scene, rel_tol=0.01, seed=4)["left"].contributions["specular"]
    value, se = found.value[:, 0], found.standard_error[:, 0]
    assert expected.mean() > 1.0
    assert np.max(np.abs(value - expected) / np.hypot(se, 1e-3 * expected.mean())) < 4.0
    assert np.sqrt(np.mean((value - expected) ** 2)) < 0.015 * expected.mean()

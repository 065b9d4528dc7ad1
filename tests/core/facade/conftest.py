"""Scenes the facade tests share: canyons whose answers are known in closed form or by radiosity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gonio.facade import Irradiance, Optics, Scene, Sun, street

Canyon = Callable[..., Scene]


@pytest.fixture
def canyon() -> Canyon:
    """Build an endless canyon of width 1 along north; the left wall faces east."""

    def build(
        *,
        height: float = 1.0,
        wall: Optics = Optics(0.72),  # noqa: B008
        right: Optics | None = None,
        ground: Optics = Optics(0.2),  # noqa: B008
        sun: Sun = Sun(60.0, 50.0, 0.0),  # noqa: B008
        dni: float = 0.0,
        dhi: float = 0.0,
        rows: int = 10,
        columns: int = 1,
        length: float = 1.0,
        infinite: bool = True,
        **options: Any,
    ) -> Scene:
        surfaces = street(
            width_m=1.0,
            length_m=length,
            height_left_m=height,
            height_right_m=height,
            azimuth_deg=0.0,
            left="left",
            right="right",
            ground="ground",
        )
        return Scene(
            surfaces=tuple(replace(s, rows=rows, columns=columns) for s in surfaces),
            materials={"left": wall, "right": wall if right is None else right, "ground": ground},
            sun=sun,
            dni_w_m2=dni,
            dhi_w_m2=dhi,
            infinite=infinite,
            **options,
        )

    return build


@pytest.fixture
def bands() -> Callable[[Irradiance], tuple[np.ndarray, np.ndarray]]:
    """Return all patches of a result, receiver after receiver: values and standard errors."""

    def collect(result: Irradiance) -> tuple[np.ndarray, np.ndarray]:
        return (
            np.concatenate([r.value.ravel() for r in result.receivers]),
            np.concatenate([r.standard_error.ravel() for r in result.receivers]),
        )

    return collect

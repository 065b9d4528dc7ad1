"""In which spectral bands is the light carried, and how much of it lies in each?

The engine carries one band at a time, with materials averaged over it.  A scene of several bands is their
sum, each with its share of the direct and of the diffuse irradiance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gonio.errors import SceneError
from gonio.facade.optics import FloatArray, Optics
from gonio.spectral import am15g

SHARES = 1e-9
"""Distance from 1 at which the shares of all bands still make up the whole."""


@dataclass(frozen=True, slots=True)
class Band:
    """One band of the light.

    Parameters
    ----------
    low_nm, high_nm
        Its limits.
    dni_share, dhi_share
        Parts of the scene's direct normal and diffuse horizontal irradiance that lie in it, 0...1.
    materials
        Averages over the band, by the names that the scene's surfaces use.
    """

    low_nm: float
    high_nm: float
    dni_share: float
    dhi_share: float
    materials: Mapping[str, Optics]

    @property
    def name(self) -> str:
        """The limits as text, such as ``380-740 nm``."""
        return f"{self.low_nm:g}-{self.high_nm:g} nm"


def check(bands: Sequence[Band], materials: Mapping[str, Optics]) -> None:
    """Raise `SceneError` unless the bands follow each other and share out all light and all materials."""
    if not bands:
        return
    if len(bands) == 1 and dict(bands[0].materials) != dict(materials):
        raise SceneError(
            f"the only band {bands[0].name} has other materials than the scene; change both, or leave it out"
        )
    before = 0.0
    for band in bands:
        if not (0.0 < band.low_nm < band.high_nm < math.inf):
            raise SceneError(
                f"band {band.name} is no band; give two wavelengths above 0, the shorter one first"
            )
        if band.low_nm < before:
            raise SceneError(
                f"band {band.name} begins below {before:g} nm, where the one before it ends; "
                "give bands in ascending order that do not overlap"
            )
        before = band.high_nm
        for key in ("dni_share", "dhi_share"):
            value = getattr(band, key)
            if not 0.0 <= value <= 1.0:
                raise SceneError(f"band {band.name}: {key} = {value:g} is outside 0...1; correct it")
        missing = [name for name in materials if name not in band.materials]
        if missing:
            raise SceneError(
                f"band {band.name} lacks the material '{missing[0]}'; give every band all materials"
            )
    for key in ("dni_share", "dhi_share"):
        total = math.fsum(getattr(band, key) for band in bands)
        if abs(total - 1.0) > SHARES:
            raise SceneError(
                f"the bands' {key} add up to {total:.10g}; they must add up to 1, or light is lost or doubled"
            )


def power_shares(limits_nm: Sequence[tuple[float, float]]) -> FloatArray:
    """Return the part of the power of AM1.5G (ASTM G173-03) in each band, of that in all of them; sums to 1.

    `SceneError` for a band without power: the spectrum runs from 280 to 4000 nm.
    """
    power = []
    for low, high in limits_nm:
        knots = np.unique(np.concatenate([[low, high], np.arange(280.0, 4000.25, 0.5)]))  # all of its entries
        knots = knots[(knots >= low) & (knots <= high)]
        value = am15g(knots)
        power.append(float(np.sum(0.5 * np.diff(knots) * (value[1:] + value[:-1]))))
        if not power[-1] > 0.0:
            raise SceneError(
                f"band {low:g}-{high:g} nm has no power in AM1.5G, which runs from 280 to 4000 nm; "
                "give bands within, or the shares by dni_share and dhi_share"
            )
    share = np.asarray(power) / math.fsum(power)
    share[-1] = 1.0 - math.fsum(share[:-1])
    return np.asarray(share)

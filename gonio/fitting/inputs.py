"""Which causes can shift all readings of a scan together, and how well is each known?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gonio.config import parse_toml, validate
from gonio.rig.uncertainty import Distribution, UncertaintyConfig

if TYPE_CHECKING:
    from gonio.aperture import Aperture

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Input:
    """One input quantity of the budget.

    Attributes
    ----------
    name, unit
        Name in `[uncertainty]` without its unit.
    value
        What the fit takes it to be.
    u
        Standard uncertainty, None if it was not stated.
    distribution, wording
        About `value`, and how it was stated.
    even
        Whether the readings depend on its square: an error of either sign has the same effect, so that there
        is no first order (a tilt out of the plane, a turned polarizer).
    """

    name: str
    unit: str
    value: float
    u: float | None = None
    distribution: Distribution = "normal"
    wording: str = "not stated, taken as 0"
    even: bool = False

    @property
    def root_mean_fourth(self) -> float:
        """``sqrt(E[x^4]) / u^2``: sqrt(3) of a normal, sqrt(9/5) of a rectangular distribution."""
        return float(np.sqrt(3.0 if self.distribution == "normal" else 1.8))

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Return `count` errors of the input, value not included."""
        u = 0.0 if self.u is None else self.u
        if self.distribution == "normal":
            return np.asarray(u * rng.standard_normal(count))
        return np.asarray(np.sqrt(3.0) * u * rng.uniform(-1.0, 1.0, count))


_EVEN = ("sample_tilt", "polarizer_angle")
_UNITS = ("_mm", "_deg", "_nm", "_relative", "_per_decade", "_r")
_SHOWN = {"_relative": "1", "_per_decade": "1/decade", "_r": "1"}


def inputs_of(config: UncertaintyConfig | None, instrument: Aperture) -> tuple[Input, ...]:
    """Return every known input, those that were not stated too.

    `instrument` gives the values of the aperture's dimensions.
    """
    values = {
        "aperture_width": instrument.width_mm,
        "aperture_height": instrument.height_mm,
        "distance": instrument.distance_mm,
    }
    found = []
    for key in UncertaintyConfig.model_fields:
        suffix = next((unit for unit in _UNITS if key.endswith(unit)), "")
        name = key.removesuffix(suffix)
        unit = _SHOWN.get(suffix, suffix.removeprefix("_") or "1")
        stated = getattr(config, key) if config is not None else None
        value, even = values.get(name, 0.0), name in _EVEN
        if stated is None:
            found.append(Input(name, unit, value, even=even))
        else:
            found.append(Input(name, unit, value, stated.standard, stated.distribution, stated.wording, even))
    return tuple(found)


def stated_in(rig_text: str) -> UncertaintyConfig | None:
    """Return the ``[uncertainty]`` table of a rig file's text, such as a scan stores; None without one.

    Raises
    ------
    ConfigError
        The table is there and cannot be read.
    """
    if not rig_text:
        return None
    table: Mapping[str, Any] | None = parse_toml(rig_text, source="rig").get("uncertainty")
    if table is None:
        return None
    return validate(UncertaintyConfig, table, source="rig", prefix="uncertainty")

"""What does `[uncertainty]` say: how well is the bench known, in causes that all readings of a scan share?"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, model_validator

from gonio.config import NotNegative, Positive, Strict

Distribution = Literal["normal", "rectangular"]


class Stated(Strict):
    """One statement of uncertainty, in one of three ways.

    ``0.1`` or ``{ u = 0.1 }``: a standard uncertainty, normal.  ``{ expanded = 0.2, coverage_factor =
    2.0 }``: normal, as certificates have it.  ``{ half_width = 0.2 }``: no value within ± is likelier than
    another (rectangular, u = half_width / sqrt(3)), as tolerances have it.
    """

    u: NotNegative | None = None
    expanded: NotNegative | None = None
    coverage_factor: Positive | None = None
    half_width: NotNegative | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        given = [name for name in ("u", "expanded", "half_width") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                "say it in one way: u (standard uncertainty), expanded with coverage_factor, or half_width"
            )
        if (self.expanded is None) != (self.coverage_factor is None):
            raise ValueError(
                "expanded and coverage_factor belong together: an expanded uncertainty says nothing "
                "without its coverage factor (2 for 95 %)"
            )
        return self

    @property
    def standard(self) -> float:
        """The standard uncertainty."""
        if self.u is not None:
            return self.u
        if self.expanded is not None and self.coverage_factor is not None:
            return self.expanded / self.coverage_factor
        return float(self.half_width or 0.0) / math.sqrt(3.0)

    @property
    def distribution(self) -> Distribution:
        """Of the quantity about its value."""
        return "normal" if self.half_width is None else "rectangular"

    @property
    def wording(self) -> str:
        """How it was said, for a budget: the distribution and what made a standard uncertainty of it."""
        if self.half_width is not None:
            return "rectangular, half width / sqrt(3)"
        if self.coverage_factor is not None:
            return f"normal, expanded / {self.coverage_factor:g}"
        return "normal, standard"


def _plain(value: Any) -> Any:
    """Take a number as a standard uncertainty."""
    return {"u": value} if isinstance(value, float | int) and not isinstance(value, bool) else value


Uncertain = Annotated[Stated, BeforeValidator(_plain)] | None


class UncertaintyConfig(Strict):
    """``[uncertainty]``; what is left out counts as not known, and the budget says so."""

    aperture_width_mm: Uncertain = None
    aperture_height_mm: Uncertain = None
    distance_mm: Uncertain = None  # of the aperture from the sample's axis
    arm_zero_deg: Uncertain = None  # of theta_mes
    theta_i_zero_deg: Uncertain = None
    sample_tilt_deg: Uncertain = None  # of the sample's normal, out of the plane of incidence
    sample_offset_mm: Uncertain = None  # of the surface from the axis, along the normal
    baseline_relative: Uncertain = None  # of the 100 % beam, S and P alike
    baseline_s_relative: Uncertain = None  # of S alone
    baseline_p_relative: Uncertain = None
    zero_offset_r: Uncertain = None  # what is read without light, over the 100 % beam
    polarizer_angle_deg: Uncertain = None  # S and P turned alike
    polarizer_extinction: Uncertain = None  # crossed over parallel transmittance, taken as 0
    wavelength_nm: Uncertain = None
    nonlinearity_per_decade: Uncertain = None  # relative change of the response per decade of light

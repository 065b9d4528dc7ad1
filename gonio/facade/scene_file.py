"""What may stand in `scene.toml`?

Lengths in metres, angles in degrees (azimuths clockwise from north), irradiances in W/m2.  Materials are
named in ``[materials.NAME]`` and used by name; see `examples/scenes/street.toml` for a complete file.
"""

from __future__ import annotations

import datetime
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from gonio.config import Count, NotNegative, Number, Positive, Strict

Fraction = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1)]
Azimuth = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-360, le=360)]
Name = Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z0-9_.-]+$")]

LATER_SKIES = ("perez", "cie")


class SiteTable(Strict):
    """Place and moment; the offset of the time from UTC must be given."""

    latitude_deg: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-90, le=90)]
    longitude_deg: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-180, le=180)]
    altitude_m: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-500, le=9000)] = 0.0
    time: datetime.datetime

    @field_validator("time", mode="before")
    @classmethod
    def _with_offset(cls, value: object) -> object:
        if not isinstance(value, datetime.datetime):
            raise ValueError("is not a date and time; write it without quotes, as 2022-06-21T10:00:00+02:00")
        if value.tzinfo is None:
            raise ValueError("has no offset from UTC; add it, as in 2022-06-21T10:00:00+02:00")
        return value


class SunTable(Strict):
    """The sun's position if it is not computed from a site; a point source with angular_diameter_deg = 0."""

    azimuth_deg: Azimuth | None = None
    elevation_deg: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-90, le=90)] | None = None
    angular_diameter_deg: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=5)] = 0.533

    @model_validator(mode="after")
    def _both_angles(self) -> Self:
        if (self.azimuth_deg is None) != (self.elevation_deg is None):
            raise ValueError("needs both azimuth_deg and elevation_deg, or neither and a [site] with a time")
        return self


class IrradianceTable(Strict):
    """Measured irradiance: direct normal (DNI) and diffuse horizontal (DHI)."""

    dni_w_m2: NotNegative | None = None
    dhi_w_m2: NotNegative | None = None


class SkyTable(Strict):
    """How the diffuse light is spread over the sky."""

    model: Literal["isotropic"] = "isotropic"

    @field_validator("model", mode="before")
    @classmethod
    def _known(cls, value: object) -> object:
        if value in LATER_SKIES:
            raise ValueError('this sky model is not available yet; use model = "isotropic"')
        return value


class ReflectionTable(Strict):
    """How the published lobe is completed."""

    energy: Literal["conserving", "published"] = "conserving"
    horizon: Literal["absorb", "renormalize"] = "absorb"


class MaterialTable(Strict):
    """One of: `scan` (a fit stored by gonio fit), `albedo` (Lambert), or the four coefficients."""

    scan: str | None = None
    fit: str | None = None
    band_nm: tuple[Positive, Positive] = (380.0, 740.0)  # the paper's band
    albedo: Fraction | None = None
    rho_d: Fraction | None = None
    rho_s: NotNegative | None = None
    alpha: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1e9)] | None = None
    n2: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1)] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        four = {"rho_d": self.rho_d, "rho_s": self.rho_s, "alpha": self.alpha, "n2": self.n2}
        given = [k for k, v in four.items() if v is not None]
        kinds = [
            k
            for k, used in (("scan", self.scan), ("albedo", self.albedo), ("coefficients", given or None))
            if used is not None
        ]
        if len(kinds) != 1:
            raise ValueError(
                f"gives {' and '.join(kinds) or 'nothing'}; give exactly one of scan, albedo, "
                "or rho_d, rho_s, alpha, n2"
            )
        if given and len(given) < 4:
            raise ValueError(
                f"lacks {', '.join(k for k in four if k not in given)}; give all of rho_d, rho_s, alpha, n2"
            )
        if self.scan is None and self.model_fields_set & {"fit", "band_nm"}:
            raise ValueError("fit and band_nm belong to a material with a scan; remove them")
        if not self.band_nm[0] < self.band_nm[1]:
            raise ValueError(
                f"band_nm = {list(self.band_nm)} nm: the first wavelength must be below the second; swap them"
            )
        return self


class StreetTable(Strict):
    """Two facades and the ground between them."""

    width_m: Positive
    length_m: Positive
    height_left_m: Positive
    height_right_m: Positive
    azimuth_deg: Azimuth
    left: str
    right: str
    ground: str
    infinite: bool = False  # endless: length_m is then the length of the receivers


class BoxTable(Strict):
    """A further building: `centre_m` of its base, `size_m` across, along its azimuth, and up."""

    name: Name
    centre_m: tuple[Number, Number, Number]
    size_m: tuple[Positive, Positive, Positive]
    azimuth_deg: Azimuth = 0.0
    material: str


class ReceiverTable(Strict):
    """A surface on which the irradiance is wanted, divided into rows x columns patches."""

    surface: str
    rows: Count
    columns: Count


class SceneTable(Strict):
    """The whole of `scene.toml`."""

    title: str = ""
    site: SiteTable | None = None
    sun: SunTable = SunTable()
    irradiance: IrradianceTable = IrradianceTable()
    sky: SkyTable = SkyTable()
    reflection: ReflectionTable = ReflectionTable()
    materials: dict[Name, MaterialTable]
    street: StreetTable | None = None
    boxes: tuple[BoxTable, ...] = ()
    receivers: tuple[ReceiverTable, ...]

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.street is None and not self.boxes:
            raise ValueError("the scene has no surfaces; add [street] or [[boxes]]")
        if not self.receivers:
            raise ValueError("receivers is empty: where is the irradiance wanted? add [[receivers]]")
        if self.site is None and self.sun.azimuth_deg is None:
            raise ValueError(
                "where is the sun? add [site] with a time, or [sun] azimuth_deg and elevation_deg"
            )
        if self.site is not None and self.sun.azimuth_deg is not None:
            raise ValueError(
                "the sun is given twice, by [site] and by [sun]; remove [site], "
                "or sun.azimuth_deg and sun.elevation_deg"
            )
        if self.site is None and None in (self.irradiance.dni_w_m2, self.irradiance.dhi_w_m2):
            raise ValueError(
                "without a [site] there is no clear sky to compute; "
                "give irradiance.dni_w_m2 and irradiance.dhi_w_m2"
            )
        if (self.irradiance.dni_w_m2 is None) != (self.irradiance.dhi_w_m2 is None):
            raise ValueError(
                "irradiance needs both dni_w_m2 and dhi_w_m2 (0.0 is allowed), or neither for a clear sky"
            )
        return self

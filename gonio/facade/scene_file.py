"""What may stand in `scene.toml`?

Lengths in metres, angles in degrees (azimuths clockwise from north), irradiances in W/m2.  Materials are
named in ``[materials.NAME]`` and used by name; see `examples/scenes/street.toml` for a complete file.
"""

from __future__ import annotations

import datetime
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from gonio.config import Count, NotNegative, Number, Positive, Strict
from gonio.facade.sky import MODELS
from gonio.spectral import WeightName

Fraction = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1)]
Azimuth = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-360, le=360)]
Name = Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z0-9_.-]+$")]

Flag = Annotated[bool, Field(strict=True)]
Tilt = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=180)]
Point = tuple[Number, Number, Number]

DEFAULT_BAND_NM = (380.0, 740.0)  # the paper's band


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
    """How the diffuse light is spread over the sky; `extraterrestrial_w_m2` is for Perez' brightness."""

    model: str = "isotropic"
    extraterrestrial_w_m2: Annotated[float, Field(strict=True, ge=1000, le=2000)] | None = None

    @field_validator("model")
    @classmethod
    def _known(cls, value: str) -> str:
        if value not in MODELS:
            raise ValueError(f"is no model of the sky; choose among {', '.join(MODELS)}")
        return value


class SpectrumTable(Strict):
    """Bands in which the light is carried, as pairs of limits or as edges of bands without gaps."""

    bands_nm: tuple[tuple[Positive, Positive], ...] | None = None
    edges_nm: tuple[Positive, ...] | None = None
    weight: WeightName = "flat"
    dni_share: tuple[Fraction, ...] | None = None
    dhi_share: tuple[Fraction, ...] | None = None

    @property
    def limits_nm(self) -> tuple[tuple[float, float], ...]:
        """Limits of each band."""
        if self.bands_nm is not None:
            return self.bands_nm
        return (DEFAULT_BAND_NM,) if self.edges_nm is None else tuple(pairwise(self.edges_nm))

    @model_validator(mode="after")
    def _bands(self) -> Self:
        if self.bands_nm is not None and self.edges_nm is not None:
            raise ValueError("gives both bands_nm and edges_nm; keep one of them")
        if not self.limits_nm:
            raise ValueError("has no band; give bands_nm one pair, or edges_nm two wavelengths")
        before = 0.0
        for low, high in self.limits_nm:
            if not before <= low < high:
                raise ValueError(
                    f"the band {low:g}-{high:g} nm does not follow {before:g} nm in ascending order; "
                    "bands must not overlap, and each must begin with its shorter wavelength"
                )
            before = high
        for key in ("dni_share", "dhi_share"):
            share = getattr(self, key)
            if share is None:
                continue
            if len(share) != len(self.limits_nm):
                raise ValueError(
                    f"{key} has {len(share)} numbers for {len(self.limits_nm)} bands; give one each"
                )
            if abs(sum(share) - 1.0) > 1e-6:
                raise ValueError(f"{key} adds up to {sum(share):g}; it must add up to 1, or light is lost")
        return self


class ReflectionTable(Strict):
    """How the published lobe is completed, and whether light keeps its polarization between lobes."""

    polarised: Flag = False
    energy: Literal["conserving", "published"] = "conserving"
    horizon: Literal["absorb", "renormalize"] = "absorb"


class MaterialTable(Strict):
    """One of: `scan` (a fit stored by gonio fit), `albedo` (Lambert), four coefficients, or two."""

    scan: str | None = None
    fit: str | None = None
    band_nm: tuple[Positive, Positive] = DEFAULT_BAND_NM
    albedo: Fraction | None = None
    rho_d: Fraction | None = None
    rho_s: NotNegative | None = None
    alpha: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1e9)] | None = None
    n2: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1)] | None = None
    k_d: Fraction | None = None
    k_s: Fraction | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        four = {"rho_d": self.rho_d, "rho_s": self.rho_s, "alpha": self.alpha, "n2": self.n2}
        two = {"k_d": self.k_d, "k_s": self.k_s}
        given = [[k for k, v in group.items() if v is not None] for group in (four, two)]
        kinds = [
            kind
            for kind, used in (
                ("scan", self.scan is not None),
                ("albedo", self.albedo is not None),
                ("coefficients", bool(given[0])),
                ("hemispherical coefficients", bool(given[1])),
            )
            if used
        ]
        if len(kinds) != 1:
            raise ValueError(
                f"gives {' and '.join(kinds) or 'nothing'}; give exactly one of scan, albedo, "
                "rho_d, rho_s, alpha, n2, or k_d, k_s"
            )
        for group, there in zip((four, two), given, strict=True):
            if there and len(there) < len(group):
                raise ValueError(
                    f"lacks {', '.join(k for k in group if k not in there)}; give all of {', '.join(group)}"
                )
        if self.k_d is not None and self.k_s is not None and self.k_d + self.k_s > 1.0:
            raise ValueError(
                f"k_d + k_s = {self.k_d + self.k_s:g} returns more light than arrives; they must not exceed 1"
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
    centre_m: Point
    size_m: tuple[Positive, Positive, Positive]
    azimuth_deg: Azimuth = 0.0
    material: str


class MeshTable(Strict):
    """A body from a mesh file beside the scene."""

    file: Annotated[str, Field(min_length=1)]
    name: Name | None = None
    material: str | dict[str, str]
    metres_per_unit: Positive | None = None
    position_m: Point = (0.0, 0.0, 0.0)
    azimuth_deg: Azimuth = 0.0
    up: Literal["z", "y"] | None = None
    sides: Literal["auto", 1, 2] = "auto"
    receiver: Flag = False

    @field_validator("material", mode="before")
    @classmethod
    def _one_or_many(cls, value: object) -> object:
        many = isinstance(value, dict) and bool(value) and all(isinstance(v, str) for v in value.values())
        if not (many or isinstance(value, str)):
            raise ValueError(
                "is no material; give a name, or a name for each part of the file, as "
                '{ roof = "tiles", "*" = "brick" }'
            )
        return value


class ModuleTable(Strict):
    """A window or panel: on a `surface`, or free-standing at `centre_m`."""

    name: Name
    size_m: tuple[Positive, Positive]
    rows: Count = 1
    columns: Count = 1
    receiver: Flag = True
    material: str | None = None
    surface: str | None = None
    at_m: tuple[Number, Number] | None = None
    centre_m: Point | None = None
    azimuth_deg: Azimuth | None = None
    tilt_deg: Tilt = 90.0
    sides: Literal[1, 2] = 1

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        there = self.model_fields_set
        on, free = there & {"surface", "at_m"}, there & {"centre_m", "azimuth_deg", "tilt_deg", "sides"}
        if bool(on) == bool(free):
            raise ValueError(
                f"gives {', '.join(sorted(on | free)) or 'no place'}; give surface and at_m for a module on "
                "a surface, or centre_m and azimuth_deg (and tilt_deg, sides) for a free-standing one"
            )
        needed = {"surface", "at_m"} if on else {"centre_m", "azimuth_deg", "material"}
        missing = sorted(needed - there)
        if missing:
            raise ValueError(f"lacks {', '.join(missing)}; add it")
        if not self.receiver and there & {"rows", "columns"}:
            raise ValueError("has rows and columns but receiver = false; remove one of the two")
        return self


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
    spectrum: SpectrumTable | None = None
    reflection: ReflectionTable = ReflectionTable()
    materials: dict[Name, MaterialTable]
    street: StreetTable | None = None
    boxes: tuple[BoxTable, ...] = ()
    meshes: tuple[MeshTable, ...] = ()
    modules: tuple[ModuleTable, ...] = ()
    receivers: tuple[ReceiverTable, ...] = ()

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.street is None and not self.boxes and not self.meshes and not self.modules:
            raise ValueError("the scene has no surfaces; add [street], [[boxes]], [[meshes]] or [[modules]]")
        receiving = [m.receiver for m in self.meshes] + [m.receiver for m in self.modules]
        if not self.receivers and not any(receiving):
            raise ValueError(
                "there is no receiver: where is the irradiance wanted? add [[receivers]], or receiver = true "
                "to a mesh"
            )
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

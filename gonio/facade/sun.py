"""Where is the sun, and how strong are sun and sky?  Position and clear sky by pvlib."""

from __future__ import annotations

import datetime
import math
import warnings
from dataclasses import dataclass

from gonio.errors import SceneError
from gonio.facade.geometry import Vector, heading

ANGULAR_DIAMETER_DEG = 0.533
"""Mean angular diameter of the sun seen from the Earth (it varies by 1.7 % over the year)."""

SOLAR_CONSTANT_W_M2 = 1361.0
"""Total solar irradiance at the mean distance (Kopp and Lean 2011); 1 W/m2 is not known better than that."""


@dataclass(frozen=True, slots=True)
class Sun:
    """Apparent position (refraction included) and size; `azimuth_deg` clockwise from north."""

    azimuth_deg: float
    elevation_deg: float
    angular_diameter_deg: float = ANGULAR_DIAMETER_DEG

    @property
    def direction(self) -> Vector:
        """Unit vector towards the centre of the disc: east, north, up."""
        east, north, _ = heading(self.azimuth_deg)
        c, s = math.cos(math.radians(self.elevation_deg)), math.sin(math.radians(self.elevation_deg))
        return east * c, north * c, s

    @property
    def is_up(self) -> bool:
        """Whether the centre of the disc is above the horizon; only then is there direct light."""
        return self.elevation_deg > 0.0


@dataclass(frozen=True, slots=True)
class Site:
    """A place and a moment; the time carries its offset from UTC."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    time: datetime.datetime


def sun_at(site: Site, *, angular_diameter_deg: float = ANGULAR_DIAMETER_DEG) -> Sun:
    """Return the apparent position of the sun by pvlib's NREL solar position algorithm (about 0.0003 deg)."""
    import pandas
    import pvlib

    when = pandas.DatetimeIndex([site.time])
    table = pvlib.solarposition.get_solarposition(
        when, site.latitude_deg, site.longitude_deg, altitude=site.altitude_m
    )
    azimuth_deg, elevation_deg = float(table["azimuth"].iloc[0]), float(table["apparent_elevation"].iloc[0])
    if not (math.isfinite(azimuth_deg) and math.isfinite(elevation_deg)):
        raise SceneError(f"the sun's position at {site.time.isoformat()} cannot be computed; check site.time")
    return Sun(azimuth_deg, elevation_deg, angular_diameter_deg)


def extraterrestrial(site: Site) -> float:
    """Return the irradiance outside the atmosphere on that day, W/m2 (Spencer 1971, by pvlib)."""
    import pvlib

    day = site.time.astimezone(datetime.UTC).timetuple().tm_yday
    return float(
        pvlib.irradiance.get_extra_radiation(day, solar_constant=SOLAR_CONSTANT_W_M2, method="spencer")
    )


def clear_sky(site: Site) -> tuple[float, float]:
    """Return (DNI, DHI) in W/m2 of a clear sky: Ineichen and Perez (2002), climatological Linke turbidity."""
    import pandas
    import pvlib

    place = pvlib.location.Location(site.latitude_deg, site.longitude_deg, altitude=site.altitude_m)
    with warnings.catch_warnings():
        # pvlib 0.16 calls a name that pandas 3 has renamed; nothing a user of this program can do about it
        warnings.filterwarnings("ignore", message="DatetimeIndex.dayofyear")
        table = place.get_clearsky(pandas.DatetimeIndex([site.time]), model="ineichen")
    return float(table["dni"].iloc[0]), float(table["dhi"].iloc[0])

"""What the simulated bench is told: dimensions and scale factors of the rig, and the truth behind the wires.

The bench reads the same `rig.toml` as the program that controls it.  Of the tables of the devices it takes
what hardware has (scale factors, limits, gratings, detector ranges) and leaves a driver's own keys alone; the
table ``[simulation]`` is the bench's own, and every key in it is checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from gonio.config import Count, NotNegative, Number, Positive, Strict, parse_toml, read_toml, validate
from gonio.errors import ConfigError

Range = tuple[Positive, Positive]

ZONE_MARGIN_DEG = 0.3
"""How far inside the blind zone's border its limit switch sits, so that the border itself can be reached."""

HOME_OVERSHOOT_DEG = 0.2
"""How far above the home switch the home routine turns, to come down to it."""


class _Hardware(BaseModel):
    """A table shared with the drivers, whose own keys are ignored here."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class ApertureTable(_Hardware):
    """``[aperture]``: the detector's rectangle, perpendicular to the arm."""

    width_mm: Positive  # in the plane of incidence
    height_mm: Positive
    distance_mm: Positive


class BaselineTable(_Hardware):
    """``[baseline]``: where the direct beam is measured."""

    theta_i_deg: Number = 90.0
    theta_mes_deg: Number = 180.0


class AxisTable(_Hardware):
    """``[stage.theta_i]`` or ``[stage.theta_mes]``: the scale of one axis."""

    steps_per_deg: Number
    zero_deg: Number = 0.0
    limits_deg: tuple[Number, Number]
    blind_zone_deg: NotNegative = 0.0
    speed_deg_s: Positive = 20.0
    acceleration_deg_s2: Positive = 100.0
    backlash_deg: NotNegative = 0.0  # the driver's overshoot; the switches stand beyond it

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if self.steps_per_deg == 0:
            raise ValueError("steps_per_deg = 0: the axis would never move; give the steps of one degree")
        low, high = self.limits_deg
        if not low < high:
            raise ValueError(
                f"limits_deg = [{low}, {high}] deg: the first must be below the second; correct them"
            )
        return self


class StageTable(_Hardware):
    """``[stage]``."""

    theta_i: AxisTable
    theta_mes: AxisTable


class PolarizerTable(_Hardware):
    """``[polarizer]``: the rotator angles of S and P."""

    s_deg: Number = 0.0
    p_deg: Number = 90.0

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if self.s_deg == self.p_deg:
            raise ValueError(
                f"s_deg and p_deg are both {self.s_deg:g} deg; give the rotator angles of S and of P"
            )
        return self


class BandTable(_Hardware):
    """One grating or order-sorting filter and the wavelengths it is meant for."""

    number: Count
    range_nm: Range

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if not self.range_nm[0] < self.range_nm[1]:
            raise ValueError(f"range_nm = {list(self.range_nm)} nm must ascend; correct it")
        return self


class MonochromatorTable(_Hardware):
    """``[spectrometer.monochromator]``; without gratings or filters, one that suits all wavelengths."""

    gratings: tuple[BandTable, ...] = ()
    filters: tuple[BandTable, ...] = ()


class LockinTable(_Hardware):
    """``[spectrometer.lockin]``: what the amplifier wakes up with."""

    time_constant_s: Positive = 0.1


class DetectorTable(_Hardware):
    """One of ``[[spectrometer.detectors]]``."""

    name: str
    type: str = ""
    range_nm: Range
    output_port: Count | None = None  # by default the place in the list, counted from one


class SpectrometerTable(_Hardware):
    """``[spectrometer]``."""

    monochromator: MonochromatorTable = MonochromatorTable()
    lockin: LockinTable = LockinTable()
    detectors: tuple[DetectorTable, ...] = Field(min_length=1)


def _as_spectrum(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float | Mapping | Spectrum):
        raise ValueError(
            "give a number, or a table { wavelength_nm = [300.0, 1500.0], value = [1.0, 2.0] } to interpolate"
        )
    return {"wavelength_nm": (1.0,), "value": (value,)} if isinstance(value, int | float) else value


class Spectrum(Strict):
    """A quantity over wavelength: linear between the table's points, constant beyond its ends."""

    wavelength_nm: tuple[Positive, ...] = Field(min_length=1)
    value: tuple[Number, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _is_table(self) -> Self:
        if len(self.wavelength_nm) != len(self.value):
            raise ValueError(
                f"has {len(self.wavelength_nm)} wavelengths but {len(self.value)} values; give as many"
            )
        if any(b <= a for a, b in zip(self.wavelength_nm, self.wavelength_nm[1:], strict=False)):
            raise ValueError("wavelength_nm must ascend strictly; sort the table and remove doubles")
        return self

    def at(self, wavelength_nm: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return the value at each wavelength, any shape."""
        return np.asarray(np.interp(wavelength_nm, self.wavelength_nm, self.value), dtype=np.float64)


def _spectrum_from(low: float, what: str) -> Any:
    """Annotated spectrum whose values are all at least `low`."""

    def check(value: Any) -> Any:
        table = _as_spectrum(value)
        values = table.value if isinstance(table, Spectrum) else table.get("value", ())
        for v in values if isinstance(values, list | tuple) else ():
            if isinstance(v, int | float) and not v >= low:
                raise ValueError(f"{v:g} is below {low:g}; {what}")
        return table

    return BeforeValidator(check)


class TruthTable(Strict):
    """``[simulation.truth]``: the four parameters of the sample's differential scattering function."""

    rho_d: Annotated[Spectrum, _spectrum_from(0.0, "a diffuse albedo is not negative")]
    rho_s: Annotated[Spectrum, _spectrum_from(0.0, "the weight of the lobe is not negative")]
    alpha: Annotated[Spectrum, _spectrum_from(0.0, "the exponent of the lobe is not negative")]
    n2: Annotated[
        Spectrum, _spectrum_from(1.0, "light comes from air: n2 = 1 is no sample, above 1 a sample")
    ]


class BeamTable(Strict):
    """``[simulation.beam]``."""

    width_mm: NotNegative = 1.0  # across the beam, in the plane of incidence
    height_mm: NotNegative = 1.0
    divergence_deg: Annotated[float, Field(strict=True, ge=0, lt=10)] = (
        0.0  # full angle of a uniform square cone
    )
    polarization: Annotated[float, Field(strict=True, gt=-1, lt=1)] = (
        0.1  # (S - P)/(S + P) before the polarizer
    )


class SampleTable(Strict):
    """``[simulation.sample]``."""

    width_mm: Positive = 100.0  # in the plane of incidence
    height_mm: Positive = 100.0


class NoiseTable(Strict):
    """``[simulation.noise]``; the noises are standard deviations of a 1 s average."""

    lamp_drift_per_hour: NotNegative = 0.0
    flicker: NotNegative = 0.0
    shot_at_full: NotNegative = 0.0
    floor: NotNegative = 0.0


class DetectorTruth(Strict):
    """``[simulation.detectors.NAME]``."""

    full_beam_v: Positive = 0.8
    dark_v: Number = 0.0
    mismatch: Annotated[float, Field(strict=True, gt=-1, allow_inf_nan=False)] = 0.0
    stray: Number = 0.0  # light that comes from the sample by other ways, in units of r


class SphereTable(Strict):
    """``[simulation.sphere]``."""

    theta_i_deg: Annotated[float, Field(strict=True, ge=0, lt=90)] = 8.0
    uncertainty: NotNegative = 0.01


class AxisTruth(Strict):
    """``[simulation.theta_i]`` and ``[simulation.theta_mes]``: how the axis behaves."""

    power_on_deg: Number | None = None
    backlash_deg: NotNegative = 0.05  # lost motion between motor and arm
    limit_margin_deg: NotNegative = (
        1.0  # the switches stand this far outside limits_deg and the driver's overshoot
    )
    obstacle_deg: Number | None = None  # something stands in the arm's way here: the motor stalls


class SimulationTable(Strict):
    """``[simulation]``."""

    clock_speed: Positive = 1.0
    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    faults: tuple[str, ...] = ()  # see docs/faults.md; what they say is checked where they are injected
    fault_log: str | None = None
    truth: TruthTable
    beam: BeamTable = BeamTable()
    sample: SampleTable = SampleTable()
    noise: NoiseTable = NoiseTable()
    detectors: Mapping[str, DetectorTruth] = {}
    sphere: SphereTable = SphereTable()
    theta_i: AxisTruth = AxisTruth()
    theta_mes: AxisTruth = AxisTruth()


class BenchConfig(_Hardware):
    """All that the bench is told, validated; made by `from_text`, `from_file` or `from_tables`."""

    aperture: ApertureTable
    baseline: BaselineTable = BaselineTable()
    stage: StageTable
    polarizer: PolarizerTable = PolarizerTable()
    spectrometer: SpectrometerTable
    simulation: SimulationTable

    @model_validator(mode="after")
    def _detectors_exist(self) -> Self:
        known = [d.name for d in self.spectrometer.detectors]
        for name in self.simulation.detectors:
            if name not in known:
                raise ValueError(
                    f"simulation.detectors.{name} is no detector of [[spectrometer.detectors]] "
                    f"({', '.join(known)}); correct the name"
                )
        return self

    @classmethod
    def from_tables(cls, tables: Mapping[str, Any], *, source: str = "rig.toml") -> Self:
        """Return the bench of a rig file's raw tables; `ConfigError` lists every mistake."""
        if "simulation" not in tables:
            raise ConfigError(
                f"{source}: [simulation] is missing, so there is no bench to simulate; add it as "
                "in the built-in arta.toml"
            )
        return validate(cls, tables, source=source)

    @classmethod
    def from_text(cls, text: str, *, source: str = "rig.toml") -> Self:
        """Return the bench of a rig file's text; `ConfigError` lists every mistake."""
        return cls.from_tables(parse_toml(text, source=source), source=source)

    @classmethod
    def from_file(cls, path: Path) -> Self:
        """Return the bench of a rig file; `ConfigError` lists every mistake."""
        return cls.from_tables(read_toml(path), source=str(path))

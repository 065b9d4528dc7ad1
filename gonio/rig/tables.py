"""What `rig.toml` says of each device: tables that a driver's own model extends."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gonio.config import NotNegative, Number, Positive, Strict
from gonio.devices import Beam, FloatArray
from gonio.latency import PassTime

SIMULATED = "simulated"
"""Address of a device that `gonio` serves itself, by starting the simulated bench."""


class ApertureConfig(Strict):
    """The detector's rectangular aperture, as measured with a ruler."""

    width_mm: Positive  # in the plane of incidence
    height_mm: Positive
    distance_mm: Positive  # from the sample's axis


class BeamConfig(Strict):
    """The beam that falls on the sample, uniform over a rectangle across it and over a square cone."""

    width_mm: NotNegative  # across the beam, in the plane of incidence
    height_mm: NotNegative
    divergence_deg: NotNegative = 0.0  # full angle


class AxisConfig(Strict):
    """What the program must know of an axis, whoever made it; a driver's model adds its own keys."""

    limits_deg: tuple[Number, Number]
    speed_deg_s: Positive = 20.0
    acceleration_deg_s2: Positive = 100.0
    tolerance_deg: Positive = 0.01
    backlash_deg: NotNegative = 0.0  # overshoot by which every target is approached from the same side
    settle_s: NotNegative = 0.0
    blind_zone_deg: NotNegative = 0.0  # |angle| below this is forbidden

    @model_validator(mode="after")
    def _limits_in_order(self) -> Self:
        low, high = self.limits_deg
        if not low < high:
            raise ValueError(
                f"limits_deg = [{low}, {high}] deg: the first must be below the second; swap or correct them"
            )
        return self

    def move_duration_s(self, distance_deg: float) -> float:
        """Return the time of a trapezoidal (or triangular) velocity profile, settling included, seconds."""
        distance = abs(distance_deg)
        ramp = self.speed_deg_s**2 / self.acceleration_deg_s2
        if distance <= ramp:
            return float(2.0 * np.sqrt(distance / self.acceleration_deg_s2)) + self.settle_s
        return distance / self.speed_deg_s + self.speed_deg_s / self.acceleration_deg_s2 + self.settle_s


class DeviceConfig(Strict):
    """Keys every device table has."""

    driver: str
    address: str = SIMULATED


class StageConfig(DeviceConfig):
    """The goniometer; a driver's model narrows the axis types."""

    theta_i: AxisConfig
    theta_mes: AxisConfig


class PolarizerConfig(DeviceConfig):
    """The polarizer rotator and its two working angles."""

    s_deg: Number
    p_deg: Number
    turn_s: NotNegative = 0.32  # from one to the other, for the estimate; an ELL14 turns 90 deg in that


class DetectorConfig(Strict):
    """One detector and the wavelengths it is used for; `range_nm` is closed below and open above, but for
    the last.
    """

    name: str
    type: str  # PMT, InGaAs, PbS, Si
    range_nm: tuple[Positive, Positive]


class SpectrometerConfig(Strict):
    """The spectrometer; a driver's model adds its parts and their addresses."""

    driver: str
    detectors: tuple[DetectorConfig, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _ranges_meet(self) -> Self:
        for detector in self.detectors:
            low, high = detector.range_nm
            if not low < high:
                raise ValueError(
                    f"detector '{detector.name}': range_nm = [{low}, {high}] nm must ascend; correct it"
                )
        for first, second in zip(self.detectors, self.detectors[1:], strict=False):
            if second.range_nm[0] < first.range_nm[1]:
                raise ValueError(
                    f"detectors '{first.name}' and '{second.name}' overlap between {second.range_nm[0]} and "
                    f"{first.range_nm[1]} nm; list them in ascending order with ranges that meet"
                )
        return self

    def addresses(self) -> dict[str, str]:
        """Return the addresses by role, such as ``{"monochromator": ..., "lockin": ...}``; a driver's
        model overrides.
        """
        return {}

    def averages_for(self, integration_s: float) -> int:
        """Return how many readings, averaged, fill an integration time; a driver's model overrides."""
        return max(1, int(np.ceil(integration_s - 1e-9)))

    def reading_duration_s(self, wavelength_nm: FloatArray, averages: int | NDArray[np.integer]) -> float:
        """Return the estimated instrument time of one pass, seconds; a driver's model overrides."""
        return float(np.sum(np.broadcast_to(averages, np.shape(wavelength_nm))))

    def pass_time(
        self,
        wavelength_nm: FloatArray,
        detector_index: NDArray[np.uint8],
        averages: int | NDArray[np.integer],
        *,
        beam: Beam = "sample",
        after: tuple[float, int] | None = None,
        first: bool = False,
    ) -> PassTime:
        """Return what one pass takes, for estimates; a driver's model overrides.

        Parameters
        ----------
        wavelength_nm, detector_index, averages
            As in `Spectrometer.measure_spectrum`.
        after
            Wavelength in nm and detector of the reading before; None if it is not known.
        first
            Whether it is the first pass of this beam, when the amplifier's range must still be found.
        """
        del detector_index, beam, after, first
        return PassTime(self.reading_duration_s(wavelength_nm, averages))


class WireConfig(Strict):
    """``[wire]``: what holds for every line of the rig."""

    reply_timeout_s: Positive | None = None  # real seconds for a whole reply; by default 1 (Modbus) or 2


class BaselineConfig(Strict):
    """Where the direct beam is measured: the sample edge-on, out of the beam, the arm facing the source."""

    theta_i_deg: Number = 90.0
    theta_mes_deg: Number = 180.0

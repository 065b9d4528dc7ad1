"""What a scan produces, one record at a time: its header, references, positions and events.

The journal stores these records, the NeXus file is made from them, and nothing else is measured.  Times
are seconds on the instrument clock since the scan began; `unix_s` is the computer's clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gonio.aperture import IncidentBeam
from gonio.devices import FloatArray, Polarization

ReferenceKind = Literal["dark", "baseline"]
Level = Literal["info", "warning", "error"]


@dataclass(frozen=True, slots=True)
class DetectorFacts:
    """One detector as the rig file has it."""

    name: str
    type: str
    low_nm: float
    high_nm: float


@dataclass(frozen=True, slots=True)
class RigFacts:
    """What of the rig decides the meaning of the data; a scan is only resumed where all of it is equal."""

    name: str
    width_mm: float
    height_mm: float
    distance_mm: float
    baseline_theta_i_deg: float
    baseline_theta_mes_deg: float
    s_deg: float
    p_deg: float
    detectors: tuple[DetectorFacts, ...]
    beam_width_mm: float | None = None  # None, all three: the rig file does not say
    beam_height_mm: float | None = None
    beam_divergence_deg: float | None = None

    @property
    def beam(self) -> IncidentBeam | None:
        """The beam on the sample; `ConfigError` if there can be none such."""
        width, height, divergence = self.beam_width_mm, self.beam_height_mm, self.beam_divergence_deg
        if width is None or height is None or divergence is None:
            return None
        return IncidentBeam(width, height, divergence)


@dataclass(frozen=True, slots=True)
class SourceFacts:
    """Which source of positions a scan was begun with, and how many it may ask for at most."""

    name: str
    version: str
    text: str  # what it says of itself, or its code
    max_positions: int


@dataclass(frozen=True, slots=True, eq=False)
class ScanHeader:
    """What is known before the first reading; `detector_index` is (m,) uint8 into `rig.detectors`."""

    plan_text: str
    rig_text: str
    rig: RigFacts
    detector_index: NDArray[np.uint8]
    devices: dict[str, str]
    program: str
    start_time: str  # ISO 8601 with offset
    unix_s: float
    wavelength_nm: FloatArray | None = None  # (m,) of the columns; None if they are the plan's, once each
    source: SourceFacts | None = None  # None if the plan says what is measured


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceRecord:
    """One pass with the shutter closed (polarization ``any``) or of the direct beam; arrays (m,)."""

    kind: ReferenceKind
    when: str  # start, end, or "before K" with the number of a position
    polarization: str
    theta_i_deg: float
    theta_mes_deg: float
    averages: int | NDArray[np.integer]
    unix_s: float
    wavelength_nm: FloatArray
    signal_v: FloatArray
    signal_sd_v: FloatArray
    time_s: FloatArray
    quality: NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class DecisionRecord:
    """Which position a source has asked for; kept before the axes move there."""

    index: int
    theta_i_deg: float
    theta_mes_deg: float
    polarization: Polarization


@dataclass(frozen=True, slots=True, eq=False)
class PositionRecord:
    """One whole position; angles and wavelengths (m,) are read back from the devices.

    `averages` is one number for all wavelengths, or (m,).
    """

    index: int
    polarization: Polarization
    theta_i_deg: float
    theta_mes_deg: float
    polarizer_deg: float
    averages: int | NDArray[np.integer]
    unix_s: float
    wavelength_nm: FloatArray
    signal_v: FloatArray
    signal_sd_v: FloatArray
    time_s: FloatArray
    quality: NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class EventRecord:
    """Something that happened during the scan: a fault, an operator's action, an interruption."""

    time_s: float
    unix_s: float
    level: Level
    source: str
    message: str

    def __post_init__(self) -> None:
        """Make a quoted device's bytes storable: HDF5 has no zero bytes, UTF-8 no half pairs."""
        clean = self.message.encode("utf-8", "replace").decode("utf-8").replace("\x00", "\N{SYMBOL FOR NULL}")
        object.__setattr__(self, "message", clean)


Record = ScanHeader | ReferenceRecord | DecisionRecord | PositionRecord | EventRecord

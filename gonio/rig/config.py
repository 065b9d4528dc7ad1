"""The whole rig file, and every question it answers without hardware."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from gonio.config import Strict
from gonio.devices import FloatArray
from gonio.errors import ConfigError, RefusedError
from gonio.latency import LatencyConfig
from gonio.rig.limits import check_target
from gonio.rig.tables import (
    SIMULATED,
    ApertureConfig,
    BaselineConfig,
    BeamConfig,
    PolarizerConfig,
    SpectrometerConfig,
    StageConfig,
    WireConfig,
)
from gonio.rig.uncertainty import UncertaintyConfig


class RigConfig(Strict):
    """A validated `rig.toml`; `text` is the file itself, which every scan stores."""

    name: str
    aperture: ApertureConfig
    beam: BeamConfig | None = None  # None: not said, and the fit takes a line of light without width
    baseline: BaselineConfig = BaselineConfig()
    uncertainty: UncertaintyConfig | None = None  # None: nothing said, and a budget takes all as exact
    stage: StageConfig
    polarizer: PolarizerConfig
    spectrometer: SpectrometerConfig
    latency: LatencyConfig = LatencyConfig()
    wire: WireConfig = WireConfig()
    simulation: Mapping[str, Any] | None = None
    text: str = ""

    # -- questions that need no hardware
    # -------------------------------------------------------------------------

    def check_axis_target(self, axis: Literal["theta_i", "theta_mes"], target_deg: float) -> None:
        """Raise `RefusedError` if the axis must not stand at `target_deg`."""
        config = self.stage.theta_i if axis == "theta_i" else self.stage.theta_mes
        check_target(axis, config, target_deg, rig_name=self.name)

    def check_position(self, theta_i_deg: float, theta_mes_deg: float) -> None:
        """Raise `RefusedError` if the rig must not stand at this pair of angles."""
        self.check_axis_target("theta_i", theta_i_deg)
        self.check_axis_target("theta_mes", theta_mes_deg)

    def detector_for(self, wavelength_nm: FloatArray) -> NDArray[np.uint8]:
        """Return the index of the detector that covers each wavelength; `RefusedError` where none does."""
        detectors = self.spectrometer.detectors
        wavelength_nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=np.float64))
        index = np.full(wavelength_nm.shape, 255, dtype=np.uint8)
        for i in reversed(range(len(detectors))):
            low, high = detectors[i].range_nm
            last = i == len(detectors) - 1 or detectors[i + 1].range_nm[0] > high
            index[(wavelength_nm >= low) & ((wavelength_nm <= high) if last else (wavelength_nm < high))] = i
        if np.any(index == 255):
            bad = float(wavelength_nm[index == 255][0])
            covered = ", ".join(f"{d.name} {d.range_nm[0]:g}-{d.range_nm[1]:g} nm" for d in detectors)
            raise RefusedError(
                f"wavelength = {bad:g} nm is covered by no detector of rig '{self.name}' ({covered}); "
                "choose wavelengths in these ranges"
            )
        return index

    def addresses(self) -> dict[str, str]:
        """Return every address by the role it plays on the wire."""
        return {
            "stage": self.stage.address,
            "polarizer": self.polarizer.address,
            **self.spectrometer.addresses(),
        }

    def is_simulated(self) -> bool:
        """Say whether every device is to be served by the simulated bench that the program starts itself."""
        return all(address == SIMULATED for address in self.addresses().values())

    def clock_speed(self) -> float:
        """Return how fast instrument time runs; only a simulated bench may differ from 1.0."""
        speed = float((self.simulation or {}).get("clock_speed", 1.0))
        if speed != 1.0:
            for role, address in self.addresses().items():
                if not _may_be_simulated(address):
                    raise ConfigError(
                        f"rig '{self.name}': [simulation] clock_speed = {speed:g} but the {role} at "
                        f"{address} is real hardware, whose settling would be cut short; remove [simulation] "
                        "from the file"
                    )
        return speed


def _may_be_simulated(address: str) -> bool:
    return (
        address == SIMULATED
        or address.startswith("/dev/pts/")
        or urlsplit(address).hostname in {"127.0.0.1", "localhost", "::1"}
    )

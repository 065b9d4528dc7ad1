"""The rig as bluesky's RunEngine wants it: two axes, a polarizer, the light, and a detector to trigger.

The axes are the drivers' own, which satisfy `bluesky.protocols` as they are.  Here are the rest, by structure
alone: bluesky itself is not imported.  A detector is read after it was triggered, as in ophyd: `trigger` runs
the pass over the wavelengths in a thread and returns its status, `read` gives what it found.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import gonio
from gonio.devices import Axis, Beam, Polarization, SpectrumReading
from gonio.errors import RefusedError
from gonio.plan.channels import Channels, channels
from gonio.plan.model import Plan
from gonio.rig import Rig
from gonio.status import ThreadStatus

BEAMS: tuple[Beam, ...] = ("sample", "direct", "dark")


class PolarizerDevice:
    """Movable to ``s`` and ``p``."""

    name = "polarization"
    parent = None

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self.value: Polarization | None = None
        self.angle_deg = float("nan")

    @property
    def position(self) -> Polarization | None:
        """What was selected last."""
        return self.value

    @property
    def hints(self) -> dict[str, list[str]]:
        """Nothing to plot."""
        return {"fields": []}

    def set(self, value: str) -> ThreadStatus:
        """Turn to S or P in the background; `RefusedError` for anything else."""
        if value not in ("s", "p"):
            raise RefusedError(f"polarization = {value!r}: give 's' or 'p'")

        def select() -> None:
            self.value = None
            self.angle_deg = self._rig.polarizer.select(value)  # type: ignore[arg-type]
            self.value = value  # type: ignore[assignment]

        return ThreadStatus(select, self.name)

    def stop(self, *, success: bool = False) -> None:
        """Stop now."""
        del success
        self._rig.polarizer.stop()

    def read(self) -> Mapping[str, Any]:
        """Return what was selected and the rotator's angle, read back."""
        now = time.time()
        return {
            self.name: {"value": self.value or "", "timestamp": now},
            "polarizer_angle": {"value": self.angle_deg, "timestamp": now},
        }

    def describe(self) -> Mapping[str, Any]:
        """Describe what `read` returns."""
        return {
            self.name: {"source": "polarizer", "dtype": "string", "shape": []},
            "polarizer_angle": {"source": "polarizer", "dtype": "number", "shape": [], "units": "deg"},
        }


class LightDevice:
    """Movable to what the detector shall look at: ``sample``, ``direct`` (100 %) or ``dark``; at once."""

    name = "light"
    parent = None

    def __init__(self) -> None:
        self.value: Beam = "sample"

    @property
    def position(self) -> Beam:
        """What was chosen last."""
        return self.value

    def set(self, value: str) -> ThreadStatus:
        """Choose; the shutter follows with the next reading."""
        if value not in BEAMS:
            raise RefusedError(f"light = {value!r}: give one of {', '.join(BEAMS)}")
        self.value = value
        return ThreadStatus(lambda: None, self.name)


class SpectrumDetector:
    """A pass over the wavelengths as one reading; see `bluesky_devices`.

    Its documents hold all that the `.h5` needs besides the axes: see `gonio.acquire.documents`.
    """

    name = "spectrum"
    parent = None

    def __init__(self, rig: Rig, plan: Plan, polarization: PolarizerDevice, light: LightDevice) -> None:
        self.columns: Channels = channels(plan, rig.config)
        self._rig = rig
        self._plan = plan
        self._polarization = polarization
        self._light = light
        self._reading: SpectrumReading | None = None
        self._beam: Beam = "sample"
        self._at_s = 0.0

    @property
    def hints(self) -> dict[str, list[str]]:
        """A spectrum is no single value to plot."""
        return {"fields": []}

    def stage(self) -> list[object]:
        """Nothing needs to be made ready."""
        return [self]

    def unstage(self) -> list[object]:
        """Close the shutter at the end of a run."""
        self._rig.spectrometer.close_shutter()
        return [self]

    def trigger(self) -> ThreadStatus:
        """Run over the wavelengths; the reading fails if an axis or the polarizer has turned meanwhile."""
        self._reading = None
        beam = self._light.value
        if beam != "dark" and self._polarization.value is None:
            raise RefusedError("the polarization is not known; move 'polarization' to 's' or 'p' first")
        return ThreadStatus(lambda: self._measure(beam), self.name)

    def _measure(self, beam: Beam) -> None:
        stage, columns = self._rig.stage, self.columns
        angles = stage.theta_i.position_deg(), stage.theta_mes.position_deg()
        averages = (
            columns.averages_asked
            if beam == "sample"
            else self._plan.references.averages_of("dark" if beam == "dark" else "baseline")
        )
        reading = self._rig.spectrometer.measure_spectrum(
            columns.wavelength_nm, columns.detector_index, beam=beam, averages=averages
        )
        self._rig.verify_still(*angles, None if beam == "dark" else self._polarization.angle_deg)
        self._reading, self._beam, self._at_s = reading, beam, time.time()

    def stop(self, *, success: bool = False) -> None:
        """End the pass at its next reading."""
        del success
        self._rig.spectrometer.stop()

    def read(self) -> Mapping[str, Any]:
        """Return the last pass; each array is (m,), in the columns of the configuration."""
        reading = self._reading
        if reading is None:
            raise RuntimeError("the spectrum was read before it was triggered")
        m = len(self.columns)
        values: dict[str, Any] = {
            "spectrum_signal": reading.signal_v,
            "spectrum_signal_sd": reading.signal_sd_v,
            "spectrum_wavelength": reading.wavelength_nm,
            "spectrum_time": reading.time_s,
            "spectrum_quality": reading.quality,
            "spectrum_averages": np.broadcast_to(np.asarray(reading.averages, dtype=np.uint32), (m,)).copy(),
            "spectrum_light": self._beam,
            "spectrum_polarization": "any" if self._beam == "dark" else self._polarization.value,
            "spectrum_polarizer_angle": self._polarization.angle_deg,
        }
        return {key: {"value": value, "timestamp": self._at_s} for key, value in values.items()}

    def describe(self) -> Mapping[str, Any]:
        """Describe what `read` returns."""
        m = len(self.columns)
        arrays = {
            "signal": ("V", "<f8"),
            "signal_sd": ("V", "<f8"),
            "wavelength": ("nm", "<f8"),
            "time": ("s", "<f8"),
            "quality": ("", "<u2"),
            "averages": ("", "<u4"),
        }
        found: dict[str, Any] = {
            f"spectrum_{name}": {
                "source": "spectrometer",
                "dtype": "array",
                "dtype_numpy": dtype,
                "shape": [m],
                "units": units,
            }
            for name, (units, dtype) in arrays.items()
        }
        for name in ("light", "polarization"):
            found[f"spectrum_{name}"] = {"source": "spectrometer", "dtype": "string", "shape": []}
        found["spectrum_polarizer_angle"] = {
            "source": "polarizer",
            "dtype": "number",
            "shape": [],
            "units": "deg",
        }
        return found

    def read_configuration(self) -> Mapping[str, Any]:
        """Return what is the same for every reading: columns, plan, devices and program."""
        rig = self._rig
        devices = {"stage": rig.stage.identify(), "polarizer": rig.polarizer.identify()}
        devices |= dict(rig.spectrometer.identify())
        values: dict[str, Any] = {
            "spectrum_columns_wavelength": self.columns.wavelength_nm,
            "spectrum_columns_detector": self.columns.detector_index,
            "spectrum_plan": self._plan.to_toml(),
            "spectrum_devices": [f"{role}={text}" for role, text in devices.items()],
            "spectrum_program": f"gonio {gonio.__version__}",
        }
        now = time.time()
        return {key: {"value": value, "timestamp": now} for key, value in values.items()}

    def describe_configuration(self) -> Mapping[str, Any]:
        """Describe what `read_configuration` returns."""
        m = len(self.columns)
        found: dict[str, Any] = {
            f"spectrum_columns_{name}": {"source": "rig", "dtype": "array", "shape": [m], "units": units}
            for name, units in (("wavelength", "nm"), ("detector", ""))
        }
        found["spectrum_devices"] = {"source": "rig", "dtype": "array", "dtype_str": "<U", "shape": [-1]}
        for name in ("plan", "program"):
            found[f"spectrum_{name}"] = {"source": "rig", "dtype": "string", "shape": []}
        return found


@dataclass(frozen=True, slots=True)
class BlueskyDevices:
    """What a RunEngine plan moves and reads; `detectors` goes into `bp.scan` and its like."""

    theta_i: Axis
    theta_mes: Axis
    polarization: PolarizerDevice
    light: LightDevice
    spectrum: SpectrumDetector

    @property
    def detectors(self) -> list[Any]:
        """What is read at every point: the axes too, for plans that move only one of them."""
        return [self.spectrum, self.theta_i, self.theta_mes]


def bluesky_devices(rig: Rig, plan: Plan) -> BlueskyDevices:
    """Return a connected rig's devices for bluesky; wavelengths and averages are those of the plan.

    Raises
    ------
    RefusedError
        No detector of the rig covers a wavelength.
    """
    polarization, light = PolarizerDevice(rig), LightDevice()
    return BlueskyDevices(
        rig.stage.theta_i,
        rig.stage.theta_mes,
        polarization,
        light,
        SpectrumDetector(rig, plan, polarization, light),
    )

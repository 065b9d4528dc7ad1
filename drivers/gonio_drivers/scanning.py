"""A spectrometer made of a monochromator and a lock-in amplifier: ``spectrometer.driver = "scanning"``.

A reading is: drive to the wavelength, read it back, let the lock-in settle, read X and its overload bits:
three exchanges when nothing else changes.  Grating, filter, output port (which is the detector) and shutter
are set only when they change.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gonio.config import Count, NotNegative
from gonio.devices import Beam, FloatArray, Quality, SpectrumReading
from gonio.errors import DeviceError, RefusedError, ScanStopped
from gonio.latency import PassTime
from gonio.rig import Context, DetectorConfig, Driver, SpectrometerConfig
from gonio_drivers.cs260 import CS260, CS260Config, open_cs260
from gonio_drivers.ranges import RangeMemory
from gonio_drivers.scan_time import pass_time
from gonio_drivers.sr830 import FULL_SCALE_V, SR830, SR830Config, open_sr830

_MOST_RANGE_CHANGES = 8  # from any range to any other, with an overload on the way
_LOOKS_AT_SATURATION = 2  # further ones, each after settling, before the largest range is called saturated


class ScanningDetectorConfig(DetectorConfig):
    """One detector, chosen by the monochromator's output port."""

    output_port: Count | None = None  # by default the place in the list, counted from one


class ScanningConfig(SpectrometerConfig):
    """``[spectrometer]`` with ``driver = "scanning"``."""

    monochromator: CS260Config
    lockin: SR830Config
    range_changes_per_pass: NotNegative = 1.0  # over a sample, for the estimate: its spectrum decides
    detectors: tuple[ScanningDetectorConfig, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _gratings_cover_detectors(self) -> Self:
        for detector in self.detectors:
            for wavelength_nm in detector.range_nm:
                try:
                    self.monochromator.grating_for(wavelength_nm)
                    self.monochromator.filter_for(wavelength_nm)
                except RefusedError as error:
                    raise ValueError(f"detector '{detector.name}': {error}") from None
        return self

    def addresses(self) -> dict[str, str]:
        """Return the addresses of both parts."""
        return {"monochromator": self.monochromator.address, "lockin": self.lockin.address}

    def port_of(self, detector: int) -> int:
        """Return the output port of a detector."""
        port = self.detectors[detector].output_port
        return detector + 1 if port is None else port

    def averages_for(self, integration_s: float) -> int:
        """Return how many readings, `SR830Config.spacing_s` apart, fill an integration time."""
        return max(1, math.ceil(integration_s / self.lockin.spacing_s() - 1e-9))

    def reading_duration_s(self, wavelength_nm: FloatArray, averages: int | NDArray[np.integer]) -> float:
        """Return the estimated instrument time of one pass, the drive back to its beginning included,
        seconds; searches for a range are not counted.
        """
        detectors = np.array([self._detector_of(float(w)) for w in wavelength_nm], dtype=np.uint8)
        after = (float(wavelength_nm[-1]), int(detectors[-1])) if len(detectors) else None
        return self.pass_time(wavelength_nm, detectors, averages, beam="direct", after=after).instrument_s

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
        """Return what one pass takes; see `gonio_drivers.scan_time`."""
        return pass_time(self, wavelength_nm, detector_index, averages, beam=beam, after=after, first=first)

    def _detector_of(self, wavelength_nm: float) -> int:
        """Return the detector for an estimate; which one measures is decided by `RigConfig.detector_for`."""
        return sum(wavelength_nm >= d.range_nm[0] for d in self.detectors[1:])


class ScanningSpectrometer:
    """Monochromator and lock-in; satisfies `gonio.devices.Spectrometer`."""

    name = "spectrometer"
    parent = None

    def __init__(self, config: ScanningConfig, context: Context, monochromator: CS260, lockin: SR830) -> None:
        self._config = config
        self._clock = context.clock
        self._monochromator = monochromator
        self._lockin = lockin
        self._ranges = RangeMemory(FULL_SCALE_V, smallest_v=config.lockin.smallest_range_v)
        self._settle_s = config.lockin.settle_s()
        self._jump_settle_s = config.lockin.jump_settle_s()
        self._spacing_s = config.lockin.spacing_s()
        self._stop_asked = threading.Event()

    def measure_spectrum(
        self,
        wavelength_nm: FloatArray,
        detector_index: NDArray[np.uint8],
        *,
        beam: Beam = "sample",
        averages: int | NDArray[np.integer] = 1,
        on_reading: Callable[[int], None] | None = None,
    ) -> SpectrumReading:
        """Measure at each wavelength with the given detector, in the given order.

        Parameters
        ----------
        wavelength_nm
            (n_wavelength,) float64, nm.
        detector_index
            (n_wavelength,) index into the rig's detectors.
        beam
            ``sample`` and ``direct`` open the shutter, ``dark`` closes it; each keeps its own amplifier
            ranges.
        averages
            Readings per wavelength, one number or (n_wavelength,), spaced so that their noise is nearly
            independent (`gonio_drivers.sr830.SPACING_TIME_CONSTANTS`).
        on_reading
            Called with the index after each reading; what it raises ends the pass.

        Returns
        -------
        SpectrumReading
            Mean X in volts, its sample standard deviation, wavelengths read back, time and quality.  A value
            whose quality has `Quality.OVER_RANGE` saturated the largest range and is a lower bound.

        Raises
        ------
        ScanStopped
            `stop` was called; the readings of this pass are lost.
        RefusedError
            No grating or filter covers a wavelength, or there is no such detector; nothing was sent.
        DeviceError
            An instrument does not answer or does not do what it is told.
        """
        self._stop_asked.clear()
        wavelengths = np.asarray(wavelength_nm, dtype=np.float64)
        detectors = np.asarray(detector_index)
        counts = np.broadcast_to(averages, wavelengths.shape)
        self._check(wavelengths, detectors, counts)
        n = len(wavelengths)
        readback_nm, signal_v, sd_v, time_s = (np.full(n, np.nan) for _ in range(4))
        quality = np.zeros(n, dtype=np.uint16)
        # The signal may have changed by orders of magnitude since the last pass: stage, polarizer, shutter.
        jump = True
        for i in range(n):
            if self._stop_asked.is_set():
                raise ScanStopped(f"the pass was stopped on request after {i} of {n} readings")
            retries = self._retries()
            jump |= self._set_light_path(float(wavelengths[i]), int(detectors[i]), beam)
            readback_nm[i] = self._monochromator.go_to(float(wavelengths[i]))
            samples_v, time_s[i], flags = self._read(beam, int(detectors[i]), int(counts[i]), jump=jump)
            jump = False
            signal_v[i] = samples_v.mean()
            if len(samples_v) > 1:  # an overload ends the averaging early
                sd_v[i] = samples_v.std(ddof=1)
            if self._retries() != retries:
                flags |= Quality.RETRIED
            quality[i] = flags
            if on_reading is not None:
                on_reading(i)
        self._monochromator.verify()
        self._lockin.verify()
        return SpectrumReading(readback_nm, signal_v, sd_v, averages, time_s, quality)

    def close_shutter(self) -> None:
        """Close the shutter and verify it."""
        self._monochromator.close_shutter()

    def recover(self) -> str:
        """Come back to a known state after a failure, with the shutter closed; say what was done for it.

        Raises
        ------
        DeviceError
            An instrument does not answer (yet), is another one, or does not do what it is told.
        """
        self._stop_asked.clear()
        self._ranges.forget()
        parts = {"monochromator": self._monochromator.recover(), "lockin": self._lockin.recover()}
        return ", ".join(f"{name}: {done}" for name, done in parts.items() if done)

    def identify(self) -> Mapping[str, str]:
        """Return what both instruments say of themselves."""
        return {"monochromator": self._monochromator.identify(), "lockin": self._lockin.identify()}

    def stop(self) -> None:
        """Let a running `measure_spectrum` end with `ScanStopped` at its next reading; any thread."""
        self._stop_asked.set()

    def close(self) -> None:
        """Close the shutter if the monochromator still answers, and release both lines."""
        try:
            self._monochromator.close_shutter()
        except DeviceError:
            self._stop_asked.set()  # its line is dead; the caller is told by whatever broke it
        finally:
            self._monochromator.close()
            self._lockin.close()

    def _check(
        self, wavelengths: FloatArray, detectors: NDArray[np.uint8], averages: NDArray[np.integer]
    ) -> None:
        if wavelengths.ndim != 1 or detectors.shape != wavelengths.shape:
            raise ValueError(
                f"wavelengths {wavelengths.shape} and detectors {detectors.shape} must be equal lists"
            )
        if np.any(averages < 1):
            raise RefusedError(f"averages = {averages.min()}: at least 1 reading is needed")
        if len(detectors) and int(detectors.max()) >= len(self._config.detectors):
            raise RefusedError(
                f"detector {int(detectors.max())} does not exist; the rig has {len(self._config.detectors)}, "
                "counted from 0"
            )
        for wavelength_nm in wavelengths:
            self._config.monochromator.grating_for(float(wavelength_nm))
            self._config.monochromator.filter_for(float(wavelength_nm))

    def _set_light_path(self, wavelength_nm: float, detector: int, beam: Beam) -> bool:
        """Set what the monochromator has besides the wavelength; return whether anything changed."""
        mono = self._monochromator
        changed = mono.select_bands(wavelength_nm)
        changed |= mono.select_port(self._config.port_of(detector))
        changed |= mono.set_shutter(beam != "dark")
        return changed

    def _read(
        self, beam: Beam, detector: int, averages: int, *, jump: bool
    ) -> tuple[FloatArray, float, Quality]:
        """Find the range, settle, and return the samples in volts, their mean time and the flags."""
        flags = Quality.GOOD
        lockin = self._lockin
        jump |= lockin.set_range(self._ranges.start(beam, detector))
        self._clock.sleep(self._jump_settle_s if jump else self._settle_s)
        patience = _LOOKS_AT_SATURATION
        for _ in range(_MOST_RANGE_CHANGES + patience):
            samples_v, magnitude_v, overload, time_s = self._samples(averages)
            index = lockin.range_index
            better = self._ranges.better(index, magnitude_v, overload=overload)
            if better == index and overload and patience:
                patience -= 1  # the largest range: a detector that was blinded for a moment may be back
                self._clock.sleep(self._jump_settle_s)
                continue
            if better == index:
                break
            lockin.set_range(better)
            flags |= Quality.RANGE_CHANGED
            self._clock.sleep(self._jump_settle_s)
        else:
            overload = True  # no range suits: the signal changes faster than ranges can follow
        if overload:
            flags |= Quality.OVER_RANGE
        else:
            self._ranges.remember(beam, detector, lockin.range_index)
        return samples_v, time_s, flags

    def _samples(self, averages: int) -> tuple[FloatArray, float, bool, float]:
        """Return X of each reading [V], the largest magnitude [V], whether any overloaded, mean time [s]."""
        samples_v = np.empty(averages)
        largest_v, overload, time_s = 0.0, False, 0.0
        for k in range(averages):
            if k:
                self._clock.sleep(self._spacing_s)
            reading = self._lockin.read()
            if reading.overload:
                # The bits are latched: this overload may be that of the light sweeping past during the drive,
                # or a spike, whose trace in the low-pass bears no bit any more.
                self._clock.sleep(self._jump_settle_s)
                reading = self._lockin.read()
            samples_v[k] = reading.x_v
            time_s += self._clock.now_s() / averages
            largest_v = max(largest_v, math.hypot(reading.x_v, reading.y_v))
            overload |= reading.overload
            if overload:
                return samples_v[: k + 1], largest_v, True, self._clock.now_s()
        return samples_v, largest_v, overload, time_s

    def _retries(self) -> int:
        return self._monochromator.line.statistics.retries + self._lockin.line.statistics.retries


def open_spectrometer(config: ScanningConfig, context: Context) -> ScanningSpectrometer:
    """Connect both instruments.

    Raises
    ------
    ConnectionFailed
        An address cannot be opened.
    DeviceError
        An instrument does not answer or is another one.
    """
    monochromator = open_cs260(config.monochromator, context)
    try:
        lockin = open_sr830(config.lockin, context)
    except BaseException:
        monochromator.close()
        raise
    return ScanningSpectrometer(config, context, monochromator, lockin)


driver = Driver("spectrometer", ScanningConfig, open_spectrometer)

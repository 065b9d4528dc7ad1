"""How one step is measured: polarizer, motion, pass over the wavelengths, and the proof that nothing turned.

A reading is recorded under the angles that were read back before its pass, and only if they are still true at
its end.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from gonio.acquire.steps import PositionStep, ReferenceStep, Step
from gonio.devices import Beam, FloatArray, Polarization, Quality, SpectrumReading
from gonio.errors import DeviceError, GonioError
from gonio.plan.channels import Channels
from gonio.plan.model import Plan
from gonio.rig import Rig
from gonio.store.records import PositionRecord, ReferenceRecord

_RECORDED = ("wavelength_nm", "signal_v", "signal_sd_v", "time_s", "quality")


class Measurer:
    """Measures steps on a rig, one after the other, from one thread.

    Parameters
    ----------
    rig, plan, channels
        Connected devices, the plan, and the columns it asks of them.
    check
        Raises what shall end a step early (a stop); called between the parts of a step.
    on_reading
        Called with the index, in measuring order, after each reading; what it raises ends the step.
    """

    def __init__(
        self,
        rig: Rig,
        plan: Plan,
        channels: Channels,
        *,
        check: Callable[[], None],
        on_reading: Callable[[int], None],
    ) -> None:
        self.offset_s = 0.0  # scan time minus the rig's clock
        self.angles_deg: tuple[float, float] | None = None  # verified, of the step being measured
        self._rig = rig
        self._plan = plan
        self._channels = channels
        self._check = check
        self._on_reading = on_reading
        self._selected: Polarization | None = None
        self._polarizer_deg: float | None = None
        self._begun: Step | None = None  # its motion is under way
        self._begin_failed: GonioError | None = None

    def measure(self, step: Step) -> PositionRecord | ReferenceRecord:
        """Measure a step whole and return its record.

        Raises
        ------
        RefusedError
            The rig must not go there from where it stands.
        DeviceError
            A device failed; nothing of the step is kept.
        """
        self.angles_deg = None
        polarization = step.polarization if isinstance(step, ReferenceStep) else step.position.polarization
        if polarization != "any":
            self._select(polarization)
        angles = self._move(step)
        reading = self._pass(step)
        # The polarizer of a dark reading is whatever it was: no light comes through.
        self._rig.verify_still(*angles, None if polarization == "any" else self._polarizer_deg)
        return self._record(step, angles, reading)

    def begin(self, step: Step) -> None:
        """Begin the motion of the step that comes next; its `measure` completes it, or tells what failed."""
        self._begun, self._begin_failed = None, None
        try:
            self._rig.begin_move(*self._target(step))
        except GonioError as error:
            self._begin_failed = error
        self._begun = step

    def skipped(self, step: PositionStep) -> PositionRecord:
        """Return the record of a position that could not be measured: NaN, flagged as skipped."""
        m = len(self._channels)
        nothing = np.full(m, np.nan)
        reading = SpectrumReading(
            nothing,
            nothing,
            nothing,
            self._channels.averages_asked,
            np.full(m, self._rig.clock.now_s()),
            np.full(m, Quality.SKIPPED, dtype=np.uint16),
        )
        return self._position(step, (float("nan"), float("nan")), reading)

    def forget(self) -> None:
        """Believe nothing of what was selected or begun; after a failure or a pause."""
        self._selected = self._polarizer_deg = self._begun = self._begin_failed = None
        self.angles_deg = None

    def rest(self) -> list[str]:
        """Stop all motion, close the shutter and believe nothing any more; return what failed on the way."""
        self.forget()
        return rest(self._rig)

    # -- the parts of a step ---------------------------------------------------------------------------------

    def _select(self, polarization: Polarization) -> None:
        self._check()
        if polarization != self._selected:
            self._selected = None
            self._polarizer_deg = self._rig.polarizer.select(polarization)
            self._selected = polarization

    def _target(self, step: Step) -> tuple[float, float]:
        if isinstance(step, PositionStep):
            return step.position.theta_i_deg, step.position.theta_mes_deg
        # A dark is taken there too: whatever light leaks past the shutter is then the same for both.
        baseline = self._rig.config.baseline
        return baseline.theta_i_deg, baseline.theta_mes_deg

    def _move(self, step: Step) -> tuple[float, float]:
        self._check()
        begun, failed = self._begun, self._begin_failed
        self._begun = self._begin_failed = None
        if begun is not step:
            self._rig.begin_move(*self._target(step))
        elif failed is not None:
            raise failed
        self.angles_deg = self._rig.finish_move()
        return self.angles_deg

    def _pass(self, step: Step) -> SpectrumReading:
        """Run over the wavelengths, up or down, and return them as the columns have them."""
        self._check()
        channels = self._channels
        if isinstance(step, PositionStep):
            beam: Beam = "sample"
            averages = channels.averages_asked
        else:
            beam = "dark" if step.kind == "dark" else "direct"
            averages = self._plan.references.averages_of(step.kind)
        order = slice(None, None, -1) if step.descending else slice(None)
        reading = self._rig.spectrometer.measure_spectrum(
            channels.wavelength_nm[order],
            channels.detector_index[order],
            beam=beam,
            averages=averages if isinstance(averages, int) else averages[order],
            on_reading=self._on_reading,
        )
        self._check()  # a driver may have ended its pass early because of a stop
        self._must_fit(reading)
        return SpectrumReading(
            reading.wavelength_nm[order],
            reading.signal_v[order],
            reading.signal_sd_v[order],
            averages,
            reading.time_s[order],
            reading.quality[order],
        )

    def _must_fit(self, reading: SpectrumReading) -> None:
        m = len(self._channels)
        for name in _RECORDED:
            shape = np.shape(getattr(reading, name))
            if shape != (m,):
                raise DeviceError(
                    self._rig.spectrometer.name,
                    f"returned {name} of shape {shape} for {m} wavelengths",
                    "this is a defect of its driver; report it",
                )

    # -- records ---------------------------------------------------------------------------------------------

    def _record(
        self, step: Step, angles: tuple[float, float], reading: SpectrumReading
    ) -> PositionRecord | ReferenceRecord:
        if isinstance(step, PositionStep):
            return self._position(step, angles, reading)
        return ReferenceRecord(
            kind=step.kind,
            when=step.when,
            polarization=step.polarization,
            theta_i_deg=angles[0],
            theta_mes_deg=angles[1],
            averages=reading.averages,
            unix_s=time.time(),
            wavelength_nm=reading.wavelength_nm,
            signal_v=reading.signal_v,
            signal_sd_v=reading.signal_sd_v,
            time_s=self._scan_time_s(reading),
            quality=reading.quality,
        )

    def _position(
        self, step: PositionStep, angles: tuple[float, float], reading: SpectrumReading
    ) -> PositionRecord:
        return PositionRecord(
            index=step.position.index,
            polarization=step.position.polarization,
            theta_i_deg=angles[0],
            theta_mes_deg=angles[1],
            polarizer_deg=float("nan") if self._polarizer_deg is None else self._polarizer_deg,
            averages=reading.averages,
            unix_s=time.time(),
            wavelength_nm=reading.wavelength_nm,
            signal_v=reading.signal_v,
            signal_sd_v=reading.signal_sd_v,
            time_s=self._scan_time_s(reading),
            quality=reading.quality,
        )

    def _scan_time_s(self, reading: SpectrumReading) -> FloatArray:
        return np.asarray(reading.time_s + self.offset_s, dtype=np.float64)


def rest(rig: Rig) -> list[str]:
    """Stop all motion and close the shutter, whatever fails on the way; return what failed."""
    troubles: list[str] = []
    for action in (
        rig.stage.stop,
        rig.polarizer.stop,
        rig.spectrometer.stop,
        rig.spectrometer.close_shutter,
    ):
        try:
            action()
        except (GonioError, OSError) as error:
            troubles.append(str(error))
    return troubles

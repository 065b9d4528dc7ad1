"""The engine that runs a scan: the same for the command line, a script and a window.

`Runner.run` works in the calling thread and knows neither Qt nor a terminal; `pause`, `resume` and `stop`
may be called from any other.  What it does, in order:

1. check everything: plan against rig, target file, disk space, an answer from each device; no file exists
until then; 2. create the journal and the `.h5` (`gonio.acquire.session`); 3. starting references in the
baseline position (dark once, direct beam per polarization); 4. the positions; each is recorded whole,
with its angles read back, or not at all; 5. ending references, correction of all positions with them,
removal of the journal.

Times are seconds on the instrument clock since the scan began.  When a scan is resumed, the axis goes on
after the last recorded time: on real hardware by the time that passed meanwhile, since lamp and amplifier
drift whether or not we measure; on a simulated bench, whose clock begins anew, without a gap.
"""

from __future__ import annotations

import datetime
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import gonio
from gonio.acquire.session import OnRecord, Session, facts_of, refuse_existing
from gonio.acquire.state import Snapshot, State
from gonio.acquire.steps import Pace, PositionStep, ReferenceStep, Step, steps_of
from gonio.aperture import Aperture
from gonio.devices import Beam, Polarization, SpectrumReading
from gonio.errors import DeviceError, GonioError, RefusedError, ScanStopped, StoreError
from gonio.plan.channels import Channels, channels
from gonio.plan.check import check
from gonio.plan.model import Plan
from gonio.plan.optimise import resolved
from gonio.rig import Rig
from gonio.store.records import (
    EventRecord,
    Level,
    PositionRecord,
    ReferenceRecord,
    ScanHeader,
)

_SNAPSHOT_INTERVAL_S = 0.05  # real seconds between snapshots of readings: 20 Hz is what an eye can follow
_PAUSE_POLL_S = 0.02
_BYTES_PER_READING = 300  # journal and .h5 together, and a rebuilt .h5 beside the old one
_SHOWN_REFUSALS = 10

OnSnapshot = Callable[[Snapshot], None]


class Runner:
    """Runs one scan; see `State` for its states and the module for its steps.

    Parameters
    ----------
    rig
        Connected devices; the runner stops them and closes the shutter at every end of a run, but does
        not disconnect.
    plan
        What to measure.
    path
        The `.h5` to write; it must not exist, unless the runner `continues` a scan (see `resume_scan`).
    on_snapshot
        Called in the thread of `run` at every change of state, after every position, and during a
        position at most 20 times a second.  It must be quick; an exception from it ends the scan.
    on_record
        Called in the thread of `run` with every position, reference and event once it is on the disk; when
        a scan goes on, with those measured before first.  The same holds for its exceptions.
    """

    def __init__(
        self,
        rig: Rig,
        plan: Plan,
        path: str | Path,
        *,
        on_snapshot: OnSnapshot | None = None,
        on_record: OnRecord | None = None,
        continues: bool = False,
    ) -> None:
        self.path = Path(path)
        self.plan = resolved(plan, rig.config)
        self._wavelength_nm = plan.wavelength_nm  # the rig's columns once they are known to be covered
        self._channels: Channels | None = None
        self._n_positions = plan.n_positions
        self._rig = rig
        self._on_snapshot = on_snapshot
        self._on_record = on_record
        self._continues = continues
        self._state = State.IDLE
        self._active = False
        self._stop_requested = False
        self._pause_requested = False
        self._session: Session | None = None
        self._steps: list[Step] = []
        self._pace: Pace | None = None
        self._offset_s = 0.0  # scan time minus the rig's clock
        self._step: Step | None = None
        self._angles_deg: tuple[float, float] | None = None
        self._reading = 0
        self._done = 0
        self._steps_done = 0
        self._selected: Polarization | None = None
        self._polarizer_deg = float("nan")
        self._message = ""
        self._published_s = 0.0

    # -- asked from any thread
    # ---------------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    def pause(self) -> None:
        """Pause when the position being measured is done; without effect if no scan runs."""
        self._pause_requested = self._active

    def resume(self) -> None:
        """Go on after `pause`."""
        self._pause_requested = False

    def stop(self) -> None:
        """Stop motion at once and the scan within one reading; callable at any time, any number of times.

        `run` then closes the shutter, leaves a file that can be resumed, and raises `ScanStopped`.
        """
        if self._active:
            self._stop_requested = True
            self._state = State.STOPPING
        self._rig.stop()

    def snapshot(self) -> Snapshot:
        """Return where the scan stands now."""
        step, m = self._step, len(self._wavelength_nm)
        at = step.position if isinstance(step, PositionStep) else None
        angles = self._angles_deg or (None, None)
        polarization = (
            step.polarization if isinstance(step, ReferenceStep) else at.polarization if at else None
        )
        now_s = self._now_s() if self._active else (self._session.last_time_s if self._session else 0.0)
        left_s = self._pace.left_s(now_s, step, self._reading / m) if self._pace and self._active else 0.0
        return Snapshot(
            state=self._state,
            done=self._done,
            total=self._n_positions,
            readings_done=self._steps_done * m + self._reading,
            readings_total=len(self._steps) * m,
            elapsed_s=now_s,
            left_s=left_s,
            position=at.index if at else None,
            theta_i_deg=angles[0],
            theta_mes_deg=angles[1],
            polarization=polarization if polarization in ("s", "p") else None,
            wavelength_nm=self._wavelength_of(step, self._reading) if step else None,
            message=self._message,
        )

    def _wavelength_of(self, step: Step, reading: int) -> float:
        at = min(reading, len(self._wavelength_nm) - 1)
        return float(self._wavelength_nm[-1 - at if step.descending else at])

    # -- the run
    # -----------------------------------------------------------------------------------------------

    def run(self) -> Path:
        """Measure everything that is not measured yet, and return the path of the finished file.

        Raises
        ------
        RefusedError
            The rig must not or cannot measure the plan; nothing has moved and no file was made.
        StoreError
            The file cannot be made or written.
        DeviceError
            A device failed; what was measured before is kept and the scan can be resumed.
        ScanStopped
            `stop` was called.
        """
        if self._active or self._state is State.DONE:
            raise RuntimeError(f"the scan into {self.path} is {self._state.value} and cannot be run now")
        self._active, self._stop_requested, self._pause_requested = True, False, False
        try:
            self._set(State.PREPARING, "checking plan and devices")
            devices = self._checked()
            self._open_session(devices)
            self._set(State.RUNNING, "")
            for step in self._steps:
                if step.key not in self._open.done:
                    self._between_steps()
                    self._measure(step)
            self._rig.spectrometer.close_shutter()
            self._step = None
            self._message = "correcting with all references"
            self._open.finish(_now_iso())
            self._active = False
            self._set(State.DONE, f"{self.path} is complete")
        except BaseException as error:
            self._end_badly(error)
            raise
        finally:
            self._active = False
            if self._session is not None:
                with suppress(StoreError):  # after an error of the disk, which has been raised already
                    self._session.close()
        return self.path

    def _checked(self) -> dict[str, str]:
        """Check all that can be checked before a file is made; return what the devices say they are."""
        config = self._rig.config
        refusals = check(self.plan, config)
        if refusals:
            shown = "\n".join(str(refusal) for refusal in refusals[:_SHOWN_REFUSALS])
            more = (
                f"\n... and {len(refusals) - _SHOWN_REFUSALS} more" if len(refusals) > _SHOWN_REFUSALS else ""
            )
            raise RefusedError(f"the plan '{self.plan.title}' cannot be measured:\n{shown}{more}")
        Aperture(config.aperture.width_mm, config.aperture.height_mm, config.aperture.distance_mm)
        if not self._continues:
            refuse_existing(self.path)
        self._channels = channels(self.plan, config)
        self._wavelength_nm = self._channels.wavelength_nm
        self._steps = steps_of(self.plan, config)
        needed = len(self._steps) * len(self._wavelength_nm) * _BYTES_PER_READING + 1_000_000
        free = shutil.disk_usage(self.path.absolute().parent).free
        if free < needed:
            raise StoreError(
                f"{self.path}: the scan takes up to {needed / 1e6:.0f} MB and the disk has "
                f"{free / 1e6:.0f} MB left; free some space or choose another disk"
            )
        rig = self._rig
        answers = {"stage": rig.stage.identify(), "polarizer": rig.polarizer.identify()}
        return answers | dict(rig.spectrometer.identify())

    def _open_session(self, devices: dict[str, str]) -> None:
        facts = facts_of(self._rig.config)
        clock = self._rig.clock
        if self._continues:
            self._session, note = Session.resume(self.path, facts, self._on_record)
            away_s = max(time.time() - self._session.last_unix_s, 0.0)
            gap_s = away_s if clock.speed == 1.0 else 0.0
            self._offset_s = self._session.last_time_s + gap_s - clock.now_s()
            if note:
                self._event("warning", note)
            self._event("info", f"resumed {away_s:.0f} s after the last record")
        else:
            header = ScanHeader(
                plan_text=self.plan.to_toml(),
                rig_text=self._rig.config.text,
                rig=facts,
                detector_index=self._columns.detector_index,
                devices=devices,
                program=f"gonio {gonio.__version__}",
                start_time=_now_iso(),
                unix_s=time.time(),
                wavelength_nm=self._columns.wavelength_nm,
            )
            self._offset_s = -clock.now_s()
            self._session = Session.begin(self.path, header, self.plan, self._on_record)
        self._continues = True  # should this run end early, the next one goes on from here
        left = [step for step in self._steps if step.key not in self._session.done]
        self._steps_done = len(self._steps) - len(left)
        self._done = sum(isinstance(key, int) for key in self._session.done)
        self._selected = None
        self._pace = Pace(left, self._now_s())

    def _between_steps(self) -> None:
        self._raise_if_stopped()
        if not self._pause_requested:
            return
        self._rig.spectrometer.close_shutter()
        began_s = self._now_s()
        self._event("info", "paused by the operator, shutter closed")
        self._step = None
        self._set(State.PAUSED, "paused, shutter closed")
        while self._pause_requested and not self._stop_requested:
            time.sleep(_PAUSE_POLL_S)
        self._raise_if_stopped()
        if self._pace is not None:
            self._pace.paused(self._now_s() - began_s)
        self._event("info", "resumed by the operator")
        self._set(State.RUNNING, "")

    def _measure(self, step: Step) -> None:
        self._step, self._reading, self._angles_deg = step, 0, None
        self._message = _describe(step)
        if isinstance(step, PositionStep):
            record: PositionRecord | ReferenceRecord = self._position(step)
        else:
            record = self._reference(step)
        self._open.record(record)
        self._done += isinstance(step, PositionStep)
        self._steps_done += 1
        self._step, self._reading = None, 0
        if self._pace is not None:
            self._pace.step_done(step)
        self._publish()

    def _position(self, step: PositionStep) -> PositionRecord:
        position = step.position
        self._select(position.polarization)
        theta_i, theta_mes = self._move(position.theta_i_deg, position.theta_mes_deg)
        reading = self._read("sample", self._columns.averages_asked, descending=step.descending)
        return PositionRecord(
            index=position.index,
            polarization=position.polarization,
            theta_i_deg=theta_i,
            theta_mes_deg=theta_mes,
            polarizer_deg=self._polarizer_deg,
            averages=reading.averages,
            unix_s=time.time(),
            wavelength_nm=reading.wavelength_nm,
            signal_v=reading.signal_v,
            signal_sd_v=reading.signal_sd_v,
            time_s=reading.time_s + self._offset_s,
            quality=reading.quality,
        )

    def _reference(self, step: ReferenceStep) -> ReferenceRecord:
        if step.polarization != "any":
            self._select(step.polarization)
        baseline = self._rig.config.baseline
        # a dark is taken there too: whatever light leaks past the shutter is then the same for both
        theta_i, theta_mes = self._move(baseline.theta_i_deg, baseline.theta_mes_deg)
        reading = self._read(
            "dark" if step.kind == "dark" else "direct",
            self.plan.references.averages_of(step.kind),
            descending=step.descending,
        )
        return ReferenceRecord(
            kind=step.kind,
            when=step.when,
            polarization=step.polarization,
            theta_i_deg=theta_i,
            theta_mes_deg=theta_mes,
            averages=reading.averages,
            unix_s=time.time(),
            wavelength_nm=reading.wavelength_nm,
            signal_v=reading.signal_v,
            signal_sd_v=reading.signal_sd_v,
            time_s=reading.time_s + self._offset_s,
            quality=reading.quality,
        )

    # -- the devices
    # -------------------------------------------------------------------------------------------

    def _select(self, polarization: Polarization) -> None:
        self._raise_if_stopped()
        if polarization != self._selected:
            self._selected = None
            self._polarizer_deg = self._rig.polarizer.select(polarization)
            self._selected = polarization

    def _move(self, theta_i_deg: float, theta_mes_deg: float) -> tuple[float, float]:
        self._raise_if_stopped()
        angles = self._rig.move_to(theta_i_deg, theta_mes_deg)
        self._angles_deg = angles
        return angles

    def _read(
        self, beam: Beam, averages: int | NDArray[np.integer], *, descending: bool
    ) -> SpectrumReading:
        self._raise_if_stopped()
        way = slice(None, None, -1) if descending else slice(None)
        columns = self._columns
        spectrometer = self._rig.spectrometer
        reading = spectrometer.measure_spectrum(
            columns.wavelength_nm[way],
            columns.detector_index[way],
            beam=beam,
            averages=averages if isinstance(averages, int) else averages[way],
            on_reading=self._on_reading,
        )
        self._raise_if_stopped()  # a driver may have ended its pass early because of the stop
        m = len(self._wavelength_nm)
        for name in ("wavelength_nm", "signal_v", "signal_sd_v", "time_s", "quality"):
            shape = np.shape(getattr(reading, name))
            if shape != (m,):
                raise DeviceError(
                    spectrometer.name,
                    f"returned {name} of shape {shape} for {m} wavelengths",
                    "this is a defect of its driver; report it",
                )
        if not descending:
            return reading
        return SpectrumReading(
            wavelength_nm=reading.wavelength_nm[way],
            signal_v=reading.signal_v[way],
            signal_sd_v=reading.signal_sd_v[way],
            averages=reading.averages if isinstance(reading.averages, int) else reading.averages[way],
            time_s=reading.time_s[way],
            quality=reading.quality[way],
        )

    @property
    def _columns(self) -> Channels:
        if self._channels is None:
            raise RuntimeError("the plan has not been checked yet")
        return self._channels

    def _on_reading(self, index: int) -> None:
        self._raise_if_stopped()
        self._reading = index + 1
        if time.monotonic() - self._published_s > _SNAPSHOT_INTERVAL_S:
            self._publish()

    # -- ends
    # --------------------------------------------------------------------------------------------------

    def _raise_if_stopped(self) -> None:
        if self._stop_requested:
            raise ScanStopped("the scan was stopped")

    def _end_badly(self, error: BaseException) -> None:
        """Bring the devices to rest, keep what was measured, and let the error say how to go on."""
        interrupted = self._stop_requested or isinstance(error, KeyboardInterrupt)
        if interrupted:
            self._state = State.STOPPING
        troubles = self._rest()
        began = self._session is not None
        go_on = (
            f"; everything measured is kept, continue with: gonio scan --resume {self.path}" if began else ""
        )
        reason = "stopped by the operator" if interrupted else f"{type(error).__name__}: {error}"
        if began:
            with suppress(Exception):  # the disk may be what failed
                self._event("info" if interrupted else "error", "; ".join([reason, *troubles]))
        self._active = False
        self._step = None
        with suppress(Exception):  # the first error counts, not what a callback makes of it
            if interrupted:
                self._set(State.IDLE, f"stopped{go_on}")
            else:
                self._set(State.FAILED, f"{error}{go_on}")
        if self._stop_requested and isinstance(error, Exception):
            raise ScanStopped("; ".join([f"the scan was stopped{go_on}", *troubles])) from None
        if isinstance(error, GonioError) and began:
            error.args = (f"{error}{go_on}",)
        if isinstance(error, OSError):
            raise StoreError(f"{self.path}: {error}{go_on}") from error

    def _rest(self) -> list[str]:
        """Stop motion and close the shutter, whatever fails on the way; return what failed."""
        troubles: list[str] = []
        rig = self._rig
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

    # -- small things
    # ------------------------------------------------------------------------------------------

    @property
    def _open(self) -> Session:
        if self._session is None:
            raise RuntimeError("no file is open")
        return self._session

    def _now_s(self) -> float:
        return self._rig.clock.now_s() + self._offset_s

    def _event(self, level: Level, message: str) -> None:
        self._open.record(EventRecord(self._now_s(), time.time(), level, "runner", message))

    def _set(self, state: State, message: str) -> None:
        if not (self._stop_requested and self._active):  # `stop` has set the state, which stays until the end
            self._state = state
        self._message = message
        self._publish()

    def _publish(self) -> None:
        self._published_s = time.monotonic()
        if self._on_snapshot is not None:
            self._on_snapshot(self.snapshot())


def _describe(step: Step) -> str:
    if isinstance(step, PositionStep):
        at = step.position
        return f"theta_i = {at.theta_i_deg:g} deg, theta_mes = {at.theta_mes_deg:g} deg, {at.polarization}"
    if step.kind == "dark":
        return f"dark reading at the {step.when}"
    return f"100 % baseline at the {step.when}, {step.polarization}"


def _now_iso() -> str:
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")

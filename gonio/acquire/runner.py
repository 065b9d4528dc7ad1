"""The engine that runs a scan: the same for the command line, a script and a window.

`Runner.run` works in the calling thread and knows neither Qt nor a terminal; `pause`, `resume`, `stop` and
`stop_motion` may be called from any other.  What it does, in order:

1. check everything: plan against rig, target file, disk space, an answer from each device; no file exists
until then; 2. create the journal and the `.h5` (`gonio.acquire.session`); 3. starting references in the
baseline position (dark once, direct beam per polarization); 4. the positions, with references between them as
planned; each is recorded whole, with its angles read back, or not at all (`gonio.acquire.measuring`); the
motion of the next begins before the record of the last is on the disk, unless a source has to see that
record first (`gonio.acquire.agenda`); 5. ending references, correction of all positions with them, removal
of the journal.

A step at which a device fails is measured anew after recovery; then `FaultPolicy` says what follows.

Times are seconds on the instrument clock since the scan began.  When a scan is resumed, the axis goes on
after the last recorded time: on real hardware by the time that passed meanwhile, since lamp and amplifier
drift whether or not we measure; on a simulated bench, whose clock begins anew, without a gap.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from gonio.acquire.agenda import Agenda
from gonio.acquire.measuring import Measurer, rest
from gonio.acquire.opening import agenda_of, begun, taken_up
from gonio.acquire.policy import FaultPolicy, attempts
from gonio.acquire.preparing import Prepared, now_iso, prepared
from gonio.acquire.session import OnRecord, Session
from gonio.acquire.sourcing import Asked, asked
from gonio.acquire.state import Snapshot, State
from gonio.acquire.steps import PositionStep, ReferenceStep, Step, describe
from gonio.acquire.watchdog import Watchdog, silence
from gonio.devices import Quality
from gonio.errors import DeviceError, GonioError, RefusedError, ScanStopped, StoreError
from gonio.plan.model import Plan
from gonio.plan.optimise import resolved
from gonio.plan.source import PositionSource
from gonio.rig import Rig
from gonio.store.records import DecisionRecord, EventRecord, Level, PositionRecord, ReferenceRecord

_SNAPSHOT_INTERVAL_S = 0.05  # real seconds between snapshots of readings: 20 Hz is what an eye can follow
_PAUSE_POLL_S = 0.02
_MOST_SKIPPED_IN_A_ROW = 3  # more are no fault of the positions

OnSnapshot = Callable[[Snapshot], None]


class _Interrupted(GonioError):
    """The step was ended early for a pause at once; it is measured anew afterwards."""


class Runner:
    """Runs one scan; see `State` for its states and the module for its steps.

    Parameters
    ----------
    rig
        Connected devices; the runner stops them and closes the shutter at every end of a run, but does
        not disconnect.
    plan
        What to measure; with a source, all but the positions.
    path
        The `.h5` to write; it must not exist, unless the runner `continues` a scan (see `resume_scan`).
    on_snapshot
        Called in the thread of `run` at every change of state, after every position, and during a
        position at most 20 times a second.  It must be quick; an exception from it ends the scan.
    on_record
        Called in the thread of `run` with every position, reference and event once it is on the disk; when
        a scan goes on, with those measured before first.  The same holds for its exceptions.
    policy
        What is done when a device fails.
    source
        Chooses each position from what was measured; without one the plan says what is measured, or names the
        source.
    ask_again
        When a scan goes on, ask the source for the positions that were measured and refuse it if it gives
        others.  False for one that cannot answer the same any more.
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
        policy: FaultPolicy | None = None,
        source: PositionSource | None = None,
        ask_again: bool = True,
    ) -> None:
        self.path = Path(path)
        self.plan = resolved(plan, rig.config)
        self.policy = policy or FaultPolicy()
        self._wavelength_nm = plan.wavelength_nm  # the rig's columns once they are known to be covered
        self._given_source = source
        self._source: Asked | None = None
        self._ask_again = ask_again
        self._rig = rig
        self._on_snapshot = on_snapshot
        self._on_record = on_record
        self._continues = continues
        self._state = State.IDLE
        self._active = False
        self._stop_requested = False
        self._pause_requested = False
        self._pause_at_once = False
        self._session: Session | None = None
        self._measurer: Measurer | None = None
        self._agenda: Agenda | None = None
        self._step: Step | None = None
        self._latest: Step | None = None  # the one measured last, for what is shown between two
        self._reading = 0
        self._done = 0
        self._steps_done = 0
        self._skipped_in_a_row = 0
        self._watchdog = Watchdog(self.policy.silence_s, self._gave_no_sign)
        self._silent: DeviceError | None = None  # what the watchdog made of a silence
        self._untold: list[EventRecord] = []  # that the disk would not take
        self._message = ""
        self._published_s = 0.0

    # -- asked from any thread -------------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    def pause(self, *, at_once: bool = False) -> None:
        """Pause when the position being measured is done; `at_once` in the middle of it.

        At once, motors stop and the position is measured anew after `resume`.  Without effect if no scan
        runs.
        """
        if not self._active:
            return
        self._pause_requested = True
        if at_once and self._state is not State.PAUSED:
            self._pause_at_once = True
            self._rig.stop()

    def stop_motion(self) -> None:
        """Stop every motor now, whatever runs; a scan pauses at once."""
        if self._active:
            self.pause(at_once=True)
        else:
            self._rig.stop()

    def resume(self) -> None:
        """Go on after a pause, the operator's or that of a fault."""
        self._pause_requested = False

    def stop(self) -> None:
        """Stop motion at once and the scan within one reading; callable at any time, any number of times.

        `run` then closes the shutter, leaves a file that can be resumed, and raises `ScanStopped`.
        """
        if self._active:
            self._stop_requested = True
            self._state = State.ABORTING
        self._rig.stop()

    def snapshot(self) -> Snapshot:
        """Return where the scan stands now."""
        step, m = self._step, len(self._wavelength_nm)
        shown = step or self._latest
        at = shown.position if isinstance(shown, PositionStep) else None
        angles = (self._measurer.angles_deg if self._measurer else None) or (None, None)
        polarization = (
            shown.polarization if isinstance(shown, ReferenceStep) else at.polarization if at else None
        )
        now_s = self._now_s() if self._active else (self._session.last_time_s if self._session else 0.0)
        agenda, given = self._agenda, self._given_source
        left_s = agenda.pace.left_s(now_s, step, self._reading / m) if agenda and self._active else 0.0
        n_positions = self.plan.n_positions if given is None else given.max_positions
        column = min(self._reading, m - 1)
        if step is not None and step.descending:
            column = m - 1 - column
        return Snapshot(
            state=self._state,
            done=self._done,
            total=agenda.n_positions if agenda else n_positions,
            readings_done=self._steps_done * m + self._reading,
            readings_total=agenda.n_steps * m if agenda else 0,
            elapsed_s=now_s,
            left_s=left_s,
            position=at.index if at else None,
            theta_i_deg=angles[0],
            theta_mes_deg=angles[1],
            polarization=polarization if polarization in ("s", "p") else None,
            wavelength_nm=float(self._wavelength_nm[column]) if step else None,
            message=self._message,
        )

    # -- the run ---------------------------------------------------------------------------------------------

    def run(self) -> Path:
        """Measure everything that is not measured yet, and return the path of the finished file.

        Raises
        ------
        RefusedError
            The rig must not or cannot measure the plan; nothing has moved and no file was made.
        StoreError
            The file cannot be made or written.
        DeviceError
            A device failed more often than the policy allows; what was measured before is kept and the scan
            can be resumed.
        ScanStopped
            `stop` was called.
        """
        if self._active or self._state is State.DONE:
            raise RuntimeError(f"the scan into {self.path} is {self._state.value} and cannot be run now")
        self._active = True
        self._stop_requested = self._pause_requested = self._pause_at_once = False
        try:
            self._set(State.PREPARING, "checking plan and devices")
            self._source = asked(self._given_source, self.plan, self._rig.config)
            ready = prepared(self._rig, self.plan, self.path, continues=self._continues, source=self._source)
            self._wavelength_nm = ready.columns.wavelength_nm
            self._open_session(ready)
            self._set(State.RUNNING, "")
            with Watchdog(self.policy.silence_s, self._gave_no_sign) as self._watchdog:
                self._perform_all()
            self._rig.spectrometer.close_shutter()
            self._latest = self._step = None
            self._message = "correcting with all references"
            self._open.finish(now_iso())
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

    def _open_session(self, ready: Prepared) -> None:
        self._measurer = Measurer(
            self._rig, self.plan, ready.columns, check=self._raise_if_interrupted, on_reading=self._on_reading
        )
        rig, source, tell = self._rig, self._source, self._on_record
        if self._continues:
            opened = taken_up(rig, self.path, source, tell, ask_again=self._ask_again)
        else:
            opened = begun(rig, self.plan, self.path, ready, source, tell)
        self._session = session = opened.session
        self._measurer.offset_s = opened.offset_s
        for level, note in opened.notes:
            self._event(level, note)
        self._continues = True  # should this run end early, the next one goes on from here
        self._agenda = agenda_of(rig, self.plan, ready, source, session, self._now_s(), self._keep)
        self._steps_done = self._agenda.n_done
        self._done = sum(isinstance(key, int) for key in session.done)

    def _perform_all(self) -> None:
        assert self._agenda is not None
        while (step := self._next_step(self._agenda)) is not None:
            if self._pause_requested:
                self._wait_for_resume("paused by the operator", "info")
            record = self._perform(step)
            following = self._agenda.following
            if following is not None and not self._pause_requested and not self._stop_requested:
                self._devices.begin(following)  # the motors run while the disk works
            self._keep(record)
            self._done += isinstance(step, PositionStep)
            self._steps_done += 1
            self._latest, self._step, self._reading = step, None, 0
            self._agenda.pace.step_done(step)
            self._publish()

    def _next_step(self, agenda: Agenda) -> Step | None:
        """Return what is to be done now; a source that cannot be followed pauses the scan, or ends it."""
        while True:
            self._raise_if_stopped()
            try:
                return agenda.next()
            except RefusedError as error:
                if self.policy.then != "pause":
                    raise
                self._pause_requested = True
                self._wait_for_resume(str(error), "error")

    def _keep(self, record: DecisionRecord | PositionRecord | ReferenceRecord) -> None:
        """Put a record on the disk; a disk that is full or gone is waited for, if the policy is to pause."""
        while True:
            try:
                self._open.repair()
                self._open.record(record)
            except StoreError as error:
                if self.policy.then != "pause":
                    raise
                self._pause_requested = True
                self._wait_for_resume(str(error), "error")
            else:
                return

    def _perform(self, step: Step) -> PositionRecord | ReferenceRecord:
        """Measure a step, anew after faults as the policy says."""
        faults = failed = 0
        while True:
            self._step, self._reading = step, 0
            self._message = describe(step)
            try:
                record = self._devices.measure(step)
            except (_Interrupted, DeviceError, RefusedError, ScanStopped) as ended:
                self._raise_if_stopped()
                error = self._silent or ended
                self._silent = None
                if self._pause_at_once:  # the stop of the motors may have become an error of its own
                    self._wait_for_resume("paused at once by the operator", "info")
                    continue
                if not isinstance(error, DeviceError | RefusedError):
                    raise
                failed += 1
                faults = self._after_fault(step, error, faults + 1)
                if faults < 0:
                    assert isinstance(step, PositionStep)
                    return self._devices.skipped(step)
            else:
                if failed:
                    record.quality[:] |= np.uint16(Quality.RETRIED)
                    self._event("info", f"{describe(step)}: measured after {attempts(failed)}")
                self._skipped_in_a_row = 0
                return record

    def _after_fault(self, step: Step, error: GonioError, faults: int) -> int:
        """Bring the rig back after the `faults`-th fault in a row; return how many count from now on.

        Negative: the step is to be skipped.  Raises `error`, or what recovery failed with, when the policy
        allows no more.
        """
        policy = self.policy
        while True:
            troubles = self._devices.rest()
            self._event("warning", "; ".join([f"{describe(step)}: {error}", *troubles]), error)
            skips = False
            if isinstance(error, DeviceError) and faults <= policy.retries:
                self._message = f"attempt {faults + 1} of {policy.retries + 1} follows: {error}"
                self._wait(policy.wait_s(faults))
            elif policy.then == "pause":
                self._pause_requested = True
                self._wait_for_resume(str(error), "error")
                faults = 0
            elif policy.then == "skip" and isinstance(step, PositionStep):
                self._skipped_in_a_row += 1
                if self._skipped_in_a_row > _MOST_SKIPPED_IN_A_ROW:
                    raise error
                skips = True
            else:
                raise error
            try:
                done = self._rig.recover()
            except DeviceError as failure:
                self._raise_if_stopped()
                if skips:  # it is not the position that is at fault
                    raise
                error, faults = failure, faults + 1
                continue
            if done:
                self._event("info", f"recovered: {'; '.join(done)}")
            if skips:
                self._event("warning", f"{describe(step)}: skipped after {attempts(faults)}")
                return -1
            return faults

    # -- pauses and interruptions ----------------------------------------------------------------------------

    def _wait_for_resume(self, reason: str, level: Level) -> None:
        """Pause: motors at rest, shutter closed, until `resume` or `stop`."""
        self._pause_at_once = False
        troubles = self._devices.rest()
        began_s = self._now_s()
        self._event(level, "; ".join([f"{reason}: motors at rest, shutter closed", *troubles]))
        self._latest, self._step, self._reading = None, None, 0
        self._set(State.PAUSED, f"{reason}; motors at rest, shutter closed")
        while self._pause_requested and not self._stop_requested:
            time.sleep(_PAUSE_POLL_S)
        self._raise_if_stopped()
        if self._agenda is not None:
            self._agenda.pace.paused(self._now_s() - began_s)
        self._event("info", "resumed by the operator")
        self._set(State.RUNNING, "")

    def _wait(self, real_s: float) -> None:
        """Let a device have its time, without keeping a stop waiting."""
        self._publish()
        end_s = time.monotonic() + real_s
        while time.monotonic() < end_s:
            self._raise_if_stopped()
            time.sleep(min(_PAUSE_POLL_S, real_s))

    def _raise_if_stopped(self) -> None:
        if self._stop_requested:
            raise ScanStopped("the scan was stopped")

    def _raise_if_interrupted(self) -> None:
        self._watchdog.feed()
        self._raise_if_stopped()
        if self._silent is not None:
            raise _Interrupted("no sign of life")
        if self._pause_at_once:
            raise _Interrupted("the step was ended early")

    def _on_reading(self, index: int) -> None:
        self._raise_if_interrupted()
        self._reading = index + 1
        if time.monotonic() - self._published_s > _SNAPSHOT_INTERVAL_S:
            self._publish()

    def _gave_no_sign(self, silent_s: float) -> None:
        """Stop everything, so that whatever hangs may come back with an error; the watchdog's thread."""
        if self._state is State.RUNNING and self._step is not None:  # a source may think as long as it likes
            self._silent = silence(silent_s, self._message)
            self._message = str(self._silent)
            with suppress(GonioError, OSError):
                self._rig.stop()

    # -- ends ------------------------------------------------------------------------------------------------

    def _end_badly(self, error: BaseException) -> None:
        """Bring the devices to rest, keep what was measured, and let the error say how to go on."""
        interrupted = self._stop_requested or isinstance(error, KeyboardInterrupt)
        if interrupted:
            self._state = State.ABORTING
        troubles = rest(self._rig)
        began = self._session is not None
        go_on = (
            f"; everything measured is kept, continue with: gonio scan --resume {self.path}" if began else ""
        )
        reason = "stopped by the operator" if interrupted else f"{type(error).__name__}: {error}"
        if began:
            with suppress(Exception):  # the disk may be what failed
                self._event("info" if interrupted else "error", "; ".join([reason, *troubles]))
        self._active = False
        self._latest = self._step = None
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

    # -- small things ----------------------------------------------------------------------------------------

    @property
    def _open(self) -> Session:
        if self._session is None:
            raise RuntimeError("no file is open")
        return self._session

    @property
    def _devices(self) -> Measurer:
        if self._measurer is None:
            raise RuntimeError("no file is open")
        return self._measurer

    def _now_s(self) -> float:
        offset_s = self._measurer.offset_s if self._measurer is not None else 0.0
        return self._rig.clock.now_s() + offset_s

    def _event(self, level: Level, message: str, error: GonioError | None = None) -> None:
        source = error.device if isinstance(error, DeviceError) else "runner"
        self._untold.append(EventRecord(self._now_s(), time.time(), level, source, message))
        while self._untold:
            event = self._untold[0]
            try:
                self._open.record(event)
            except StoreError:
                if not self._open.has(event):
                    return  # a full disk: it is told with the next event
            del self._untold[0]

    def _set(self, state: State, message: str) -> None:
        if not (self._stop_requested and self._active):  # `stop` has set the state, which stays until the end
            self._state = state
        self._message = message
        self._publish()

    def _publish(self) -> None:
        self._published_s = time.monotonic()
        if self._on_snapshot is not None:
            self._on_snapshot(self.snapshot())

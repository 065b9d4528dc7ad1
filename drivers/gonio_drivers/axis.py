"""When is a move allowed, how is it made, and when is it done: one rotation axis, whatever drive turns it.

A `Drive` knows the protocol of one motor and counts steps; `MotorAxis` knows degrees, limits, the blind zone,
the approach and the proof of arrival.  A move is over only when the drive is idle without a fault **and** the
position read back lies within the tolerance of the target: a limit switch, a stall or a manual stop also
makes a drive idle.

Threads: `start`, `wait` and `home` are for one thread at a time and axis; `stop` is for any.  `wait` keeps
the other axes of its stage going too, so that both can be in the second leg of their approach at once.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gonio.clock import Clock
from gonio.errors import DeviceError, MotionError
from gonio.rig import Context, check_path, check_target
from gonio_drivers.drive import Drive, DriveState, MotorConfig, approach_legs
from gonio_drivers.status import ThreadStatus

POLL_S = 0.05  # instrument seconds between polls of a moving axis; a fault is seen at most this late
_SHORTEST_POLL_S = 0.01
_PATH_SLACK_DEG = 1.0  # by which a moving axis may read outside its path: lag of an encoder, lost motion
_DEADLINE_FACTOR = 3.0
_DEADLINE_MARGIN_S = 5.0
_REAL_FLOOR_S = 3.0  # a fast simulated clock must not turn a pause of the operating system into a timeout


@dataclass(frozen=True, slots=True)
class _Deadline:
    """Passed when both the instrument's and the real time are over."""

    instrument_s: float
    real_s: float

    @classmethod
    def after(cls, clock: Clock, duration_s: float, *, real_floor_s: float | None = None) -> _Deadline:
        floor_s = _REAL_FLOOR_S if real_floor_s is None else real_floor_s
        return cls(clock.now_s() + duration_s, time.monotonic() + floor_s)

    def passed(self, clock: Clock) -> bool:
        return clock.now_s() > self.instrument_s and time.monotonic() > self.real_s


@dataclass(slots=True)
class _Move:
    """A move in progress or ended; `result_deg` or `error` is set when it has ended."""

    target_deg: float
    legs_deg: tuple[float, ...]
    homing: bool = False
    leg: int = 0
    from_deg: float | None = None  # where the leg began
    expected_end_s: float = 0.0
    deadline: _Deadline | None = None
    may_be_idle: _Deadline | None = None
    settled: bool = False
    result_deg: float | None = None
    error: DeviceError | None = None

    @property
    def ended(self) -> bool:
        return self.result_deg is not None or self.error is not None


class MotorAxis:
    """A rotation axis on a `Drive`; a `gonio.devices.Axis`, and a Movable, Readable, Stoppable of bluesky."""

    parent = None

    def __init__(self, name: str, config: MotorConfig, drive: Drive, context: Context) -> None:
        self._name = name
        self._config = config
        self._drive = drive
        self._clock = context.clock
        self._rig_name = context.rig_name
        self._group: Sequence[MotorAxis] = (self,)
        self._move: _Move | None = None
        self._stands_at_steps: int | None = (
            None  # target of the last verified move, until something disturbs it
        )
        self._rests_at_deg: float | None = None  # read-back of the last verified move, until the next begins
        self._doubts: str | None = None  # why the count may not be true any more
        self._stop_asked = threading.Event()
        self._command_lock = threading.Lock()  # between a stop and a command that starts a motion
        self._poll_lock = threading.Lock()

    # -- what gonio asks of an axis --------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """``theta_i`` or ``theta_mes``."""
        return self._name

    @property
    def config(self) -> MotorConfig:
        """The axis' table of the rig file."""
        return self._config

    def join(self, group: Sequence[MotorAxis]) -> None:
        """Keep the moves of these axes going while one of them is waited for."""
        self._group = tuple(group)

    def position_deg(self) -> float:
        """Return the position read back from the drive, degrees.

        Raises
        ------
        MotionError
            The count has no reference, so it is no position: never homed, or switched off and on since.
        """
        state = self._drive.state()
        why = None if state.referenced else "has no reference (it was switched off, or never homed)"
        if not self._drive.reports_reference:
            why = why or self._drive.confirm(state.position_steps)
        if why is not None:
            raise self._distrusted(why, "home it, which opening the rig again does")
        return self._degrees(state.position_steps)

    def start(self, target_deg: float) -> None:
        """Begin a move, in two legs if the approach needs it (`approach_legs`); `wait` completes it.

        Raises
        ------
        RefusedError
            The target is outside the limits or inside the blind zone, or the way from the position read back
            leads through the blind zone; no command that could move anything was sent.
        MotionError
            The axis has no reference, has a fault that does not go away, or is moving already.
        """
        check_target(self._name, self._config, target_deg, rig_name=self._rig_name)
        if self._stop_asked.is_set() or (self._move is not None and self._move.ended):
            self._move = None  # a start that fails must not leave the result of an earlier move to `wait`
        self._stop_asked.clear()
        state = self._ready_state()
        here_deg = self._degrees(state.position_steps)
        if self._stands_at_steps == self._steps(target_deg) and self._is_at(here_deg, target_deg):
            self._move = _Move(target_deg, (), result_deg=here_deg)
            return
        if not self._drive.reports_reference:
            self._expect_at_rest(here_deg)
        legs_deg = approach_legs(self._config, here_deg, target_deg)
        for begin_deg, end_deg in zip((here_deg, *legs_deg), legs_deg, strict=False):
            check_target(self._name, self._config, end_deg, rig_name=self._rig_name)
            check_path(self._name, self._config, begin_deg, end_deg, rig_name=self._rig_name)
        self._stands_at_steps = self._rests_at_deg = None
        move = _Move(target_deg, legs_deg)
        self._begin_leg(move, here_deg)
        self._move = move

    def wait(self) -> float:
        """Block until the move is verified and return the read-back in degrees.

        Raises
        ------
        MotionError
            The drive reported a fault, was stopped, ended elsewhere than at the target, or never ended.
        DeviceError
            The drive did not answer.
        """
        move = self._move
        if move is None:
            return self.position_deg()
        while not move.ended:
            for axis in self._group:
                axis._advance()
            if not move.ended:
                self._clock.sleep(self._poll_interval_s(move))
        if move.error is not None:
            raise move.error
        assert move.result_deg is not None
        return move.result_deg

    def home(self) -> None:
        """Find the reference switch and wait for it; raises as `wait`."""
        self.start_home()
        self.wait()

    def start_home(self) -> None:
        """Begin the search for the reference switch; `wait` completes it."""
        self._stop_asked.clear()
        self._stands_at_steps = self._rests_at_deg = None
        self._drive.clear_faults()
        move = _Move(self._config.zero_deg, (self._config.zero_deg,), homing=True)
        self._begin_leg(move, None)
        self._move = move

    def needs_home(self) -> bool:
        """Say whether the drive has no valid reference, or its count is in doubt."""
        return self._doubts is not None or not self._drive.state().referenced

    def verify_still(self, expected_deg: float) -> float:
        """Return the position read back if the axis stands where it stood, within its tolerance.

        Raises
        ------
        MotionError
            It moves, has a fault, has lost its reference, or stands elsewhere.
        """
        state = self._drive.state()
        here_deg = self._degrees(state.position_steps)
        if state.fault is not None or state.moving or not state.referenced:
            what = state.fault or ("is moving" if state.moving else "has lost its reference")
            raise self._distrusted(
                f"{what}; it stood at {expected_deg:.3f} deg and is at {here_deg:.3f} deg", state.remedy
            )
        if not self._is_at(here_deg, expected_deg):
            raise self._distrusted(
                f"is at {here_deg:.3f} deg although it was left at {expected_deg:.3f} deg",
                "leave the stage alone while it measures, then repeat",
            )
        return here_deg

    def recover(self) -> str | None:
        """Bring the axis to rest after a failure, set its drive up again and clear its faults.

        Returns why it must be homed before it may be used again, None if its count is still true.  Raises
        `DeviceError` if the drive does not answer, is another one, or keeps its fault.
        """
        self._move = None
        self._stands_at_steps = self._rests_at_deg = None
        self._drive.stop()
        if self._drive.state().moving:
            self._come_to_rest()
        self._drive.resume()
        self._drive.clear_faults()
        state = self._drive.state()
        if state.fault is not None:
            raise MotionError(self._drive.device, state.fault, state.remedy)
        if not state.referenced:
            return self._doubts or "it had lost its reference"
        return self._doubts

    def stop(self, *, success: bool = False) -> None:
        """Stop now; callable from any thread, at any time, any number of times.

        A `wait` in progress ends with a `MotionError`.  The line is free for the stop as soon as the reply to
        the request under way is there.
        """
        del success  # bluesky says whether it considers the plan a success; a stop is a stop
        self._stop_asked.set()
        with self._command_lock:
            self._drive.stop()

    # -- bluesky ---------------------------------------------------------------------------------------------

    @property
    def position(self) -> float:
        """The position read back, degrees (bluesky's relative plans ask for it)."""
        return self.position_deg()

    @property
    def hints(self) -> dict[str, list[str]]:
        """Which of `read`'s values matter to a plot."""
        return {"fields": [self._name]}

    def set(self, value: float) -> ThreadStatus:
        """Begin a move and return its `Status`; raises as `start`."""
        self.start(float(value))
        return ThreadStatus(self.wait, self._name)

    def read(self) -> Mapping[str, Any]:
        """Return ``{name: {"value": degrees, "timestamp": Unix time}}``."""
        return {self._name: {"value": self.position_deg(), "timestamp": time.time()}}

    def describe(self) -> Mapping[str, Any]:
        """Return the description of `read`'s value."""
        return {
            self._name: {
                "source": self._drive.device,
                "dtype": "number",
                "shape": [],
                "units": "deg",
                "precision": 4,
            }
        }

    # -- inside ----------------------------------------------------------------------------------------------

    def _degrees(self, position_steps: int) -> float:
        return self._config.zero_deg + position_steps / self._config.steps_per_deg

    def _steps(self, angle_deg: float) -> int:
        return round((angle_deg - self._config.zero_deg) * self._config.steps_per_deg)

    def _is_at(self, here_deg: float, target_deg: float) -> bool:
        return abs(here_deg - target_deg) <= self._config.tolerance_deg

    def _ready_state(self) -> DriveState:
        """Return the state of a drive that can start, or raise the reason why it cannot."""
        state = self._drive.state()
        if state.moving:
            if self._move is not None:
                raise MotionError(self._drive.device, "is still moving", "wait for it or stop it first")
            state = self._come_to_rest()
        if state.fault is not None:
            self._stands_at_steps = self._rests_at_deg = None
            self._drive.clear_faults()
            state = self._drive.state()
        if state.fault is not None:
            raise MotionError(self._drive.device, state.fault, state.remedy)
        if not state.referenced:
            raise self._distrusted(
                "has lost its reference (it was switched off, or never homed)",
                "free its way and home it, which opening the rig again does",
            )
        if self._doubts is not None:
            raise self._distrusted(
                f"may have lost count ({self._doubts})",
                "free its way and home it, which opening the rig again does",
            )
        return state

    def _distrusted(self, fault: str, remedy: str) -> MotionError:
        """Return the error for an axis whose count is not to be trusted until it has been homed."""
        self._doubts = self._doubts or fault
        self._stands_at_steps = self._rests_at_deg = None
        return MotionError(self._drive.device, fault, remedy)

    def _expect_at_rest(self, here_deg: float) -> None:
        """A drive that cannot say whether it was switched off, and has another count now, may have been.

        Without a known place of rest (the last move was stopped, or never waited for) it is asked.
        """
        if self._rests_at_deg is None:
            if (why := self._drive.confirm(self._steps(here_deg))) is not None:
                raise self._distrusted(f"{why}; it reads {here_deg:.3f} deg", "home it")
        elif not self._is_at(here_deg, self._rests_at_deg):
            raise self._distrusted(
                f"reads {here_deg:.3f} deg although left at {self._rests_at_deg:.3f} deg: it was moved by "
                "hand, or switched off and on",
                "leave the stage alone, then home it",
            )

    def _come_to_rest(self) -> DriveState:
        """Wait for the end of a deceleration after a stop."""
        ramp_s = self._config.speed_deg_s / self._config.acceleration_deg_s2
        deadline = _Deadline.after(self._clock, _DEADLINE_FACTOR * ramp_s + _DEADLINE_MARGIN_S)
        while (state := self._drive.state()).moving:
            if deadline.passed(self._clock):
                raise MotionError(
                    self._drive.device,
                    "is moving although nothing was asked of it",
                    "stop whatever else drives it (hand knob, joystick, another program)",
                )
            self._clock.sleep(_SHORTEST_POLL_S)
        return state

    def _begin_leg(self, move: _Move, from_deg: float | None) -> None:
        target_deg = move.legs_deg[move.leg]
        with self._command_lock:
            if self._stop_asked.is_set():
                raise self._stopped(move, from_deg)
            try:
                if move.homing:
                    self._drive.home()
                else:
                    self._drive.move_to(self._steps(target_deg))
            except DeviceError:
                self._stop_quietly()  # the command may have been taken although its confirmation was lost
                raise
        move.from_deg = from_deg
        low, high = self._config.limits_deg
        if from_deg is None:  # homing, at a speed that only the drive knows
            duration_s = 20.0 * self._config.move_duration_s(high - low) + 60.0
            move.expected_end_s = 0.0
        else:
            duration_s = self._config.move_duration_s(target_deg - from_deg)
            move.expected_end_s = self._clock.now_s() + duration_s - self._config.settle_s
        move.deadline = _Deadline.after(self._clock, _DEADLINE_FACTOR * duration_s + _DEADLINE_MARGIN_S)
        latency_s = self._drive.start_latency_s
        move.may_be_idle = (
            _Deadline.after(self._clock, latency_s, real_floor_s=latency_s) if latency_s else None
        )

    def _poll_interval_s(self, move: _Move) -> float:
        left_s = move.expected_end_s - self._clock.now_s()
        return min(max(left_s, _SHORTEST_POLL_S), POLL_S)

    def _advance(self) -> None:
        """Poll once and take the move one step further; an error is kept for whoever waits for this axis."""
        move = self._move
        if move is None or move.ended or not self._poll_lock.acquire(blocking=False):
            return
        try:
            if not move.ended:
                self._judge(move, self._drive.state())
        except DeviceError as error:
            move.error = error
        finally:
            self._poll_lock.release()

    def _judge(self, move: _Move, state: DriveState) -> None:
        """Decide from one poll whether the move goes on, has arrived or has failed."""
        here_deg = self._degrees(state.position_steps)
        aim_deg = move.legs_deg[move.leg]
        stop_asked = self._stop_asked.is_set()
        if stop_asked and not state.moving:
            raise self._stopped(move, here_deg)
        # While it decelerates after our own stop a drive may call the move interrupted, and while it searches
        # for its reference it may meet a switch.
        if state.fault is not None and not (state.moving and (stop_asked or move.homing)):
            if state.moving:
                self._stop_quietly()
            raise self._distrusted(
                f"{state.fault}; it stands at {here_deg:.3f} deg on its way to {move.target_deg:g} deg",
                state.remedy,
            )
        if not move.homing and (why := self._astray(move, state, here_deg)) is not None:
            if state.moving:
                self._stop_quietly()
            raise self._distrusted(why, "check its power supply, then home the axis and repeat")
        if state.moving:
            assert move.deadline is not None
            if move.deadline.passed(self._clock):
                self._stop_quietly()
                raise MotionError(
                    self._drive.device,
                    f"is still moving at {here_deg:.3f} deg, long after it was due at {aim_deg:g} deg; "
                    "it was stopped",
                    "compare speed_deg_s and acceleration_deg_s2 with the drive's; look for friction",
                )
            return
        if move.may_be_idle is not None and not self._arrived(move, state, here_deg):
            if not move.may_be_idle.passed(self._clock):
                return
            move.may_be_idle = None
        if move.homing:
            self._drive.finish_home()
            state = self._drive.state()
            here_deg = self._degrees(state.position_steps)
        if not self._arrived(move, state, here_deg):
            what = "ended the search for its reference" if move.homing else "is idle"
            raise self._distrusted(
                f"{what} at {here_deg:.3f} deg instead of {aim_deg:g} +- {self._config.tolerance_deg:g} deg",
                "look for an obstacle, a stall or a hand on the knob; then home the axis and repeat",
            )
        if move.leg + 1 < len(move.legs_deg):
            move.leg += 1
            self._begin_leg(move, here_deg)
        elif self._config.settle_s and not move.settled:
            self._clock.sleep(self._config.settle_s)  # then one more poll proves that it stayed
            move.settled = True
        else:
            if (why := self._drive.confirm(state.position_steps)) is not None:
                raise self._distrusted(
                    f"{why}; it reads {here_deg:.3f} deg", "look for its cause, then home the axis and repeat"
                )
            if move.homing:
                self._doubts = None
            self._stands_at_steps = None if move.homing else self._steps(move.target_deg)
            self._rests_at_deg = here_deg
            move.result_deg = here_deg

    def _astray(self, move: _Move, state: DriveState, here_deg: float) -> str | None:
        """Return why a move that was begun cannot lead to its target: the count is another one since.

        A drive that was switched off and on just before the command counts from elsewhere, and would run that
        far beyond the target: into a switch, or to an angle that it calls by a wrong number.
        """
        if not state.referenced:
            return f"lost its reference on its way to {move.target_deg:g} deg (it was switched off)"
        if state.moving and move.from_deg is not None:
            low_deg, high_deg = sorted((move.from_deg, move.legs_deg[move.leg]))
            if not low_deg - _PATH_SLACK_DEG <= here_deg <= high_deg + _PATH_SLACK_DEG:
                return f"reads {here_deg:.3f} deg on its way from {low_deg:.3f} to {high_deg:.3f} deg"
        return None

    def _arrived(self, move: _Move, state: DriveState, here_deg: float) -> bool:
        return self._is_at(here_deg, move.legs_deg[move.leg]) and (state.referenced or not move.homing)

    def _stopped(self, move: _Move, here_deg: float | None) -> MotionError:
        where = "" if here_deg is None else f" at {here_deg:.3f} deg"
        return MotionError(
            self._drive.device,
            f"was stopped on request{where}, before it reached {move.target_deg:g} deg",
            "start the move again when the way is free",
        )

    def _stop_quietly(self) -> None:
        try:
            self._drive.stop()
        except DeviceError:
            return  # the error that led here says more

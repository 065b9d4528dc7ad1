"""What an axis refuses, how it approaches, and what it takes for an arrival; on a motor of memory."""

from __future__ import annotations

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from gonio.clock import Clock
from gonio.errors import MotionError, RefusedError, ReplyError
from gonio.rig import Context
from gonio_drivers import axis as axis_module
from gonio_drivers.axis import MotorAxis
from gonio_drivers.drive import DriveState, MotorConfig, approach_legs
from gonio_drivers.stage import MotorStage

THETA_MES = MotorConfig(
    steps_per_deg=-1000.0, zero_deg=180.0, limits_deg=(15.0, 180.0), blind_zone_deg=15.0, backlash_deg=0.5
)
PLAIN = MotorConfig(steps_per_deg=1000.0, limits_deg=(-90.0, 90.0))


class Motor:
    """A drive that needs `polls` polls for each move; `fate` may change the state it then reports."""

    device = "theta (motor)"
    start_latency_s = 0.0
    reports_reference = True

    def __init__(self, position_steps: int = 0, *, polls: int = 2) -> None:
        self.position_steps = position_steps
        self.referenced = True
        self.fault: str | None = None
        self.log: list[str] = []
        self.polls = polls
        self._target = position_steps
        self._left = 0
        self.fate = None
        self.forgotten: str | None = None

    def state(self) -> DriveState:
        if self._left:
            self._left -= 1
            if not self._left:
                self.position_steps = self._target
        state = DriveState(self.position_steps, self._left > 0, self.referenced, self.fault, "do something")
        return state if self.fate is None else self.fate(state)

    def clear_faults(self) -> None:
        self.log.append("clear")
        self.fault = None

    def move_to(self, position_steps: int) -> None:
        self.log.append(f"move {position_steps}")
        self._target, self._left = position_steps, self.polls

    def home(self) -> None:
        self.log.append("home")
        self._target, self._left = 0, self.polls

    def finish_home(self) -> None:
        self.referenced = True

    def stop(self) -> None:
        self.log.append("stop")
        self._left = 0

    def resume(self) -> None:
        self.log.append("resume")

    def confirm(self, position_steps: int) -> str | None:
        return self.forgotten


def make(config: MotorConfig, motor: Motor, name: str = "theta_mes") -> MotorAxis:
    return MotorAxis(name, config, motor, Context("test", Clock(speed=1e6)))


# -- approach ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("from_deg", "target_deg", "legs"),
    [
        (180.0, 30.0, (30.0,)),  # comes from outside
        (15.0, 18.0, (18.5, 18.0)),  # the next step of a sweep
        (18.3, 18.0, (18.5, 18.0)),  # from outside, but not by the whole backlash
        (180.0, 15.0, (15.0,)),  # the edge of the blind zone, from above
        (15.2, 15.0, (15.5, 15.0)),
        (90.0, 180.0, (180.0,)),  # no room
        (90.0, 179.8, (179.8,)),  # no room
        (18.0, 18.0, (18.5, 18.0)),  # where the lost motion is not known to be taken up
    ],
)
def test_legs(from_deg, target_deg, legs):
    assert approach_legs(THETA_MES, from_deg, target_deg) == legs


@given(st.floats(15, 180), st.floats(15, 180), st.floats(0, 2))
def test_legs_end_at_the_target_inside_the_limits_and_outside_the_zone(from_deg, target_deg, backlash_deg):
    config = THETA_MES.model_copy(update={"backlash_deg": backlash_deg})
    legs = approach_legs(config, from_deg, target_deg)
    assert legs[-1] == target_deg
    assert all(15.0 <= leg <= 180.0 for leg in legs)


@given(st.floats(-180, 180), st.floats(-179, 179), st.floats(0.1, 1))
def test_where_there_is_room_the_last_motion_is_always_towards_zero(from_deg, target_deg, backlash_deg):
    config = MotorConfig(steps_per_deg=100.0, limits_deg=(-181.0, 181.0), backlash_deg=backlash_deg)
    path = (from_deg, *approach_legs(config, from_deg, target_deg))
    last = path[-1] - path[-2]
    assert last * (-1 if target_deg < 0 else 1) <= -backlash_deg * (1 - 1e-6) + 1e-12


# -- refusals ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("target_deg", "words"),
    [
        (10.0, "blind zone"),
        (-20.0, "outside the limits"),
        (181.0, "outside the limits"),
        (float("nan"), "finite"),
    ],
)
def test_a_refused_target_is_not_even_asked_about(target_deg, words):
    motor = Motor()
    motor.state = None  # any question would fail
    with pytest.raises(RefusedError, match=words):
        make(THETA_MES, motor).start(target_deg)
    assert motor.log == []


def test_the_way_through_the_blind_zone_is_refused_from_the_position_read_back():
    config = PLAIN.model_copy(update={"blind_zone_deg": 15.0})
    motor = Motor(-30_000)
    with pytest.raises(RefusedError, match="from -30 to 30 deg sweeps through the blind zone"):
        make(config, motor).start(30.0)
    assert motor.log == []


def test_without_a_reference_nothing_moves():
    motor = Motor()
    motor.referenced = False
    with pytest.raises(MotionError, match="lost its reference"):
        make(PLAIN, motor).start(30.0)
    assert motor.log == []


def test_a_fault_that_stays_prevents_the_start():
    motor = Motor()
    motor.fate = lambda s: DriveState(s.position_steps, False, True, "the driver is disabled", "let it cool")
    with pytest.raises(MotionError, match=r"theta \(motor\): the driver is disabled; let it cool"):
        make(PLAIN, motor).start(30.0)
    assert motor.log == ["clear"]


def test_an_old_fault_is_acknowledged_before_a_new_move():
    motor = Motor()
    motor.fault = "stalled"
    axis = make(PLAIN, motor)
    axis.start(30.0)
    assert axis.wait() == 30.0
    assert motor.log == ["clear", "move 30000"]


def test_start_while_moving_is_an_error():
    axis = make(PLAIN, Motor(polls=1000))
    axis.start(30.0)
    with pytest.raises(MotionError, match="still moving"):
        axis.start(40.0)


# -- arrival -------------------------------------------------------------------------


def test_move_in_two_legs_with_the_sign_of_the_scale():
    motor = Motor(165_000)  # 15 deg
    axis = make(THETA_MES, motor)
    axis.start(18.0)
    assert axis.wait() == 18.0
    assert motor.log == ["move 161500", "move 162000"]


def test_where_it_verifiably_stands_it_need_not_go():
    motor = Motor(165_000)
    axis = make(THETA_MES, motor)
    for _ in range(2):
        axis.start(18.0)
        assert axis.wait() == 18.0
    assert len(motor.log) == 2
    motor.position_steps += 20  # somebody pushed it by 0.02 deg
    axis.start(18.0)
    assert axis.wait() == 18.0
    assert len(motor.log) == 4


@pytest.mark.parametrize(
    ("fate", "words"),
    [
        (
            lambda s: DriveState(s.position_steps, s.moving, True, "it stalled", "remove it"),
            "it stalled; it stands at",
        ),
        (
            lambda s: DriveState(s.position_steps - 20, s.moving, True, None),
            r"is idle at 29\.980 deg instead of 30 \+- 0\.01",
        ),
        (lambda s: DriveState(12_345, False, True, None), r"is idle at 12\.345 deg instead of 30"),
    ],
)
def test_an_idle_drive_is_not_an_arrival(fate, words):
    motor = Motor()
    axis = make(PLAIN, motor)
    axis.start(30.0)
    motor.fate = fate
    with pytest.raises(MotionError, match=words):
        axis.wait()
    motor.fate = None
    with pytest.raises(MotionError, match=r"may have lost count .*home it"):
        axis.start(30.0)  # what ended the move may have cost steps
    axis.recover()
    axis.home()
    axis.start(30.0)
    assert axis.wait() == 30.0


def test_a_move_without_an_end_is_stopped(monkeypatch):
    monkeypatch.setattr(axis_module, "_REAL_FLOOR_S", 0.0)
    motor = Motor(polls=10**9)
    axis = make(PLAIN, motor)
    axis.start(30.0)
    with pytest.raises(MotionError, match=r"still moving at 0\.000 deg, long after it was due at 30 deg"):
        axis.wait()
    assert motor.log == ["move 30000", "stop"]


def test_settling_ends_with_another_look():
    motor = Motor()
    looks = 0

    def creep(state: DriveState) -> DriveState:
        nonlocal looks
        looks += not state.moving
        return DriveState(state.position_steps + 50 * (looks > 2), state.moving, True, None)

    motor.fate = creep
    axis = make(PLAIN.model_copy(update={"settle_s": 0.1}), motor)
    axis.start(30.0)
    with pytest.raises(MotionError, match=r"30\.050 deg"):
        axis.wait()


def test_a_drive_that_starts_late_is_waited_for():
    motor = Motor()
    motor.start_latency_s = 5000.0  # of the fast clock: 5 ms, but judged by real seconds as well
    axis = make(PLAIN, motor)
    axis.start(30.0)
    idle = iter([DriveState(0, False, True, None)] * 5)
    motor.fate = lambda s: next(idle, s)
    assert axis.wait() == 30.0


def test_a_failed_command_is_followed_by_a_stop():
    motor = Motor()

    def lost(position_steps: int) -> None:
        raise ReplyError(motor.device, "gave no reply", "repeat")

    motor.move_to = lost
    with pytest.raises(ReplyError):
        make(PLAIN, motor).start(30.0)
    assert motor.log == ["stop"]


def test_home_needs_a_reference_afterwards():
    motor = Motor(50_000)
    motor.referenced = False
    axis = make(PLAIN, motor)
    assert axis.needs_home()
    axis.home()
    assert axis.position_deg() == 0.0
    motor.finish_home = lambda: setattr(motor, "referenced", False)
    with pytest.raises(MotionError, match="ended the search for its reference"):
        axis.home()


# -- stop ----------------------------------------------------------------------------


def test_stop_from_another_thread_ends_the_wait():
    motor = Motor(polls=10**9)
    axis = make(PLAIN, motor)
    axis.start(30.0)
    polled = threading.Event()
    motor.fate = lambda s: (polled.set(), s)[1]
    outcome: list[BaseException] = []

    def wait() -> None:
        try:
            axis.wait()
        except MotionError as error:
            outcome.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    assert polled.wait(10)
    for _ in range(3):
        axis.stop()
    thread.join(10)
    assert not thread.is_alive()
    assert "was stopped on request at 0.000 deg, before it reached 30 deg" in str(outcome[0])


def test_stop_between_the_check_and_the_command_prevents_the_move():
    motor = Motor()
    axis = make(PLAIN, motor)
    motor.fate = lambda s: (axis.stop(), s)[1]
    with pytest.raises(MotionError, match="stopped on request"):
        axis.start(30.0)
    assert motor.log == ["stop"]


def test_stop_in_the_first_leg_prevents_the_second():
    motor = Motor(165_000)
    axis = make(THETA_MES, motor)
    axis.start(18.0)
    motor.fate = lambda s: (axis.stop(), s)[1]
    with pytest.raises(MotionError, match="stopped on request"):
        axis.wait()
    assert [entry for entry in motor.log if entry != "stop"] == ["move 161500"]


def test_a_move_that_was_stopped_without_anybody_waiting_does_not_block_the_next():
    motor = Motor(polls=5)
    axis = make(PLAIN, motor)
    axis.start(30.0)
    motor.stop = lambda: None  # it takes its time to decelerate
    axis.stop()
    axis.start(40.0)
    assert axis.wait() == 40.0


def test_after_a_refused_start_wait_tells_where_it_stands():
    motor = Motor()
    axis = make(PLAIN, motor)
    axis.start(30.0)
    axis.wait()
    motor.position_steps = 25_000  # moved by hand
    with pytest.raises(RefusedError):
        axis.start(91.0)
    with pytest.raises(MotionError):
        _start_faulty(axis, motor)
    assert axis.wait() == 25.0


def _start_faulty(axis: MotorAxis, motor: Motor) -> None:
    motor.clear_faults = lambda: None
    motor.fault = "too hot"
    try:
        axis.start(30.0)
    finally:
        motor.fault = None


def test_a_tolerance_finer_than_the_steps_is_a_mistake_in_the_rig_file():
    with pytest.raises(ValidationError, match="below half a step, 0\\.05 deg"):
        MotorConfig(steps_per_deg=10.0, limits_deg=(0.0, 90.0))
    with pytest.raises(ValidationError, match="steps_per_deg = 0"):
        MotorConfig(steps_per_deg=0.0, limits_deg=(0.0, 90.0))


def test_stop_while_idle_is_harmless_and_the_next_move_goes():
    motor = Motor()
    axis = make(PLAIN, motor)
    axis.stop()
    axis.stop()
    axis.start(30.0)
    assert axis.wait() == 30.0


# -- both axes -----------------------------------------------------------------------


def stage_of(*motors: Motor) -> MotorStage:
    axes = [
        make(THETA_MES, motor, name) for name, motor in zip(("theta_i", "theta_mes"), motors, strict=True)
    ]
    return MotorStage(*axes, line=None, descriptions={})


def test_waiting_for_one_axis_keeps_the_other_going():
    slow, quick = Motor(165_000, polls=50), Motor(165_000, polls=2)
    stage = stage_of(slow, quick)
    stage.theta_i.start(18.0)
    stage.theta_mes.start(18.0)
    assert stage.theta_i.wait() == 18.0
    assert quick.log == ["move 161500", "move 162000"]  # both legs, while the first axis was waited for
    assert stage.theta_mes.wait() == 18.0


def test_a_fault_of_one_axis_is_told_by_that_axis():
    good, bad = Motor(165_000, polls=10), Motor(165_000)
    stage = stage_of(good, bad)
    stage.theta_i.start(18.0)
    stage.theta_mes.start(18.0)
    bad.fault = "it stalled"
    assert stage.theta_i.wait() == 18.0
    with pytest.raises(MotionError, match="it stalled"):
        stage.theta_mes.wait()


def test_stage_stop_reaches_the_second_axis_though_the_first_fails():
    first, second = Motor(), Motor()

    def dead() -> None:
        raise ReplyError("first", "dead", "mend it")

    first.stop = dead
    with pytest.raises(ReplyError):
        stage_of(first, second).stop()
    assert second.log == ["stop"]


def test_both_axes_home_at_once():
    motors = Motor(1000), Motor(2000)
    for motor in motors:
        motor.referenced = False
    stage = stage_of(*motors)
    stage.home_where_needed()
    assert [motor.log for motor in motors] == [["clear", "home"]] * 2
    stage.home_where_needed()
    assert motors[0].log == ["clear", "home"]

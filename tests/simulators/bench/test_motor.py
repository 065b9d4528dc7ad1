"""Motion against closed forms, and the switches: no position that the axis does not have."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio_simulators.bench import Fault, Motor, MotorHardware
from gonio_simulators.bench.motion import cut_at, pieces_to
from gonio_simulators.clock import ManualClock

STEPS_PER_DEG = 4266.6666666666667
ARM = MotorHardware(
    name="theta_mes",
    steps_per_deg=-STEPS_PER_DEG,
    zero_deg=180.0,
    limits_deg=(-181.0, 181.0),
    blind_zone_deg=15.0,
    speed_deg_s=20.0,
    acceleration_deg_s2=100.0,
    backlash_deg=0.05,
    power_on_deg=114.0,
)
SAMPLE = MotorHardware(
    name="theta_i",
    steps_per_deg=STEPS_PER_DEG,
    limits_deg=(-1.0, 96.0),
    backlash_deg=0.05,
    power_on_deg=57.0,
)
ONE_STEP_DEG = 1.0 / STEPS_PER_DEG


def homed(hardware: MotorHardware) -> tuple[Motor, ManualClock]:
    clock = ManualClock()
    motor = Motor(hardware, clock)
    motor.home()
    clock.advance(120.0)
    assert motor.referenced
    assert motor.fault is Fault.NONE
    return motor, clock


def steps(motor: Motor, angle_deg: float) -> int:
    return round((angle_deg - motor.hardware.zero_deg) * motor.hardware.steps_per_deg)


def go(motor: Motor, clock: ManualClock, angle_deg: float) -> float:
    motor.move_absolute(steps(motor, angle_deg))
    clock.advance(120.0)
    assert not motor.is_moving()
    return motor.angle_deg()


@given(
    distance=st.floats(1.0, 1e6),
    speed=st.floats(1.0, 1e5),
    acceleration=st.floats(1.0, 1e6),
)
def test_trapezoid_takes_the_textbook_time(distance: float, speed: float, acceleration: float) -> None:
    pieces = pieces_to(3.0, 10.0, 0.0, 10.0 + distance, speed, acceleration)
    if distance >= speed**2 / acceleration:
        expected = distance / speed + speed / acceleration
    else:
        expected = 2.0 * math.sqrt(distance / acceleration)
    assert sum(p.duration_s for p in pieces) == pytest.approx(expected, rel=1e-9)
    assert pieces[-1].end == 10.0 + distance


@given(
    start=st.integers(-(10**6), 10**6),
    target=st.integers(-(10**6), 10**6),
    start_speed=st.floats(-2e5, 2e5),
    max_speed=st.floats(10.0, 1e5),
    acceleration=st.floats(100.0, 1e6),
)
def test_motion_is_continuous_and_obeys_its_limits(
    start: int, target: int, start_speed: float, max_speed: float, acceleration: float
) -> None:
    pieces = pieces_to(0.0, float(start), start_speed, float(target), max_speed, acceleration)
    position, speed, time_s = float(start), start_speed, 0.0
    scale = 1.0 + abs(start) + abs(target) + start_speed**2 / acceleration
    for piece in pieces:
        assert piece.start_s == pytest.approx(time_s, abs=1e-9, rel=1e-9)
        assert piece.start == pytest.approx(position, abs=1e-9 * scale)
        assert piece.speed == pytest.approx(speed, abs=1e-6 * (1.0 + abs(start_speed) + max_speed))
        assert abs(piece.acceleration) <= acceleration
        assert abs(piece.speed) <= max(abs(start_speed), max_speed) * (1 + 1e-12)
        end_s = piece.start_s + piece.duration_s
        drift = piece.start + piece.duration_s * (piece.speed + 0.5 * piece.acceleration * piece.duration_s)
        assert drift == pytest.approx(piece.end, abs=1e-7 * scale)
        position, speed, time_s = piece.end, piece.speed_at(end_s), end_s
    assert position == float(target)
    assert speed == pytest.approx(0.0, abs=1e-6 * (1.0 + abs(start_speed) + max_speed))


@given(border=st.floats(0.5, 999.5), acceleration=st.floats(1.0, 1e4))
def test_a_cut_ends_on_the_border_at_the_right_time(border: float, acceleration: float) -> None:
    whole = pieces_to(0.0, 0.0, 0.0, 1000.0, 50.0, acceleration)
    kept, met = cut_at(whole, -math.inf, border)
    assert met == border
    assert kept[-1].end == border
    end_s = kept[-1].start_s + kept[-1].duration_s
    on_the_way = next(p for p in reversed(whole) if p.start_s <= end_s)
    assert on_the_way.position(end_s) == pytest.approx(border, abs=1e-6)


def test_move_lasts_as_long_as_the_rig_file_promises() -> None:
    motor, clock = homed(SAMPLE)
    motor.move_absolute(steps(motor, 30.0))
    clock.advance(30.0 / 20.0 + 20.0 / 100.0 - 1e-3)
    assert motor.is_moving()
    assert motor.speed_now_steps_s() > 0
    clock.advance(2e-3)
    assert not motor.is_moving()
    assert motor.speed_now_steps_s() == 0
    assert motor.position_steps() == 128000


@pytest.mark.parametrize("hardware", [ARM, SAMPLE], ids=lambda h: h.name)
def test_backlash_is_taken_up_from_above_only(hardware: MotorHardware) -> None:
    motor, clock = homed(hardware)
    go(motor, clock, 60.0)
    assert go(motor, clock, 45.0) == pytest.approx(45.0, abs=ONE_STEP_DEG)
    go(motor, clock, 30.0)
    below = go(motor, clock, 45.0)
    assert below == pytest.approx(45.0 - hardware.backlash_deg, abs=2 * ONE_STEP_DEG)
    assert motor.position_steps() == steps(motor, 45.0)  # the encoder sits at the shaft


def test_a_turn_within_the_lost_motion_does_not_move_the_arm() -> None:
    motor, clock = homed(SAMPLE)
    go(motor, clock, 50.0)
    stood = go(motor, clock, 40.0)
    assert go(motor, clock, 40.02) == stood
    assert go(motor, clock, 40.0) == stood


@pytest.mark.parametrize("hardware", [ARM, SAMPLE], ids=lambda h: h.name)
def test_home_finds_the_angle_of_step_zero(hardware: MotorHardware) -> None:
    for start in (20.0, 57.0, 95.0, hardware.zero_deg):
        motor, _ = homed(dataclasses.replace(hardware, power_on_deg=start))
        assert motor.position_steps() == 0
        assert motor.angle_deg() == pytest.approx(hardware.zero_deg, abs=ONE_STEP_DEG)


def test_before_homing_the_counter_is_off_by_a_constant() -> None:
    clock = ManualClock()
    motor = Motor(SAMPLE, clock)
    assert not motor.referenced
    off = motor.position_steps() - steps(motor, motor.angle_deg())
    motor.move_absolute(motor.position_steps() - 40_000)
    clock.advance(10.0)
    assert motor.position_steps() - steps(motor, motor.angle_deg()) == pytest.approx(off, abs=1)
    assert abs(off) > 1000


def test_home_is_under_way_until_it_is_done_and_a_stop_leaves_it_undone() -> None:
    clock = ManualClock()
    motor = Motor(SAMPLE, clock)
    motor.home()
    clock.advance(1.0)
    assert motor.is_homing()
    motor.stop()
    clock.advance(5.0)
    assert not motor.is_homing()
    assert not motor.is_moving()
    assert not motor.referenced


@pytest.mark.parametrize(
    ("start_deg", "target_deg", "stands_deg", "fault"),
    [
        (40.0, 5.0, 14.7, Fault.HIGH_LIMIT),  # a negative scale: falling angles are rising counts
        (-40.0, -5.0, -14.7, Fault.LOW_LIMIT),
        (40.0, -40.0, 14.7, Fault.HIGH_LIMIT),
        (170.0, 190.0, 181.0, Fault.LOW_LIMIT),
    ],
)
def test_switches_stop_the_arm_where_it_then_stands(
    start_deg: float, target_deg: float, stands_deg: float, fault: Fault
) -> None:
    clock = ManualClock()
    motor = Motor(dataclasses.replace(ARM, power_on_deg=start_deg), clock)
    count = motor.position_steps()
    motor.move_absolute(count + round((target_deg - start_deg) * ARM.steps_per_deg))
    clock.advance(60.0)
    assert motor.fault is fault
    assert not motor.is_moving()
    assert motor.angle_deg() == pytest.approx(stands_deg, abs=2 * ONE_STEP_DEG)
    told_deg = start_deg + (motor.position_steps() - count) / ARM.steps_per_deg
    assert told_deg == pytest.approx(stands_deg, abs=ARM.backlash_deg + 2 * ONE_STEP_DEG)
    motor.clear_fault()
    assert motor.fault is Fault.NONE
    motor.move_absolute(count)  # back is free
    clock.advance(60.0)
    assert motor.fault is Fault.NONE
    assert motor.angle_deg() == pytest.approx(start_deg, abs=ARM.backlash_deg + 2 * ONE_STEP_DEG)


def test_pushing_against_a_switch_faults_at_once_without_moving() -> None:
    motor, clock = homed(ARM)
    stood = go(motor, clock, 3.0)
    motor.clear_fault()
    motor.move_absolute(motor.position_steps() + 1000)
    assert motor.fault is Fault.HIGH_LIMIT
    assert not motor.is_moving()
    assert motor.angle_deg() == stood


def test_the_border_of_the_blind_zone_can_be_reached() -> None:
    motor, clock = homed(ARM)
    assert go(motor, clock, 15.0) == pytest.approx(15.0, abs=ONE_STEP_DEG)
    assert motor.fault is Fault.NONE


def test_an_obstacle_stalls_the_motor_where_it_stands() -> None:
    motor, clock = homed(dataclasses.replace(ARM, obstacle_deg=70.0))
    assert go(motor, clock, 50.0) == pytest.approx(70.0, abs=ONE_STEP_DEG)
    assert motor.fault is Fault.STALL
    assert motor.position_steps() == steps(motor, 70.0)


commands = st.lists(
    st.tuples(
        st.sampled_from(["move", "stop", "home", "clear"]),
        st.integers(-1_700_000, 1_700_000),
        st.floats(0.0, 20.0),
    ),
    max_size=12,
)


@given(sequence=commands, positive_side=st.booleans(), backlash_deg=st.sampled_from([0.0, 0.05, 1.0]))
def test_whatever_is_commanded_the_arm_is_never_inside_the_zone_nor_beyond_the_limits(
    sequence: list[tuple[str, int, float]], positive_side: bool, backlash_deg: float
) -> None:
    clock = ManualClock()
    start = 100.0 if positive_side else -100.0
    motor = Motor(dataclasses.replace(ARM, power_on_deg=start, backlash_deg=backlash_deg), clock)
    before = motor.angle_deg()
    for what, target, wait_s in sequence:
        if what == "move":
            motor.move_absolute(target)
        elif what == "stop":
            motor.stop()
        elif what == "home":
            motor.home()
        else:
            motor.clear_fault()
        for _ in range(8):
            clock.advance(wait_s / 8)
            angle = motor.angle_deg()
            assert 14.7 - 1e-9 <= (angle if positive_side else -angle) <= 181.0 + 1e-9
            # nothing jumps: at most the axis's speed (a stop may round up to the next step)
            assert abs(angle - before) <= 20.0 * wait_s / 8 + 2 * ONE_STEP_DEG
            before = angle
            if motor.referenced:
                shaft_deg = motor.hardware.zero_deg + motor.position_steps() / motor.hardware.steps_per_deg
                assert -1.01 * ONE_STEP_DEG <= shaft_deg - angle <= backlash_deg + 1.01 * ONE_STEP_DEG

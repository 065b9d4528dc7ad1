"""Any commands in any order, hands, switches, power cuts and bad lines: the arm is never driven into the
blind zone, and what a driver says of a position is true.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import Literal

import hypothesis.strategies as st
import pytest
from hypothesis import note
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from gonio.errors import GonioError, RefusedError
from gonio_simulators.bench.motor import Disturbance, Fault

from .machines import RECOVERIES, run_machine
from .world import STAGES, World

AxisName = Literal["theta_i", "theta_mes"]
AXES = st.sampled_from(("theta_i", "theta_mes"))
OPENINGS = 12
HALF_STEP_DEG = 0.5 / 4266.6
BORDERS_DEG = (15.0, 180.0, 0.0, 95.0, -0.0, 14.9999, 15.0001, 15.3, 94.6, 95.0001, 179.6, 180.0001, -15.0)
ABSURD_DEG = (math.nan, math.inf, -math.inf, 1e300, 1e9, -180.0, 5e-324)
TARGETS = st.one_of(
    st.floats(15.0, 95.0),
    st.floats(0.0, 180.0),
    st.sampled_from(BORDERS_DEG),
    st.sampled_from(ABSURD_DEG),
)
TROUBLES = (
    "lost request",
    "lost reply",
    "late 0.5",
    "late 1.5",
    "late 3",
    "noise before",
    "cut",
    "twice",
    "split",
)


class StageMachine(RuleBasedStateMachine):
    """The goniometer of one kind of stage with its simulator."""

    kind = "zaber"

    def __init__(self) -> None:
        super().__init__()
        self.world: World | None = None

    @initialize(backlash_deg=st.sampled_from((0.0, 0.3)), seed=st.integers(0, 2**16))
    def begin(self, backlash_deg: float, seed: int) -> None:
        self.world = world = World(stage=self.kind, backlash_deg=backlash_deg, seed=seed)
        self._installed = world.installed()
        self._installed.__enter__()
        try:
            self.rig = world.open_rig()
        except BaseException:
            self._installed.__exit__(None, None, None)
            self.world = None  # nothing to close
            raise
        self.cable = world.cables["stage"]
        self.targets: dict[str, float | None] = {"theta_i": None, "theta_mes": None}
        self.trusted = {"theta_i": True, "theta_mes": True}  # no power cut since the last homing

    def teardown(self) -> None:
        if self.world is not None:
            self.world.time.forget()
            self.rig.close()
            self._installed.__exit__(None, None, None)

    # -- commands ------------------------------------------------------------------------------------------

    @rule(name=AXES, target_deg=TARGETS)
    def start(self, name: AxisName, target_deg: float) -> None:
        assert self.world is not None
        config = self.axis(name).config
        low, high = config.limits_deg
        allowed = low <= target_deg <= high and abs(target_deg) >= config.blind_zone_deg
        before = self.cable.writes
        error = self.attempt(lambda: self.axis(name).start(target_deg), forget=False)
        if allowed:
            assert not isinstance(error, RefusedError) or name == "theta_mes", error
        else:
            assert isinstance(error, RefusedError), f"{target_deg} was not refused: {error!r}"
            assert self.cable.writes == before, "something was sent although the target is forbidden"
        if error is None:
            self.targets[name] = target_deg

    @rule(name=AXES)
    def wait(self, name: AxisName) -> None:
        got: list[float] = []
        # The move may have ended while the other axis was waited for: any instant since it began counts.
        error = self.attempt(lambda: got.append(self.axis(name).wait()), forget=False)
        if error is None and self.targets[name] is not None:
            self.arrived(name, self.targets[name], got[0])
        self.targets[name] = None

    @rule(theta_i_deg=st.floats(0.0, 95.0), theta_mes_deg=st.floats(15.0, 180.0))
    def move_to(self, theta_i_deg: float, theta_mes_deg: float) -> None:
        got: list[tuple[float, float]] = []
        error = self.attempt(lambda: got.append(self.rig.move_to(theta_i_deg, theta_mes_deg)))
        self.targets = {"theta_i": None, "theta_mes": None}
        if error is None:
            self.arrived("theta_i", theta_i_deg, got[0][0])
            self.arrived("theta_mes", theta_mes_deg, got[0][1])

    @rule(name=AXES)
    def stop(self, name: AxisName) -> None:
        self.attempt(self.axis(name).stop)

    @rule(name=AXES, delay_s=st.floats(0.0, 5.0))
    def another_thread_stops(self, name: AxisName, delay_s: float) -> None:
        assert self.world is not None

        def stop() -> None:
            with contextlib.suppress(GonioError):
                self.axis(name).stop()

        self.world.time.command_at(delay_s, stop)

    @rule(name=AXES)
    def home(self, name: AxisName) -> None:
        assert self.world is not None
        self.targets[name] = None
        if self.attempt(self.axis(name).home) is None:
            self.world.watches[name].disturbed = False
            self.trusted[name] = True

    @rule()
    def recover(self) -> None:
        self.targets = {"theta_i": None, "theta_mes": None}
        self.attempt(self.rig.stage.recover)

    @rule(name=AXES)
    def read_position(self, name: AxisName) -> None:
        got: list[float] = []
        if self.attempt(lambda: got.append(self.axis(name).position_deg())) is None:
            self.is_real(name, got[0])

    @rule(theta_i_deg=st.floats(0.0, 95.0), theta_mes_deg=st.floats(15.0, 180.0), delay_s=st.floats(0.0, 5.0))
    def measure_there(self, theta_i_deg: float, theta_mes_deg: float, delay_s: float) -> None:
        """Move, let a reading take its time, and ask whether nothing has turned meanwhile."""
        assert self.world is not None
        got: list[tuple[float, float]] = []
        error = self.attempt(lambda: got.append(self.rig.move_to(theta_i_deg, theta_mes_deg)))
        self.targets = {"theta_i": None, "theta_mes": None}
        if error is None:
            self.world.time.advance(delay_s)
            if self.attempt(lambda: self.rig.verify_still(*got[0], None)) is None:
                for name, angle_deg in zip(("theta_i", "theta_mes"), got[0], strict=True):
                    slack_deg = self.axis(name).config.tolerance_deg + HALF_STEP_DEG + self.world.backlash_deg
                    self.is_near(name, angle_deg, slack_deg, "stood still at")

    @rule()
    def open_again(self) -> None:
        """A program ends and another begins; the bench and its troubles stay."""
        assert self.world is not None
        self.world.time.forget()
        self.attempt(self.rig.close)
        self.targets = {"theta_i": None, "theta_mes": None}
        for _ in range(OPENINGS):
            if self.attempt(self._open) is None:
                return
            self.world.time.advance(20.0)
        raise AssertionError("the rig could not be opened")

    def _open(self) -> None:
        assert self.world is not None
        self.rig = self.world.open_rig()

    @rule(duration_s=st.floats(0.0, 20.0))
    def time_passes(self, duration_s: float) -> None:
        assert self.world is not None
        self.world.time.advance(duration_s)

    # -- the bench's bad days --------------------------------------------------------------------------------

    @rule(
        name=AXES,
        delay_s=st.floats(0.0, 4.0),
        turn_deg=st.floats(-20.0, 20.0),
        duration_s=st.floats(0.1, 3.0),
    )
    def hand_turns_the_knob(self, name: AxisName, delay_s: float, turn_deg: float, duration_s: float) -> None:
        assert self.world is not None
        motor, watch = self.world.motors[name], self.world.watches[name]

        def turn() -> None:
            watch.by_hand()
            motor.turn_by_hand(turn_deg * motor.hardware.steps_per_deg, duration_s)

        self.world.time.at(delay_s, turn)

    @rule(delay_s=st.floats(0.0, 4.0) | st.integers(0, 40).map(lambda ms: ms * 1e-3 + 5e-4))
    def power_fails_for_a_moment(self, delay_s: float) -> None:
        assert self.world is not None
        cable, trusted = self.cable, self.trusted

        def cut() -> None:
            trusted.update(theta_i=False, theta_mes=False)
            cable.instrument.power_cycle()  # type: ignore[attr-defined]
            cable.restart()

        self.world.time.at(delay_s, cut)

    @rule(
        name=AXES,
        fault=st.sampled_from(
            (Fault.LOW_LIMIT, Fault.STALL, Fault.OVER_TEMPERATURE, Fault.ENCODER, Fault.NONE)
        ),
        part=st.floats(0.0, 1.0),
        hold_s=st.floats(0.0, 3.0),
    )
    def next_move_goes_wrong(self, name: AxisName, fault: Fault, part: float, hold_s: float) -> None:
        """A switch that answers by itself, a stall, heat, a broken encoder; without a fault a hand."""
        assert self.world is not None
        motor, watch = self.world.motors[name], self.world.watches[name]

        def once(homing: bool) -> Disturbance:
            motor.disturb = None
            if fault is Fault.NONE:
                steps = -3.0 * motor.hardware.steps_per_deg
                return Disturbance(part, lambda _: watch.by_hand(), hand_steps=steps)
            return Disturbance(part, lambda _: watch.tripped(), fault=fault, hold_s=hold_s)

        motor.disturb = once

    @rule(delay_s=st.floats(0.0, 4.0), duration_s=st.floats(0.0, 30.0))
    def cable_is_pulled(self, delay_s: float, duration_s: float) -> None:
        assert self.world is not None
        self.world.time.at(delay_s, lambda: self.cable.unplug(duration_s))

    @rule(troubles=st.lists(st.sampled_from((*TROUBLES, *[""] * 6)), max_size=6), data=st.data())
    def line_goes_bad(self, troubles: list[str], data: st.DataObject) -> None:
        assert self.world is not None
        if self.world.has_checksum and data.draw(st.booleans()):
            troubles = [*troubles, "bit"]
        self.cable.troubles.extend(troubles)

    @precondition(lambda self: self.world is not None)
    @rule()
    def everything_is_well_again(self) -> None:
        """After the worst, with the causes gone, recovering works and the next move is right."""
        assert self.world is not None
        world = self.world
        world.time.forget()
        world.time.advance(60.0)
        self.cable.troubles.clear()
        for motor in world.motors.values():
            motor.disturb = None
        world.time.advance(1.0)
        for _ in range(RECOVERIES):  # the first may only find out that the connection is dead
            if (error := self.attempt(self.rig.stage.recover)) is None:
                break
            world.time.advance(5.0)
        assert error is None, error
        self.targets = {"theta_i": None, "theta_mes": None}
        got = self.rig.move_to(20.0, 60.0)
        self.arrived("theta_i", 20.0, got[0])
        self.arrived("theta_mes", 60.0, got[1])

    # -- what must hold --------------------------------------------------------------------------------------

    @invariant()
    def nothing_forbidden_happened(self) -> None:
        if self.world is not None:
            assert self.world.broken() == []

    def axis(self, name: AxisName):
        return self.rig.stage.theta_i if name == "theta_i" else self.rig.stage.theta_mes

    def attempt(self, action: Callable[[], object], *, forget: bool = True) -> GonioError | None:
        """Call a driver: it may fail, but only by an error that a user can act on."""
        if forget:
            self.cable.said_at_deg.clear()
        try:
            action()
        except GonioError as error:
            note(f"   {type(error).__name__}: {error}")
            return error
        return None

    def arrived(self, name: AxisName, target_deg: float, got_deg: float) -> None:
        """A move that ended well ended at its target, up to lost motion where nothing takes it up."""
        assert self.world is not None
        config = self.axis(name).config
        assert abs(got_deg - target_deg) <= config.tolerance_deg + 1e-9
        slack_deg = config.tolerance_deg + HALF_STEP_DEG
        no_room = target_deg + config.backlash_deg > config.limits_deg[1]  # for an approach from beyond
        if no_room or self.world.watches[name].disturbed:
            slack_deg += self.world.backlash_deg
        self.is_near(name, target_deg, slack_deg, "moved")
        self.world.watches[name].disturbed = False

    def is_real(self, name: AxisName, got_deg: float) -> None:
        assert self.world is not None
        self.is_near(name, got_deg, HALF_STEP_DEG + self.world.backlash_deg + 1e-6, "read")

    def is_near(self, name: str, angle_deg: float, slack_deg: float, what: str) -> None:
        """Compare with where the arm was when the bench gave one of the replies of the call."""
        true_deg = [angles[name] for angles in self.cable.said_at_deg]
        assert min(abs(angle_deg - t) for t in true_deg) <= slack_deg + 1e-9, (
            f"{name} {what} {angle_deg} deg, but the arm was at {true_deg[-3:]} deg"
        )


@pytest.mark.parametrize("kind", STAGES)
def test_stage(kind: str) -> None:
    run_machine(type("StageMachine", (StageMachine,), {"kind": kind}), max_examples=15)

"""What the state machines and the fuzzers have found, each in its shortest form."""

from __future__ import annotations

import pytest

from gonio.config import parse_toml
from gonio.errors import ConfigError, GonioError, MotionError
from gonio.wirelog import from_printable
from gonio_drivers.decimals import decimal, fixed, whole
from gonio_drivers.sr830 import SR830

from .world import STAGES, World

NO_NUMBERS = ("", "nan", "inf", "-Infinity", "1_000", "٣", "0x10", "1e", "--5", "5 5", "1,5")


@pytest.mark.parametrize("text", [*NO_NUMBERS, "1e999", "9" * 5000 + "e"])
def test_a_reading_is_a_number_as_instruments_print_it(text):
    with pytest.raises(ValueError, match="number"):
        decimal(text)


@pytest.mark.parametrize("text", [*NO_NUMBERS, "1e5", "12345678901"])
def test_a_count_has_ten_digits_and_no_exponent(text):
    for parse in (fixed, whole):
        with pytest.raises(ValueError, match="number"):
            parse(text)


def test_numbers():
    assert [decimal(t) for t in ("1.25e-3", " -4.", ".5", "+7E2")] == [1.25e-3, -4.0, 0.5, 700.0]
    assert [fixed(t) for t in ("-20000", "12.5")] == [-20000.0, 12.5]
    assert [whole(t) for t in ("26", "-1", "+3 ")] == [26, -1, 3]


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 5000])
def test_toml_that_python_itself_gives_up_on(value):
    with pytest.raises(ConfigError, match=r"x\.toml: is not valid TOML"):
        parse_toml(f"a = {value}", source="x.toml")


def test_an_unknown_escape_in_a_log():
    with pytest.raises(ValueError, match="escape"):
        from_printable("\\K")


@pytest.mark.parametrize("kind", STAGES)
def test_no_position_without_a_reference(kind):
    """A controller that was switched off counts from zero wherever it stands."""
    world = World(stage=kind)
    with world.installed():
        rig = world.open_rig()
        rig.move_to(20.0, 146.0)
        world.cables["stage"].instrument.power_cycle()
        with pytest.raises(MotionError, match=r"reference.*home it"):
            rig.stage.theta_mes.position_deg()
        rig.close()


@pytest.mark.parametrize("kind", STAGES)
@pytest.mark.parametrize("ms", [0.5, 2.5, 6.5])
def test_power_fails_while_a_move_begins(kind, ms):
    """Between the look at the count and the command: the drive would run to its count, which is another."""
    world = World(stage=kind)
    with world.installed():
        rig = world.open_rig()
        rig.move_to(20.0, 100.0)
        world.time.at(ms * 1e-3, world.cables["stage"].instrument.power_cycle)
        with pytest.raises(GonioError):
            rig.move_to(20.0, 60.0)
        assert world.broken() == []
        rig.stage.recover()
        rig.move_to(20.0, 60.0)
        assert world.angles_deg()["theta_mes"] == pytest.approx(60.0, abs=0.01)
        rig.close()


@pytest.mark.parametrize("ms", [2.5, 6.5, 10.5, 14.5, 18.5])
def test_power_fails_while_a_modbus_stage_recovers(ms):
    """What the recovery writes must not look like what the drive has kept."""
    world = World(stage="modbus-tcp")
    with world.installed():
        rig = world.open_rig()
        rig.move_to(20.0, 15.0)
        world.time.at(ms * 1e-3, world.cables["stage"].instrument.power_cycle)
        for _ in range(2):
            rig.stage.recover()
        rig.move_to(20.0, 60.0)
        assert world.angles_deg()["theta_mes"] == pytest.approx(60.0, abs=0.01)
        assert world.broken() == []
        rig.close()


@pytest.mark.parametrize("kind", STAGES)
def test_a_hand_that_ends_the_search_for_home(kind):
    """It ends without an alarm, and where it ended is no reference."""
    world = World(stage=kind)
    with world.installed():
        rig = world.open_rig()
        rig.move_to(20.0, 160.0)
        motor, watch = world.motors["theta_mes"], world.watches["theta_mes"]

        def turn() -> None:
            watch.by_hand()
            motor.turn_by_hand(-5.0 * motor.hardware.steps_per_deg, 0.5)

        world.time.at(1.0, turn)
        with pytest.raises(MotionError):
            rig.stage.theta_mes.home()
        with pytest.raises(MotionError):
            rig.move_to(20.0, 120.0)
        rig.stage.recover()
        rig.move_to(20.0, 120.0)
        assert world.angles_deg()["theta_mes"] == pytest.approx(120.0, abs=0.01)
        rig.close()


def test_a_range_that_was_not_confirmed_is_set_again():
    world = World()
    with world.installed():
        rig = world.open_rig()
        cable = world.cables["lockin"]
        lockin = rig.spectrometer._lockin
        assert isinstance(lockin, SR830)
        before = lockin.range_index
        cable.troubles.extend(["lost reply"] * 12)
        with pytest.raises(GonioError):
            lockin.set_range(20)
        cable.troubles.clear()
        assert lockin.set_range(before), "the instrument may stand at range 20"
        rig.close()

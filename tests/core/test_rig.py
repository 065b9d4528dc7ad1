"""What the rig file answers before anything moves."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.errors import ConfigError, RefusedError
from gonio.rig import (
    AxisConfig,
    RigConfig,
    check_path,
    check_target,
    default_rig_text,
    load_rig,
    parse_rig,
    with_addresses,
)

TWO_SIDED = AxisConfig(limits_deg=(-170.0, 170.0), blind_zone_deg=15.0)


@pytest.fixture(scope="module")
def rig() -> RigConfig:
    return load_rig()


@pytest.mark.parametrize("angle", [0.0, 14.99, -14.99, 12.0])
def test_the_blind_zone_is_forbidden_on_either_side(angle: float) -> None:
    with pytest.raises(
        RefusedError, match=r"theta_mes = .* is inside the blind zone .*15 deg.*start the sweep at"
    ):
        check_target("theta_mes", TWO_SIDED, angle, rig_name="arta")


@pytest.mark.parametrize("angle", [15.0, -15.0, 170.0, -170.0])
def test_its_border_and_the_limits_are_allowed(angle: float) -> None:
    check_target("theta_mes", TWO_SIDED, angle, rig_name="arta")


@pytest.mark.parametrize("angle", [170.01, -171.0, float("nan"), float("inf")])
def test_beyond_the_limits_or_no_angle(angle: float) -> None:
    with pytest.raises(RefusedError):
        check_target("theta_mes", TWO_SIDED, angle, rig_name="arta")


def test_the_way_through_the_blind_zone_is_refused_and_the_way_beside_it_is_not() -> None:
    with pytest.raises(RefusedError, match="from 30 to -30 deg sweeps through the blind zone"):
        check_path("theta_mes", TWO_SIDED, 30.0, -30.0, rig_name="arta")
    check_path("theta_mes", TWO_SIDED, 30.0, 160.0, rig_name="arta")
    check_path("theta_mes", TWO_SIDED, 14.7, 20.0, rig_name="arta")  # off the limit switch, on its own side
    free = AxisConfig(limits_deg=(-90.0, 90.0))
    check_path("theta_i", free, 30.0, -30.0, rig_name="arta")


def test_detectors_change_where_the_file_says(rig: RigConfig) -> None:
    index = rig.detector_for(np.array([300.0, 859.9, 860.0, 1500.0, 1600.0]))
    assert index.tolist() == [0, 0, 1, 1, 1]
    with pytest.raises(RefusedError, match=r"1700 nm is covered by no detector .*pmt 200-860 nm.*ingaas"):
        rig.detector_for(np.array([500.0, 1700.0]))


def test_move_duration_is_that_of_a_trapezoid() -> None:
    axis = AxisConfig(limits_deg=(0.0, 90.0), speed_deg_s=20.0, acceleration_deg_s2=100.0)
    assert axis.move_duration_s(40.0) == pytest.approx(40 / 20 + 20 / 100)
    assert axis.move_duration_s(-1.0) == pytest.approx(2 * (1 / 100) ** 0.5)  # never reaches full speed


def test_simulated_addresses_are_replaced_and_the_rest_is_kept(rig: RigConfig) -> None:
    assert rig.is_simulated()
    text = default_rig_text().replace('address = "simulated"', 'address = "/dev/ttyUSB9"', 1)
    mixed = parse_rig(text.replace("clock_speed = 4000.0", "clock_speed = 1.0"))
    served = with_addresses(
        mixed, {role: f"socket://127.0.0.1:{i}" for i, role in enumerate(mixed.addresses())}
    )
    assert served.addresses() == {
        "stage": "/dev/ttyUSB9",
        "polarizer": "socket://127.0.0.1:1",
        "monochromator": "socket://127.0.0.1:2",
        "lockin": "socket://127.0.0.1:3",
    }
    assert served.stage.theta_mes == mixed.stage.theta_mes
    assert not mixed.is_simulated()


def test_a_fast_clock_never_meets_real_hardware() -> None:
    text = default_rig_text().replace('address = "simulated"', 'address = "COM3"', 1)
    with pytest.raises(
        ConfigError, match=r"clock_speed = 4000 but the stage at COM3 is real hardware.*remove"
    ):
        parse_rig(text).clock_speed()
    assert load_rig().clock_speed() == 4000.0


def test_an_unknown_driver_lists_those_there_are() -> None:
    with pytest.raises(
        ConfigError,
        match="'newport' is not installed; installed stage drivers: applied-motion, modbus-registers, zaber",
    ):
        parse_rig(default_rig_text().replace('driver = "zaber"', 'driver = "newport"'))


def test_overlapping_detectors_are_refused() -> None:
    with pytest.raises(ConfigError, match="overlap between 800"):
        parse_rig(default_rig_text().replace("range_nm = [860.0, 1600.0]", "range_nm = [800.0, 1600.0]"))

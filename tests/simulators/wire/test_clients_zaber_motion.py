"""The vendor's library at the stages: identification, parking, driver, storage, profile of one move."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from zaber_motion import DeviceDbSourceType, Library, Units
from zaber_motion.ascii import AxisType, Connection
from zaber_motion.exceptions import (
    BadCommandException,
    CommandFailedException,
    DeviceDbFailedException,
    DriverDisabledException,
)

from tests.simulators.wire.conftest import Simulator, running
from tests.simulators.wire.zaber_database import write_database


@pytest.fixture(scope="module")
def sim() -> Iterator[Simulator]:
    with running("--clock-speed", "2000") as simulator:
        yield simulator


@pytest.fixture
def chain(sim: Simulator) -> Iterator[Connection]:
    with Connection.open_tcp("127.0.0.1", sim.port("stage")) as line:
        yield line


@pytest.fixture(autouse=True)
def _without_store() -> Iterator[None]:
    """The library keeps what it found on the disk; not what it finds here."""
    Library.disable_device_db_store()
    yield
    Library.enable_device_db_store()
    Library.set_device_db_source(DeviceDbSourceType.WEB_SERVICE)


@pytest.fixture
def database(tmp_path: Path) -> Path:
    path = tmp_path / "devices.sqlite"
    write_database(path)
    Library.set_device_db_source(DeviceDbSourceType.FILE, str(path))
    return path


def test_identification_without_a_database(chain: Connection) -> None:
    """First in this file, as the library keeps what it once found.

    A place where no service listens stands for a machine without internet.
    """
    Library.set_device_db_source(DeviceDbSourceType.WEB_SERVICE, "http://127.0.0.1:9/")
    with pytest.raises(DeviceDbFailedException):
        chain.detect_devices()
    assert len(chain.detect_devices(identify_devices=False)) == 2  # everything but units goes on


def test_identification_from_a_database_file(chain: Connection, database: Path) -> None:
    try:
        theta_i, theta_mes = chain.detect_devices()
    except DeviceDbFailedException as failure:
        if "not compatible" in str(failure):
            pytest.skip(f"this zaber-motion wants another form of database: {failure}")
        raise
    identity = theta_i.identity
    assert (identity.device_id, identity.serial_number, identity.axis_count) == (50952, 120_001, 1)
    assert (identity.firmware_version.major, identity.firmware_version.minor) == (7, 35)
    assert identity.is_integrated
    assert theta_mes.identity.serial_number == 120_002
    axis = theta_i.get_axis(1)
    assert axis.axis_type is AxisType.ROTARY
    assert (axis.resolution, axis.is_peripheral) == (64, False)
    axis.home()
    axis.move_absolute(10.0, Units.ANGLE_DEGREES)
    assert axis.get_position(Units.ANGLE_DEGREES) == pytest.approx(10.0, abs=1e-3)
    assert axis.get_position() == 42_667
    speed = axis.settings.get("maxspeed", Units.ANGULAR_VELOCITY_DEGREES_PER_SECOND)
    assert speed == pytest.approx(20.0, abs=1e-3)


def test_commands_beyond_moving(chain: Connection) -> None:
    device = chain.get_device(1)
    axis = device.get_axis(1)
    axis.home()
    axis.move_absolute(5000, velocity=50_000, acceleration=100)
    assert axis.get_position() == 5000
    axis.park()
    assert axis.is_parked()
    with pytest.raises(CommandFailedException, match="PARKED"):
        axis.move_absolute(0)
    axis.unpark()
    axis.driver_disable()
    assert axis.warnings.get_flags() == {"FO"}
    with pytest.raises(DriverDisabledException):
        axis.move_absolute(0)
    axis.driver_enable()
    axis.move_velocity(10)  # the bench's seconds are fast
    assert axis.is_busy()
    axis.stop()
    assert not axis.is_busy()

    text = " ".join(f"word{i}" for i in range(40))  # longer than a packet, both ways
    device.storage.set_string("gonio.note", text)
    assert device.storage.get_string("gonio.note") == text
    device.storage.set_number("gonio.n", 1.5)
    assert device.storage.get_number("gonio.n") == 1.5
    assert set(device.storage.list_keys()) == {"gonio.note", "gonio.n"}
    assert device.storage.erase_key("gonio.n")
    assert not device.storage.key_exists("gonio.n")

    assert device.io.get_channels_info().number_digital_inputs == 0
    with pytest.raises(BadCommandException):
        device.get_lockstep(1).is_enabled()
    device.restore()
    device.generic_command("system reset")
    assert not axis.is_homed()

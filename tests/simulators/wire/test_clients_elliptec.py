"""Other people's Elliptec clients: thorlabs-elliptec, tl-elliptec, and what pylablib sends."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from tests.simulators.wire.conftest import Simulator, running

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")

PULSE_DEG = 360 / 143360


@pytest.fixture(scope="module")
def sim() -> Iterator[Simulator]:
    with running("--clock-speed", "50", "--pty") as simulator:
        yield simulator


def test_thorlabs_elliptec(sim: Simulator) -> None:
    from thorlabs_elliptec import ELLx

    stage = ELLx(sim.address("polarizer", pty=True), x=14)
    try:
        assert (stage.model_number, stage.serial_number, stage.travel) == ("ELL14/M", "11400051", 360)
        stage.home(blocking=True)
        stage.move_absolute(90, blocking=True)
        assert stage.get_position() == 90.0
        stage.move_relative(-30.5, blocking=True)
        assert stage.get_position() == pytest.approx(59.5, abs=2 * PULSE_DEG)
    finally:
        stage.close()
        stage._thread.join(timeout=5)  # the port is closed there


def test_tl_elliptec(sim: Simulator) -> None:
    from tl_elliptec.bus import ElliptecBus
    from tl_elliptec.devices.models import ELL14
    from tl_elliptec.status import StatusCode

    bus = ElliptecBus(sim.address("polarizer", pty=True))
    try:
        stage = ELL14(bus, "0")
        assert stage.info is not None
        assert (stage.info.ell_type, stage.info.pulses_per_unit) == (14, 143360)
        assert stage.home() == 0.0
        assert stage.move_absolute(45) == 45.0
        assert stage.move_relative(-5) == pytest.approx(40.0, abs=PULSE_DEG)
        stage.set_jog_step_size(10)
        assert stage.forward() == pytest.approx(50.0, abs=2 * PULSE_DEG)
        stage.set_velocity(60)
        assert stage.get_velocity() == 60
        stage.set_forward_frequency(1, 90e3)
        assert stage.get_motor_info(1).forward_frequency_hz == pytest.approx(90e3, rel=0.01)
        assert stage.search_frequency(1) == StatusCode.OK
        assert stage.clean_mechanics() == StatusCode.OK
        stage.change_address("A")
        assert stage.get_position() == pytest.approx(50.0, abs=2 * PULSE_DEG)
        stage.change_address("0")
        assert stage.get_status() == StatusCode.OK
    finally:
        bus.close()


def test_what_pylablib_sends(sim: Simulator) -> None:
    """Bytes and reply lengths of `pylablib.devices.Thorlabs.ElliptecMotor`, which is too large to install."""
    lengths = {"IN": 30, "GS": 2, "I1": 22, "I2": 22, "PO": 8, "HO": 8, "GJ": 8, "GV": 2}
    with sim.client("polarizer") as client:

        def query(command: str, *kinds: str) -> str:
            reply = client.ask(command.encode("ascii")).decode("ascii")
            assert reply.endswith("\r\n")
            kind, data = reply[1:3], reply[3:-2]
            assert kind in kinds
            assert len(data) == lengths[kind]
            return data

        for address in range(16):  # who is there? all are asked, one answers
            client.socket.sendall(f"{address:01X}gs".encode("ascii"))
        assert client.read_until(b"\r\n") == b"0GS00\r\n"
        information = query("0in", "IN")
        assert (int(information[:2], 16), int(information[18:22], 16)) == (14, 360)
        assert query("0ho0", "GS", "PO") == "00000000"
        query("0ma00004600", "GS", "PO")
        assert query("0gp", "PO") == "00004600"
        assert query("0mrFFFFF000", "GS", "PO") == "00003600"
        for command, kind in (("0i1", "I1"), ("0i2", "I2"), ("0go", "HO"), ("0gv", "GV"), ("0us", "GS")):
            query(command, kind)
        assert query("0i3", "I3", "GS") == "03"  # it takes this as the end of the motors
        assert query("0gs", "GS") == "03"  # and clears the status
        assert query("0sv40", "GS") == "00"
        client.socket.sendall(b"0ca3")
        assert client.read_until(b"\r\n") == b"3GS00\r\n"
        client.socket.sendall(b"3ca0")
        assert client.read_until(b"\r\n") == b"0GS00\r\n"

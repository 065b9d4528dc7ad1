"""Lines that are lost and come back, adapters under another name, shared lines, and what is then believed."""

from __future__ import annotations

import socket
import threading
from dataclasses import dataclass

import pytest

from gonio.clock import Clock
from gonio.errors import ConnectionFailed, DeviceError, MotionError
from gonio.rig import Context
from gonio_drivers import usb
from gonio_drivers.lines import Line, open_line
from gonio_drivers.stage import MotorStage
from gonio_drivers.usb import UsbIdentity, device_of, identity_of, parse_usb_address

from .conftest import ScriptedPort
from .test_axis import PLAIN, THETA_MES, Motor, make

# -- lines ---------------------------------------------------------------------------


class Echo:
    """Answers each line with itself, one client after the other; `hang_up` closes the present connection."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"socket://127.0.0.1:{self.listener.getsockname()[1]}"
        self.clients = 0
        self._client: socket.socket | None = None
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                self._client, _ = self.listener.accept()
            except OSError:
                return
            self.clients += 1
            with self._client:
                while data := self._receive(self._client):
                    self._client.sendall(data)

    @staticmethod
    def _receive(client: socket.socket) -> bytes:
        try:
            return client.recv(100)
        except OSError:
            return b""

    def hang_up(self) -> None:
        assert self._client is not None
        self._client.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.listener.close()
        if self._client is not None:
            self._client.close()


@pytest.fixture
def echo():
    server = Echo()
    yield server
    server.close()


def ask(line: Line, text: bytes) -> bytes:
    with line.transaction():
        line.send(text + b"\n")
        return line.read_until(b"\n", line.deadline_s())


def unanswered(line: Line) -> None:
    with line.transaction():
        line.send(b"no line end")
        line.read_until(b"\n", line.deadline_s())


def context() -> Context:
    return Context("test", Clock())


def test_a_lost_line_stays_lost_until_it_is_renewed(echo):
    line = open_line("stage", echo.address, context())
    assert ask(line, b"one") == b"one"
    echo.hang_up()
    with pytest.raises(ConnectionFailed, match="the connection was lost"):
        ask(line, b"two")
    with pytest.raises(ConnectionFailed, match="the connection was lost"):
        ask(line, b"three")  # nothing was sent: the device's state is not known
    assert line.renew()
    assert ask(line, b"four") == b"four"
    assert line.statistics.reconnects == 1
    assert not line.renew()  # nothing is wrong with it
    assert echo.clients == 2
    line.close()


def test_a_line_that_cannot_be_renewed_yet_can_be_later(echo):
    port = ScriptedPort()
    answers = [ConnectionFailed("stage", "not there", "wait"), port]

    def reopen():
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    line = Line(ScriptedPort(), "stage", "scripted", reopen=reopen)
    line._lost(OSError("unplugged"))
    with pytest.raises(ConnectionFailed, match="not there"):
        line.renew()
    assert line.renew()
    assert line.port is port


def test_a_line_in_doubt_is_opened_anew_too(echo):
    """A peer that vanished without a word takes bytes and never answers."""
    line = open_line("stage", echo.address, context())
    line.reply_timeout_s = 0.05
    with pytest.raises(DeviceError, match="gave no complete reply"):
        unanswered(line)
    assert line.renew()
    assert ask(line, b"again") == b"again"
    line.close()


def test_a_closed_line_is_not_renewed(echo):
    line = open_line("stage", echo.address, context())
    line.close()
    with pytest.raises(ConnectionFailed, match="has been closed"):
        line.renew()


def test_devices_with_one_address_share_one_line_and_the_last_closes_it(echo):
    shared = context()
    first = open_line("stage", echo.address, shared, protocol="elliptec")
    second = open_line("polarizer", echo.address, shared, protocol="elliptec")
    assert second is first
    first.close()
    assert ask(second, b"still here") == b"still here"
    second.close()
    second.close()
    third = open_line("polarizer", echo.address, shared, protocol="elliptec")
    assert third is not first
    assert ask(third, b"anew") == b"anew"
    third.close()


def test_one_line_speaks_one_protocol_at_one_speed(echo):
    shared = context()
    line = open_line("stage", echo.address, shared, protocol="zaber", baudrate=115200)
    with pytest.raises(
        ConnectionFailed, match=r"lockin at .*: the stage is connected there already \(zaber at"
    ):
        open_line("lockin", echo.address, shared, protocol="sr830", baudrate=9600)
    assert ask(line, b"unharmed") == b"unharmed"
    line.close()


def test_reply_timeout_of_the_rig_file(echo):
    line = open_line("stage", echo.address, Context("test", Clock(), reply_timeout_s=0.125))
    assert line.reply_timeout_s == 0.125
    line.close()


# -- adapters ------------------------------------------------------------------------


@dataclass
class Plugged:
    device: str
    vid: int | None = 0x0403
    pid: int | None = 0x6001
    serial_number: str | None = "A6008isP"
    location: str | None = "1-1.2"


def test_an_adapter_is_known_by_its_serial_number_under_any_name():
    identity = identity_of("/dev/ttyUSB0", [Plugged("/dev/ttyUSB0")])
    assert identity == UsbIdentity(0x0403, 0x6001, "A6008isP")
    other = Plugged("/dev/ttyUSB0", serial_number="B7")
    assert device_of(identity, [other, Plugged("/dev/ttyUSB3", location="2-4")]) == "/dev/ttyUSB3"


def test_without_a_serial_number_it_is_known_by_its_socket():
    nameless = Plugged("COM3", serial_number=None)
    identity = identity_of("COM3", [nameless])
    assert identity is not None
    assert identity.location == "1-1.2"
    elsewhere = Plugged("COM4", serial_number=None, location="1-1.3")
    assert device_of(identity, [elsewhere, Plugged("COM7", serial_number=None)]) == "COM7"


def test_a_port_of_the_mainboard_has_no_identity():
    assert identity_of("/dev/ttyS0", [Plugged("/dev/ttyS0", vid=None, pid=None)]) is None


def test_usb_addresses():
    assert parse_usb_address("usb://0403:6001/A6008isP") == UsbIdentity(0x0403, 0x6001, "A6008isP")
    assert str(parse_usb_address("usb://0403:6001")) == "usb://0403:6001"
    with pytest.raises(ValueError, match="usb://VID:PID"):
        parse_usb_address("usb://403:6001")


def test_absent_or_ambiguous_adapters_are_told():
    identity = UsbIdentity(0x0403, 0x6001)
    with pytest.raises(OSError, match="no USB adapter usb://0403:6001 is plugged in"):
        device_of(identity, [])
    with pytest.raises(OSError, match=r"2 USB adapters .*\(COM3, COM4\); add the serial number"):
        device_of(identity, [Plugged("COM4"), Plugged("COM3")])


def test_an_absent_adapter_in_the_rig_file_is_one_message():
    with pytest.raises(ConnectionFailed, match=r"lockin at usb://0403:6001/none: no USB adapter"):
        open_line("lockin", "usb://0403:6001/none", context())


# -- axes and stages -----------------------------------------------------------------


class SharedLine:
    def __init__(self) -> None:
        self.renewed = False

    def renew(self) -> bool:
        return self.renewed

    def close(self) -> None:
        return


def stage_of(theta_i: Motor, theta_mes: Motor) -> MotorStage:
    return MotorStage(
        make(PLAIN, theta_i, "theta_i"),
        make(THETA_MES, theta_mes, "theta_mes"),
        line=SharedLine(),
        descriptions={},
    )


def test_after_a_fault_only_the_axis_in_doubt_is_homed():
    theta_i, theta_mes = Motor(), Motor()
    stage = stage_of(theta_i, theta_mes)
    stage.theta_i.start(30.0)
    theta_i.fault = "stalled"
    with pytest.raises(MotionError, match="stalled"):
        stage.theta_i.wait()
    theta_i.fault = None
    told = stage.recover()
    assert told.startswith("theta_i homed since stalled; it stands at")
    assert "theta_mes" not in told
    assert "home" in theta_i.log
    assert "home" not in theta_mes.log
    assert theta_mes.log == ["stop", "resume", "clear"]
    stage.theta_i.start(30.0)
    assert stage.theta_i.wait() == 30.0


def test_a_reconnection_is_told_and_a_lost_reference_found_again():
    theta_i = Motor()
    stage = stage_of(theta_i, Motor())
    stage._line.renewed = True
    theta_i.referenced = False
    assert stage.recover() == "connection opened anew, theta_i homed since it had lost its reference"
    assert theta_i.referenced


def test_recovery_brings_a_runaway_to_rest_first():
    motor = Motor(polls=1000)
    axis = make(PLAIN, motor)
    axis.start(80.0)
    assert axis.recover() is None
    assert motor.log == ["move 80000", "stop", "resume", "clear"]


def test_a_fault_that_stays_is_told():
    motor = Motor()
    motor.clear_faults = lambda: None
    motor.fault = "the motor is too hot"
    with pytest.raises(MotionError, match="too hot"):
        make(PLAIN, motor).recover()


def test_a_search_for_home_that_fails_leaves_the_doubt():
    motor = Motor()
    axis = make(PLAIN, motor)
    axis.start(30.0)
    motor.fault = "stalled"
    with pytest.raises(MotionError):
        axis.wait()
    motor.fault = None
    axis.start_home()
    motor.fault = "stalled"
    with pytest.raises(MotionError):
        axis.wait()
    motor.fault = None
    assert axis.needs_home()
    with pytest.raises(MotionError, match="may have lost count"):
        axis.start(10.0)


def test_a_drive_that_was_switched_off_on_the_way_has_not_arrived():
    """It counts from zero again: idle, without a fault, and at the target by its own count."""
    motor = Motor(30_000)
    axis = make(PLAIN, motor)
    axis.start(0.0)
    motor.forgotten = "it was switched off and on"
    with pytest.raises(MotionError, match=r"switched off and on; it reads 0\.000 deg"):
        axis.wait()
    assert axis.needs_home()


def test_a_count_that_changed_at_rest_is_a_lost_reference_where_the_drive_cannot_say():
    motor = Motor()
    motor.reports_reference = False
    axis = make(PLAIN, motor)
    axis.start(30.0)
    axis.wait()
    motor.position_steps = 0
    with pytest.raises(MotionError, match=r"reads 0\.000 deg although left at 30\.000 deg.*switched off"):
        axis.start(40.0)


def test_a_count_that_changed_at_rest_is_a_turned_knob_where_the_drive_can_say():
    motor = Motor()
    axis = make(PLAIN, motor)
    axis.start(30.0)
    axis.wait()
    motor.position_steps = 10_000
    axis.start(40.0)
    assert axis.wait() == 40.0


@pytest.mark.parametrize(
    ("disturb", "words"),
    [
        (
            lambda motor: setattr(motor, "position_steps", 31_000),
            "is at 31.000 deg although it was left at 30",
        ),
        (lambda motor: setattr(motor, "referenced", False), "has lost its reference"),
        (lambda motor: setattr(motor, "fault", "is moved by its knob"), "is moved by its knob"),
        (lambda motor: motor.move_to(31_000), "is moving"),
    ],
)
def test_what_turns_during_a_pass_is_found_out(disturb, words):
    motor = Motor()
    axis = make(PLAIN, motor)
    axis.start(30.0)
    axis.wait()
    assert axis.verify_still(30.0) == 30.0
    disturb(motor)
    with pytest.raises(MotionError, match=words):
        axis.verify_still(30.0)
    assert axis.needs_home()


def test_the_ports_of_this_machine_are_listed_with_the_address_that_stays(monkeypatch, capsys):
    @dataclass
    class Described(Plugged):
        description: str = "USB-RS232 adapter"

    monkeypatch.setattr(
        usb, "comports", lambda: [Described("/dev/ttyUSB1"), Described("/dev/ttyS0", vid=None)]
    )
    assert usb.main([]) == 0
    nothing, adapter = capsys.readouterr().out.splitlines()
    assert nothing.split() == ["/dev/ttyS0", "USB-RS232", "adapter"]
    assert adapter.split()[:2] == ["/dev/ttyUSB1", "usb://0403:6001/A6008isP"]

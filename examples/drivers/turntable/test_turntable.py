"""The driver against a device of memory that speaks on a real port."""

import socketserver
import threading

import pytest

from gonio.clock import Clock
from gonio.errors import DeviceError, MotionError
from gonio.rig import Context, find_driver

CHECK = {"QS": 0, "ID": 0, "ST": 0, "CL": 0, "HO": 0, "MA": 1, "SP": 1, "AC": 1}  # parameters


class Turntable:
    """One device of the chain; a move takes three polls, and `blocked_at` stalls it."""

    def __init__(self):
        self.position = self.target = 777  # wherever it was switched on
        self.left, self.reference, self.fault, self.blocked_at = 0, "U", "-", None

    def answer(self, letters, value):
        if letters not in CHECK or bool(value) != bool(CHECK[letters]):
            return None
        if letters == "ID":
            return "TT1 serial 4711 firmware 2.3"
        if letters == "QS":
            self.poll()
            return f"{self.position},{'M' if self.left else 'I'},{self.reference},{self.fault}"
        if letters == "MA":
            self.target, self.left = int(value), 3
        elif letters == "HO":
            self.position, self.target, self.left, self.reference = 777, 0, 3, "R"
        elif letters == "ST":
            self.left = 0
        elif letters == "CL":
            self.fault = "-"
        return ""

    def poll(self):
        if self.left:
            self.position += (self.target - self.position) // self.left
            self.left -= 1
            if self.blocked_at is not None and self.position > self.blocked_at:
                self.position, self.left, self.fault = self.blocked_at, 0, "S"


class Chain(socketserver.StreamRequestHandler):
    def handle(self):
        text = b""
        while data := self.connection.recv(256):
            text += data
            *commands, text = text.split(b"\r")
            for command in (c.decode() for c in commands):
                device = self.server.tables.get(command[:1])
                if device is not None:  # the others on a chain are silent
                    answer = device.answer(command[1:3], command[3:])
                    head = command[:3] if answer is not None else command[:1] + "??"
                    self.wfile.write(f"{head}{'02' if answer is None else answer}\r".encode())


@pytest.fixture
def tables():
    return {"1": Turntable(), "2": Turntable()}


@pytest.fixture
def stage(tables):
    with socketserver.TCPServer(("127.0.0.1", 0), Chain) as server:
        server.tables = tables
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        driver = find_driver("stage", "turntable", source="test")
        axis = {"steps_per_deg": 1000.0, "limits_deg": [0.0, 180.0], "backlash_deg": 0.5}
        config = driver.config.model_validate(
            {
                "driver": "turntable",
                "address": f"socket://127.0.0.1:{server.server_address[1]}",
                "theta_i": {"device": 1, **axis},
                "theta_mes": {"device": 2, **axis},
            }
        )
        stage = driver.open(config, Context("test", Clock(speed=1e6)))
        yield stage
        stage.close()
        server.shutdown()


def test_it_is_homed_on_connecting(stage, tables):
    assert stage.identify().startswith("theta_i: TT1 serial 4711")
    assert [table.position for table in tables.values()] == [0, 0]


def test_a_move_ends_at_its_target_approached_from_one_side(stage, tables):
    stage.theta_i.start(30.0)
    stage.theta_mes.start(45.5)
    assert (stage.theta_i.wait(), stage.theta_mes.wait()) == (30.0, 45.5)
    assert tables["1"].position == 30_000


def test_a_stop_is_not_an_arrival(stage):
    stage.theta_i.start(90.0)
    stage.stop()
    with pytest.raises(MotionError, match="was stopped on request"):
        stage.theta_i.wait()


def test_a_stall_is_named_and_the_axis_homed_before_it_goes_on(stage, tables):
    tables["1"].blocked_at = 12_345
    stage.theta_i.start(90.0)
    with pytest.raises(MotionError, match=r"turntable 1.*it stalled; it stands at 12.345 deg"):
        stage.theta_i.wait()
    tables["1"].blocked_at = None
    assert "theta_i homed" in stage.recover()
    stage.theta_i.start(90.0)
    assert stage.theta_i.wait() == 90.0


def test_a_restart_is_seen(stage, tables):
    tables["1"].reference = "U"
    with pytest.raises(MotionError, match="reference"):
        stage.theta_i.start(30.0)
    assert "theta_i homed" in stage.recover()


def test_a_refusal_in_the_devices_own_words(stage):
    with pytest.raises(DeviceError, match=r"refused 'XY' \(02\)"):
        stage.theta_i._drive.command("XY")

"""The driver with a register map: on the simulated drives beside their own driver, and on drives of other
makes, played by pymodbus' own server.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from gonio.clock import Clock
from gonio.config import validate
from gonio.errors import DeviceError, MotionError, RefusedError
from gonio.rig import Context, StageConfig, find_driver
from gonio_drivers.modbus_axis import RegisterStageConfig, open_stage
from gonio_drivers.stage import MotorStage

from .conftest import Bench, running_bench

AXES = ("theta_i", "theta_mes")
EXAMPLE = Path(__file__).parents[2] / "examples" / "rigs" / "arta-modbus-registers.toml"


def test_the_entry_point_leads_here():
    assert find_driver("stage", "modbus-registers", source="test").open is open_stage


# -- beside the dedicated driver ---------------------------------------------------------


@pytest.fixture(scope="module", params=[("rtu", "big"), ("tcp", "little")], ids=lambda p: "-".join(p))
def example_bench(request, tmp_path_factory):
    framing, word_order = request.param
    text = EXAMPLE.read_text(encoding="utf-8").replace('framing = "rtu"', f'framing = "{framing}"')
    text = text.replace('word_order = "big"', f'word_order = "{word_order}"')
    with running_bench(tmp_path_factory.mktemp("bench"), text) as bench:
        yield bench


@contextlib.contextmanager
def opened(bench: Bench, table: StageConfig | None = None) -> Iterator[MotorStage]:
    """Open the stage alone, with the driver that its table names."""
    table = table or bench.config.stage
    driver = find_driver("stage", table.driver, source="test")
    stage = driver.open(table, Context("test", Clock(bench.config.clock_speed())))
    try:
        yield stage
    finally:
        stage.close()


def move(stage: MotorStage, theta_i_deg: float, theta_mes_deg: float) -> tuple[float, float]:
    stage.theta_i.start(theta_i_deg)
    stage.theta_mes.start(theta_mes_deg)
    return stage.theta_i.wait(), stage.theta_mes.wait()


def test_read_backs_are_those_of_the_dedicated_driver(example_bench):
    """Both drivers on the same two motors, one after the other: the angles of one are those of the other."""
    table = example_bench.config.stage
    dedicated = find_driver("stage", "applied-motion", source="test").config.model_validate(
        {
            "driver": "applied-motion",
            "home_on_connect": False,
            **table.model_dump(include={"address", "framing", "word_order"}),
            **{name: getattr(table, name).model_dump(exclude={"registers"}) for name in AXES},
        }
    )
    for target in [(20.0, 15.0), (20.0, 18.0), (55.123, 141.0), (0.0, 15.3), (95.0, 180.0)]:
        with opened(example_bench) as stage:
            got = move(stage, *target)
        with opened(example_bench, dedicated) as stage:
            assert (stage.theta_i.position_deg(), stage.theta_mes.position_deg()) == got
            assert stage.verify_still(*got) == got
        assert got == pytest.approx(target, abs=0.5 / 5000.0)


def test_one_read_per_poll(example_bench):
    with opened(example_bench) as stage:
        move(stage, 20.0, 30.0)
        statistics = stage._line.line.statistics
        before = statistics.replies
        stage.theta_i._drive.state()
        assert statistics.replies == before + 1
        with pytest.raises(RefusedError, match="blind zone"):
            stage.theta_mes.start(14.0)
        assert statistics.replies == before + 1


def test_alarms_in_the_words_of_the_map(tmp_path):
    text = EXAMPLE.read_text(encoding="utf-8") + "\n[simulation.theta_mes]\nobstacle_deg = 60.0\n"
    with running_bench(tmp_path, text) as bench, opened(bench) as stage:
        with pytest.raises(
            MotionError, match=r"unit 2.*position error: the motor stalled.*alarm 0x0001.*remove what blocks"
        ):
            move(stage, 20.0, 40.0)
        assert "theta_mes homed" in stage.recover()
        assert move(stage, 20.0, 100.0)[1] == pytest.approx(100.0, abs=0.01)


def test_stop_in_the_middle_of_a_move(tmp_path):
    text = EXAMPLE.read_text(encoding="utf-8").replace("clock_speed = 4000.0", "clock_speed = 20.0")
    with running_bench(tmp_path, text) as bench, opened(bench) as stage:
        axis = stage.theta_i
        axis.start(90.0)
        while axis.position_deg() < 10.0:
            time.sleep(0.001)
        axis.stop()
        with pytest.raises(MotionError, match="was stopped on request"):
            axis.wait()
        assert 10.0 <= axis.position_deg() < 80.0


def test_a_wrong_word_order_is_not_an_arrival(tmp_path):
    """The read-back betrays it before a scan does."""
    with running_bench(tmp_path, EXAMPLE.read_text(encoding="utf-8")) as bench:
        wrong = bench.config.stage.model_copy(update={"word_order": "little"})
        with (
            pytest.raises(DeviceError, match=r"reads .* in the other word order|limit switch"),
            opened(bench, wrong) as stage,
        ):
            move(stage, 20.0, 30.0)


# -- drives of other makes -----------------------------------------------------------


class Played:
    """A motor behind a register layout; a move takes `polls` reads of its status."""

    def __init__(self) -> None:
        self.position = 0.0
        self.target = 0.0
        self.left = 0
        self.polls = 3
        self.alarm = 0
        self.stalls = False
        self.log: list[str] = []

    def start(self, target: float) -> None:
        self.log.append(f"start {target:g}")
        self.target, self.left = target, self.polls

    def stop(self) -> None:
        self.log.append("stop")
        self.target, self.left = self.position, 0

    def tick(self) -> None:
        if self.left:
            if self.stalls:
                self.stalls, self.left, self.alarm = False, 0, 0x30
                return
            self.position += (self.target - self.position) / self.left
            self.left -= 1


@contextlib.contextmanager
def served(devices: list[SimDevice], framer: FramerType) -> Iterator[str]:
    """Serve pymodbus' own slaves from a thread with a loop of its own."""
    ready, address = threading.Event(), []
    loop = asyncio.new_event_loop()

    async def begin() -> ModbusTcpServer:
        server = ModbusTcpServer(devices, framer=framer, address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        address.append(f"socket://127.0.0.1:{server.transport.sockets[0].getsockname()[1]}")
        ready.set()
        return server

    def run() -> None:
        server = loop.run_until_complete(begin())
        loop.run_forever()
        loop.run_until_complete(server.shutdown())
        loop.close()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert ready.wait(10)
    try:
        yield address[0]
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join(10)
    assert not thread.is_alive()


def words(number: float, form: str = ">i") -> list[int]:
    return list(struct.unpack(">HH", struct.pack(form, number)))


def pulsed(motor: Played, unit: int) -> SimDevice:
    """A drive like Oriental Motor's AZ: direct data from 0x58, input bits that act when they rise, an alarm
    number; every register that is not listed is refused.
    """
    inputs = [0]

    async def action(function, start, address, count, registers, values):
        def put(where: int, content: list[int]) -> None:
            registers[where - start : where - start + len(content)] = content

        if values is None:
            motor.tick()
            put(0x7F, [(1 << 13 if motor.left else 1 << 5) | (1 << 7 if motor.alarm else 0)])
            put(0x80, words(motor.alarm, ">I"))
            put(0xCC, words(round(motor.position)))
        elif function == 16 and address == 0x66 and values == [0, 1] and not motor.alarm:
            high, low = registers[0x5C - start], registers[0x5D - start]
            motor.start(struct.unpack(">i", struct.pack(">HH", high, low))[0])
        elif function == 6 and address == 0x7D:
            rising, inputs[0] = values[0] & ~inputs[0], values[0]
            if rising & 1 << 5:
                motor.stop()
            if rising & 1 << 4:
                motor.start(0)
            if rising & 1 << 7:
                motor.log.append("reset")
                motor.alarm = 0

    def block(address: int, count: int) -> SimData:
        return SimData(address, count=count, values=0, datatype=DataType.REGISTERS)

    return SimDevice(
        unit,
        simdata=[block(0x5A, 14), block(0x7D, 1), block(0x7F, 3), block(0xCC, 2)],
        action=action,
    )


PULSED = """
driver = "modbus-registers"
address = "ADDRESS"
[registers]
position = { address = 0xCC }
target = { address = 0x5C }
speed = { address = 0x5E }
acceleration = { address = 0x60 }
deceleration = { address = 0x62 }
moving = [{ address = 0x7F, mask = 0x2000 }]
fault = [{ address = 0x7F, mask = 0x0080 }]
initialise = [{ address = 0x5A, value = 1, type = "u32" }]
start = [{ address = 0x66, value = 1, type = "u32" }]
stop = [{ address = 0x7D, value = 0x20, then = 0 }]
home = [{ address = 0x7D, value = 0x10, then = 0, hold_s = 0.005 }]
clear_faults = [{ address = 0x7D, value = 0x80, then = 0 }]
start_latency_s = 0.02
[registers.alarm]
address = 0x80
type = "u32"
codes = { 0x30 = ["overload", "look for friction"] }
[theta_i]
device = 1
steps_per_deg = 1000.0
limits_deg = [0.0, 95.0]
[theta_mes]
device = 2
steps_per_deg = -1000.0
zero_deg = 180.0
limits_deg = [15.0, 180.0]
blind_zone_deg = 15.0
"""


def stage_config(text: str, address: str) -> RegisterStageConfig:
    from gonio.config import parse_toml

    table = parse_toml(text.replace("ADDRESS", address), source="test")
    return validate(RegisterStageConfig, table, source="test", prefix="stage")


@pytest.fixture
def played(context):
    motors = Played(), Played()
    with served([pulsed(motors[0], 1), pulsed(motors[1], 2)], FramerType.RTU) as address:
        stage = open_stage(stage_config(PULSED, address), context)
        yield stage, motors
        stage.close()


def test_bits_that_are_set_and_reset(played):
    stage, (one, other) = played
    assert one.log == ["reset", "start 0"], "homed on connecting, by one rising edge each"
    stage.theta_mes.start(30.0)
    assert stage.theta_mes.wait() == 30.0
    assert other.log[-1] == "start 150000"
    stage.theta_i.start(50.0)
    stage.theta_i.stop()
    with pytest.raises(MotionError, match="was stopped on request"):
        stage.theta_i.wait()
    assert one.log[-2:] == ["start 50000", "stop"]


def test_an_alarm_number_ends_the_move_and_is_reset_for_the_next(played):
    stage, (motor, _) = played
    motor.stalls = True
    stage.theta_i.start(50.0)
    with pytest.raises(MotionError, match=r"overload \(alarm 0x00000030\).*on its way to 50 deg; look for"):
        stage.theta_i.wait()
    assert motor.alarm
    assert "theta_i homed" in stage.recover()
    stage.theta_i.start(50.0)
    assert stage.theta_i.wait() == 50.0
    assert motor.log[-3:] == ["reset", "start 0", "start 50000"]


def test_scattered_registers_take_two_reads_with_the_position_last(played):
    stage, _ = played
    drive = stage.theta_i._drive
    assert [(read.address, read.count) for read in drive._reads] == [(0x7F, 3), (0xCC, 2)]


def test_a_drive_that_was_switched_off_has_forgotten_its_speed(played):
    stage, _ = played
    drive = stage.theta_i._drive
    assert not drive.reports_reference
    replies = drive._line.line.statistics.replies
    assert drive.confirm(0) is None
    assert drive._line.line.statistics.replies == replies + 1, "three settings side by side: one read"
    drive._line.write(1, 0x5E, [0, 7])
    assert "switched off" in drive.confirm(0)
    drive.resume()
    assert drive._line.read(1, 0x5E, 2) == [0, 20_000], "20 deg/s of 1000 steps"
    assert drive.confirm(0) is None
    assert not drive.state().referenced


def coils(motor: Played, unit: int) -> SimDevice:
    """An absolute encoder in float degrees among the input registers, discrete inputs for the status, coils
    for commands.
    """

    async def action(function, start, address, count, registers, values):
        if function == 2:
            motor.tick()
            registers[0] = (motor.left == 0) | (not motor.alarm) << 1
        elif function == 4:
            registers[0:2] = words(motor.position, ">f")[::-1]
        elif values is None:  # a write is read back for its confirmation
            return None
        elif function == 16:
            motor.target = struct.unpack(">f", struct.pack(">HH", *values[::-1]))[0]
        elif function == 5 and values[0]:
            if address == 16:
                motor.start(motor.target)
            elif address == 17:
                motor.stop()
        elif function == 6 and values[0] > 500:
            return ExcCodes.ILLEGAL_VALUE
        return None

    bits = [SimData(1, count=16, values=False, datatype=DataType.BITS)]
    inputs = [SimData(0, count=16, values=True, datatype=DataType.BITS)]
    holding = [SimData(0x10, count=4, values=0, datatype=DataType.REGISTERS)]
    position = [SimData(0x300, count=2, values=0, datatype=DataType.REGISTERS)]
    return SimDevice(unit, simdata=(bits, inputs, holding, position), action=action)


COILS = """
driver = "modbus-registers"
address = "ADDRESS"
framing = "tcp"
word_order = "little"
[registers]
position = { address = 0x300, type = "float32", function = 4, scale = 0.001 }
target = { address = 0x10, type = "float32", scale = 0.001 }
speed = { address = 0x12, type = "u16", scale = 0.01 }
in_position = [{ address = 0, function = 2, equals = 1 }]
enabled = [{ address = 1, function = 2, equals = 1 }]
start = [{ address = 16, value = 1, then = 0, write_function = 5 }]
stop = [{ address = 17, value = 1, then = 0, write_function = 5 }]
start_latency_s = 0.02
[theta_i]
device = 1
steps_per_deg = 1000.0
limits_deg = [0.0, 95.0]
[theta_mes]
device = 2
steps_per_deg = 1000.0
limits_deg = [15.0, 180.0]
"""


def test_coils_inputs_and_floats_over_tcp(context):
    motors = Played(), Played()
    motors[0].position, motors[1].position = 12.5, 90.25
    with served([coils(motors[0], 1), coils(motors[1], 2)], FramerType.SOCKET) as address:
        stage = open_stage(stage_config(COILS, address), context)
        assert motors[0].log == [], "an absolute encoder is not homed"
        assert stage.theta_i.position_deg() == 12.5
        stage.theta_i.start(30.125)
        assert stage.theta_i.wait() == 30.125
        assert motors[0].log == ["start 30.125"]
        stage.theta_mes.start(40.0)
        stage.theta_mes.stop()
        with pytest.raises(MotionError, match="was stopped on request"):
            stage.theta_mes.wait()
        motors[1].alarm = 1
        with pytest.raises(MotionError, match=r"the motor is disabled \(register 0x01 = 0x0000\)"):
            stage.theta_mes.start(50.0)
        with pytest.raises(MotionError, match="has no reference, and its register map has no command"):
            stage.theta_mes.home()
        stage.close()


def test_a_speed_that_the_drive_refuses(context):
    with served([coils(Played(), 1), coils(Played(), 2)], FramerType.SOCKET) as address:
        config = stage_config(COILS.replace("scale = 0.01 }", "scale = 0.1 }"), address)
        with pytest.raises(DeviceError, match=r"unit 1: refused the value \(Modbus exception 3\)"):
            open_stage(config, context)


def test_a_canary_that_the_drive_refuses_is_found_on_connecting(context):
    text = PULSED.replace("start_latency_s", "canary = { address = 0x300, count = 9 }\nstart_latency_s")
    with (
        served([pulsed(Played(), 1), pulsed(Played(), 2)], FramerType.RTU) as address,
        pytest.raises(DeviceError, match=r"refused the canary.*give another canary"),
    ):
        open_stage(stage_config(text, address), context)


def test_the_loopback_canary_against_another_slave(context):
    text = PULSED.replace("start_latency_s", 'canary = "loopback"\nstart_latency_s')
    with served([pulsed(Played(), 1), pulsed(Played(), 2)], FramerType.RTU) as address:
        stage = open_stage(stage_config(text, address), context)
        assert stage.theta_i.position_deg() == 0.0
        stage.close()

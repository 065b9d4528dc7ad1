"""Libraries that are not ours against the simulated instruments, over TCP and a pseudo-terminal."""

import sys

import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusTcpClient
from zaber_motion.ascii import Connection
from zaber_motion.exceptions import MovementFailedException

STEPS_PER_DEG = 4266.6666666666667


def test_zaber_motion_over_tcp(simulator) -> None:
    """The vendor's library; it looks up device types online, so the devices stay unidentified here."""
    with (
        simulator("--clock-speed", "2000") as sim,
        Connection.open_tcp("127.0.0.1", sim.port("stage")) as line,
    ):
        line.enable_alerts()
        theta_i, theta_mes = (d.get_axis(1) for d in line.detect_devices(identify_devices=False))
        assert theta_i.warnings.get_flags() == {"WR"}
        assert not theta_i.is_homed()
        theta_i.home()
        theta_mes.home()
        assert theta_i.is_homed()
        assert theta_i.warnings.get_flags() == set()
        theta_i.move_absolute(20_000)
        assert theta_i.get_position() == 20_000
        theta_i.move_relative(-500)
        assert theta_i.get_position() == 19_500
        assert theta_i.settings.get("resolution") == 64
        reply = line.generic_command("get system.serial", device=2)
        assert (reply.device_address, reply.data) == (2, "120002")

        with pytest.raises(MovementFailedException) as failure:
            theta_mes.move_absolute(round(180 * STEPS_PER_DEG))  # into the beam
        assert failure.value.details.warnings == ["FE"]
        assert 14.0 < 180 - theta_mes.get_position() / STEPS_PER_DEG < 15.0


@pytest.mark.parametrize(
    ("framing", "framer", "word_order"),
    [("rtu", FramerType.RTU, "big"), ("tcp", FramerType.SOCKET, "little")],
)
def test_pymodbus_over_tcp(simulator, rig_file, framing: str, framer: FramerType, word_order: str) -> None:
    rig = rig_file(stage="applied-motion", framing=framing, word_order=word_order)
    with simulator(str(rig), "--clock-speed", "5000") as sim:
        assert sim.protocol("stage") == f"modbus-{framing}"
        client = ModbusTcpClient("127.0.0.1", port=sim.port("stage"), framer=framer, timeout=2, retries=0)
        assert client.connect()
        try:
            int32 = client.DATATYPE.INT32

            def wait(unit: int) -> int:
                while True:
                    alarm, status = client.read_holding_registers(0, count=2, device_id=unit).registers
                    assert alarm == 0
                    if not status & 0x10:
                        return int(status)

            def position(unit: int) -> int:
                registers = client.read_holding_registers(6, count=2, device_id=unit).registers
                value = client.convert_from_registers(registers, int32, word_order=word_order)
                assert isinstance(value, int)
                return value

            for unit in (1, 2):
                client.write_register(0x7C, 0xDB, device_id=unit)
                wait(unit)
                client.write_registers(0x7D, [0, 0], device_id=unit)
                client.write_register(0x7C, 0xA5, device_id=unit)
                assert position(unit) == 0
            target = client.convert_to_registers(100_000, int32, word_order=word_order)
            assert not client.write_registers(0x1B, [600, 600, 240, *target], device_id=2).isError()
            client.write_register(0x7C, 0x67, device_id=2)
            assert wait(2) == 0b1001
            assert (position(1), position(2)) == (0, 100_000)
            refusal = client.read_holding_registers(0x100, count=1, device_id=1)
            assert refusal.exception_code == 2
        finally:
            client.close()


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")
def test_minimalmodbus_over_a_pty(simulator, rig_file) -> None:
    import minimalmodbus

    with simulator(str(rig_file(stage="applied-motion")), "--pty", "--clock-speed", "5000") as sim:
        drive = minimalmodbus.Instrument(sim.address("stage", pty=True), 1)
        drive.serial.baudrate = 115200
        drive.serial.timeout = 2.0
        try:
            drive.write_register(0x7C, 0xDB, functioncode=6)
            while drive.read_register(1) & 0x10:
                pass
            drive.write_registers(0x7D, [0, 0])
            drive.write_register(0x7C, 0xA5, functioncode=6)
            drive.write_long(0x1E, 50_000, signed=True)
            drive.write_register(0x7C, 0x67, functioncode=6)
            while drive.read_register(1) & 0x10:
                pass
            assert drive.read_long(6, signed=True) == 50_000
            with pytest.raises(minimalmodbus.IllegalRequestError):
                drive.read_register(0x100)
        finally:
            drive.serial.close()

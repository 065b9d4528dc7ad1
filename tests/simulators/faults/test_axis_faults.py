"""Each fault of a motor, as each controller tells of it, and where the arm then truly is."""

from __future__ import annotations

import struct

import pytest

from gonio_simulators.wire.modbus_frames import rtu_frame

SCALE = 4266.6666666666667
ALARM, STATUS, ENCODER, POSITION = 0, 1, 4, 6
OPCODE, TARGET = 0x7C, 0x1E
FP, FH, AX, SP = 0x67, 0xDB, 0xBA, 0xA5


def zaber(wire, command: str, device: int = 1) -> list[str]:
    """Status words and data of the reply."""
    return wire.ask(f"/{device} 1 01 {command}\n".encode()).decode().split()[3:]


def homed_zaber(f):
    wire = f.zaber()
    for device in (1, 2):
        zaber(wire, "home", device)
    f.advance(60.0)
    assert zaber(wire, "get pos") == ["OK", "IDLE", "--", "0"]
    return wire


def settle(f, duration_s: float = 30.0) -> None:
    f.advance(duration_s, steps=300)


def read(wire, address: int, count: int = 1, unit: int = 1) -> tuple[int, ...]:
    got = wire.ask(rtu_frame(unit, struct.pack(">BHH", 3, address, count)))
    return struct.unpack(f">{count}H", got[3:-2])


def s32(wire, address: int) -> int:
    return struct.unpack(">i", struct.pack(">HH", *read(wire, address, 2)))[0]


def write(wire, address: int, value: int) -> None:
    assert wire.ask(rtu_frame(1, struct.pack(">BHH", 6, address, value)))[1] == 6


def go(f, wire, steps: int) -> None:
    high, low = struct.unpack(">HH", struct.pack(">i", steps))
    write(wire, TARGET, high)
    write(wire, TARGET + 1, low)
    write(wire, OPCODE, FP)


def homed_drives(f):
    wire = f.drives()
    write(wire, OPCODE, FH)
    f.advance(60.0)
    write(wire, 0x7D, 0)
    write(wire, 0x7E, 0)
    write(wire, OPCODE, SP)
    assert s32(wire, POSITION) == 0
    return wire


# -- stall ----------------------------------------------------------------------------------------------


def test_stall_that_the_controller_sees(faulty) -> None:
    f = faulty("stall@theta_i:nth=2:part=0.5")  # the first move is the homing
    wire = homed_zaber(f)
    assert zaber(wire, "move abs 85333") == ["OK", "BUSY", "--", "0"]
    f.advance(0.2)
    assert zaber(wire, "get pos")[1:3] == ["BUSY", "--"]
    settle(f)
    status = zaber(wire, "get pos")
    assert status[:3] == ["OK", "IDLE", "FS"]
    assert int(status[3]) == pytest.approx(42667, abs=30)
    assert f.bench.theta_i.angle_deg() == pytest.approx(10.0, abs=0.06)  # the lost motion of a rise
    assert zaber(wire, "warnings")[2:] == ["FS", "01", "FS"]
    (injected,) = f.injected
    assert (injected.name, injected.target) == ("stall", "theta_i")
    assert injected.bench_s == pytest.approx(60.0 + 0.5 * 1.2, abs=1e-4)  # 20 deg at 20 deg/s, 100 deg/s2
    assert zaber(wire, "move abs 85333")[:2] == ["OK", "BUSY"]
    settle(f)
    assert zaber(wire, "get pos") == ["OK", "IDLE", "--", "85333"]


def test_silent_stall_is_seen_by_an_encoder_alone(faulty) -> None:
    f = faulty("stall@theta_i:nth=1:part=0.5:silent=true")  # a homing trusts no counter: no opportunity
    wire = homed_zaber(f)
    zaber(wire, "move abs 85333")
    settle(f)
    assert zaber(wire, "get pos") == ["OK", "IDLE", "--", "85333"]
    assert int(zaber(wire, "get encoder.pos")[3]) == pytest.approx(42667, abs=30)
    assert f.bench.theta_i.angle_deg() == pytest.approx(10.0, abs=0.06)
    zaber(wire, "move abs 42667")  # the counter keeps its wrong belief
    settle(f)
    assert zaber(wire, "get pos") == ["OK", "IDLE", "--", "42667"]
    assert f.bench.theta_i.angle_deg() == pytest.approx(0.0, abs=0.06)
    zaber(wire, "home")
    settle(f, 60.0)
    zaber(wire, "move abs 85333")
    settle(f)
    assert f.bench.theta_i.angle_deg() == pytest.approx(20.0, abs=0.06)
    assert zaber(wire, "get encoder.pos")[3] == "85333"


def test_silent_stall_of_an_axis_that_reads_its_encoder(faulty) -> None:
    f = faulty("stall@theta_i:nth=1:part=0.5:silent=true:readback=truth")
    wire = homed_zaber(f)
    zaber(wire, "move abs 85333")
    settle(f)
    status = zaber(wire, "get pos")
    assert status[:3] == ["OK", "IDLE", "--"]
    assert int(status[3]) == pytest.approx(42667, abs=30)


def test_a_new_command_while_the_counter_runs_on(faulty) -> None:
    f = faulty("stall@theta_i:nth=1:part=0.2:silent=true")
    wire = homed_zaber(f)
    zaber(wire, "move abs 85333")
    f.advance(0.9)
    zaber(wire, "stop")
    settle(f)
    claimed = int(zaber(wire, "get pos")[3])
    truth = int(zaber(wire, "get encoder.pos")[3])
    assert claimed > truth + 10_000
    assert f.bench.theta_i.angle_deg() == pytest.approx(truth / SCALE, abs=0.06)


def test_stall_on_a_drive_is_a_position_error(faulty) -> None:
    f = faulty("stall@theta_i:nth=2:part=0.5")
    wire = homed_drives(f)
    go(f, wire, 85333)
    settle(f)
    assert read(wire, ALARM) == (1,)
    assert read(wire, STATUS) == (1 << 2 | 1 << 9,)
    assert s32(wire, POSITION) == pytest.approx(42667, abs=30)


def test_silent_stall_on_a_drive(faulty) -> None:
    f = faulty("stall@theta_i:nth=1:part=0.5:silent=true")
    wire = homed_drives(f)
    go(f, wire, 85333)
    settle(f)
    assert read(wire, ALARM) == (0,)
    assert read(wire, STATUS) == (1 | 1 << 3,)
    assert (s32(wire, POSITION), s32(wire, ENCODER)) == (85333, pytest.approx(42667, abs=30))
    write(wire, OPCODE, FH)
    f.advance(60.0)
    assert s32(wire, POSITION) == pytest.approx(42666, abs=30)  # SP, not the switch, names the counter
    assert s32(wire, ENCODER) == 0


def test_stall_of_the_rotator(faulty) -> None:
    f = faulty("stall@polarizer:nth=1")
    wire = f.rotator()
    assert wire.ask(b"0ma00004600") == b""
    settle(f)
    assert wire.take() == b"0GS02\r\n"  # mechanical time-out


def test_the_rotator_cannot_claim(faulty) -> None:
    f = faulty("stall@polarizer:nth=1:silent=true:part=0.5")
    wire = f.rotator()
    assert wire.ask(b"0ma00004600") == b""
    settle(f)
    assert int(wire.take()[3:11], 16) == pytest.approx(0x2300, abs=30)
    assert wire.ask(b"0gs") == b"0GS00\r\n"


# -- alarm and limit ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cause", "flag"), [("over-temperature", "FD"), ("encoder", "FQ"), ("position-error", "FS")]
)
def test_alarm_of_a_zaber(faulty, cause: str, flag: str) -> None:
    f = faulty(f"alarm@theta_i:nth=2:cause={cause}:hold_s=20")
    wire = homed_zaber(f)
    zaber(wire, "move abs 85333")
    f.advance(2.0)
    status = zaber(wire, "get pos")
    assert status[:3] == ["OK", "IDLE", flag]
    assert 0 < int(status[3]) < 85333
    assert zaber(wire, "warnings clear")[2:] == [flag, "01", flag]
    assert zaber(wire, "get pos")[2] == flag  # the cause lasts
    if cause != "position-error":
        assert zaber(wire, "move abs 0")[:3] == ["RJ", "IDLE", flag]
    f.advance(20.0)
    zaber(wire, "warnings clear")
    assert zaber(wire, "get pos")[2] == "--"
    zaber(wire, "move abs 85333")
    settle(f)
    assert zaber(wire, "get pos") == ["OK", "IDLE", "--", "85333"]
    assert f.injected[0].details.startswith(f"cause={cause} ")


@pytest.mark.parametrize(("cause", "bit"), [("over-temperature", 3), ("position-error", 0), ("encoder", 0)])
def test_alarm_of_a_drive(faulty, cause: str, bit: int) -> None:
    f = faulty(f"alarm@theta_i:nth=2:cause={cause}:hold_s=20")
    wire = homed_drives(f)
    go(f, wire, 85333)
    f.advance(2.0)
    assert read(wire, ALARM) == (1 << bit,)
    assert read(wire, STATUS) == (1 << 2 | 1 << 9,)  # fault and alarm, no longer enabled
    where = s32(wire, POSITION)
    assert 0 < where < 85333
    write(wire, OPCODE, AX)
    assert read(wire, ALARM) == (1 << bit,)  # still hot
    f.advance(20.0)
    write(wire, OPCODE, AX)
    assert read(wire, ALARM) == (0,)
    assert read(wire, STATUS)[0] & 1 == 0  # the alarm is reset, the motor still released
    write(wire, OPCODE, 0x9F)
    go(f, wire, 85333)
    settle(f)
    assert s32(wire, POSITION) == 85333


@pytest.mark.parametrize(
    ("cause", "status"), [("over-temperature", b"08"), ("encoder", b"0A"), ("position-error", b"02")]
)
def test_alarm_of_the_rotator(faulty, cause: str, status: bytes) -> None:
    f = faulty(f"alarm@polarizer:nth=1:cause={cause}:hold_s=0")
    wire = f.rotator()
    assert wire.ask(b"0ma00004600") == b""
    settle(f)
    assert wire.take() == b"0GS" + status + b"\r\n"
    assert wire.ask(b"0ma00004600") == b""
    settle(f)
    assert wire.take() == b"0PO00004600\r\n"


def test_homing_that_an_alarm_ends_gives_no_reference(faulty) -> None:
    f = faulty("alarm@theta_i:nth=1")
    wire = f.zaber()
    zaber(wire, "home")
    settle(f)
    assert zaber(wire, "get pos")[1:3] == ["IDLE", "FD"]
    zaber(wire, "warnings clear")
    assert zaber(wire, "get pos")[2] == "WR"


@pytest.mark.parametrize(("target", "bit"), [(85333, 2), (-8533, 1)])
def test_limit_of_a_drive_is_that_of_its_direction(faulty, target: int, bit: int) -> None:
    f = faulty("limit@theta_i:nth=2:part=0.5")
    wire = homed_drives(f)
    go(f, wire, 8533)
    settle(f)
    go(f, wire, target if target > 0 else 0)
    settle(f)
    assert read(wire, ALARM) == (1 << bit,)


def test_limit_of_a_zaber(faulty) -> None:
    f = faulty("limit@stage:nth=1")
    wire = homed_zaber(f)
    zaber(wire, "move abs 85333", 1)
    zaber(wire, "move abs 85333", 2)
    settle(f)
    for device in (1, 2):
        words = zaber(wire, "warnings", device)
        assert words[1] == "IDLE"
        assert words[2] in ("FE", "WL")
        assert words[2] in words[4:]
        assert 0 < int(zaber(wire, "get pos", device)[3]) < 85333
    assert sorted(i.target for i in f.injected) == ["theta_i", "theta_mes"]


def test_a_move_that_is_stopped_before_has_no_fault(faulty) -> None:
    f = faulty("alarm@theta_i:nth=2:part=0.9")
    wire = homed_zaber(f)
    zaber(wire, "move abs 85333")
    f.advance(0.3)
    zaber(wire, "stop")
    settle(f)
    assert zaber(wire, "warnings")[2] == "NI"
    assert f.injected == []


# -- hands ----------------------------------------------------------------------------------------------


def test_knob_while_moving(faulty) -> None:
    f = faulty("knob@theta_i:nth=1:moving=true:part=0.5:turn_s=0.5:size_deg=2")
    wire = homed_zaber(f)
    zaber(wire, "move abs 85333")
    f.advance(0.6 + 0.2)
    assert zaber(wire, "get pos")[:3] == ["OK", "BUSY", "NC"]
    assert zaber(wire, "warnings")[3:] == ["02", "NC", "NI"]
    settle(f)
    status = zaber(wire, "get pos")
    assert status[:3] == ["OK", "IDLE", "NI"]
    assert abs(int(status[3]) - 42667) == pytest.approx(8533, abs=30)
    assert f.bench.theta_i.angle_deg() == pytest.approx(int(status[3]) / SCALE, abs=0.06)


def test_knob_while_idle(faulty) -> None:
    f = faulty("knob@theta_i:nth=1:idle_s=1:turn_s=0.5:size_deg=2")
    wire = homed_zaber(f)
    zaber(wire, "move abs 85333")
    f.advance(1.2, steps=120)
    assert zaber(wire, "get pos") == ["OK", "IDLE", "--", "85333"]
    seen = set()
    for _ in range(200):
        f.advance(0.01)
        seen.add(tuple(zaber(wire, "get pos")[1:3]))
    assert seen == {("IDLE", "--"), ("BUSY", "NC")}
    assert abs(int(zaber(wire, "get pos")[3]) - 85333) == pytest.approx(8533, abs=2)
    assert "while=idle" in f.injected[0].details


def test_knob_at_a_time(faulty) -> None:
    f = faulty("knob@theta_i:at=100:size_deg=2")
    wire = homed_zaber(f)
    f.advance(39.9)
    assert zaber(wire, "get pos")[3] == "0"
    f.advance(0.2)
    assert zaber(wire, "get pos")[1:3] == ["BUSY", "NC"]
    f.advance(1.0)
    assert abs(int(zaber(wire, "get pos")[3])) in (8533, pytest.approx(6826, abs=2700))  # or at the switch
    assert f.injected[0].bench_s == pytest.approx(100.1)


def test_push(faulty) -> None:
    f = faulty("knob@theta_i:at=70:by=push:size_deg=0.5")
    wire = homed_zaber(f)
    zaber(wire, "move abs 85333")
    f.advance(20.0, steps=20)
    status = zaber(wire, "get pos")
    assert status[:3] == ["OK", "IDLE", "WM"]
    assert abs(int(status[3]) - 85333) == 2133
    zaber(wire, "warnings clear")
    assert zaber(wire, "get pos")[2] == "--"


def test_jog_input_of_a_drive(faulty) -> None:
    f = faulty("knob@theta_i:at=70:turn_s=0.5:size_deg=2")
    wire = homed_drives(f)
    go(f, wire, 85333)
    f.advance(10.2, steps=102)
    assert read(wire, STATUS)[0] & (1 << 5 | 1 << 4) == 1 << 5 | 1 << 4  # jogging, moving
    f.advance(5.0)
    assert read(wire, STATUS)[0] & 1 << 5 == 0
    assert abs(s32(wire, POSITION) - 85333) == pytest.approx(8533, abs=2)


def test_the_rotator_is_turned_by_hand(faulty) -> None:
    f = faulty("knob@polarizer:at=5:size_deg=10")
    wire = f.rotator()
    wire.ask(b"0ma00004600")
    f.advance(4.0)
    assert wire.take() == b"0PO00004600\r\n"
    f.advance(4.0, steps=40)
    position = int(wire.ask(b"0gp")[3:11], 16)
    assert abs(position - 0x4600) == pytest.approx(3982, abs=1)

"""What each device forgets when its power fails, and what it does not."""

from __future__ import annotations

import pytest

from tests.simulators.faults.test_axis_faults import (
    ALARM,
    POSITION,
    go,
    homed_drives,
    homed_zaber,
    read,
    s32,
    settle,
    write,
    zaber,
)


def test_zaber(faulty) -> None:
    f = faulty("power-cycle@stage:at=100:boot_s=0.5")
    wire = homed_zaber(f)
    zaber(wire, "set maxspeed 12345")
    zaber(wire, "move abs 85333")
    settle(f)
    wire.send(b"/1 1 09 move abs 4")  # half a command
    f.advance(20.0)
    assert wire.ask(b"/1 1 10 get pos\n") == b""
    f.timers.pass_(0.6)
    assert wire.ask(b"/1 1 11 get pos\n") == b"@01 1 11 OK IDLE WR 0\r\n"
    assert f.bench.theta_i.angle_deg() == pytest.approx(20.0, abs=0.06)  # nobody moved it
    assert zaber(wire, "get maxspeed")[3] == "12345"  # settings are in the device's memory
    assert f.bench.theta_mes.referenced is False
    assert [(i.name, i.target) for i in f.injected] == [("power-cycle", "stage")]


def test_zaber_in_mid_move(faulty) -> None:
    f = faulty("power-cycle@stage:at=60.6")
    wire = homed_zaber(f)
    zaber(wire, "move abs 85333")
    f.advance(0.6)
    f.advance(10.0)
    f.timers.pass_(1.0)
    assert zaber(wire, "get pos") == ["OK", "IDLE", "WR", "0"]
    assert f.bench.theta_i.angle_deg() == pytest.approx(10.0, abs=0.06)


def test_drives(faulty) -> None:
    f = faulty("power-cycle@stage:at=100")
    wire = homed_drives(f)
    profile = read(wire, 0x1B, 3)
    write(wire, 0x1B, 601)
    assert read(wire, 0x1B, 3) != profile
    go(f, wire, 85333)
    settle(f)
    f.advance(20.0)
    f.timers.pass_(1.0)
    assert s32(wire, POSITION) == 0
    assert read(wire, ALARM) == (0,)
    assert read(wire, 0x1B, 3) == profile


def test_rotator(faulty) -> None:
    f = faulty("power-cycle@polarizer:nth=5")
    wire = f.rotator()
    assert wire.ask(b"0sj00001000") == b"0GS00\r\n"
    assert wire.ask(b"0us") == b"0GS00\r\n"
    assert wire.ask(b"0sj00002000") == b"0GS00\r\n"
    assert wire.ask(b"0ma00004600") == b""
    f.advance(5.0)
    assert wire.take() == b"0PO00004600\r\n"
    assert wire.ask(b"0gp") == b""  # the fifth request meets a device that restarts
    f.timers.pass_(1.0)
    assert wire.ask(b"0gp") == b"0PO00000000\r\n"
    assert wire.ask(b"0gj") == b"0GJ00001000\r\n"  # what was saved
    assert wire.ask(b"0gs") == b"0GS00\r\n"


def test_an_owed_answer_is_forgotten(faulty) -> None:
    f = faulty("power-cycle@polarizer:at=0.1")
    wire = f.rotator()
    assert wire.ask(b"0ma00004600") == b""
    f.advance(0.2)
    f.advance(5.0)
    f.timers.pass_(1.0)
    assert wire.take() == b""


def test_monochromator(faulty) -> None:
    f = faulty("power-cycle@monochromator:at=50")
    wire = f.monochromator()
    for statement in (b"HANDSHAKE 1\n", b"UNITS UM\n", b"SHUTTER O\n", b"GOWAVE 0.65\n", b"NONSENSE\n"):
        wire.ask(statement)
        f.advance(5.0)
        wire.take()
    f.advance(25.0)
    f.timers.pass_(1.0)
    assert not f.bench.monochromator.state_at(f.clock.now_s()).shutter_open
    f.advance(30.0)
    assert wire.ask(b"HANDSHAKE?\n") == b"HANDSHAKE?\n0\r\n"
    assert wire.ask(b"ERROR?\n") == b"ERROR?\n0\r\n"
    assert wire.ask(b"WAVE?\n") == b"WAVE?\n500.000\r\n"
    assert wire.ask(b"SHUTTER?\n") == b"SHUTTER?\nC\r\n"


@pytest.mark.parametrize(("memory", "range_"), [("kept", b"20\r"), ("lost", b"26\r")])
def test_lockin(faulty, memory: str, range_: bytes) -> None:
    f = faulty(f"power-cycle@lockin:at=5:memory={memory}")
    wire = f.lockin()
    wire.ask(b"SENS 20;*CLS;*ESE 32\r")
    f.advance(5.0)
    assert wire.ask(b"SENS?\r") == b""
    f.timers.pass_(1.0)
    assert wire.ask(b"*ESR?\r") == b"128\r"  # power on
    assert wire.ask(b"*ESE?\r") == b"0\r"
    assert wire.ask(b"SENS?\r") == range_


def test_all_at_once(faulty) -> None:
    f = faulty("power-cycle:at=1")
    wires = [f.zaber(), f.rotator(), f.monochromator(), f.lockin()]
    f.advance(2.0)
    questions = (b"/1 1 01\n", b"0gs", b"STB?\n", b"SENS?\r")
    assert [w.ask(q) for w, q in zip(wires, questions, strict=True)] == [b""] * 4
    f.timers.pass_(1.0)
    f.advance(30.0)
    assert all(w.ask(q) for w, q in zip(wires, questions, strict=True))
    assert f.names == ["power-cycle"] * 4

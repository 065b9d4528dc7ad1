"""Other people's clients at the stages: zaber.serial (the vendor's old library) and mbpoll."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.simulators.wire.conftest import Simulator, rig_text, running

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")
MBPOLL = shutil.which("mbpoll")
needs_mbpoll = pytest.mark.skipif(
    MBPOLL is None, reason="mbpoll is not installed (Debian: apt-get install mbpoll)"
)


@needs_pty
def test_zaber_serial() -> None:
    from zaber.serial import AsciiCommand, AsciiDevice, AsciiSerial

    with (
        running("--clock-speed", "2000", "--pty") as sim,
        AsciiSerial(sim.address("stage", pty=True), timeout=5) as port,
    ):
        port.write(AsciiCommand(0, 0, 11, ""))
        replies = [port.read(), port.read()]
        assert [(r.device_address, r.message_id, r.warning_flag) for r in replies] == [
            (1, 11, "WR"),
            (2, 11, "WR"),
        ]
        first, second = AsciiDevice(port, 1), AsciiDevice(port, 2)
        for device in (first, second):
            reply = device.home()
            assert reply.reply_flag == "OK"
            assert device.get_position() == 0
        first.move_abs(20_000)
        assert first.get_position() == 20_000
        first.move_rel(-500)
        assert first.get_position() == 19_500
        axis = first.axis(1)
        axis.move_vel(50)  # the bench's seconds are fast
        assert axis.get_status() == "BUSY"
        axis.stop()
        assert axis.get_status() == "IDLE"
        refusal = second.send("move abs -1")
        assert (refusal.reply_flag, refusal.data) == ("RJ", "BADDATA")
        assert second.send("1 get resolution").data == "64"
        refusal = first.lockstep().send("info")
        assert (refusal.reply_flag, refusal.data) == ("RJ", "BADCOMMAND")
        reply = first.send("get deviceid")
        assert reply.data.isdigit()


def mbpoll(*options: str) -> tuple[int, str]:
    """Run mbpoll once with zero-based addresses; return its exit status and what it says."""
    assert MBPOLL is not None
    done = subprocess.run(
        [MBPOLL, "-0", "-1", "-q", *options], capture_output=True, text=True, timeout=30, check=False
    )
    return done.returncode, done.stdout + done.stderr


def values(output: str) -> dict[int, int]:
    return {int(a): int(v, 0) for a, v in re.findall(r"^\[(\d+)\]:\s+(\S+)", output, re.MULTILINE)}


@pytest.fixture(scope="module", params=["rtu", "tcp"])
def drives(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Simulator]:
    if request.param == "rtu" and sys.platform == "win32":
        pytest.skip("this system has no pseudo-terminals")
    rig: Path = tmp_path_factory.mktemp("rig") / "rig.toml"
    rig.write_text(rig_text(stage="applied-motion", framing=request.param), encoding="utf-8")
    with running(str(rig), "--clock-speed", "2000", *(["--pty"] if request.param == "rtu" else [])) as sim:
        yield sim


@needs_mbpoll
def test_mbpoll(drives: Simulator) -> None:
    if drives.protocol("stage") == "modbus-rtu":
        line = ["-m", "rtu", "-b", "9600", "-P", "none"]
        where = [drives.address("stage", pty=True)]
    else:
        line = ["-m", "tcp", "-p", str(drives.port("stage"))]
        where = ["127.0.0.1"]

    def ask(*options: str, value: int | None = None) -> tuple[int, str]:
        """Read, or write a value (which ``--`` keeps from being taken for an option)."""
        return mbpoll(*line, *options, *where, *([] if value is None else ["--", str(value)]))

    for unit in ("1", "2"):
        status, said = ask("-a", unit, "-t", "4", "-r", "0", "-c", "8")
        assert (status, values(said)[1]) == (0, 0b1001)  # enabled, in position
        assert ask("-a", unit, "-t", "4", "-r", "124", value=0xDB)[0] == 0  # find home
        while values(ask("-a", unit, "-t", "4", "-r", "1", "-c", "1")[1])[1] & 0x10:
            pass
        assert ask("-a", unit, "-t", "4:int", "-B", "-r", "125", value=0)[0] == 0
        assert ask("-a", unit, "-t", "4", "-r", "124", value=0xA5)[0] == 0  # call it zero
    assert ask("-a", "1", "-t", "4:int", "-B", "-r", "30", value=50_000)[0] == 0
    assert ask("-a", "1", "-t", "4", "-r", "124", value=0x67)[0] == 0  # go
    while values(ask("-a", "1", "-t", "4", "-r", "1", "-c", "1")[1])[1] & 0x10:
        pass
    assert values(ask("-a", "1", "-t", "4:int", "-B", "-r", "6", "-c", "1")[1]) == {6: 50_000}
    assert values(ask("-a", "2", "-t", "3:int", "-B", "-r", "6", "-c", "1")[1]) == {
        6: 0
    }  # as input registers

    status, said = ask("-a", "1", "-t", "4", "-r", "256", "-c", "1")
    assert (status, "Illegal data address" in said) == (1, True)
    status, said = ask("-a", "1", "-t", "0", "-r", "0", "-c", "1")
    assert (status, "Illegal function" in said) == (1, True)
    status, said = ask("-a", "3", "-o", "0.1", "-t", "4", "-r", "0", "-c", "1")  # nobody has this number
    assert (status, "timed out" in said) == (1, True)

"""What the drivers write into a wire log: sessions, files with a torn end, bytes and notes."""

from __future__ import annotations

from pathlib import Path

import pytest

from gonio.clock import Clock
from gonio.wirelog import GAVE_UP, LOST, read_log
from gonio_drivers.lines import Line, NoReply
from gonio_drivers.wirelog import WireLog


class DeadPort:
    """Takes everything and says nothing, until it breaks."""

    def __init__(self) -> None:
        self.broken = False

    def write(self, data: bytes) -> None:
        if self.broken:
            raise ConnectionResetError("unplugged")

    def read(self, timeout_s: float) -> bytes:
        return b""

    def close(self) -> None:
        pass


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "wire.log"


def opened(path: Path, clock: Clock, *roles: str) -> list[WireLog]:
    return [WireLog(path, role, f"/dev/{role}", clock, protocol="raw") for role in roles]


def test_lines_of_a_rig_share_a_session_and_the_next_rig_begins_another(path):
    for _ in range(2):
        for log in opened(path, Clock(), "stage", "lockin"):
            log.sent(b"\x00\xff\\\n ")
            log.close()
            log.sent(b"after the end")
    log = read_log(path)
    assert [list(session.lines) for session in log.sessions] == [["stage", "lockin"]] * 2
    assert log.sessions[0].start.endswith("+00:00")
    for session in log.sessions:
        for role, line in session.lines.items():
            assert (line.protocol, line.opening.address) == ("raw", f"/dev/{role}")
            assert [r.data for r in line.records[1:]] == [b"\x00\xff\\\n "]


def test_times_are_real_seconds(path):
    (log,) = opened(path, Clock(speed=1e6), "stage")
    log.note("two\nlines")
    log.close()
    line = read_log(path).sessions[0].lines["stage"]
    assert line.opening.clock_speed == 1e6
    assert line.records[1].time_s < 60.0
    assert line.records[1].text == "two lines"


@pytest.mark.parametrize(
    "torn", ["1.000000 stage > 2f31", "1.000000 stage > 2f31  /1", "1.00", "1 stage = wire-log 1: zab"]
)
def test_a_torn_end_does_not_swallow_the_next_session(path, torn):
    (log,) = opened(path, Clock(), "stage")
    log.sent(b"whole")
    log.close()
    with path.open("ab") as file:
        file.write(torn.encode())  # killed here
    for log in opened(path, Clock(), "stage", "lockin"):
        log.close()
    log = read_log(path)
    assert [list(session.lines) for session in log.sessions] == [["stage"], ["stage", "lockin"]]
    assert len(log.warnings) == 1
    assert "line 3: left out" in log.warnings[0]


def test_giving_up_and_a_lost_connection_are_in_the_log(path):
    (log,) = opened(path, Clock(), "stage")
    port = DeadPort()
    line = Line(port, "stage", "/dev/stage", log)
    with line.transaction():
        line.send(b"?")
        with pytest.raises(NoReply):
            line.read_until(b"\n", line.deadline_s(0.0))
    port.broken = True
    with pytest.raises(Exception, match="unplugged"), line.transaction():
        line.send(b"?")
    line.close()
    notes = [r.text for r in read_log(path).sessions[0].lines["stage"].records if r.direction == "="]
    assert notes[1].startswith(GAVE_UP)
    assert notes[2].startswith(LOST)
    assert "1 timeouts" in notes[3]

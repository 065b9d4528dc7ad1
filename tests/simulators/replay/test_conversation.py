"""When recorded bytes go out; the clock is the test's."""

from __future__ import annotations

import pytest

from gonio_simulators.replay import conversation


class Time:
    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def time(monkeypatch) -> Time:
    clock = Time()
    monkeypatch.setattr(conversation, "time", clock)
    return clock


def heard(talk, time: Time) -> list[tuple[float, bytes]]:
    """Keep the conversation's appointments; return what came when, seconds from now."""
    begin_s = time.now_s
    got = []
    while talk.wait_s is not None:
        time.now_s += talk.wait_s
        if data := talk.poll():
            got.append((round(time.now_s - begin_s, 6), data))
    return got


MOVE = r"""
polarizer = wire-log 1: elliptec
polarizer > 0ma00008C00
polarizer < 0GS09\r\n
polarizer < 0PO0000
polarizer < 8C00\r\n
"""


@pytest.mark.parametrize("speed", [1.0, 10.0])
def test_each_chunk_comes_as_late_as_recorded(replayed_line, time, speed):
    line, _ = replayed_line(MOVE, speed=speed)
    talk = line.open()
    assert talk.feed(b"0ma00008C00") == b""
    assert heard(talk, time) == [
        (pytest.approx(0.01 / speed), b"0GS09\r\n"),
        (pytest.approx(0.02 / speed), b"0PO0000"),
        (pytest.approx(0.03 / speed), b"8C00\r\n"),
    ]


def test_what_came_too_late_is_not_hurried(replayed_line, time):
    line, _ = replayed_line(
        r"""
        stage = wire-log 1: zaber
        stage > /1 1 get pos\n
        stage < @01
        stage = gave up: no complete reply within 2 s
        stage < 1 OK IDLE -- 1\r\n
        """,
        speed=1000.0,
    )
    talk = line.open()
    # the first bytes are due within less than a timer is worth
    assert talk.feed(b"/1 1 get pos\n") == b"@01"
    assert heard(talk, time) == [(0.03, b"1 OK IDLE -- 1\r\n")]


def test_bytes_that_were_found_later_come_right_behind_the_reply(replayed_line, time):
    """Nobody listened after the reply; the log says when they were found, not when they came."""
    line, _ = replayed_line(
        r"""
        stage = wire-log 1: zaber
        stage > /1 1 get pos\n
        stage < @01 1 OK IDLE -- 1\r\n
        stage = this takes a while
        stage < @01 1 OK IDLE -- 1\r\n
        stage = threw away b'@01 1 OK IDLE -- 1\r\n'
        """
    )
    talk = line.open()
    talk.feed(b"/1 1 get pos\n")
    assert heard(talk, time) == [(0.01, b"@01 1 OK IDLE -- 1\r\n")] * 2


def test_replies_keep_the_order_of_their_requests(replayed_line, time):
    line, _ = replayed_line(
        r"""
        mono = wire-log 1: cs260
        mono > A?\r\n
        mono = slow
        mono = slow
        mono < A?\r\n1\r\n
        mono > B?\r\n
        mono < B?\r\n2\r\n
        """
    )
    talk = line.open()
    talk.feed(b"A?\r\nB?\r\n")
    assert heard(talk, time) == [(0.03, b"A?\r\n1\r\n"), (0.03, b"B?\r\n2\r\n")]


def test_a_device_that_speaks_first_does_so_once(replayed_line, time):
    line, _ = replayed_line(
        "stage = wire-log 1: zaber\nstage < noise\\r\\n\nstage > /1\\n\nstage < @01 0 OK\\r\\n"
    )
    assert heard(line.open(), time) == [(0.01, b"noise\r\n")]
    assert heard(line.open(), time) == []


def test_a_lost_connection_is_lost_again(replayed_line, time):
    line, _ = replayed_line(
        "stage = wire-log 1: zaber\nstage > /1\\n\nstage < @01 0\nstage = connection lost (reset)\n"
        "stage = connection opened anew\nstage > /1\\n\nstage < @01 0 OK IDLE -- 0\\r\\n"
    )
    hung_up: list[float] = []
    line.hang_up = lambda: hung_up.append(time.now_s)
    talk = line.open()
    talk.feed(b"/1\n")
    assert heard(talk, time) == [(0.01, b"@01 0")]
    assert hung_up == [pytest.approx(100.01)]
    again = line.open()
    again.feed(b"/1\n")
    assert heard(again, time) == [(0.01, b"@01 0 OK IDLE -- 0\r\n")]
    assert len(hung_up) == 1


def test_unexpected_requests_get_silence(replayed_line, time):
    line, unexpected = replayed_line(MOVE)
    talk = line.open()
    assert talk.feed(b"0ma00000000") == b""
    assert heard(talk, time) == []
    assert "'0ma00008C00' (line 2)" in unexpected[0]

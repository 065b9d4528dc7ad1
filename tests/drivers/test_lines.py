"""A reply is complete or an error, and never taken for the answer to another request."""

from __future__ import annotations

import itertools

import pytest

from gonio.errors import ConnectionFailed, ReplyError
from gonio_drivers.lines import Line, NoReply, connecting

from .conftest import SILENCE, ScriptedPort


def ask(line: Line, request: bytes, terminator: bytes = b"\r\n") -> bytes:
    with line.transaction():
        line.send(request)
        reply = line.read_until(terminator, line.deadline_s())
        line.answered()
        return reply


def test_split_anywhere_the_reply_is_the_same(scripted):
    whole = b"12.5\r\n"
    for cuts in itertools.chain.from_iterable(
        itertools.combinations(range(1, len(whole)), k) for k in range(5)
    ):
        ends = (0, *cuts, len(whole))
        line = scripted((b"?", [whole[a:b] for a, b in itertools.pairwise(ends)]))
        assert ask(line, b"?") == b"12.5"


def test_two_lines_in_one_read_are_two_replies(scripted):
    line = scripted((b"?", b"1\r\n2\r\n"))
    with line.transaction():
        line.send(b"?")
        assert [line.read_until(b"\r\n", line.deadline_s()) for _ in range(2)] == [b"1", b"2"]


def test_silence_is_an_error_that_names_device_and_deadline(scripted):
    line = scripted((b"?", []))
    with pytest.raises(NoReply, match=r"stage at scripted: gave no complete reply within 2 s; .*power"):
        ask(line, b"?")
    assert line.statistics.timeouts == 1


def test_half_a_reply_is_shown(scripted):
    line = scripted((b"?", b"12."))
    with pytest.raises(NoReply, match=r"only b'12\.' came"):
        ask(line, b"?")


def test_a_late_reply_is_thrown_away_before_the_next_request(scripted):
    line = scripted((b"a?", [SILENCE, b"late\r\n"]), (b"b?", b"right\r\n"))
    with pytest.raises(NoReply):
        ask(line, b"a?")
    assert ask(line, b"b?") == b"right"
    assert line.statistics.stale_bytes == len(b"late\r\n")


def test_bytes_nobody_asked_for_are_thrown_away(scripted):
    line = scripted((b"a?", b"1\r\nunasked\r\n"), (b"b?", b"2\r\n"))
    assert ask(line, b"a?") == b"1"
    assert ask(line, b"b?") == b"2"


def test_after_a_failure_the_proof_runs_once_before_the_next_request(scripted):
    line = scripted((b"a?", []), (b"canary", b"tweet\r\n"), (b"b?", b"2\r\n"), (b"c?", b"3\r\n"))

    def prove() -> None:
        line.send(b"canary")
        assert line.read_until(b"\r\n", line.deadline_s()) == b"tweet"

    replies = []
    for request in (b"a?", b"b?", b"c?"):
        try:
            with line.transaction(prove):
                line.send(request)
                replies.append(line.read_until(b"\r\n", line.deadline_s()))
        except NoReply:
            replies.append(None)
    assert replies == [None, b"2", b"3"]


def test_a_failed_proof_keeps_the_line_in_doubt(scripted):
    line = scripted(
        (b"a?", []),
        (b"canary", b"late\r\n"),
        (b"canary", b"later\r\n"),  # asked once more at once: one reply may have been held up
        (b"canary", b"tweet\r\n"),
        (b"b?", b"2\r\n"),
    )

    def prove() -> None:
        line.send(b"canary")
        reply = line.read_until(b"\r\n", line.deadline_s())
        if reply != b"tweet":
            raise line.damaged(reply, "not a tweet")

    with pytest.raises(NoReply):
        ask(line, b"a?")
    with pytest.raises(ReplyError, match="not a tweet"), line.transaction(prove):
        pytest.fail("the body of a transaction must not run while the line is in doubt")
    with line.transaction(prove):
        line.send(b"b?")
        assert line.read_until(b"\r\n", line.deadline_s()) == b"2"


def test_endless_noise_is_an_error(scripted):
    line = scripted((b"?", [b"\xff" * 1000] * 6))
    with pytest.raises(ReplyError, match="without an end of line"):
        ask(line, b"?")


def test_a_query_is_repeated_once_and_counted(scripted):
    line = scripted((b"?", []), (b"?", b"5\r\n"))
    assert line.query(lambda: ask(line, b"?")) == b"5"
    assert line.statistics.retries == 1
    line = scripted((b"?", []), (b"?", []))
    with pytest.raises(NoReply):
        line.query(lambda: ask(line, b"?"))


def test_reply_times_are_counted(scripted):
    line = scripted(*[(b"?", b"5\r\n")] * 3)
    for _ in range(3):
        ask(line, b"?")
    s = line.statistics
    assert s.replies == 3
    assert 0 <= s.mean_s <= s.longest_s <= s.total_s


class _DeadPort(ScriptedPort):
    def read(self, timeout_s: float) -> bytes:
        raise OSError(5, "Input/output error")


def test_a_lost_connection_names_the_device():
    line = Line(_DeadPort(), "lockin", "/dev/ttyUSB7")
    with pytest.raises(
        ConnectionFailed, match=r"lockin at /dev/ttyUSB7: the connection was lost .*then repeat"
    ):
        ask(line, b"?")


def test_silence_at_first_contact_is_a_failed_connection(scripted):
    line = scripted((b"?", []))
    with (
        pytest.raises(ConnectionFailed, match=r"stage at scripted: gave no .* check that the right device"),
        connecting(line),
    ):
        ask(line, b"?")
    assert line.port.closed


def test_an_interrupt_between_request_and_reply_leaves_no_reply_for_the_next(scripted):
    line = scripted((b"a?", [SILENCE, b"1\r\n"]), (b"b?", b"2\r\n"))
    with pytest.raises(KeyboardInterrupt):
        _interrupted(line)
    assert ask(line, b"b?") == b"2"


def _interrupted(line: Line) -> None:
    with line.transaction():
        line.send(b"a?")
        raise KeyboardInterrupt


def test_close_twice(scripted):
    line = scripted()
    line.close()
    line.close()
    assert line.port.closed

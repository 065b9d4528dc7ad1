"""Each fault of a line, byte by byte."""

from __future__ import annotations

import pytest

from gonio_simulators.faults.damage import lines, shown

POLL = b"/1 1 %02d\n"


def poll(number: int) -> bytes:
    return POLL % number


def reply(number: int) -> bytes:
    return b"@01 1 %02d OK IDLE WR 0\r\n" % number


def test_slow_reply(faulty) -> None:
    f = faulty("slow-reply@stage:nth=1:delay_s=0.3")
    wire = f.zaber()
    assert wire.ask(poll(1)) == b""
    f.timers.pass_(0.29)
    assert wire.ask(poll(2)) == b""  # the line keeps its order
    f.timers.pass_(0.02)
    assert wire.take() == reply(1) + reply(2)
    assert wire.ask(poll(3)) == reply(3)
    assert f.names == ["slow-reply"]


def test_dropped_reply_still_takes_effect(faulty) -> None:
    f = faulty("dropped-reply@lockin:nth=1")
    wire = f.lockin()
    assert wire.ask(b"SENS 20;SENS?\r") == b""
    assert wire.ask(b"SENS?\r") == b"20\r"


def test_late_reply_answers_the_previous_request(faulty) -> None:
    f = faulty("late-reply@stage:nth=2")
    wire = f.zaber()
    assert wire.ask(poll(1)) == reply(1)
    assert wire.ask(poll(2)) == b""
    f.timers.pass_(100.0)
    assert wire.take() == b""
    wire.send(poll(3))
    assert wire.chunks == [reply(2) + reply(3)]  # one write: no client can read one without the other


def test_late_reply_waits_for_a_later_request(faulty) -> None:
    f = faulty("late-reply@stage:nth=1")
    wire = f.zaber()
    assert wire.ask(b"/0 1 01\n") == b"@02 1 01 OK IDLE WR 0\r\n"  # the other device's reply to the same
    assert wire.ask(poll(2)) == reply(1) + reply(2)


def test_late_reply_after_a_time(faulty) -> None:
    f = faulty("late-reply@stage:nth=1:delay_s=2.5")
    wire = f.zaber()
    assert wire.ask(poll(1)) == b""
    f.timers.pass_(2.6)
    assert wire.take() == reply(1)
    assert wire.ask(poll(2)) == reply(2)


def test_dropped_request_has_no_effect(faulty) -> None:
    f = faulty("dropped-request@lockin:nth=1")
    wire = f.lockin()
    assert wire.ask(b"SENS 20\rSENS?\r") == b"26\r"
    assert f.injected[0].details == "request=b'SENS 20\\r'"


@pytest.mark.parametrize(("buffers", "value"), [("false", b"26\r"), ("true", b"20\r")])
def test_hang(faulty, buffers: str, value: bytes) -> None:
    f = faulty(f"hang@lockin:nth=1:hang_s=3:buffers={buffers}")
    wire = f.lockin()
    assert wire.ask(b"SENS 20\rSENS?\r") == b""
    f.timers.pass_(2.9)
    assert wire.ask(b"OFLT?\r") == b""
    f.timers.pass_(0.2)
    late = wire.take()
    assert late == (b"20\r8\r" if buffers == "true" else b"")
    assert wire.ask(b"SENS?\r") == value


@pytest.mark.parametrize(
    ("place", "cut"),
    [("before", lambda b: b[8:]), ("after", lambda b: b[:-8]), ("within", lambda b: b[:0])],
)
def test_garbage(faulty, place: str, cut) -> None:
    f = faulty(f"garbage@stage:nth=1:place={place}")
    wire = f.zaber()
    got = wire.ask(poll(1))
    assert len(got) == len(reply(1)) + 8
    if place == "within":
        assert got[:1] == b"@"
        assert got[-1:] == b"\n"
        i = next(i for i in range(1, len(reply(1))) if got[:i] + got[i + 8 :] == reply(1))
        assert 1 <= i < len(reply(1))
    else:
        assert cut(got) == reply(1)
    assert wire.ask(poll(2)) == reply(2)


@pytest.mark.parametrize("unit", ["bit", "byte"])
def test_corrupt_reply(faulty, unit: str) -> None:
    f = faulty(f"corrupt-reply@stage:1:unit={unit}")
    wire = f.zaber()
    for number in range(50):
        got = wire.ask(poll(number))
        differing = [a ^ b for a, b in zip(got, reply(number), strict=True) if a != b]
        assert len(differing) == 1
        assert unit == "byte" or differing[0].bit_count() == 1


def test_corrupt_request(faulty) -> None:
    f = faulty("corrupt-request@lockin:1:unit=bit")
    wire = f.lockin()
    wire.send(b"SENS 20\r")
    details = f.injected[0].details
    assert details.startswith("request=b'SENS 20\\r' became=b'")
    assert f.names == ["corrupt-request"]


def test_split_reply(faulty) -> None:
    f = faulty("split-reply@stage:nth=1:size=5:gap_s=0.01")
    wire = f.zaber()
    wire.send(poll(1))
    assert wire.chunks == [reply(1)[:5]]
    wire.send(poll(2))
    f.timers.pass_(0.011)
    assert wire.chunks == [reply(1)[:5], reply(1)[5:10]]
    f.timers.pass_(1.0)
    assert wire.take() == reply(1) + reply(2)


def test_doubled_reply(faulty) -> None:
    f = faulty("doubled-reply@stage:nth=1")
    wire = f.zaber()
    assert wire.ask(poll(1)) == reply(1) * 2
    assert wire.ask(poll(2)) == reply(2)


@pytest.mark.parametrize(("executed", "value"), [("yes", b"20\r"), ("no", b"26\r")])
def test_disconnect(faulty, executed: str, value: bytes) -> None:
    f = faulty(f"disconnect@lockin:nth=1:executed={executed}:refuse_s=0.7")
    wire = f.lockin()
    got = wire.ask(b"SENS 20;SENS?\r")
    assert got == (b"2" if executed == "yes" else b"")  # half a reply
    assert (wire.hung_up, wire.refused_s) == (1, 0.7)
    assert wire.ask(b"SENS?\r") == value


def test_echo(faulty) -> None:
    f = faulty("echo-missing:nth=1", "echo-doubled:nth=3")
    wire = f.monochromator()
    assert wire.ask(b"WAVE?\n") == b"500.000\r\n"
    assert wire.ask(b"WAVE?\n") == b"WAVE?\n500.000\r\n"
    assert wire.ask(b"WA") + wire.ask(b"VE?\n") == b"WAVE?\n500.000\r\n"[:2] + b"VE?\nVE?\n500.000\r\n"
    assert wire.ask(b"WAVE?\r\n") == b"WAVE?\r\n500.000\r\n"
    assert f.names == ["echo-missing", "echo-doubled"]


def test_an_answer_that_looks_like_no_echo_stays(faulty) -> None:
    f = faulty("echo-missing:1")
    wire = f.monochromator()
    assert wire.ask(b"SHUTTER?\nOUTPORT?\n") == b"C\r\n1\r\n"
    assert f.names == ["echo-missing"] * 2


def test_modbus_frames_are_one_reply(faulty) -> None:
    f = faulty("late-reply@stage:nth=1")
    wire = f.drives()
    ask, answer = bytes.fromhex("010300010001d5ca"), 7
    assert wire.ask(ask) == b""
    assert len(wire.ask(ask)) == 2 * answer


def test_every_place_counts_for_itself(faulty) -> None:
    f = faulty("dropped-reply:nth=1")
    assert f.zaber().ask(poll(1)) == b""
    assert f.lockin().ask(b"SENS?\r") == b""
    assert f.monochromator().ask(b"STB?\n") == b""
    assert f.rotator().ask(b"0gs") == b""
    assert [i.target for i in f.injected] == ["stage", "lockin", "monochromator", "polarizer"]


def test_a_new_client_inherits_nothing(faulty) -> None:
    f = faulty("late-reply@stage:nth=1", "slow-reply@stage:nth=2")
    wire = f.zaber()
    first: list[bytes] = []
    talk = wire.talk
    wire.filter.received(poll(1), lambda data: wire.filter.sending(talk.feed(data), first.append))
    assert wire.ask(poll(2)) == b""  # slow
    f.timers.pass_(1.0)
    assert wire.take() == reply(2)
    assert first == []


def test_runs_repeat_and_faults_do_not_shift_each_other(tmp_path, faulty) -> None:
    def struck(*specs: str) -> list[str]:
        f = faulty(*specs)
        wire = f.zaber()
        before = len(f.injected)
        for number in range(100):
            wire.ask(poll(number))
        return [i.details for i in f.injected[before:] if i.name == "dropped-reply"]

    alone = struck("dropped-reply@stage:0.2")
    assert 5 < len(alone) < 40
    assert struck("dropped-reply@stage:0.2") == alone
    assert struck("dropped-request@lockin:0.5", "dropped-reply@stage:0.2") == alone


def test_lines_and_log_text() -> None:
    assert lines(b"a\r\nb\rc\n\r\nd") == [b"a\r\n", b"b\r", b"c\n\r\n", b"d"]
    assert shown(b"ab\r") == "b'ab\\r'"
    assert shown(bytes(100)).endswith("(100 bytes)")

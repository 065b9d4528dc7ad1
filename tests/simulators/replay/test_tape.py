"""Which recorded reply answers a request: polls, commands, several devices, several lines."""

from __future__ import annotations

MOVE = r"""
stage = wire-log 1: zaber
stage > /1 1 01 get pos\n
stage < @01 1 01 OK IDLE -- 0\r\n
stage > /1 1 02 move abs 100\n
stage < @01 1 02 OK BUSY -- 0\r\n
stage > /1 1 03 get pos\n
stage < @01 1 03 OK BUSY -- 50\r\n
stage > /1 1 04 get pos\n
stage < @01 1 04 OK IDLE -- 100\r\n
stage > /1 1 05 move abs 0\n
stage < @01 1 05 OK BUSY -- 0\r\n
stage > /1 1 06 get pos\n
stage < @01 1 06 OK IDLE -- 0\r\n
"""


def test_polled_as_recorded(played):
    player = played(MOVE)
    answers = [
        player.ask("stage", text)
        for text in (b"/1 1 31 get pos\n", b"/1 1 32 move abs 100\n", b"/1 1 33 get pos\n", b"/1 1 get pos\n")
    ]
    assert answers == [
        b"@01 1 31 OK IDLE -- 0\r\n",
        b"@01 1 32 OK BUSY -- 0\r\n",
        b"@01 1 33 OK BUSY -- 50\r\n",
        b"@01 1 OK IDLE -- 100\r\n",  # asked without a number, answered without one
    ]


def test_polled_more_often_the_last_answer_holds_until_the_next_command(played):
    player = played(MOVE)
    player.ask("stage", b"/1 1 get pos\n/1 1 move abs 100\n/1 1 get pos\n/1 1 get pos\n")
    for _ in range(3):
        assert player.ask("stage", b"/1 1 get pos\n") == b"@01 1 OK IDLE -- 100\r\n"
    assert player.tapes["stage"].counts.repeated == 3
    player.ask("stage", b"/1 1 move abs 0\n")
    assert player.ask("stage", b"/1 1 get pos\n") == b"@01 1 OK IDLE -- 0\r\n"


def test_polled_less_often(played):
    player = played(MOVE)
    assert player.ask("stage", b"/1 1 move abs 100\n/1 1 move abs 0\n/1 1 get pos\n").endswith(b" 0\r\n")
    assert player.unexpected == []


def test_a_command_out_of_turn_is_not_answered(played):
    player = played(MOVE)
    assert player.ask("stage", b"/1 1 01 move abs 0\n") is None
    assert player.ask("stage", b"/1 1 01 move abs 7\n") is None
    assert player.unexpected == [
        "stage: the command '1 1 move abs 0' comes later in the log (line 10); the next command there is "
        "'1 1 move abs 100' (line 4)",
        "stage: the command '1 1 move abs 7' is not in the log; the next command there is "
        "'1 1 move abs 100' (line 4)",
    ]
    assert player.tapes["stage"].commands_left() == 2
    assert player.tapes["stage"].next_left().number == 4
    player.ask("stage", b"/1 1 move abs 100\n/1 1 move abs 0\n")
    assert player.tapes["stage"].next_left() is None
    assert player.ask("stage", b"/1 1 stop\n") is None
    assert (
        player.unexpected[-1] == "stage: the command '1 1 stop' is not in the log; no command is left there"
    )
    assert player.ask("stage", b"/3 1 get pos\n") is None
    assert player.unexpected[-1].endswith(
        "'3 1 get pos' is not in the log; the log has nothing for this device"
    )


def test_a_query_that_comes_only_behind_the_next_command_is_not_answered(played):
    player = played(
        "stage = wire-log 1: zaber\nstage > /1 1 home\\n\nstage < @01 1 OK BUSY -- 0\\r\\n\n"
        "stage > /1 0 get version\\n\nstage < @01 0 OK IDLE -- 7.38\\r\\n"
    )
    assert player.ask("stage", b"/1 0 get version\n") is None
    assert player.ask("stage", b"/1 1 home\n/1 0 get version\n").endswith(b"7.38\r\n")


def test_warnings_is_a_query_and_clearing_them_a_command(played):
    player = played(
        "stage = wire-log 1: zaber\n"
        "stage > /1 1 warnings\\n\nstage < @01 1 OK IDLE WR 01 WR\\r\\n\n"
        "stage > /1 1 warnings clear\\n\nstage < @01 1 OK IDLE -- 0\\r\\n\n"
        "stage > /1 1 warnings\\n\nstage < @01 1 OK IDLE -- 00\\r\\n"
    )
    for _ in range(2):
        assert player.ask("stage", b"/1 1 warnings\n").endswith(b"01 WR\r\n")
    player.ask("stage", b"/1 1 warnings clear\n")
    assert player.ask("stage", b"/1 1 warnings\n").endswith(b" 00\r\n")


def test_two_devices_of_a_line_in_another_order(played):
    """Which axis begins its second leg first depends on when it was polled."""
    player = played(
        "stage = wire-log 1: zaber\n"
        "stage > /1 1 move abs 5\\n\nstage < @01 1 OK BUSY -- 0\\r\\n\n"
        "stage > /2 1 move abs 6\\n\nstage < @02 1 OK BUSY -- 0\\r\\n\n"
    )
    assert player.ask("stage", b"/2 1 move abs 6\n/1 1 move abs 5\n").count(b"OK BUSY") == 2


def test_time_does_not_go_back_on_another_line(played):
    """A client that reads less often gets the reading that belongs to the wavelength it has set."""
    player = played(
        r"""
        mono = wire-log 1: cs260
        lockin = wire-log 1: sr830
        mono > GOWAVE 500.000\r\n
        mono < GOWAVE 500.000\r\n
        lockin > SNAP? 1,2;LIAS?\r
        lockin < 0.5,0\r0\r
        lockin > SNAP? 1,2;LIAS?\r
        lockin < 0.51,0\r0\r
        mono > GOWAVE 600.000\r\n
        mono < GOWAVE 600.000\r\n
        lockin > SNAP? 1,2;LIAS?\r
        lockin < 0.6,0\r0\r
        """
    )
    player.ask("mono", b"GOWAVE 500.000\r\n")
    assert player.ask("lockin", b"SNAP? 1,2;LIAS?\r") == b"0.5,0\r0\r"
    player.ask("mono", b"GOWAVE 600.000\r\n")
    assert player.ask("lockin", b"SNAP? 1,2;LIAS?\r") == b"0.6,0\r0\r"
    assert player.ask("lockin", b"SNAP? 1,2\r") == b"0.6,0\r"


def test_silence_is_repeated_as_silence_only_if_nothing_was_ever_answered(played):
    player = played(
        "stage = wire-log 1: zaber\nstage > /1 1 get pos\\n\nstage = gave up: no complete reply within 2 s\n"
        "stage > /1 1 get pos\\n\nstage < @01 1 OK IDLE -- 3\\r\\n\n"
        "stage > /2 1 get pos\\n\n"
    )
    assert player.ask("stage", b"/1 1 get pos\n") == b""
    for _ in range(3):
        assert player.ask("stage", b"/1 1 get pos\n").endswith(b" 3\r\n")
    for _ in range(2):
        assert player.ask("stage", b"/2 1 get pos\n") == b""
    assert player.unexpected == []


def test_a_long_log_is_asked_in_no_time(tmp_path, played):
    lines = "".join(f"stage > /1 1 get pos\\n\nstage < @01 1 OK IDLE -- {n}\\r\\n\n" for n in range(5000))
    player = played("stage = wire-log 1: zaber\n" + lines)
    for _ in range(20000):
        last = player.ask("stage", b"/1 1 get pos\n")
    assert last == b"@01 1 OK IDLE -- 4999\r\n"

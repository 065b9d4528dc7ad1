"""The Elliptec rotator: exact bytes, status in words, and a read-back after every turn."""

from __future__ import annotations

import pytest

from gonio.errors import DeviceError, MotionError, ReplyError
from gonio_drivers.elliptec import ElliptecConfig, ElliptecRotator

from .conftest import SILENCE

CONFIG = ElliptecConfig(driver="elliptec", s_deg=0.0, p_deg=45.0)
INFORMATION = b"0IN0E114000512022170101680002300" + b"0\r\n"
IDENTIFIED = (b"0in", INFORMATION)
HOMED = (b"0ho0", b"0PO00000000\r\n")
AT_ZERO = (b"0gp", b"0PO00000000\r\n")
CONNECT = (IDENTIFIED, HOMED, AT_ZERO)


@pytest.fixture
def rotator(scripted, context):
    def make(*exchanges, config=CONFIG):
        return ElliptecRotator(config, context, scripted(*CONNECT, *exchanges, role="polarizer"))

    return make


def test_documented_exchanges(rotator):
    """45 deg is 17 920 = 0x4600 of 143 360 pulses."""
    polarizer = rotator(
        AT_ZERO,
        (b"0ma00004600", b"0PO00004600\r\n"),
        (b"0gp", b"0PO00004600\r\n"),
    )
    assert polarizer.select("p") == 45.0
    assert polarizer.identify() == "Thorlabs ELL14, serial 11400051, firmware 1.7"


def test_no_move_where_it_stands(rotator):
    assert rotator(AT_ZERO).select("s") == 0.0


def test_negative_angles_are_twos_complement(rotator):
    config = CONFIG.model_copy(update={"p_deg": -45.0})
    polarizer = rotator(
        AT_ZERO, (b"0maFFFFBA00", b"0POFFFFBA00\r\n"), (b"0gp", b"0POFFFFBA00\r\n"), config=config
    )
    assert polarizer.select("p") == -45.0


def test_standing_elsewhere_is_an_error(rotator):
    elsewhere = (b"0gp", b"0PO00004500\r\n")
    polarizer = rotator(AT_ZERO, (b"0ma00004600", b"0PO00004600\r\n"), elsewhere, elsewhere)
    with pytest.raises(
        MotionError, match=r"polarizer at scripted .*is at 44\.36 deg instead of 45 \+- 0\.1 deg \(P\)"
    ):
        polarizer.select("p")


@pytest.mark.parametrize(
    ("status", "words"),
    [(2, "mechanical time-out"), (8, "too hot"), (0x0A, "sensor"), (0x7F, "unknown status 127")],
)
def test_status_in_words(rotator, status, words):
    polarizer = rotator(AT_ZERO, (b"0ma00004600", b"0GS%02X\r\n" % status))
    with pytest.raises(MotionError, match=words):
        polarizer.select("p")


def test_busy_is_not_the_end_of_a_move(rotator):
    polarizer = rotator(
        AT_ZERO, (b"0ma00004600", [b"0GS09\r\n", b"0PO00", b"004600\r\n"]), (b"0gp", b"0PO00004600\r\n")
    )
    assert polarizer.select("p") == 45.0


def test_a_move_whose_reply_is_lost_begins_anew_from_the_home_position(rotator):
    """The module may have restarted on the way; it then counts from wherever it was."""
    proof = (b"0gs", b"0GS00\r\n")
    move = (b"0ma00004600", b"0PO00004600\r\n")
    polarizer = rotator(
        AT_ZERO, (move[0], [SILENCE, move[1]]), proof, HOMED, AT_ZERO, move, (b"0gp", b"0PO00004600\r\n")
    )
    assert polarizer.select("p") == 45.0


def test_a_module_that_does_not_answer_its_search_for_home_is_not_believed(rotator):
    proof = (b"0gs", b"0GS00\r\n")
    polarizer = rotator(AT_ZERO, (b"0ma00004600", []), proof, (b"0ho0", []), proof, (b"0ho0", []))
    with pytest.raises(ReplyError, match="gave no complete reply"):
        polarizer.select("p")


def test_turned_by_hand_it_is_homed_before_the_next_turn(rotator):
    by_hand = (b"0gp", b"0PO00000400\r\n")
    polarizer = rotator(by_hand, HOMED, AT_ZERO, AT_ZERO)
    assert polarizer.select("s") == 0.0


def test_turned_while_it_should_stand_is_an_error_and_then_homed(rotator):
    by_hand = (b"0gp", b"0PO00000400\r\n")
    polarizer = rotator(AT_ZERO, AT_ZERO, by_hand, by_hand, HOMED, AT_ZERO, AT_ZERO)
    assert polarizer.select("s") == 0.0
    assert polarizer.verify_still(0.0) == 0.0
    with pytest.raises(MotionError, match=r"is at 2\.57 deg although it was left at 0\.00 deg"):
        polarizer.verify_still(0.0)
    assert polarizer.select("s") == 0.0


def test_recovery_wants_the_same_module(rotator):
    polarizer = rotator(IDENTIFIED, HOMED, AT_ZERO, (b"0in", INFORMATION.replace(b"11400051", b"11400052")))
    assert polarizer.recover() == "homed"
    with pytest.raises(DeviceError, match=r"another module now: .*11400052.* instead of .*11400051"):
        polarizer.recover()


def test_a_late_position_is_not_taken_for_the_next(rotator):
    polarizer = rotator(
        (b"0gp", []),
        (b"0gs", b"0PO00004600\r\n"),  # the late one, after the line was quiet: not a status
        (b"0gs", b"0GS00\r\n"),
        AT_ZERO,
    )
    assert polarizer.position_deg() == 0.0


@pytest.mark.parametrize("reply", [b"1PO00000000\r\n", b"0PO0000\r\n", b"0POxyzxyzxy\r\n", b"\xff\xff\r\n"])
def test_damaged_replies_are_repeated_after_a_proof(rotator, reply):
    polarizer = rotator((b"0gp", reply), (b"0gs", b"0GS00\r\n"), AT_ZERO)
    assert polarizer.position_deg() == 0.0


def test_another_pulse_count_is_refused(scripted, context):
    config = CONFIG.model_copy(update={"pulses_per_turn": 262144})
    with pytest.raises(DeviceError, match="counts 143360 pulses per turn, the rig file says 262144"):
        ElliptecRotator(config, context, scripted(IDENTIFIED))


def test_stop_during_a_turn_is_told_to_who_waits(rotator):
    polarizer = rotator(AT_ZERO, (b"0ma00004600", b"0PO00004600\r\n"), (b"0gp", b"0PO00004600\r\n"), AT_ZERO)
    write = polarizer._line.port.write

    def stop_meanwhile(data: bytes) -> None:
        if data.startswith(b"0ma"):
            polarizer.stop()
            polarizer.stop()
        write(data)

    polarizer._line.port.write = stop_meanwhile
    with pytest.raises(MotionError, match="stopped on request"):
        polarizer.select("p")
    assert polarizer.select("s") == 0.0

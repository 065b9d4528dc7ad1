"""The Modbus drives: the documents' bytes, registers, opcodes, alarms."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU

from gonio_simulators.wire.applied_motion import AppliedMotionLine
from gonio_simulators.wire.applied_motion_drive import Drive
from gonio_simulators.wire.modbus_frames import MbapReceiver, RtuReceiver, crc16, mbap_frame, rtu_frame
from tests.simulators.wire.conftest import StillBench

ENABLED, IN_POSITION, MOVING, ALARM, HOMING = 1 << 0, 1 << 3, 1 << 4, 1 << 9, 1 << 10


class Master:
    """Speaks to one unit in protocol data units."""

    def __init__(self, bench: StillBench, *, word_order: str = "big") -> None:
        self.line = AppliedMotionLine(
            bench,
            theta_i=1,
            theta_mes=2,
            steps_per_rev=(20000.0, 20000.0),
            framing="rtu",
            word_order=word_order,
        )
        self.high_first = word_order == "big"

    def read(self, unit: int, address: int, count: int) -> tuple[int, ...]:
        reply = self.line.answer(unit, struct.pack(">BHH", 3, address, count))
        assert reply is not None
        assert reply[:2] == bytes([3, 2 * count]), reply
        return struct.unpack(f">{count}H", reply[2:])

    def write(self, unit: int, address: int, *values: int) -> bytes:
        pdu = struct.pack(f">BHHB{len(values)}H", 16, address, len(values), 2 * len(values), *values)
        reply = self.line.answer(unit, pdu)
        assert reply is not None
        return reply

    def do(self, unit: int, opcode: int) -> bytes | None:
        return self.line.answer(unit, struct.pack(">BHH", 6, 0x7C, opcode))

    def words(self, value: int) -> tuple[int, int]:
        high, low = value >> 16 & 0xFFFF, value & 0xFFFF
        return (high, low) if self.high_first else (low, high)

    def position(self, unit: int) -> int:
        first, second = self.read(unit, 6, 2)
        high, low = (first, second) if self.high_first else (second, first)
        return struct.unpack(">i", struct.pack(">HH", high, low))[0]

    def home(self, bench: StillBench, unit: int) -> None:
        self.do(unit, 0xDB)
        bench.clock.advance(60.0)
        self.write(unit, 0x7D, 0, 0)
        self.do(unit, 0xA5)


# -- frames


@given(st.binary(max_size=250))
def test_crc_agrees_with_pymodbus(data: bytes) -> None:
    assert crc16(data).to_bytes(2, "little") == FramerRTU.compute_CRC(data).to_bytes(2, "big")


@pytest.mark.parametrize(
    ("request_hex", "reply_hex"),
    [
        ("01 10 00 1B 00 05 0A 02 58 02 58 00 F0 00 03 0D 40 CD 83", "01 10 00 1B 00 05 70 0D"),
        ("01 06 00 7C 00 67 09 F8", "01 06 00 7C 00 67 09 F8"),
        ("01 06 00 7C 00 E1 88 5A", "01 06 00 7C 00 E1 88 5A"),
        # the vendor's manual of another drive with the same registers
        ("01 10 00 1B 00 05 0A 02 58 04 B0 09 60 00 00 4E 20 24 3B", "01 10 00 1B 00 05 70 0D"),
    ],
)
def test_documented_exchanges(bench: StillBench, request_hex: str, reply_hex: str) -> None:
    talk = Master(bench).line.open()
    assert talk.feed(bytes.fromhex(request_hex)) == bytes.fromhex(reply_hex)


def test_documented_status_reply() -> None:
    assert RtuReceiver().feed(bytes.fromhex("01 03 00 01 00 01 D5 CA")) == [
        (1, bytes.fromhex("03 00 01 00 01"))
    ]
    assert rtu_frame(1, bytes.fromhex("03 02 40 01")) == bytes.fromhex("01 03 02 40 01 48 44")


def test_frames_are_found_in_any_pieces() -> None:
    stream = rtu_frame(1, bytes.fromhex("0300010001")) + rtu_frame(
        2, struct.pack(">BHHB5H", 16, 0x1B, 5, 10, 1, 2, 3, 4, 5)
    )
    for cut in range(len(stream)):
        receiver = RtuReceiver()
        assert [unit for unit, _ in receiver.feed(stream[:cut]) + receiver.feed(stream[cut:])] == [1, 2]


def test_a_damaged_frame_is_dropped_and_the_next_one_heard() -> None:
    receiver = RtuReceiver()
    frame = rtu_frame(1, bytes.fromhex("0300010001"))
    assert receiver.feed(frame[:-1] + bytes([frame[-1] ^ 1])) == []
    assert receiver.feed(frame) == [(1, bytes.fromhex("0300010001"))]


@given(st.integers(0, 0xFFFF), st.integers(0, 255), st.binary(min_size=1, max_size=253), st.integers(0, 260))
def test_mbap_round_trip(transaction: int, unit: int, pdu: bytes, cut: int) -> None:
    frame = mbap_frame(transaction, unit, pdu)
    receiver = MbapReceiver()
    assert receiver.feed(frame[:cut]) + receiver.feed(frame[cut:]) == [(transaction, unit, pdu)]


# -- the drive


@pytest.mark.parametrize("word_order", ["big", "little"])
def test_a_move_with_both_word_orders(bench: StillBench, word_order: str) -> None:
    master = Master(bench, word_order=word_order)
    master.home(bench, 1)
    assert master.position(1) == 0
    # 1 rev/s = 20 000 steps/s, 100 rev/s2: 200 000 steps take 10 s + 0.01 s
    assert master.write(1, 0x1B, 600, 600, 240, *master.words(200_000)) == bytes.fromhex("10 00 1B 00 05")
    master.do(1, 0x67)
    bench.clock.advance(10.009)
    assert master.read(1, 1, 1) == (ENABLED | MOVING,)
    assert 199_000 < master.position(1) < 200_000
    bench.clock.advance(0.002)
    assert master.read(1, 0, 2) == (0, ENABLED | IN_POSITION)
    assert master.position(1) == 200_000
    master.write(1, 0x1E, *master.words(-100_000))
    master.do(1, 0x66)  # relative
    bench.clock.advance(20.0)
    assert master.position(1) == 100_000
    # an approach with falling angles leaves no backlash
    assert bench.theta_i.angle_deg() == pytest.approx(100_000 / 4266.6666666666667, abs=1e-9)


def test_homing_finds_the_switch_but_only_sp_calls_it_zero(bench: StillBench) -> None:
    master = Master(bench)
    origin = round(bench.theta_i.hardware.power_on_deg * bench.theta_i.hardware.steps_per_deg)
    assert master.position(1) == 0  # where power came on
    master.do(1, 0x6E)
    assert master.read(1, 1, 1) == (ENABLED | MOVING | HOMING,)
    bench.clock.advance(60.0)
    assert master.position(1) == -origin
    master.write(1, 0x7D, 0, 0)
    master.do(1, 0xA5)
    assert master.position(1) == 0


def test_units_live_side_by_side_and_others_stay_silent(bench: StillBench) -> None:
    master = Master(bench)
    read = struct.pack(">BHH", 3, 1, 1)
    assert master.line.answer(3, read) is None
    assert master.line.answer(0, read) is None
    master.write(1, 0x1E, *master.words(1000))
    assert master.read(1, 0x1E, 2) == (0, 1000)
    assert master.read(2, 0x1E, 2) == (0, 0)
    assert master.line.answer(0, struct.pack(">BHH", 6, 0x1E, 7)) is None  # a broadcast is obeyed
    assert master.read(1, 0x1E, 1) == master.read(2, 0x1E, 1) == (7,)


@pytest.mark.parametrize(
    ("pdu", "code"),
    [
        (struct.pack(">BHH", 1, 0, 1), 1),  # read coils
        (struct.pack(">BHH", 3, 0, 0), 3),
        (struct.pack(">BHH", 3, 0, 126), 3),
        (struct.pack(">BHH", 3, 0x8F, 2), 2),
        (struct.pack(">BHH", 6, 0, 1), 2),  # the alarm is read only
        (struct.pack(">BHH", 6, 0x7C, 0xFF), 3),  # no such opcode
        (struct.pack(">BHH", 6, 0x1D, 0), 3),  # no speed
        (struct.pack(">BHHB2H", 16, 0x1A, 2, 4, 1, 1), 2),
        (struct.pack(">BHHB2H", 16, 0x1B, 2, 3, 1, 1), 3),  # byte count does not fit
    ],
)
def test_exceptions(bench: StillBench, pdu: bytes, code: int) -> None:
    assert Master(bench).line.answer(1, pdu) == bytes([pdu[0] | 0x80, code])


def test_a_refused_write_changes_nothing(bench: StillBench) -> None:
    master = Master(bench)
    before = master.read(1, 0x1B, 5)
    assert master.write(1, 0x1B, 100, 100, 0) == bytes([0x90, 3])
    assert master.read(1, 0x1B, 5) == before


def test_input_registers_read_the_same(bench: StillBench) -> None:
    drive = Drive(bench.theta_i, steps_per_rev=20000.0, word_order="big")
    holding = drive.answer(struct.pack(">BHH", 3, 0, 8))
    assert drive.answer(struct.pack(">BHH", 4, 0, 8)) == b"\x04" + holding[1:]


def test_the_blind_zone_raises_a_limit_alarm(bench: StillBench) -> None:
    master = Master(bench)
    master.home(bench, 2)
    master.write(2, 0x1E, *master.words(768_000))
    master.do(2, 0x67)
    bench.clock.advance(60.0)
    assert master.read(2, 0, 2) == (1 << 2, ENABLED | ALARM)
    stands_deg = 180.0 - master.position(2) / 4266.6666666666667
    assert 14.0 < stands_deg < 15.0
    master.do(2, 0xBA)
    assert master.read(2, 0, 2) == (0, ENABLED | IN_POSITION)


def test_a_disabled_motor_does_not_move(bench: StillBench) -> None:
    master = Master(bench)
    master.home(bench, 1)
    master.do(1, 0x9E)
    master.write(1, 0x1E, *master.words(5000))
    master.do(1, 0x67)
    bench.clock.advance(10.0)
    assert master.read(1, 0, 2) == (1 << 12, ALARM)
    assert master.position(1) == 0
    master.do(1, 0xBA)
    master.do(1, 0x9F)
    master.do(1, 0x67)
    bench.clock.advance(10.0)
    assert master.read(1, 0, 2) == (0, ENABLED | IN_POSITION)
    assert master.position(1) == 5000


def test_stop(bench: StillBench) -> None:
    master = Master(bench)
    master.home(bench, 1)
    master.write(1, 0x1B, 6, 6, 240, *master.words(300_000))  # 1 rev/s2
    master.do(1, 0x67)
    bench.clock.advance(2.0)
    master.do(1, 0xE1)
    assert master.read(1, 1, 1) == (ENABLED | MOVING | 1 << 6,)
    bench.clock.advance(1.01)
    assert master.read(1, 1, 1) == (ENABLED | IN_POSITION,)
    assert master.position(1) == pytest.approx(10_000 + 20_000 + 10_000, abs=1)


def test_jogging(bench: StillBench) -> None:
    master = Master(bench)
    master.home(bench, 1)
    master.write(1, 0x2E, 60, 60, 240)  # 10 rev/s2, 1 rev/s
    master.write(1, 0x1E, *master.words(1))
    master.do(1, 0x96)
    bench.clock.advance(5.0)
    assert master.read(1, 1, 1) == (ENABLED | MOVING | 1 << 5,)
    assert master.read(1, 0x0A, 1) == (240,)
    before = master.position(1)
    bench.clock.advance(1.0)
    assert master.position(1) - before == 20_000
    master.do(1, 0xD8)
    bench.clock.advance(1.0)
    assert master.read(1, 1, 1) == (ENABLED | IN_POSITION,)
    master.write(1, 0x1B, 600, 600, 480, *master.words(0))  # the next move has its own profile
    master.do(1, 0x67)
    bench.clock.advance(0.5)
    assert master.read(1, 0x0A, 1) == (0x10000 - 480,)
    master.write(1, 0x7D, *master.words(77))
    bench.clock.advance(30.0)
    master.do(1, 0x98)
    assert master.read(1, 4, 4) == (0, 77, 0, 0)  # EP renames the encoder alone


@pytest.mark.parametrize(
    "pdu",
    [
        "01 0000 0001",
        "02 0000 0001",
        "05 0000 FF00",
        "07",
        "08 0000 A537",  # diagnostics: return query data
        "0B",
        "0F 0000 0008 01 FF",
        "11",
        "16 0004 00F2 0025",
        "17 0003 0006 000E 0003 06 00FF 00FF 00FF",  # read and write
        "18 04DE",
        "2B 0E 01 00",  # device identification
    ],
)
def test_other_public_functions_are_refused_and_the_line_stays_in_step(bench: StillBench, pdu: str) -> None:
    request = bytes.fromhex(pdu)
    stream = rtu_frame(1, request) + rtu_frame(1, bytes.fromhex("0300010001"))
    refusal = rtu_frame(1, bytes([request[0] | 0x80, 1]))
    for cut in range(len(stream)):
        talk = Master(bench).line.open()
        replies = talk.feed(stream[:cut]) + talk.feed(stream[cut:])
        assert replies.startswith(refusal)
        assert len(replies) == len(refusal) + 7


def test_garbage_is_forgotten_after_a_silence() -> None:
    now_s = 0.0
    receiver = RtuReceiver(lambda: now_s)
    frame = rtu_frame(1, bytes.fromhex("0300010001"))
    assert receiver.feed(b"\x01\x10\x00\x00") == []  # the beginning of a long request, and then nothing
    now_s = 0.01
    assert receiver.feed(frame) == []  # taken for its rest
    now_s = 0.05
    assert receiver.feed(frame) == [(1, bytes.fromhex("0300010001"))]


def test_a_function_of_unknown_length_ends_with_its_crc() -> None:
    receiver = RtuReceiver()
    frame = rtu_frame(1, b"\x64\x01\x02\x03")
    assert receiver.feed(frame[:5]) == []
    assert receiver.feed(frame[5:]) == [(1, b"\x64\x01\x02\x03")]

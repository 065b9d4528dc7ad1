"""The journal: what is written comes back, and a torn or damaged file gives no wrong record."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import gonio
from gonio.acquire import Runner, Snapshot, State, resume_scan
from gonio.acquire import journal as journal_module
from gonio.acquire.journal import MAGIC, Journal, decode, encode, frames, journal_path
from gonio.acquire.lock import FileLock
from gonio.errors import ScanStopped, StoreError
from gonio.plan import Plan
from gonio.store.records import (
    DetectorFacts,
    EventRecord,
    PositionRecord,
    Record,
    ReferenceRecord,
    RigFacts,
    ScanHeader,
)

FACTS = RigFacts(
    "bench", 26.0, 18.0, 95.0, 90.0, 180.0, 0.0, 90.0, (DetectorFacts("pmt", "PMT", 200.0, 860.0),)
)


def a_header() -> ScanHeader:
    return ScanHeader(
        'title = "α β"\n', "", FACTS, np.array([0, 0], dtype=np.uint8), {"stage": "X"}, "gonio", "t", 1.5
    )


def a_position(index: int = 0) -> PositionRecord:
    two = np.array([1.0, np.nan])
    return PositionRecord(
        index, "s", 20.0, 15.0, 0.01, 1, 9.0, two, two, two, two, np.array([0, 1], dtype=np.uint16)
    )


def written(path: Path) -> int:
    """Return the end of the last record: zeros stand behind it while the journal is open."""
    return max(end for end, _ in frames(path.read_bytes()))


def equal(a: Record, b: Record) -> bool:
    if type(a) is not type(b):
        return False
    for name in type(a).__slots__:
        x, y = getattr(a, name), getattr(b, name)
        if isinstance(x, np.ndarray):
            if x.dtype != y.dtype or not np.array_equal(x, y, equal_nan=x.dtype.kind == "f"):
                return False
        elif x != y:
            return False
    return True


floats = st.floats(allow_nan=False, allow_infinity=False)
arrays = hnp.arrays(np.float64, 4, elements=st.floats(allow_nan=True))


@given(
    index=st.integers(0, 10**6),
    angles=st.tuples(floats, floats, floats, floats),
    columns=st.tuples(arrays, arrays, arrays, arrays),
    quality=hnp.arrays(np.uint16, 4),
)
def test_a_position_comes_back_bit_for_bit(
    index: int,
    angles: tuple[float, float, float, float],
    columns: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    quality: np.ndarray,
) -> None:
    record = PositionRecord(index, "p", *angles[:3], 2, angles[3], *columns, quality)
    ((_, payload),) = frames(MAGIC + encode(record))
    assert equal(decode(payload), record)


@given(st.text(), st.text())
def test_texts_come_back(source: str, message: str) -> None:
    try:
        message.encode()
        source.encode()
    except UnicodeEncodeError:
        return  # a lone surrogate is no text
    event = EventRecord(1.0, 2.0, "warning", source, message)
    ((_, payload),) = frames(MAGIC + encode(event))
    assert decode(payload) == event


def test_a_header_and_a_reference_come_back(tmp_path: Path) -> None:
    two = np.array([1.0, 2.0])
    reference = ReferenceRecord(
        "dark", "end", "any", 90.0, 180.0, 4, 3.0, two, two, two, two, np.zeros(2, dtype=np.uint16)
    )
    journal = Journal.create(tmp_path / "a.journal", a_header())
    journal.append(reference)
    journal.append(a_position(7))
    journal.close()
    again, header, records, note = Journal.reopen(tmp_path / "a.journal")
    again.close()
    assert note == ""
    assert equal(header, a_header())
    assert equal(records[0], reference)
    assert equal(records[1], a_position(7))


@settings(max_examples=150)
@given(st.data())
def test_no_damage_ever_yields_a_record_that_was_not_written(data: st.DataObject) -> None:
    written: list[Record] = [a_header(), *(a_position(i) for i in range(4))]
    good = MAGIC + b"".join(encode(record) for record in written)
    bad = bytearray(good)
    for _ in range(data.draw(st.integers(1, 6))):
        kind = data.draw(st.sampled_from(["flip", "cut", "insert", "zero"]))
        at = data.draw(st.integers(len(MAGIC), max(len(bad), len(MAGIC))))
        if kind == "flip" and at < len(bad):
            bad[at] ^= data.draw(st.integers(1, 255))
        elif kind == "cut":
            del bad[at : at + data.draw(st.integers(1, 50))]
        elif kind == "insert":
            bad[at:at] = data.draw(st.binary(min_size=1, max_size=30))
        else:
            bad[at : at + 20] = bytes(len(bad[at : at + 20]))
    found = [decode(payload) for _, payload in frames(bytes(bad))]
    positions = iter(written)
    for record in found:  # each is one of those written, in their order
        assert any(equal(record, candidate) for candidate in positions)


def test_a_bit_flipped_anywhere_costs_a_record_or_an_explanation_and_never_makes_one(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    originals: list[Record] = [a_header(), *(a_position(i) for i in range(3))]
    good = MAGIC + b"".join(encode(record) for record in originals)
    header_end = len(MAGIC) + len(encode(originals[0]))
    for at in range(len(good)):
        bad = bytearray(good)
        bad[at] ^= 1 << (at % 8)
        path.write_bytes(bad)
        if at < header_end:
            message = "not the journal of a gonio scan" if at < len(MAGIC) else "its beginning is damaged"
            with pytest.raises(StoreError, match=message):
                Journal.reopen(path)
            assert path.read_bytes() == bad  # nothing is thrown away
            continue
        journal, header, records, note = Journal.reopen(path)
        journal.close()
        assert equal(header, originals[0])
        hit = next(i for i in range(3) if at < header_end + (i + 1) * len(encode(a_position())))
        assert len(records) == 2
        assert all(
            equal(a, b) for a, b in zip(records, [a_position(i) for i in range(3) if i != hit], strict=True)
        )
        assert note


def test_zeros_ahead_of_the_end_are_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    journal = Journal.create(path, a_header())
    for i in range(3):
        journal.append(a_position(i))
    killed = path.read_bytes()  # as a kill leaves it
    journal.close()
    assert len(killed) > written(path)
    assert killed.rstrip(b"\0") == path.read_bytes().rstrip(b"\0")
    for torn, expected in ((b"", ""), (encode(a_position(3))[:50], "50 bytes of an unfinished record")):
        path.write_bytes(killed[: written(path)] + torn + bytes(5000))
        journal, _, records, note = Journal.reopen(path)
        journal.append(a_position(9))
        journal.close()
        assert [r.index for r in records if isinstance(r, PositionRecord)] == [0, 1, 2]
        assert note.startswith(expected)
        assert bool(note) == bool(expected)
        killed = path.read_bytes()[: -len(encode(a_position(9)))]


def test_a_record_damaged_in_the_middle_costs_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    journal = Journal.create(path, a_header())
    sizes = [written(path)]
    for i in range(3):
        journal.append(a_position(i))
        sizes.append(written(path))
    journal.close()
    data = bytearray(path.read_bytes())
    data[(sizes[1] + sizes[2]) // 2] ^= 0x10
    path.write_bytes(data)
    journal, _, records, note = Journal.reopen(path)
    journal.append(a_position(9))
    journal.close()
    assert [r.index for r in records if isinstance(r, PositionRecord)] == [0, 2]
    assert f"{sizes[2] - sizes[1]} bytes in the middle of the journal are damaged" in note
    journal, _, records, _ = Journal.reopen(path)
    journal.close()
    assert [r.index for r in records if isinstance(r, PositionRecord)] == [0, 2, 9]


def test_what_the_disk_does_not_confirm_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.journal"
    journal = Journal.create(path, a_header())
    journal.append(a_position(0))
    end = written(path)

    def dying(_descriptor: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(journal_module, "_sync", dying)
    journal.write(a_position(1))
    with pytest.raises(StoreError, match=r"cannot be written.*Input/output error"):
        journal.confirm()
    monkeypatch.undo()
    assert written(path) == end
    journal.append(a_position(1))  # the disk is back: kept once
    journal.close()
    journal, _, records, note = Journal.reopen(path)
    journal.close()
    assert [r.index for r in records if isinstance(r, PositionRecord)] == [0, 1]
    assert note == ""


def test_at_the_end_of_the_interpreter_records_are_kept_without_a_thread(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    journal = Journal.create(path, a_header())
    journal._disk.shutdown()
    journal.append(a_position(0))
    journal.close()
    journal, _, records, _ = Journal.reopen(path)
    journal.close()
    assert len(records) == 1


def test_a_foreign_journal_is_not_touched(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    path.write_bytes(b"something else altogether")
    with pytest.raises(StoreError, match="not the journal of a gonio scan"):
        Journal.reopen(path)
    with pytest.raises(StoreError, match="not finished"):
        Journal.create(path, a_header())
    assert path.read_bytes() == b"something else altogether"


@pytest.mark.parametrize("length", [0, 5, len(MAGIC), len(MAGIC) + 20])
def test_a_journal_that_died_at_birth_says_so_and_makes_way(tmp_path: Path, length: int) -> None:
    path = tmp_path / "a.journal"
    path.write_bytes((MAGIC + encode(a_header()))[:length])
    with pytest.raises(StoreError, match="died before its first reading"):
        Journal.reopen(path)
    Journal.create(path, a_header()).close()
    Journal.reopen(path)[0].close()


def test_the_lock_ends_with_its_process_and_only_then(tmp_path: Path) -> None:
    path = tmp_path / "locked"
    path.touch()
    code = (
        "import sys; from pathlib import Path; from gonio.acquire.lock import FileLock\n"
        "lock = FileLock(Path(sys.argv[1])); print('locked', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"locked\n"
        with pytest.raises(BlockingIOError):
            FileLock(path)
        other.kill()
    FileLock(path).release()


def test_the_journal_cut_at_every_byte_of_its_last_two_records_resumes(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    sizes: list[int] = []

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.state is State.RUNNING:
            sizes.append(written(journal_path(path)))
        if snapshot.done == 6:
            runner.stop()

    runner = Runner(memory.rig(), plan, path, on_snapshot=on_snapshot)
    with pytest.raises(ScanStopped):
        runner.run()
    ends = sorted(set(sizes))
    whole = journal_path(path).read_bytes()[: ends[-1]]  # without the event of the stop
    work = tmp_path / "work" / "scan.h5"
    work.parent.mkdir()
    for cut in range(ends[-3], ends[-1] + 1):
        journal_path(work).write_bytes(whole[:cut])
        journal, header, records, note = Journal.reopen(journal_path(work))
        journal.close()
        kept = [record.index for record in records if isinstance(record, PositionRecord)]
        assert kept == list(range(6 - (cut < ends[-2]) - (cut < ends[-1])))
        assert bool(note) == (cut not in ends)
        assert journal_path(work).stat().st_size == max(end for end in ends if end <= cut)
        assert header.plan_text == plan.to_toml()
    # the whole way to a finished file, for a few cuts of every kind
    for cut in (ends[-3], ends[-3] + 1, ends[-3] + 11, ends[-2] - 1, ends[-2], ends[-2] + 12, ends[-1] - 1):
        shutil.copy(path, work)
        journal_path(work).write_bytes(whole[:cut])
        resume_scan(work, memory.rig()).run()
        scan = gonio.load(work)
        assert scan.finished
        assert scan.position.tolist() == list(range(10))
        truth = memory.true_r(scan.theta_i_deg, scan.theta_mes_deg, scan.polarization, scan.wavelength_nm)
        np.testing.assert_allclose(scan.r, truth, rtol=1e-9)
        work.unlink()

"""A scan whose positions a source chooses: nothing it decided is lost or doubled, whatever dies when."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest
from source_walker import ABORT, PLAN, SHORT, Walker, asked_for, events, same_bits, stopped, whole

import gonio
from gonio.acquire import FaultPolicy, Runner, Snapshot, State, resume_scan
from gonio.acquire.journal import Journal, encode, frames, journal_path, read_records
from gonio.acquire.session import Session
from gonio.cli import main
from gonio.devices import Quality
from gonio.errors import MotionError, RefusedError, ScanStopped, StoreError
from gonio.plan import Plan, Position
from gonio.plan.source import Measured, PlanSource
from gonio.store.records import DecisionRecord, PositionRecord


def test_what_the_source_asked_for_is_what_was_measured(memory: ModuleType, tmp_path: Path) -> None:
    source, path = Walker(), tmp_path / "scan.h5"
    snapshots: list[Snapshot] = []
    Runner(memory.rig(), PLAN, path, source=source, on_snapshot=snapshots.append).run()
    scan = gonio.load(path)
    decided = [found.position for found in source.shown[-1]]
    assert asked_for(scan) == [(p.theta_i_deg, p.theta_mes_deg, p.polarization) for p in decided]
    assert len({p.theta_mes_deg for p in decided}) > 4, "the source hardly moved"
    truth = memory.true_r(scan.theta_i_deg, scan.theta_mes_deg, scan.polarization, scan.wavelength_nm)
    np.testing.assert_allclose(scan.r, truth, rtol=1e-9)
    assert scan.finished
    assert scan.n_planned == 8
    assert not journal_path(path).exists()
    assert main(["check", str(path)]) == 0
    with h5py.File(path) as file:
        entry = file["entry"]
        np.testing.assert_array_equal(entry["data/theta_i_set"], [p.theta_i_deg for p in decided])
        np.testing.assert_array_equal(entry["data/theta_mes_set"], [p.theta_mes_deg for p in decided])
        rows = [entry[name]["position"][...] for name in entry if name.startswith("sweep_")]
        assert sorted(np.concatenate(rows).tolist()) == list(range(8))
        assert entry["source/name"].asstr()[()] == "walker"
        assert "Goes where the last readings send it" in entry["source/text"].asstr()[()]
        whens = entry["references/when"].asstr()[...].tolist()
        assert list(dict.fromkeys(whens)) == ["start", "before 3", "before 6", "end"]
    assert [s.total for s in snapshots if s.state is State.RUNNING and s.done < 8] == [12] * sum(
        s.state is State.RUNNING and s.done < 8 for s in snapshots
    )
    last = snapshots[-1]
    assert (last.done, last.total, last.left_s) == (8, 8, 0.0)
    assert last.readings_done == last.readings_total == (8 + 4 * 3) * 2
    assert any(s.left_s > 0 for s in snapshots)


def test_a_decision_is_on_the_disk_before_the_axes_move(memory: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    kept: list[tuple[float, Any]] = []

    class Watched(memory.World):  # type: ignore[misc, name-defined]
        def did(self, action: str) -> None:
            if action.startswith("start theta_mes") and journal_path(path).exists():
                last = [r for r in read_records(journal_path(path))[1] if isinstance(r, DecisionRecord)][-1:]
                kept.append((float(action.split()[2]), last[0].theta_mes_deg if last else None))
            super().did(action)

    Runner(memory.rig(Watched()), PLAN, path, source=Walker()).run()
    to_samples = [(at, decided) for at, decided in kept if at != 180.0]
    assert len(to_samples) >= 8
    assert all(at == decided or abs(at - decided) <= 1.0 for at, decided in to_samples), kept  # backlash


@pytest.fixture(scope="module")
def journal_of_a_scan(memory: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, Any]:
    """A journal that has everything, and the file it became."""
    folder = tmp_path_factory.mktemp("whole")
    path = folder / "scan.h5"
    taken: list[bytes] = []
    finish = Session.finish

    def copied(session: Session, end_time: str) -> None:
        taken.append(journal_path(path).read_bytes().rstrip(b"\0"))
        finish(session, end_time)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Session, "finish", copied)
        scan = whole(memory, path, SHORT())
    end = max(end for end, _ in frames(taken[0] + bytes(64)))
    return taken[0].ljust(end, b"\0"), scan


def test_killed_at_every_record_and_in_the_middle_of_each(
    memory: ModuleType, tmp_path: Path, journal_of_a_scan: tuple[bytes, Any]
) -> None:
    data, expected = journal_of_a_scan
    ends = [end for end, _ in frames(data)]
    assert len(ends) == 1 + 5 * 2 + 3 * 3
    cuts = [*ends, *((a + b) // 2 for a, b in pairwise(ends))]
    for cut in sorted(cuts):
        path = tmp_path / f"at-{cut}.h5"
        journal_path(path).write_bytes(data[:cut])
        before = [r for r in read_records(journal_path(path))[1] if isinstance(r, PositionRecord)]
        world = memory.World()
        resume_scan(path, memory.rig(world), source=SHORT()).run()
        scan = gonio.load(path)
        assert asked_for(scan) == asked_for(expected), cut
        np.testing.assert_allclose(scan.r, expected.r, rtol=1e-12)
        assert (scan.n_planned, scan.finished) == (5, True)
        assert sum(a.startswith("measure sample") for a in world.log) == 5 - len(before), cut
        with h5py.File(path) as file, h5py.File(expected.path) as other:
            for name in ("theta_i_set", "theta_mes_set", "polarization", "quality", "averages", "position"):
                np.testing.assert_array_equal(file[f"entry/data/{name}"], other[f"entry/data/{name}"])
            for name in ("when", "kind", "polarization"):
                np.testing.assert_array_equal(
                    file[f"entry/references/{name}"], other[f"entry/references/{name}"]
                )


def test_a_source_is_shown_the_same_bits_after_a_resume(memory: ModuleType, tmp_path: Path) -> None:
    drift = {"noise_full": 1e-3, "noise_dark_v": 1e-5, "gain_drift_s": 1e-4, "dark_drift_v_s": 1e-6}
    path, first, second = tmp_path / "scan.h5", Walker(), Walker()
    stopped(memory, path, 5, first, **drift)
    shown = np.stack([found.r for found in first.shown[-1]])
    assert len(shown) == 4, "with references before the last"
    np.testing.assert_allclose(gonio.load(path).r[:4], shown, rtol=1e-13)
    resume_scan(path, memory.rig(memory.World(**drift)), source=second).run()
    for seen in second.shown:
        for before, after in zip(first.shown[-1], seen, strict=False):
            assert same_bits(before, after)
    with h5py.File(path) as file:
        now = file["entry/data/r"][...]
    shown = np.stack([found.r for found in second.shown[-1]])
    assert np.all(np.abs(now / shown - 1.0) < 0.2)
    assert np.any(now != shown), "the references at the end refine the file, not what the source saw"


def test_what_a_source_is_shown_it_cannot_change(memory: ModuleType, tmp_path: Path) -> None:
    class Vandal(Walker):
        def next(self, measured: Sequence[Measured]) -> Position | None:
            if measured:
                measured[0].r[0] = 1.0
            return super().next(measured)

    with pytest.raises(RefusedError, match=r"failed at position 2 \(ValueError: .*read-only\).*--resume"):
        whole(memory, tmp_path / "scan.h5", Vandal())
    resume_scan(tmp_path / "scan.h5", memory.rig(), source=Walker()).run()
    assert gonio.load(tmp_path / "scan.h5").n_planned == 8


@dataclass
class Wrong(Walker):
    """Asks for something else once, at the fifth position."""

    instead: Any = None

    def next(self, measured: Sequence[Measured]) -> Position | None:
        right = super().next(measured)
        return self.instead(right) if len(measured) == 4 else right


REFUSED: list[tuple[Callable[[Position], Any], str]] = [
    (lambda p: Position(4, 20.0, 12.0, "s"), "asks for position 5 .*blind zone"),
    (lambda p: Position(4, 20.0, float("nan"), "s"), "asks for position 5 "),
    (lambda p: Position(4, 20.0, -40.0, "s"), "asks for position 5 .*blind zone"),
    (lambda p: Position(7, 20.0, 40.0, "s"), "gave number 7 where 4 is next"),
    (lambda p: Position(4, 20.0, 40.0, "x"), "polarization 'x' at position 5"),  # type: ignore[arg-type]
    (lambda p: (4, 20.0, 40.0, "s"), "must give a gonio.plan.Position"),
    (lambda p: 1 / 0, "failed at position 5 .ZeroDivisionError"),
]


@pytest.mark.parametrize(("instead", "words"), REFUSED)
def test_a_refused_decision_ends_the_scan_and_loses_nothing(
    memory: ModuleType, tmp_path: Path, instead: Any, words: str
) -> None:
    path = tmp_path / "scan.h5"
    runner = Runner(memory.rig(), PLAN, path, source=Wrong(instead=instead), policy=ABORT)
    with pytest.raises(RefusedError, match=words + r"(.|\n)*everything measured is kept"):
        runner.run()
    assert runner.state is State.FAILED
    so_far = gonio.load(path)
    assert (len(so_far.position), so_far.n_planned, so_far.finished) == (4, 12, False)
    resume_scan(path, memory.rig(), source=Walker()).run()
    assert asked_for(gonio.load(path)) == asked_for(whole(memory, tmp_path / "whole.h5"))


def test_more_than_announced_is_refused(memory: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="asks for position 4, more than its max_positions = 3"):
        whole(memory, tmp_path / "scan.h5", Walker(max_positions=3))
    assert len(gonio.load(tmp_path / "scan.h5").position) == 3


def test_a_refused_decision_may_pause_until_the_source_is_mended(memory: ModuleType, tmp_path: Path) -> None:
    path, source = tmp_path / "scan.h5", Wrong(instead=lambda p: Position(4, 20.0, 12.0, "s"))
    told: list[str] = []

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.state is State.PAUSED:
            told.append(snapshot.message)
            source.instead = lambda position: position
            runner.resume()

    runner = Runner(
        memory.rig(), PLAN, path, source=source, on_snapshot=on_snapshot, policy=FaultPolicy(then="pause")
    )
    runner.run()
    assert len(told) == 1
    assert "blind zone" in told[0]
    assert "shutter closed" in told[0]
    assert asked_for(gonio.load(path)) == asked_for(whole(memory, tmp_path / "whole.h5"))


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (Wrong(instead=None, count=0), "asks for no position at all"),
        (Walker(max_positions=0), "max_positions = 0; give 1 to 1000000"),
        (Walker(max_positions=2_000_000), "max_positions = 2000000; give 1 to 1000000"),
        (PlanSource((Position(0, 20.0, 5.0, "s"),)), "blind zone"),
        (PlanSource((Position(0, 20.0, -40.0, "s"),)), "blind zone"),  # on the way from the baseline
        (None, r'\[source\] name = "python"\); give Runner or resume_scan a source'),
    ],
)
def test_what_can_be_known_before_makes_no_file_and_moves_nothing(
    memory: ModuleType, tmp_path: Path, source: Any, words: str
) -> None:
    world = memory.World()
    with pytest.raises(RefusedError, match=words):
        Runner(memory.rig(world), PLAN, tmp_path / "scan.h5", source=source).run()
    assert list(tmp_path.iterdir()) == []
    assert not any(action.startswith("start") for action in world.log)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (
            Walker(salt=1),
            r"gives theta_i = .* for position 1, which was measured at .*; resume the scan with",
        ),
        (Walker(count=2), r"gives no position for position 3, which was measured at"),
        (PlanSource((Position(0, 20.0, 40.0, "s"),)), "begun with the source of positions walker, not with"),
        (Walker(max_positions=13), "may ask for 13 positions, and the scan was begun with room for 12"),
        (
            None,
            "leaves its positions to the script|begun with the source of positions walker; resume it with",
        ),
    ],
)
def test_another_source_is_refused_on_resuming(
    memory: ModuleType, tmp_path: Path, source: Any, words: str
) -> None:
    path = tmp_path / "scan.h5"
    stopped(memory, path, 5)
    kept = journal_path(path).read_bytes()
    with pytest.raises((StoreError, RefusedError), match=words):
        resume_scan(path, memory.rig(), source=source).run()
    assert journal_path(path).read_bytes() == kept
    resume_scan(path, memory.rig(), source=Walker()).run()
    assert gonio.load(path).n_planned == 8


def test_a_source_that_cannot_be_asked_again_goes_on_from_what_was_measured(
    memory: ModuleType, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"
    stopped(memory, path, 5)
    before = gonio.load(path)
    other = Walker(salt=1)
    other.name = "other"  # type: ignore[misc]
    resume_scan(path, memory.rig(), source=other, ask_again=False).run()
    scan = gonio.load(path)
    assert asked_for(scan)[:5] == asked_for(before)
    assert len(scan.position) == 8
    assert any("source of positions other" in message and "walker" in message for message in events(path))


def test_a_scan_of_a_plan_is_not_resumed_with_a_source(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "scan.h5"

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == 3:
            runner.stop()

    runner = Runner(memory.rig(), plan, path, on_snapshot=on_snapshot)
    with pytest.raises(ScanStopped):
        runner.run()
    with pytest.raises(StoreError, match="begun without a source of positions"):
        resume_scan(path, memory.rig(), source=PlanSource.of(plan)).run()
    resume_scan(path, memory.rig()).run()


def test_it_can_be_read_while_it_runs(memory: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    seen: list[tuple[int, int, bool]] = []

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.state is State.RUNNING and snapshot.done in (1, 4) and snapshot.wavelength_nm is None:
            scan = gonio.load(path)
            truth = memory.true_r(scan.theta_i_deg, scan.theta_mes_deg, scan.polarization, scan.wavelength_nm)
            np.testing.assert_allclose(scan.r, truth, rtol=1e-9)
            seen.append((len(scan.position), scan.n_planned, scan.finished))

    Runner(memory.rig(), PLAN, path, source=Walker(), on_snapshot=on_snapshot).run()
    assert set(seen) == {(1, 12, False), (4, 12, False)}


def test_a_skipped_position_is_shown_as_nan(memory: ModuleType, tmp_path: Path) -> None:
    path, world, source = tmp_path / "scan.h5", memory.World(), Walker()

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.done == 2 and snapshot.wavelength_nm is None:
            world.fail["measure"] = MotionError("theta_i", "is stuck", "free it")

    policy = FaultPolicy(retries=0, then="skip")
    runner = Runner(memory.rig(world), PLAN, path, source=source, on_snapshot=on_snapshot, policy=policy)
    runner.run()
    last = source.shown[-1]
    assert len(last) == 8
    assert np.all(np.isnan(last[2].r) & np.isnan(last[2].r_sd))
    assert np.all(last[2].quality & np.uint16(Quality.SKIPPED))
    assert np.isnan(last[2].theta_i_deg)
    assert all(np.all(np.isfinite(found.r)) for found in last if found.position.index != 2)
    assert main(["check", str(path)]) == 0
    assert gonio.load(path).n_planned == 8


@pytest.mark.parametrize("kind", [DecisionRecord, PositionRecord])
def test_a_disk_that_will_not_take_it_pauses_and_keeps_it_once(
    memory: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: type
) -> None:
    path, write = tmp_path / "scan.h5", Journal.write
    refused: list[Any] = []

    def full(journal: Journal, record: Any) -> None:
        if isinstance(record, kind) and record.index == 3 and not refused:  # type: ignore[attr-defined]
            refused.append(record)
            raise StoreError("no space left")
        write(journal, record)

    def on_snapshot(snapshot: Snapshot) -> None:
        if snapshot.state is State.PAUSED:
            assert "no space left" in snapshot.message
            runner.resume()

    monkeypatch.setattr(Journal, "write", full)
    runner = Runner(
        memory.rig(), PLAN, path, source=Walker(), on_snapshot=on_snapshot, policy=FaultPolicy(then="pause")
    )
    runner.run()
    assert len(refused) == 1
    assert asked_for(gonio.load(path)) == asked_for(whole(memory, tmp_path / "whole.h5"))


@pytest.mark.parametrize("kind", ["decision", "position"])
def test_a_record_damaged_by_the_disk_is_decided_or_measured_again(
    memory: ModuleType, tmp_path: Path, journal_of_a_scan: tuple[bytes, Any], kind: str
) -> None:
    data, expected = journal_of_a_scan
    start = data.index(f'{{"record": "{kind}", "index": 3'.encode())
    bad = bytearray(data)
    bad[start + 3] ^= 0xFF
    path = tmp_path / "scan.h5"
    journal_path(path).write_bytes(bytes(bad))
    assert len(gonio.load(path).position) == 4, "a reading nobody asked for means nothing"
    world = memory.World()
    resume_scan(path, memory.rig(world), source=SHORT()).run()
    scan = gonio.load(path)
    assert asked_for(scan) == asked_for(expected)
    np.testing.assert_allclose(scan.r, expected.r, rtol=1e-12)
    assert sum(action.startswith("measure sample") for action in world.log) == 1


@pytest.mark.parametrize(
    "decision",
    [
        DecisionRecord(12, 20.0, 40.0, "s"),
        DecisionRecord(1, float("inf"), 40.0, "s"),
        DecisionRecord(1, 20.0, 40.0, "q"),  # type: ignore[arg-type]
    ],
)
def test_a_decision_made_by_hand_is_refused(
    memory: ModuleType, tmp_path: Path, journal_of_a_scan: tuple[bytes, Any], decision: DecisionRecord
) -> None:
    data, _ = journal_of_a_scan
    path = tmp_path / "scan.h5"
    journal_path(path).write_bytes(data[: next(frames(data))[0]] + encode(decision))
    with pytest.raises(StoreError, match="holds a record that this version of gonio does not know"):
        resume_scan(path, memory.rig(), source=Walker()).run()

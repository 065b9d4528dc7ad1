"""A queue of scans: what is measured, skipped, gone on with and asked for; and what stands in the way."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

import gonio
from gonio.acquire import Runner, Snapshot, resume_scan
from gonio.acquire.journal import journal_path
from gonio.acquire.queue import Answer, QueuedScan, ScanQueue, Standing
from gonio.acquire.queue_file import load_queue
from gonio.errors import ConfigError, DeviceError, RefusedError, ScanStopped

QUEUE = """
title = "two panels"
[[scans]]
sample = "white"
plan = "plan.toml"
output = "white.h5"
[[scans]]
sample = "white"
plan = "plan.toml"
output = "white-again.h5"
[[scans]]
sample = "grey"
description = "as delivered"
plan = "plan.toml"
output = "grey.h5"
"""


@pytest.fixture
def folder(memory: ModuleType, tmp_path: Path) -> Path:
    (tmp_path / "plan.toml").write_text(memory.PLAN_TOML, encoding="utf-8")
    (tmp_path / "queue.toml").write_text(QUEUE, encoding="utf-8")
    return tmp_path


class Bench:
    """Measures the scans of a queue on the bench in memory, and notes which."""

    def __init__(self, memory: ModuleType) -> None:
        self.memory = memory
        self.seen: list[tuple[str, bool]] = []
        self.stop_in = ""
        self.fail_in = ""

    def __call__(self, scan: QueuedScan, goes_on: bool) -> None:
        self.seen.append((scan.output.name, goes_on))
        world = self.memory.World()
        if scan.output.name == self.fail_in:
            world.fail["measure"] = DeviceError("lockin", "does not answer", "switch it on")
        rig = self.memory.rig(world)

        def on_snapshot(snapshot: Snapshot) -> None:
            if scan.output.name == self.stop_in and snapshot.done == 4:
                runner.stop()

        from gonio.acquire import FaultPolicy

        policy = FaultPolicy(retries=0)
        if goes_on:
            runner = resume_scan(scan.output, rig, on_snapshot=on_snapshot, policy=policy)
        else:
            runner = Runner(rig, scan.plan, scan.output, on_snapshot=on_snapshot, policy=policy)
        runner.run()


@pytest.fixture
def bench(memory: ModuleType) -> Bench:
    return Bench(memory)


def answers(*given: Answer) -> tuple[Callable[[QueuedScan], Answer], list[str]]:
    asked: list[str] = []
    left = list(given)

    def ask(scan: QueuedScan) -> Answer:
        asked.append(scan.output.name)
        return left.pop(0)

    return ask, asked


def test_all_are_measured_and_the_operator_is_asked_only_for_another_sample(
    memory: ModuleType, bench: Bench, folder: Path
) -> None:
    queue, _ = ScanQueue.load(folder / "queue.toml")
    ask, asked = answers("go")
    results = queue.run(memory.config(), bench, ask=ask)
    assert asked == ["grey.h5"]
    assert [r.standing for r in results] == ["done"] * 3
    assert [(r.positions, r.planned, r.wavelengths, r.flagged) for r in results] == [(10, 10, 5, 0)] * 3
    scan = gonio.load(folder / "grey.h5")
    assert scan.finished
    assert scan.sample_name == "grey"
    summary = json.loads((folder / "queue-summary.json").read_text(encoding="utf-8"))
    assert summary["title"] == "two panels"
    assert [entry["sample"] for entry in summary["scans"]] == ["white", "white", "grey"]
    assert all(entry["standing"] == "done" for entry in summary["scans"])
    # once more: nothing is left to do, and nobody is asked
    ask, asked = answers()
    assert [r.standing for r in queue.run(memory.config(), bench, ask=ask)] == ["done"] * 3
    assert asked == []
    assert len(bench.seen) == 3


def test_a_queue_that_was_stopped_goes_on_with_the_scan_and_the_rest(
    memory: ModuleType, bench: Bench, folder: Path
) -> None:
    queue, _ = ScanQueue.load(folder / "queue.toml")
    bench.stop_in = "white-again.h5"
    with pytest.raises(ScanStopped):
        queue.run(memory.config(), bench)
    assert [r.standing for r in queue.results(memory.config())] == ["done", "stopped", "waiting"]
    assert [r.positions for r in queue.results(memory.config())] == [10, 4, 0]
    bench.stop_in = ""
    ask, asked = answers("go")
    again, _ = ScanQueue.load(folder / "queue.toml")
    assert again.standing(again.scans[1], memory.config()) is Standing.UNFINISHED
    results = again.run(memory.config(), bench, ask=ask)
    assert [r.standing for r in results] == ["done"] * 3
    assert bench.seen[2:] == [("white-again.h5", True), ("grey.h5", False)]
    assert asked == ["grey.h5"]  # the half-measured sample is still in


@pytest.mark.parametrize(("then", "expected"), [("stop", "waiting"), ("next", "done")])
def test_when_one_fails(memory: ModuleType, bench: Bench, folder: Path, then: str, expected: str) -> None:
    (folder / "queue.toml").write_text(f'when_one_fails = "{then}"\n{QUEUE}', encoding="utf-8")
    queue, _ = ScanQueue.load(folder / "queue.toml")
    bench.fail_in = "white.h5"
    results = queue.run(memory.config(), bench)
    assert [r.standing for r in results] == ["failed", expected, expected]
    assert "lockin does not answer" in results[0].message.replace(":", "")
    bench.fail_in = ""
    assert [r.standing for r in queue.run(memory.config(), bench)] == ["done"] * 3


def test_the_operator_skips_one_and_ends_the_queue(memory: ModuleType, bench: Bench, folder: Path) -> None:
    (folder / "queue.toml").write_text(
        QUEUE + '[[scans]]\nsample = "black"\nplan = "plan.toml"\noutput = "black.h5"\n', encoding="utf-8"
    )
    queue, _ = ScanQueue.load(folder / "queue.toml")
    ask, asked = answers("skip", "stop")
    results = queue.run(memory.config(), bench, ask=ask)
    assert asked == ["grey.h5", "black.h5"]
    assert [r.standing for r in results] == ["done", "done", "skipped", "skipped"]
    ask, asked = answers("go", "go")
    assert [r.standing for r in queue.run(memory.config(), bench, ask=ask)] == ["done"] * 4


def test_what_stands_in_the_way_is_said_before_anything_is_measured(
    memory: ModuleType, bench: Bench, folder: Path
) -> None:
    refused = memory.PLAN_TOML.replace("15.0, 30.0", "12.0, 30.0")
    (folder / "refused.toml").write_text(refused, encoding="utf-8")
    (folder / "queue.toml").write_text(
        QUEUE
        + '[[scans]]\nsample = "black"\nplan = "refused.toml"\noutput = "black.h5"\n'
        + '[[scans]]\nsample = "blue"\nplan = "plan.toml"\noutput = "nowhere/blue.h5"\n'
        + '[[scans]]\nsample = "red"\nplan = "plan.toml"\noutput = "red.h5"\n',
        encoding="utf-8",
    )
    (folder / "red.h5").write_bytes(b"no HDF5 at all")
    queue, _ = ScanQueue.load(folder / "queue.toml")
    problems = "\n".join(queue.check(memory.config()))
    assert "black: position 1 (theta_i = 20 deg, theta_mes = 12 deg, s)" in problems
    assert "blue: the folder" in problems
    assert "red: " in problems
    assert "red.h5" in problems
    with pytest.raises(RefusedError, match="the queue cannot be run:"):
        queue.run(memory.config(), bench)
    assert bench.seen == []


def test_a_file_of_another_sample_or_plan_is_not_taken_for_done(
    memory: ModuleType, bench: Bench, folder: Path
) -> None:
    queue, _ = ScanQueue.load(folder / "queue.toml")
    queue.run(memory.config(), bench)
    (folder / "queue.toml").write_text(QUEUE.replace('"grey"', '"gray"'), encoding="utf-8")
    changed, _ = ScanQueue.load(folder / "queue.toml")
    (problem,) = changed.check(memory.config())
    assert "holds a scan of 'grey', not of 'gray'" in problem
    (folder / "queue.toml").write_text(QUEUE, encoding="utf-8")
    (folder / "plan.toml").write_text(
        memory.PLAN_TOML.replace("step = 60.0", "step = 30.0"), encoding="utf-8"
    )
    changed, _ = ScanQueue.load(folder / "queue.toml")
    assert all("measured with another plan" in problem for problem in changed.check(memory.config()))
    assert not journal_path(folder / "grey.h5").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("white-again.h5", "white.h5"), r"scans\[2\] output = 'white.h5' is that of 'white' too"),
        (("grey.h5", "grey.hdf"), r"scans\[3\] output = 'grey.hdf': give a name ending in .h5"),
        (('sample = "grey"\n', ""), "sample"),
        (("title", "titel"), "did you mean 'title'"),
        (("[[scans]]", "[[scan]]"), "scans"),
        (('plan = "plan.toml"', 'plan = "missing.toml"'), "missing.toml: there is no such file"),
        (('title = "two panels"', 'when_one_fails = "perhaps"'), "'stop' or 'next'"),
    ],
)
def test_mistakes_of_the_file_are_explained(folder: Path, change: tuple[str, str], message: str) -> None:
    (folder / "queue.toml").write_text(QUEUE.replace(*change), encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        load_queue(folder / "queue.toml")

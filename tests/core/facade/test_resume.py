"""A run that was stopped, or finished too early, goes on to the bits of one that was not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.errors import SceneError
from gonio.facade import CONTRIBUTIONS, Irradiance, Optics, Scene, load_irradiance, simulate
from gonio.facade.engine import Engine
from gonio.facade.state_file import Checkpoints

GLOSSY = Optics(0.6, 1.0, 80.0, 1.5)


class Stop:
    """Raise Ctrl-C at a given report of progress."""

    def __init__(self, after: int) -> None:
        self.left = after

    def __call__(self, _done: float, _text: str) -> None:
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt


@pytest.fixture
def scene(canyon: Callable[..., Scene]) -> Scene:
    return canyon(wall=GLOSSY, dni=800.0, dhi=100.0, rows=3, columns=2)


def same_bits(a: Irradiance, b: Irradiance) -> bool:
    """Compare everything that rays decide."""
    pairs = []
    for x, y in zip(a.receivers, b.receivers, strict=True):
        for k in CONTRIBUTIONS:
            pairs += [(x.contributions[k], y.contributions[k])]
            pairs += [(x.mean_contributions[k], y.mean_contributions[k])]
        pairs += [(x.total, y.total), (x.mean, y.mean)]
    arrays = all(
        np.array_equal(p.value, q.value) and np.array_equal(p.standard_error, q.standard_error)
        for p, q in pairs
    )
    return arrays and (a.rays, a.energy, a.relative_error) == (b.rays, b.energy, b.relative_error)


@pytest.mark.parametrize("estimator", ["paths", "backward"])
def test_a_stopped_run_goes_on_to_the_same_bits(
    scene: Scene, tmp_path: Path, estimator: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    # batches so small that a round has several: stopped between rounds, and in the middle of one
    monkeypatch.setattr("gonio.facade.paths._BATCH", 1 << 12)
    asked: dict[str, Any] = {"rel_tol": 0.01, "seed": 3, "estimator": estimator}
    simulate(scene, rel_tol=0.5, estimator=estimator)  # compiled from here on, which is reported only once
    reports: list[str] = []
    through = simulate(scene, **asked, progress=lambda _done, text: reports.append(text))
    assert not through.interrupted
    assert len(reports) > 8
    rays = []
    for after in (len(reports) - 5, len(reports) - 1):
        stopped = simulate(scene, **asked, progress=Stop(after))
        assert stopped.interrupted
        assert "INTERRUPTED" in stopped.table()
        rays.append(stopped.rays)
        stopped.save(tmp_path / "part.h5")
        kept = load_irradiance(tmp_path / "part.h5")
        assert kept.interrupted
        again = simulate(scene, **asked, threads=1, state=kept.state)
        assert same_bits(through, again)
        assert again.duration_s > stopped.duration_s
    assert 0 < rays[0] < rays[1] <= through.rays


@pytest.mark.parametrize("lights", [900.0, 0.0])
def test_rows_stopped_anywhere_go_on_to_the_same_bits(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lights: float
) -> None:
    scene = replace(scene, dni_w_m2=lights)
    asked: dict[str, Any] = {"rel_tol": 0.002, "seed": 3, "estimator": "rows", "full": True}
    calls = 0
    stop_at = -1
    add = Engine._add

    def counted(self: Engine, *arguments: Any) -> None:
        nonlocal calls
        calls += 1
        if calls == stop_at:
            raise KeyboardInterrupt
        add(self, *arguments)

    monkeypatch.setattr(Engine, "_add", counted)
    through = simulate(scene, **asked)
    every = calls
    stopped_runs = 0
    for stop_at in range(1, every + 1):
        calls = 0
        try:
            stopped = simulate(scene, **asked)
        except KeyboardInterrupt:
            assert stop_at <= 8  # before every part has its first points there is nothing to keep
            continue
        assert stopped.interrupted
        stopped_runs += 1
        stopped.save(tmp_path / "part.h5")
        calls, kept = every + 1, load_irradiance(tmp_path / "part.h5")
        assert same_bits(through, simulate(scene, **asked, threads=1, state=kept.state)), stop_at
    assert stopped_runs >= 3


def test_a_finished_result_is_tightened_to_the_same_bits(scene: Scene) -> None:
    coarse = simulate(scene, rel_tol=0.05, seed=7, full=True, estimator="paths")
    fine = simulate(scene, rel_tol=0.01, seed=7, full=True, estimator="paths")
    again = simulate(scene, rel_tol=0.01, seed=7, full=True, estimator="paths", state=coarse.state)
    assert coarse.rays < fine.rays
    assert same_bits(fine, again)


def test_points_of_another_run_are_refused(scene: Scene) -> None:
    state = simulate(scene, rel_tol=0.2, seed=7).state
    assert state is not None
    others = [
        (scene, 8, "auto"),
        (scene, 7, "backward"),
        (replace(scene, dni_w_m2=801.0), 7, "auto"),
        (replace(scene, materials={**scene.materials, "right": Optics(0.6, 1.0, 81.0, 1.5)}), 7, "auto"),
    ]
    for other, seed, estimator in others:
        with pytest.raises(SceneError, match="do not belong to this run"):
            simulate(other, rel_tol=0.2, seed=seed, estimator=estimator, state=state)  # type: ignore[arg-type]


def test_before_the_first_result_an_interrupt_passes_through(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gonio.facade.paths._BATCH", 1 << 10)  # stopped with no photon under way yet
    with pytest.raises(KeyboardInterrupt):
        simulate(scene, estimator="paths", progress=Stop(2))


def test_checkpoints_are_whole_results_to_go_on_with(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gonio.facade.paths._BATCH", 1 << 13)
    path = tmp_path / "out.h5"
    kept: list[Irradiance] = []

    def prepare(irradiance: Irradiance) -> Irradiance:
        if path.exists():
            kept.append(load_irradiance(path))
        return replace(irradiance, options={**irradiance.options, "mine": "kept"})

    checkpoints = Checkpoints(path, prepare, every_s=0.0, most_share=1.0)
    through = simulate(scene, rel_tol=0.02, seed=3, estimator="paths", checkpoint=checkpoints)
    assert checkpoints.written == len(kept) + 1 > 3
    assert list(tmp_path.iterdir()) == [path]
    for so_far in (kept[0], kept[-1]):
        assert so_far.interrupted
        assert so_far.options["mine"] == "kept"
        again = simulate(scene, rel_tol=0.02, seed=3, estimator="paths", state=so_far.state)
        assert same_bits(again, through)


def test_checkpoints_wait(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "out.h5"
    simulate(scene, rel_tol=0.05, checkpoint=Checkpoints(path))
    assert not path.exists()

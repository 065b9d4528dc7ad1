"""The state behind the window, message by message; no Qt and no bench."""

from __future__ import annotations

from pathlib import Path

import pytest

from gonio.acquire import Snapshot, State
from gonio.plan import Plan, parse_plan
from gonio.rig import RigConfig
from gonio_gui.bench_thread import AxesRead, Begun, Connected, Disconnected, Note, ScanEnded
from gonio_gui.controls import time_text
from gonio_gui.model import Model, Phase

from .conftest import at_speed


@pytest.fixture
def model(rig: RigConfig, tiny_plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Model:
    monkeypatch.chdir(tmp_path)
    return Model(rig, tiny_plan)


def snapshot(state: State = State.RUNNING, **values: object) -> Snapshot:
    fields: dict[str, object] = {
        "done": 3,
        "total": 14,
        "readings_done": 20,
        "readings_total": 60,
        "elapsed_s": 5000.0,
        "left_s": 90_000.0,
    }
    return Snapshot(state, **(fields | values))  # type: ignore[arg-type]


def test_connection(model: Model) -> None:
    model.apply(Connected({"stage": "Zaber"}))
    assert model.phase is Phase.READY
    model.apply(AxesRead(1.5, 180.0))
    assert (model.theta_i_deg, model.theta_mes_deg) == (1.5, 180.0)
    model.apply(Disconnected("stage: nobody answers"))
    assert model.phase is Phase.OFFLINE
    assert model.theta_i_deg != model.theta_i_deg
    assert model.banner is not None
    assert "nobody answers" in model.banner.text


def test_a_pause_asked_for_is_not_forgotten_by_the_next_snapshot(model: Model) -> None:
    model.apply(snapshot())
    assert model.phase is Phase.RUNNING
    model.phase = Phase.PAUSING
    model.apply(snapshot())
    assert model.phase is Phase.PAUSING
    model.apply(snapshot(State.PAUSED))
    assert model.phase is Phase.PAUSED


def test_a_fault_that_pauses_the_scan_stands_in_the_banner(model: Model) -> None:
    model.apply(snapshot())
    told = "theta_i: stalled (FS); free the axis; motors at rest, shutter closed"
    model.apply(snapshot(State.PAUSED, message=told))
    assert model.phase is Phase.PAUSED
    assert model.banner is not None
    assert told in model.banner.text
    assert model.banner.text.endswith("Mend it, then Resume.")


def test_a_pause_by_the_operator_needs_no_banner(model: Model) -> None:
    model.banner = None
    model.apply(snapshot(State.PAUSED, message="paused by the operator; motors at rest, shutter closed"))
    assert model.banner is None


def test_stopping_lasts_until_the_thread_says_so(model: Model, tmp_path: Path) -> None:
    model.phase = Phase.STOPPING
    model.apply(snapshot(State.IDLE))
    assert model.phase is Phase.STOPPING
    model.apply(ScanEnded(tmp_path / "x.h5", "stopped", "the scan was stopped"))
    assert model.phase is Phase.READY


def test_between_two_steps_the_display_keeps_the_last(model: Model) -> None:
    model.apply(snapshot(position=4, polarization="p", wavelength_nm=900.0))
    model.apply(snapshot(position=None, polarization=None, wavelength_nm=None))
    assert model.snapshot is not None
    assert (model.snapshot.position, model.snapshot.polarization) == (4, "p")
    model.apply(snapshot(position=None, polarization=None, wavelength_nm=450.0))  # a dark reading
    assert model.snapshot.position is None


def test_time_is_told_in_the_users_seconds_and_the_benchs(model: Model) -> None:
    model.rig = at_speed(1000.0)
    model.apply(snapshot())
    # the simulated bench runs at 1000 x: 5000 s and 90 000 s of its time are 5 s and 1 min 30 s here
    assert time_text(model) == "5.0 s elapsed   ·   about 1 min 30 s left (1 d 1 h of bench time)"


def test_before_the_start_the_estimate_is_of_bench_time(model: Model) -> None:
    assert "of bench time" in time_text(model)
    assert time_text(model).startswith("estimated ")


def test_suggested_names_are_free_and_say_the_sample(model: Model) -> None:
    first = model.suggested_path()
    assert first.name.startswith("tiny-sample-")
    first.with_name(first.name + ".journal").touch()
    assert model.suggested_path() != first


def test_after_a_finished_scan_the_next_goes_elsewhere(model: Model, tmp_path: Path) -> None:
    model.path = tmp_path / "mine.h5"
    model.path.touch()
    model.apply(ScanEnded(model.path, "done", "stored"))
    assert model.path != tmp_path / "mine.h5"
    assert model.banner is not None
    assert str(tmp_path / "mine.h5") in model.banner.text


def test_a_resumed_scan_brings_its_own_plan(model: Model, tiny_plan: Plan, tmp_path: Path) -> None:
    model.set_plan(Plan.paper())
    model.apply(Begun(tiny_plan, tmp_path / "x.h5"))
    assert model.plan == tiny_plan
    assert model.live is not None
    assert model.live.plan == tiny_plan


def test_refused_positions_are_known_before_anything_moves(rig: RigConfig, tmp_path: Path) -> None:
    plan = parse_plan(
        "[[wavelengths]]\nvalues_nm = [550.0]\n[[sweeps]]\ntheta_i_deg = 20.0\ntheta_mes_deg = [12.0, 30.0]\n"
    )
    model = Model(rig, plan, tmp_path / "x.h5")
    assert {r.position.index for r in model.refusals if r.position} == {0, 2}
    assert "blind zone" in str(model.refusals[0])
    model.apply(Connected({}))  # the connection changes nothing about it
    assert model.banner is not None
    assert "blind zone" in model.banner.text


def test_a_wavelength_without_a_detector_leaves_no_plot_but_a_reason(rig: RigConfig, tmp_path: Path) -> None:
    plan = parse_plan(
        "[[wavelengths]]\nvalues_nm = [2500.0]\n[[sweeps]]\ntheta_i_deg = 20.0\ntheta_mes_deg = [30.0]\n"
    )
    model = Model(rig, plan, tmp_path / "x.h5")
    assert model.live is None
    assert "2500" in str(model.refusals[0])


def test_errors_reach_the_banner_and_all_reach_the_log(model: Model) -> None:
    model.apply(Note("info", "stop", "all motion stopped"))
    assert model.banner is None
    model.apply(Note("error", "bench", "no answer"))
    assert model.banner is not None
    assert [line.text for line in model.log] == ["all motion stopped", "no answer"]

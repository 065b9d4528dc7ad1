"""`gonio plan`: what is said of a scan before it begins, and how near the estimate comes to the scan."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from gonio.acquire import Runner
from gonio.acquire.latencies import measured_latency
from gonio.bench_process import served
from gonio.cli.main import main
from gonio.plan import parse_plan, timetable
from gonio.rig import default_rig_text, load_rig, open_rig, parse_rig

EXAMPLES = Path(__file__).parents[3] / "examples/plans"

SMALL = """
[[wavelengths]]
values_nm = [550.0, 600.0]
[[sweeps]]
theta_i_deg = 30.0
theta_mes_deg = [40.0, 60.0, 80.0]
[references]
averages = 2
"""


def test_an_allowed_plan_is_counted_timed_and_compared_with_other_orders(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["plan", str(EXAMPLES / "complete.toml")]) == 0
    text = capsys.readouterr().out
    assert "118 positions (each 2 times), 42 wavelengths, rig 'arta-simulated'" in text
    assert "2 dark and" in text
    assert "45 columns, 3 wavelengths with both detectors; averages 2, 4, 8" in text
    assert "of real time at 4000 x" in text
    assert "the plan's  serpentine" in text or "the plan's  nested" in text  # optimised, as found
    assert "put into the plan" not in text  # nothing is faster than the optimised order


def test_the_saving_of_the_best_order_is_printed_as_toml_that_a_plan_takes(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["plan", str(EXAMPLES / "hpl.toml")]) == 0
    text = capsys.readouterr().out
    order = text[text.index("[order]") :]
    hpl = (EXAMPLES / "hpl.toml").read_text(encoding="utf-8")
    better, own = parse_plan(f"{hpl}\n{order}"), parse_plan(hpl)
    assert better.order.alternate_wavelengths
    rig = load_rig()
    assert timetable(better, rig).instrument_s < 0.9 * timetable(own, rig).instrument_s


def test_a_refused_plan_is_explained_and_exits_1(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(SMALL.replace("40.0", "12.0"), encoding="utf-8")
    assert main(["plan", str(path)]) == 1
    said = capsys.readouterr().err
    assert "refused: position 1 (theta_i = 30 deg, theta_mes = 12 deg, s)" in said
    assert "start the sweep at 15" in said
    assert "2 refused" in said


def test_the_estimate_is_near_the_scan(tmp_path: Path) -> None:
    """A generous bound: a loaded computer takes longer over the wires than when they were measured."""
    rig = parse_rig(default_rig_text().replace("clock_speed = 4000.0", "clock_speed = 60.0"))
    plan = parse_plan(SMALL)
    with served(rig) as reachable, open_rig(reachable) as connected:
        latency = measured_latency(connected, plan, tmp_path)
        assert list(tmp_path.iterdir()) == []  # the file it measured the disk with is gone
        assert min(latency.stage_s, latency.record_s) > 0.0
        connected.move_to(rig.baseline.theta_i_deg, rig.baseline.theta_mes_deg)
        Runner(connected, plan, tmp_path / "scan.h5").run()
    with h5py.File(tmp_path / "scan.h5") as file:
        measured_s = float(np.max(file["entry/references/time"][...]))
    table = timetable(plan, rig.model_copy(update={"latency": latency}))
    assert table.instrument_s < 1.05 * measured_s
    assert table.total_s > 0.7 * measured_s


def test_a_plan_whose_positions_are_chosen_on_the_way_says_so(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    plan = tmp_path / "chosen.toml"
    plan.write_text('[[wavelengths]]\nvalues_nm = [550.0]\n[source]\nname = "python"\n', encoding="utf-8")
    assert main(["plan", str(plan)]) == 0
    text = capsys.readouterr().out
    assert "the positions come from the source 'python' while the scan runs" in text
    assert "order" not in text

"""References between positions, columns of two detectors, passes to and fro: what is done when, and its
time.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.latency import LatencyConfig
from gonio.plan import Plan, Position, channels, check, estimate, parse_plan, timetable
from gonio.plan.check import bytes_needed, refused_room
from gonio.plan.motion import legs_deg
from gonio.plan.timetable import PlannedReference
from gonio.rig import AxisConfig, BaselineConfig, RigConfig, load_rig

PLAN = """
{top}
[[wavelengths]]
start_nm = 830.0
stop_nm = 900.0
step_nm = 10.0
[[sweeps]]
theta_i_deg = 20.0
theta_mes_deg = [15.0, 30.0, 45.0, 60.0]
{more}
"""


def a_plan(more: str = "", top: str = "") -> Plan:
    return parse_plan(PLAN.format(top=top, more=more))


def tasks(plan: Plan, rig: RigConfig) -> list[str]:
    return [
        f"{task.kind} {task.when} {task.polarization}"
        if isinstance(task := step.task, PlannedReference)
        else f"position {task.index}"
        for step in timetable(plan, rig).steps
    ]


def test_references_every_so_many_positions_stand_between_them(a_rig: RigConfig) -> None:
    found = tasks(a_plan("[references]\nevery_positions = 3\n"), a_rig)
    assert found[3:6] == ["position 0", "position 1", "position 2"]
    # the polarizer stands at s before position 3, which is the last in s: p first, then back
    assert found[6:9] == ["dark before 3 any", "baseline before 3 p", "baseline before 3 s"]
    # between s and p it turns once
    assert found[12:15] == ["dark before 6 any", "baseline before 6 s", "baseline before 6 p"]
    assert found[-3:] == ["dark end any", "baseline end s", "baseline end p"]
    assert len(found) == 8 + 3 + 3 + 2 * 3


def test_no_interval_between_references_is_longer_than_asked(a_rig: RigConfig) -> None:
    plan = a_plan('[references]\nevery_minutes = 0.4\nperiodic = ["baseline"]\n')
    since_s, periodic = 0.0, 0
    for step in timetable(plan, a_rig).steps:
        if isinstance(step.task, Position):
            since_s += step.instrument_s
            assert since_s <= 0.4 * 60.0 or since_s == step.instrument_s
        else:
            periodic += step.task.when.startswith("before")
            assert step.task.kind == "baseline" or not step.task.when.startswith("before")
            since_s = 0.0
    assert periodic > 0


def test_a_timetable_is_the_same_again(a_rig: RigConfig) -> None:
    plan = a_plan('[references]\nevery_minutes = 1.0\n[order]\nkind = "random"\nseed = 9\n')
    assert timetable(plan, a_rig) == timetable(parse_plan(plan.to_toml()), a_rig)


def test_the_way_to_periodic_references_is_checked(a_rig: RigConfig) -> None:
    two_sided = a_rig.model_copy(
        update={
            "stage": a_rig.stage.model_copy(
                update={"theta_mes": AxisConfig(limits_deg=(-180.0, 180.0), blind_zone_deg=15.0)}
            ),
            "baseline": BaselineConfig(theta_i_deg=90.0, theta_mes_deg=-180.0),
        }
    )
    plan = a_plan("[references]\nevery_positions = 4\n")
    reasons = [str(refusal) for refusal in check(plan, two_sided)]
    # to the first position, back and forth at the one period, back at the end
    assert [("way back" in r, "from the [baseline] position" in r) for r in reasons] == [
        (False, True), (True, False), (False, True), (True, False),
    ]  # fmt: skip


def test_overlap_measures_wavelengths_about_the_change_with_both_detectors(a_rig: RigConfig) -> None:
    columns = channels(a_plan(top="overlap_nm = 20.0"), a_rig)
    pmt = columns.wavelength_nm[columns.detector_index == 0]
    ingaas = columns.wavelength_nm[columns.detector_index == 1]
    np.testing.assert_array_equal(pmt, [830, 840, 850, 860, 870, 880])
    np.testing.assert_array_equal(ingaas, [840, 850, 860, 870, 880, 890, 900])
    assert np.all(np.diff(columns.detector_index.astype(int)) >= 0)  # one change in a pass


def test_without_overlap_every_wavelength_is_there_once(a_rig: RigConfig) -> None:
    plan = a_plan()
    columns = channels(plan, a_rig)
    np.testing.assert_array_equal(columns.wavelength_nm, plan.wavelength_nm)
    np.testing.assert_array_equal(columns.detector_index, a_rig.detector_for(plan.wavelength_nm))
    assert columns.averages_asked == 1


def test_averages_and_integration_belong_to_their_wavelengths(a_rig: RigConfig) -> None:
    text = PLAN.format(top="overlap_nm = 10.0", more="[reading]\naverages = 2\n").replace(
        "[[sweeps]]",
        "averages = 3\n[[wavelengths]]\nvalues_nm = [910.0]\nintegration_s = 4.5\n"
        "[[wavelengths]]\nvalues_nm = [920.0]\n[[sweeps]]",
    )
    columns = channels(parse_plan(text), a_rig)
    assert columns.averages.tolist() == [3] * (len(columns) - 2) + [
        5,
        2,
    ]  # one second per reading of this rig
    assert columns.averages_asked is columns.averages


def test_integration_is_filled_by_readings_as_far_apart_as_their_noise_asks() -> None:
    rig = load_rig()
    spacing_s = 0.3  # three time constants of 0.1 s
    assert [rig.spectrometer.averages_for(t) for t in (0.01, spacing_s, 0.31, 3.0)] == [1, 1, 2, 10]


def test_every_second_pass_runs_backwards_and_saves_the_way_back() -> None:
    rig = load_rig()
    plan = a_plan()
    to_and_fro = a_plan("[order]\nalternate_wavelengths = true\n")
    steps = timetable(to_and_fro, rig).steps
    assert [step.descending for step in steps] == [i % 2 == 1 for i in range(len(steps))]
    assert not any(step.descending for step in timetable(plan, rig).steps)
    assert estimate(to_and_fro, rig) < estimate(plan, rig)


def test_latencies_are_real_seconds(a_rig: RigConfig) -> None:
    plan = a_plan()
    latency = LatencyConfig(stage_s=0.1, polarizer_s=0.2, record_s=0.0)
    table = timetable(plan, a_rig.model_copy(update={"latency": latency}))
    assert table.instrument_s == timetable(plan, a_rig).instrument_s
    fast = table.__class__(table.steps, 100.0)
    assert fast.total_s == pytest.approx(table.instrument_s + 100.0 * table.real_s)
    # two axes asked at the start and at the end of each step, and the polarizer once
    assert table.real_s > len(table.steps) * (4 * 0.1 + 0.2)


def test_a_record_is_written_while_the_axes_move_on(a_rig: RigConfig) -> None:
    slow_disk = a_rig.model_copy(update={"latency": LatencyConfig(record_s=0.2)})
    for step in timetable(a_plan(), slow_disk).steps:
        assert step.real_s == (0.2 if isinstance(step.task, PlannedReference) else 0.0)


@pytest.mark.parametrize("to_deg", [-60.0, -15.0, 15.0, 15.3, 90.0, 179.8, 180.0])
@pytest.mark.parametrize("from_deg", [-90.0, 15.0, 89.7, 90.2, 91.0, 180.0])
@pytest.mark.parametrize("backlash_deg", [0.0, 0.5])
def test_legs_are_those_of_the_drivers(from_deg: float, to_deg: float, backlash_deg: float) -> None:
    from gonio_drivers.drive import approach_legs

    axis = AxisConfig(limits_deg=(-180.0, 180.0), backlash_deg=backlash_deg)
    ends = (from_deg, *approach_legs(axis, from_deg, to_deg))
    expected = [abs(b - a) for a, b in pairwise(ends)] if from_deg != to_deg else []
    assert legs_deg(axis, from_deg, to_deg) == pytest.approx(expected)


def test_room_on_the_disk_is_asked_for(a_rig: RigConfig, tmp_path: Path) -> None:
    plan = a_plan()
    needed = bytes_needed(timetable(plan, a_rig), len(channels(plan, a_rig)))
    assert 14 * 8 * 100 < needed < 2_000_000
    assert refused_room(needed, tmp_path) == ""
    refusal = refused_room(10**18, tmp_path)
    assert "1000000000000 MB" in refusal
    assert "free some space" in refusal


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("[references]\nevery_minutes = 5\nevery_positions = 5\n", "not both"),
        ("[references]\nperiodic = ['dark']\n", "add every_minutes or every_positions"),
        ("[references]\nevery_minutes = 0\n", r"every_minutes = 0"),
        ("[references]\nevery_hours = 1\n", "unknown key"),
        ("[reading]\naverages = 2\nintegration_s = 1.0\n", "not both"),
        ("[repeats]\ncount = 0\n", r"repeats.count = 0"),
    ],
)
def test_mistakes_in_schedules_are_explained(more: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        a_plan(more)


def test_an_overlap_wider_than_detectors_see_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"overlap_nm = 500"):
        a_plan(top="overlap_nm = 500.0")

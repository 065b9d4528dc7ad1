"""Refusals and the time estimate, against a rig described by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gonio.plan import Plan, check, estimate, parse_plan
from gonio.rig import (
    ApertureConfig,
    AxisConfig,
    BaselineConfig,
    DetectorConfig,
    PolarizerConfig,
    RigConfig,
    SpectrometerConfig,
    StageConfig,
)


def a_rig(
    *, theta_mes: dict[str, Any] | None = None, theta_i: dict[str, Any] | None = None, **changes: Any
) -> RigConfig:
    return RigConfig(
        **{
            "name": "bench",
            "aperture": ApertureConfig(width_mm=26.0, height_mm=18.0, distance_mm=95.0),
            "stage": StageConfig(
                driver="none",
                theta_i=AxisConfig(**{"limits_deg": (0.0, 95.0), **(theta_i or {})}),
                theta_mes=AxisConfig(
                    **{"limits_deg": (15.0, 180.0), "blind_zone_deg": 15.0, **(theta_mes or {})}
                ),
            ),
            "polarizer": PolarizerConfig(driver="none", s_deg=0.0, p_deg=90.0),
            "spectrometer": SpectrometerConfig(
                driver="none",
                detectors=(DetectorConfig(name="pmt", type="PMT", range_nm=(300.0, 860.0)),),
            ),
            **changes,
        }
    )


def a_plan(theta_mes: str, theta_i: float = 20.0, wavelengths: str = "[500.0]", more: str = "") -> Plan:
    return parse_plan(
        f"[[wavelengths]]\nvalues_nm = {wavelengths}\n"
        f"[[sweeps]]\ntheta_i_deg = {theta_i}\ntheta_mes_deg = {theta_mes}\n{more}"
    )


def test_a_plan_that_fits_is_not_refused() -> None:
    assert check(a_plan("[15.0, 180.0]"), a_rig()) == []


def test_a_position_in_the_blind_zone_is_refused_in_both_polarizations_with_its_angle() -> None:
    refusals = check(a_plan("[12.0, 15.0]"), a_rig())
    assert [r.position.index for r in refusals if r.position] == [0, 2]
    for refusal in refusals:
        assert "theta_mes = 12 deg is inside the blind zone (|theta_mes| < 15 deg)" in str(refusal)
        assert "start the sweep at 15" in refusal.reason


def test_a_position_beyond_a_limit_is_refused() -> None:
    (s, p) = check(a_plan("[181.0]"), a_rig())
    assert "outside the limits 15...180 deg of rig 'bench'" in s.reason
    assert str(p).startswith("position 2 (theta_i = 20 deg, theta_mes = 181 deg, p)")


def test_both_axes_are_named_when_both_are_wrong() -> None:
    refusal = check(a_plan("[181.0]", theta_i=-5.0), a_rig())[0]
    assert "theta_i = -5 deg" in refusal.reason
    assert "theta_mes = 181 deg" in refusal.reason


def test_each_wavelength_without_a_detector_is_refused() -> None:
    refusals = check(a_plan("[15.0]", wavelengths="[299.0, 300.0, 860.0, 861.0]"), a_rig())
    assert [r.wavelength_nm for r in refusals] == [299.0, 861.0]
    assert "299 nm is covered by no detector" in str(refusals[0])


def test_a_path_through_the_blind_zone_is_refused_though_both_ends_are_allowed() -> None:
    rig = a_rig(theta_mes={"limits_deg": (-180.0, 180.0)})
    plan = a_plan("[-20.0, 20.0]", more='[references]\nbaseline = ["start"]\ndark = ["start"]\n')
    refusals = check(plan, rig)
    reasons = [r.reason for r in refusals]
    # from the baseline at 180 to -20, from -20 to 20, back for p, and again
    assert [r.position.index for r in refusals if r.position] == [0, 1, 2, 3]
    assert all("sweeps through the blind zone" in reason for reason in reasons)
    assert "from -20 to 20 deg" in reasons[1]


def test_the_way_back_to_the_baseline_is_checked() -> None:
    rig = a_rig(theta_mes={"limits_deg": (-180.0, 180.0)})
    last = check(a_plan("[-20.0]"), rig)[-1]
    assert last.position is None
    assert "way back to the [baseline] position" in last.reason


def test_a_baseline_position_the_rig_cannot_reach_is_refused() -> None:
    (refusal,) = check(a_plan("[15.0]"), a_rig(baseline=BaselineConfig(theta_i_deg=90.0, theta_mes_deg=0.0)))
    assert "[baseline] position of the rig file" in refusal.reason
    assert "blind zone" in refusal.reason


def test_the_estimate_is_the_sum_of_passes_and_the_slower_axis_of_each_move() -> None:
    # reading_duration_s of the base model is one second per wavelength and average
    rig = a_rig(
        theta_i={"speed_deg_s": 10.0, "acceleration_deg_s2": 1e9},
        theta_mes={"speed_deg_s": 20.0, "acceleration_deg_s2": 1e9, "settle_s": 0.5},
    )
    plan = a_plan(
        "[15.0, 35.0]",
        wavelengths="[500.0, 510.0, 520.0]",
        more="[reading]\naverages = 2\n[references]\naverages = 5\n",
    )
    passes = 4 * 3 * 2 + 6 * 3 * 5
    # baseline (90, 180) to (20, 15): 7.0 s and 8.25 + 0.5 s; 20 deg: 1.5 s three times; (20, 35) back:
    # 7.0 and 7.75 s
    motion = 8.75 + 3 * 1.5 + 7.75
    turns = 6 * rig.polarizer.turn_s  # s, p for the baselines, s, p for the positions, s, p at the end
    assert estimate(plan, rig) == pytest.approx(passes + motion + turns, rel=1e-6)


def test_references_only_at_one_end_cost_only_there() -> None:
    rig = a_rig()
    both = estimate(a_plan("[15.0]"), rig)
    start = estimate(a_plan("[15.0]", more='[references]\ndark = ["start"]\nbaseline = ["start"]\n'), rig)
    back_s = max(rig.stage.theta_i.move_duration_s(70.0), rig.stage.theta_mes.move_duration_s(165.0))
    assert both - start == pytest.approx(3 * 4 * 1.0 + back_s + 2 * rig.polarizer.turn_s)


def test_the_estimate_of_the_papers_plan_is_dominated_by_its_readings() -> None:
    rig = a_rig(
        spectrometer=SpectrometerConfig(
            driver="none",
            detectors=(DetectorConfig(name="all", type="Si", range_nm=(300.0, 1500.0)),),
        )
    )
    readings_s = 292 * 121 + 4 * 121 * 4 + 2 * 121 * 16  # positions, baselines, darks
    total_s = estimate(Plan.paper(), rig)
    assert readings_s < total_s < 1.02 * readings_s
    assert np.isfinite(total_s)

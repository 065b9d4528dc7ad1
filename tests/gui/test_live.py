"""Live values against the closed form r = (V - D) / (B - D)."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.devices import Quality
from gonio.plan import Plan
from gonio.rig import RigConfig
from gonio.store.records import PositionRecord, ReferenceRecord
from gonio_gui.live import LiveScan, SweepKey, broken_at

DARK_V, FULL_V = 0.002, 0.8


def reference(kind: str, polarization: str, value_v: float, time_s: float = 0.0) -> ReferenceRecord:
    m = 3
    return ReferenceRecord(
        kind=kind,  # type: ignore[arg-type]
        when="start",
        polarization=polarization,
        theta_i_deg=90.0,
        theta_mes_deg=180.0,
        averages=2,
        unix_s=0.0,
        wavelength_nm=np.array([450.0, 550.0, 900.0]),
        signal_v=np.full(m, value_v),
        signal_sd_v=np.full(m, 1e-5),
        time_s=np.full(m, time_s),
        quality=np.zeros(m, dtype=np.uint16),
    )


def position(
    index: int, theta_i: float, theta_mes: float, pol: str, r: list[float], bad: int = 0
) -> PositionRecord:
    quality = np.zeros(3, dtype=np.uint16)
    quality[1] = bad
    return PositionRecord(
        index=index,
        polarization=pol,  # type: ignore[arg-type]
        theta_i_deg=theta_i,
        theta_mes_deg=theta_mes,
        polarizer_deg=0.0,
        averages=1,
        unix_s=0.0,
        wavelength_nm=np.array([450.0, 550.0, 900.0]),
        signal_v=DARK_V + np.array(r) * (FULL_V - DARK_V),
        signal_sd_v=np.full(3, np.nan),
        time_s=np.full(3, 10.0 + index),
        quality=quality,
    )


@pytest.fixture
def live(tiny_plan: Plan, rig: RigConfig) -> LiveScan:
    scan = LiveScan(tiny_plan, rig)
    scan.add_reference(reference("dark", "any", DARK_V))
    for polarization in ("s", "p"):
        scan.add_reference(reference("baseline", polarization, FULL_V))
    return scan


def test_r_is_signal_over_baseline_without_the_dark(live: LiveScan) -> None:
    live.add_position(position(0, 20.0, 30.0, "s", [0.01, 0.02, 0.03]))
    spectrum = live.last_spectrum()
    assert spectrum is not None
    np.testing.assert_allclose(spectrum.r, [0.01, 0.02, 0.03], rtol=1e-12)
    assert (spectrum.index, spectrum.polarization) == (0, "s")


def test_curve_takes_its_own_sweep_in_order_of_the_angles_read_back(live: LiveScan) -> None:
    # read back a little off the plan, and arriving in another order than the angles
    for index, theta_mes, r in ((2, 50.01, 0.3), (0, 30.02, 0.1), (1, 39.99, 0.2)):
        live.add_position(position(index, 20.0, theta_mes, "s", [0.0, r, 0.0]))
    live.add_position(position(4, 20.0, 30.0, "p", [0.0, 0.9, 0.0]))
    theta_o, r = live.curve(SweepKey(20.0, "s"), column=1)
    np.testing.assert_allclose(theta_o, [10.02, 19.99, 30.01], atol=1e-12)
    np.testing.assert_allclose(r, [0.1, 0.2, 0.3], rtol=1e-12)
    assert len(live.curve(SweepKey(45.0, "s"), column=1)[0]) == 0


def test_a_saturated_reading_has_no_value(live: LiveScan) -> None:
    live.add_position(position(0, 20.0, 30.0, "s", [0.1, 0.2, 0.3], bad=int(Quality.OVER_RANGE)))
    spectrum = live.last_spectrum()
    assert spectrum is not None
    assert np.isnan(spectrum.r).tolist() == [False, True, False]


def test_what_is_there_and_what_changes(live: LiveScan) -> None:
    assert live.incidences_deg == (20.0, 45.0)
    assert live.detector_change_nm == (725.0,)  # between 550 nm (pmt) and 900 nm (ingaas)
    assert live.column_near(560.0) == 1
    assert live.last_spectrum() is None
    live.add_position(position(3, 20.0, 60.0, "s", [0.1, 0.2, 0.3]))
    assert live.revision == {"s": 1, "p": 0}
    assert np.flatnonzero(live.measured).tolist() == [3]


def test_no_line_joins_two_detectors() -> None:
    x, y = broken_at(np.array([450.0, 550.0, 900.0]), np.array([1.0, 2.0, 3.0]), (725.0,))
    assert x.tolist() == [450.0, 550.0, 725.0, 900.0]
    assert np.isnan(y).tolist() == [False, False, True, False]

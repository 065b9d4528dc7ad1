"""r from volts: exact where drift is linear, and with uncertainties that agree with simulated scatter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.devices import Quality
from gonio.store.pooling import moving_sum, pooled_variance
from gonio.store.records import ReferenceKind, ReferenceRecord
from gonio.store.reduction import Reduction

M = 12
DETECTOR = np.array([0] * 5 + [1] * 7, dtype=np.uint8)


def reference(
    kind: ReferenceKind,
    t_s: float,
    signal_v: np.ndarray | float,
    *,
    polarization: str = "any",
    sd_v: np.ndarray | float = 0.0,
    averages: int = 4,
    quality: np.ndarray | None = None,
) -> ReferenceRecord:
    return ReferenceRecord(
        kind=kind,
        when="start",
        polarization=polarization,
        theta_i_deg=90.0,
        theta_mes_deg=180.0,
        averages=averages,
        unix_s=0.0,
        wavelength_nm=np.linspace(800.0, 920.0, M),
        signal_v=np.broadcast_to(np.asarray(signal_v, dtype=np.float64), (M,)).copy(),
        signal_sd_v=np.broadcast_to(np.asarray(sd_v, dtype=np.float64), (M,)).copy(),
        time_s=np.asarray(t_s + 0.1 * np.arange(M), dtype=np.float64),
        quality=np.zeros(M, dtype=np.uint16) if quality is None else quality,
    )


NO_SD = np.full((1, M), np.nan)
ONCE = np.array([1])


@given(
    dark=st.floats(-0.01, 0.01),
    dark_slope=st.floats(-1e-6, 1e-6),
    full=st.floats(0.1, 10.0),
    gain_slope=st.floats(-1e-5, 1e-5),
    r=st.floats(-0.001, 1.5),
    when=st.floats(100.0, 9000.0),
    polarization=st.sampled_from(["s", "p"]),
)
def test_r_is_exact_under_linear_drift_of_gain_and_dark(
    dark: float,
    dark_slope: float,
    full: float,
    gain_slope: float,
    r: float,
    when: float,
    polarization: str,
) -> None:
    spectrum = np.linspace(1.0, 2.0, M)
    gain = {"s": 1.0, "p": 0.8}

    def dark_v(t: np.ndarray) -> np.ndarray:
        return dark + dark_slope * t

    def full_v(t: np.ndarray, p: str) -> np.ndarray:
        return gain[p] * full * spectrum * (1.0 + gain_slope * t)

    references = []
    for t0 in (0.0, 10_000.0):
        times = reference("dark", t0, 0.0).time_s
        references.append(reference("dark", t0, dark_v(times)))
        for k, p in enumerate(("s", "p")):
            times = reference("baseline", t0 + 20.0 + 20.0 * k, 0.0).time_s
            references.append(
                reference("baseline", times[0], dark_v(times) + full_v(times, p), polarization=p)
            )
    time_s = np.asarray(when + 0.3 * np.arange(M)[None, :], dtype=np.float64)
    raw = dark_v(time_s) + r * full_v(time_s, polarization)
    reduced = Reduction(references, DETECTOR).apply(raw, NO_SD, ONCE, time_s, [polarization])
    np.testing.assert_allclose(reduced.r, r, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(reduced.dark_v, dark_v(time_s), rtol=1e-9, atol=1e-15)


def test_before_the_end_reference_the_nearest_one_holds() -> None:
    reduction = Reduction(
        [reference("dark", 0.0, 0.1), reference("baseline", 10.0, 1.1, polarization="s")], DETECTOR
    )
    reduced = reduction.apply(np.full((1, M), 0.6), NO_SD, ONCE, np.full((1, M), 5000.0), ["s"])
    np.testing.assert_allclose(reduced.r, 0.5)
    np.testing.assert_allclose(reduced.baseline_v, 1.1)


def test_without_a_baseline_of_the_polarization_there_is_no_r() -> None:
    reduction = Reduction(
        [reference("dark", 0.0, 0.1), reference("baseline", 10.0, 1.1, polarization="p")], DETECTOR
    )
    reduced = reduction.apply(
        np.full((2, M), 0.6), np.full((2, M), np.nan), np.array([1, 1]), np.ones((2, M)), ["s", "p"]
    )
    assert np.all(np.isnan(reduced.r[0]))
    np.testing.assert_allclose(reduced.r[1], 0.5)


def test_three_references_are_joined_piecewise() -> None:
    references = [reference("dark", 0.0, 0.0)]
    for t0, value in ((0.0, 1.0), (100.0, 2.0), (300.0, 1.0)):
        references.append(reference("baseline", t0, value, polarization="s"))
    reduction = Reduction(references, DETECTOR)
    for t, expected in ((50.0, 1.5), (100.0, 2.0), (200.0, 1.5), (400.0, 1.0), (-5.0, 1.0)):
        time_s = np.asarray(t + 0.1 * np.arange(M)[None, :], dtype=np.float64)
        reduced = reduction.apply(np.full((1, M), 1.0), NO_SD, ONCE, time_s, ["s"])
        np.testing.assert_allclose(reduced.baseline_v, expected, atol=1e-12)


def test_a_saturated_reference_reading_is_replaced_by_the_other_one() -> None:
    quality = np.zeros(M, dtype=np.uint16)
    quality[3] = Quality.OVER_RANGE
    reduction = Reduction(
        [
            reference("dark", 0.0, 0.0),
            reference("baseline", 0.0, 9.0, polarization="s", quality=quality),
            reference("baseline", 100.0, 2.0, polarization="s"),
        ],
        DETECTOR,
    )
    baseline = reduction.apply(np.ones((1, M)), NO_SD, ONCE, np.zeros((1, M)), ["s"]).baseline_v[0]
    assert baseline[3] == 2.0
    assert np.all(np.delete(baseline, 3) == 9.0)


def test_a_baseline_no_brighter_than_the_dark_gives_no_r_and_no_warning() -> None:
    reduction = Reduction(
        [reference("dark", 0.0, 1.0), reference("baseline", 0.0, 1.0, polarization="s")], DETECTOR
    )
    assert np.all(np.isnan(reduction.apply(np.ones((1, M)), NO_SD, ONCE, np.zeros((1, M)), ["s"]).r))


def test_without_repeats_no_uncertainty_is_claimed() -> None:
    references = [
        reference("dark", 0.0, 0.0, averages=1, sd_v=np.nan),
        reference("baseline", 0.0, 1.0, polarization="s", averages=1, sd_v=np.nan),
    ]
    reduced = Reduction(references, DETECTOR).apply(np.ones((1, M)), NO_SD, ONCE, np.zeros((1, M)), ["s"])
    np.testing.assert_allclose(reduced.r, 1.0)
    for unknown in (reduced.r_sd, reduced.gain_u, reduced.offset_u):
        assert np.all(np.isnan(unknown))


def test_the_variance_goes_from_that_of_the_dark_to_that_of_the_full_beam_in_proportion_to_the_signal() -> (
    None
):
    sd_dark, sd_full = 1e-3, 5e-3
    reduction = Reduction(
        [
            reference("dark", 0.0, 0.0, sd_v=sd_dark),
            reference("baseline", 0.0, 2.0, polarization="s", sd_v=sd_full),
        ],
        DETECTOR,
    )
    for r, variance in (
        (0.0, sd_dark**2),
        (1.0, sd_full**2),
        (0.25, 0.75 * sd_dark**2 + 0.25 * sd_full**2),
        (-0.01, sd_dark**2),
    ):
        reduced = reduction.apply(np.full((1, M), 2.0 * r), NO_SD, ONCE, np.zeros((1, M)), ["s"])
        np.testing.assert_allclose(reduced.r_sd, np.sqrt(variance) / 2.0, rtol=1e-12)
        np.testing.assert_allclose(reduced.gain_u, sd_full / np.sqrt(4) / 2.0, rtol=1e-12)
        np.testing.assert_allclose(reduced.offset_u, sd_dark / np.sqrt(4) / 2.0, rtol=1e-12)


def test_repeated_readings_bring_their_own_scatter_and_are_averaged() -> None:
    reduction = Reduction(
        [
            reference("dark", 0.0, 0.0, sd_v=1e-3),
            reference("baseline", 0.0, 1.0, polarization="s", sd_v=1e-3),
        ],
        DETECTOR,
    )
    reduced = reduction.apply(
        np.full((1, M), 0.5), np.full((1, M), 7e-3), np.array([9]), np.zeros((1, M)), ["s"]
    )
    np.testing.assert_allclose(reduced.r_sd, 7e-3 / 3.0, rtol=1e-12)


def test_the_stated_uncertainties_are_those_of_ten_thousand_simulated_scans() -> None:
    rng = np.random.default_rng(5)
    r, full, sd_dark, sd_full, averages = 0.3, 1.5, 2e-3, 6e-3, 8
    detector = np.zeros(2000, dtype=np.uint8)
    m = len(detector)
    sd = np.sqrt(sd_dark**2 + r * (sd_full**2 - sd_dark**2))
    stated, errors = [], []
    for _ in range(5):
        dark = sd_dark * rng.standard_normal((averages, m))
        baseline = full + sd_full * rng.standard_normal((averages, m))
        raw = r * full + sd * rng.standard_normal((1, m))

        def record(kind: ReferenceKind, polarization: str, readings: np.ndarray) -> ReferenceRecord:
            return ReferenceRecord(
                kind, "start", polarization, 90.0, 180.0, averages, 0.0,
                np.arange(1.0, m + 1), readings.mean(axis=0), readings.std(axis=0, ddof=1), np.zeros(m),
                np.zeros(m, dtype=np.uint16),
            )  # fmt: skip

        reduction = Reduction([record("dark", "any", dark), record("baseline", "s", baseline)], detector)
        reduced = reduction.apply(raw, np.full((1, m), np.nan), np.array([1]), np.zeros((1, m)), ["s"])
        errors.append(reduced.r[0] - r)
        total = reduced.r_sd**2 + (r * reduced.gain_u) ** 2 + ((1.0 - r) * reduced.offset_u) ** 2
        stated.append(np.sqrt(total[0]))
    z = np.concatenate(errors) / np.concatenate(stated)
    # the variance of 10 000 z has a relative standard error of 1.4 %, and pooling to 30 dof adds 7 % to
    # z^2's mean
    assert np.mean(z**2) == pytest.approx(30 / 28, rel=0.06)
    assert abs(np.mean(z)) < 4.0 / np.sqrt(len(z))


def test_pooling_never_crosses_the_detector_change() -> None:
    variance = np.where(DETECTOR == 0, 1.0, 100.0)
    pooled = pooled_variance(variance, np.full(M, 3.0), DETECTOR, min_dof=1000)
    np.testing.assert_allclose(pooled, variance)


def test_pooling_weighs_by_degrees_of_freedom_and_leaves_out_nan() -> None:
    variance = np.array([1.0, np.nan, 4.0])
    pooled = pooled_variance(variance, np.array([1.0, 5.0, 2.0]), np.zeros(3, dtype=np.uint8), min_dof=100)
    np.testing.assert_allclose(pooled, 3.0)


@given(st.integers(0, 15))
def test_the_moving_sum_is_the_plain_one(half_width: int) -> None:
    values = np.random.default_rng(half_width).random((2, M))
    expected = np.array(
        [
            [
                sum(row[j] for j in range(M) if abs(i - j) <= half_width and DETECTOR[i] == DETECTOR[j])
                for i in range(M)
            ]
            for row in values
        ]
    )
    np.testing.assert_allclose(moving_sum(values, DETECTOR, half_width), expected, rtol=1e-12)

"""Mistakes in the rig file's [simulation] are refused with the key, the value and a remedy."""

from __future__ import annotations

import pytest

from gonio.errors import ConfigError
from gonio_simulators.bench import Bench, BenchConfig
from gonio_simulators.clock import ManualClock


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("simulation.noise.flickr", 0.1, "did you mean 'flicker'"),
        ("simulation.truth.rho_d", -0.1, "-0.1 is below 0"),
        ("simulation.truth.n2", 0.9, "0.9 is below 1"),
        ("simulation.truth.alpha", {"wavelength_nm": [300.0, 500.0], "value": [5.0, -1.0]}, "-1 is below 0"),
        ("simulation.truth.alpha", {"wavelength_nm": [500.0, 300.0], "value": [5.0, 6.0]}, "ascend"),
        (
            "simulation.truth.alpha",
            {"wavelength_nm": [300.0], "value": [5.0, 6.0]},
            "1 wavelengths but 2 values",
        ),
        ("simulation.truth.alpha", "90", "give a number, or a table"),
        ("simulation.truth.alpha", True, "give a number, or a table"),
        ("simulation.truth.alpha", float("nan"), "nan"),
        ("simulation.truth.rho_s", None, "rho_s is missing"),
        ("simulation.truth.rho_x", 1.0, "did you mean 'rho_"),
        ("simulation.detectors.pmd", {"full_beam_v": 1.0}, "pmd is no detector"),
        ("simulation.detectors.pmt.mismatch", -1.5, "mismatch"),
        ("simulation.detectors.pmt.full_beam_v", 0.0, "full_beam_v"),
        ("simulation.beam.divergence_deg", 45.0, "divergence_deg"),
        ("simulation.sphere.theta_i_deg", 90.0, "theta_i_deg"),
        ("simulation.clock_speed", 0.0, "clock_speed"),
        ("simulation.seed", -1, "seed"),
        ("simulation.seed", "2022", "seed"),
        ("simulation.sample.width_mm", "100 mm", "width_mm"),
        ("simulation", None, r"\[simulation\] is missing"),
        ("stage.theta_i.steps_per_deg", 0.0, "steps_per_deg = 0"),
        ("polarizer.p_deg", 0.0, "both 0 deg"),
    ],
)
def test_mistakes_are_refused(make_tables, key: str, value: object, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        BenchConfig.from_tables(make_tables({key: value}), source="my.toml")
    assert "my.toml" in str(caught.value)


def test_keys_of_drivers_are_left_to_the_drivers(make_tables) -> None:
    tables = make_tables(
        {"stage.word_order": "big", "stage.theta_i.device": 7, "spectrometer.driver": "mine"}
    )
    assert BenchConfig.from_tables(tables).stage.theta_i.zero_deg == 0.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"simulation.theta_mes": {"power_on_deg": 3.0}}, "beyond a switch"),
        ({"simulation.theta_i": {"power_on_deg": 120.0}}, "120 deg lies beyond a switch"),
        (
            {"simulation.theta_i": {"limit_margin_deg": 0.0, "backlash_deg": 2.0}},
            "no room for the home",
        ),
    ],
)
def test_axes_that_cannot_stand_or_home_are_refused(
    make_config, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        Bench.from_config(make_config(changes), ManualClock())


def test_a_number_is_a_flat_spectrum(make_config) -> None:
    truth = make_config({"simulation.truth.n2": 2}).simulation.truth
    assert truth.n2.at([300.0, 900.0]).tolist() == [2.0, 2.0]


def test_defaults_where_the_rig_says_little(make_tables) -> None:
    tables = make_tables({"spectrometer.monochromator": None, "spectrometer.lockin": None, "polarizer": None})
    del tables["simulation"]["noise"], tables["simulation"]["detectors"]
    bench = Bench.from_config(BenchConfig.from_tables(tables), ManualClock())
    assert bench.monochromator.output_ports == (1, 2)
    assert bench.lockin.time_constant_s == 0.1
    bench.monochromator.goto(1234.5)

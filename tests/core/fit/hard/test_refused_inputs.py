"""Arrays that are no readings: an error that says which value and what to do, not numpy's, and no result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from simulated_readings import FloatArray, Positions

from gonio.aperture import Aperture
from gonio.errors import FitError
from gonio.fitting import FitResult, fit_readings

Readings = Callable[..., FloatArray]
TRUTH = (0.72, 1.0, 90.0, 1.5)


@pytest.fixture(scope="module")
def arrays(positions: Positions, exact_readings: Readings) -> dict[str, Any]:
    return {
        "theta_i_deg": positions.theta_i_deg,
        "theta_o_deg": positions.theta_o_deg,
        "polarization_of": positions.polarization,
        "r": np.repeat(exact_readings(*TRUTH)[:, None], 3, axis=1),
    }


def run(arrays: dict[str, Any], instrument: Aperture, **change: Any) -> FitResult:
    return fit_readings(**{**arrays, **change}, instrument=instrument)


def put(values: Any, at: Any, value: Any) -> Any:
    changed = np.array(values)
    changed[at] = value
    return changed


@pytest.mark.parametrize(
    ("name", "at", "value", "words"),
    [
        ("theta_i_deg", 3, 95.0, "theta_i = 95 deg at position 3 is outside 0...90"),
        ("theta_i_deg", 3, -20.0, "theta_i = -20 deg at position 3 .* positive on the specular side"),
        ("theta_i_deg", 7, np.nan, "theta_i = nan at position 7 is no angle; leave the position out"),
        ("theta_o_deg", 7, np.nan, "theta_o = nan at position 7 is no angle"),
        ("theta_o_deg", 7, -np.inf, "theta_o = -inf at position 7 is no angle"),
        ("theta_o_deg", 4, -98.0, "theta_o = -98 deg at position 4 is behind the sample"),
        ("theta_o_deg", 4, 141.0, "is behind the sample .* theta_mes - theta_i"),
        ("polarization_of", 0, "S", "polarization 'S' of position 0 is not known; label every position"),
        ("polarization_of", 9, "", "polarization '' of position 9 is not known"),
        ("r", (50, 1), 1e200, r"r = 1e\+200 at position 50, wavelength number 1, is no reflected"),
        ("r", (50, 1), -1e20, r"r = -1e\+20 at position 50"),
    ],
)
def test_one_bad_value_is_named(
    arrays: dict[str, Any], aperture: Aperture, name: str, at: Any, value: Any, words: str
) -> None:
    with pytest.raises(FitError, match=words):
        run(arrays, aperture, **{name: put(arrays[name], at, value)})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: {"r": a["r"] + 0j}, "r holds complex128 values; give real numbers"),
        (lambda a: {"r": a["r"].astype(str)}, "r holds str"),
        (lambda a: {"r": a["r"] > 0.01}, "r holds bool values"),
        (lambda a: {"r": [["x", 1.0, 2.0]] * 292}, "r holds str"),
        (lambda a: {"r": [[None, "x", 2.0]] * 292}, "r is not an array of real numbers"),
        (lambda a: {"r": [[1.0, 2.0], [1.0]]}, "r is not an array of real numbers"),
        (lambda a: {"theta_i_deg": ["a"] * 292}, "theta_i_deg holds str"),
        (lambda a: {"r": a["r"].T}, "have 3 positions"),
        (lambda a: {"r": a["r"][:, 0]}, "have 1 positions .*is it turned round"),
        (lambda a: {"r": a["r"][:, :, None]}, r"r has the shape \(292, 3, 1\)"),
        (lambda a: {"r": 1.0}, "give one of each per position"),
        (lambda a: {"theta_i_deg": 20.0}, r"theta_i of shape \(\)"),
        (lambda a: {"theta_i_deg": a["theta_i_deg"][:, None]}, r"theta_i of shape \(292, 1\)"),
        (lambda a: {"r": np.zeros((292, 0))}, "no wavelength has 8 usable readings"),
        (
            lambda a: {"r": np.zeros((0, 3)), "theta_i_deg": [], "theta_o_deg": [], "polarization_of": []},
            "there are no positions",
        ),
        (
            lambda a: {"polarization_of": np.char.upper(a["polarization_of"])},
            "label every position 's' or 'p'",
        ),
        (lambda a: {"polarization_of": ["unpolarized"] * 292}, "was not measured; the scan has: unpolarized"),
        (lambda a: {"r": a["r"] * 1e-40}, "the largest r of wavelength number 0 is .* correct the unit"),
        (lambda a: {"r": np.full((292, 3), np.nan)}, "no wavelength has 8 usable readings"),
        (lambda a: {"wavelength_nm": ["red", "green", "blue"]}, "wavelength_nm holds str"),
        (
            lambda a: {"wavelength_nm": [400.0, 0.0, 600.0]},
            r"wavelength_nm = 0 \(number 1\) is no wavelength",
        ),
        (lambda a: {"wavelength_nm": [400.0, 500.0, np.inf]}, "wavelength_nm = inf"),
        (lambda a: {"detector_index": [0, -1, 0]}, "detector_index must hold whole numbers"),
        (lambda a: {"detector_index": [0.0, 0.5, 1.0]}, "detector_index must hold whole numbers"),
        (lambda a: {"detector_index": ["a", "b", "c"]}, "detector_index must hold whole numbers"),
        (lambda a: {"r_sd": np.zeros((3, 2))}, r"r_sd has the shape \(3, 2\), the readings \(292, 3\)"),
        (lambda a: {"r_sd": np.ones(292)}, r"r_sd has the shape \(292,\)"),
        (lambda a: {"r_sd": -1e-3}, "r_sd = -0.001 at position 0 is no standard uncertainty"),
        (lambda a: {"gain_u": np.inf}, "gain_u = inf at position 0"),
        (lambda a: {"offset_u": "small"}, "offset_u holds str"),
        (lambda a: {"detector_gain_u": "small"}, "detector_gain_u holds str"),
        (lambda a: {"detector_offset_u": np.nan}, "detector_offset_u = nan must be standard uncertainties"),
        (lambda a: {"n2": 1.5 + 0.1j}, "n2 holds complex128 values"),
        (lambda a: {"n2": None}, "n2 = nan .* is outside"),
        (lambda a: {"n2": [1.5, 1.5]}, r"n2 has the shape \(2,\)"),
        (lambda a: {"n2": "1.5"}, "n2 = '1.5' is not known"),
        (lambda a: {"weights": np.ones(292)}, "is not known; use one of 'auto'"),
        (lambda a: {"loss": ["huber"]}, r"loss = \['huber'\] is not known"),
    ],
)
def test_wrong_arrays_and_options(
    arrays: dict[str, Any], aperture: Aperture, change: Callable[[Any], dict[str, Any]], words: str
) -> None:
    with pytest.raises(FitError, match=words):
        run(arrays, aperture, **change(arrays))


def test_memory_and_type_of_the_arrays_do_not_matter(arrays: dict[str, Any], aperture: Aperture) -> None:
    expected = run(arrays, aperture)
    readonly = arrays["r"].copy()
    readonly.setflags(write=False)
    strided = np.repeat(arrays["r"], 2, axis=1)[:, ::2]
    for r in (
        np.asfortranarray(arrays["r"]),
        readonly,
        strided,
        arrays["r"].tolist(),
        arrays["r"].astype(object),
    ):
        np.testing.assert_array_equal(run(arrays, aperture, r=r).value, expected.value)
    lists = {key: values.tolist() for key, values in arrays.items()}
    np.testing.assert_array_equal(run(lists, aperture).value, expected.value)
    narrow = run(arrays, aperture, r=arrays["r"].astype(np.float32))
    np.testing.assert_allclose(narrow.value, expected.value, rtol=1e-4)  # 292 readings rounded to 6e-8
    whole = run(arrays, aperture, r=np.round(arrays["r"] * 1e9).astype(np.int64))
    np.testing.assert_allclose(whole.value / [1e9, 1e9, 1.0, 1.0], expected.value, rtol=1e-5)


def test_masked_readings_are_missing(arrays: dict[str, Any], aperture: Aperture) -> None:
    """The values under a mask are often sentinels; they must not be seen."""
    mask = np.zeros((292, 3), bool)
    mask[::5, 1] = True
    masked = np.ma.masked_array(np.where(mask, 9e9, arrays["r"]), mask=mask)
    fit = run(arrays, aperture, r=masked)
    missing = run(arrays, aperture, r=np.where(mask, np.nan, arrays["r"]))
    np.testing.assert_array_equal(fit.value, missing.value)
    assert fit.dof.tolist() == [288, 288 - 59, 288]


def test_nothing_is_asked_of_readings_that_are_not_there(arrays: dict[str, Any], aperture: Aperture) -> None:
    """A refused reading may come with an infinite uncertainty: baseline 0."""
    y = put(arrays["r"], (5, 0), np.nan)
    sd = put(np.full((292, 3), 1e-5), (5, 0), np.inf)
    assert np.all(np.isfinite(run(arrays, aperture, r=y, r_sd=sd, gain_u=sd).value))

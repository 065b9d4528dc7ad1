"""The model that made the readings is chosen; a wrong one shows in its residuals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from simulated_readings import Positions, instrument_noise

from gonio.aperture import Aperture
from gonio.errors import FitError
from gonio.fitting.columns import FloatArray, readings
from gonio.fitting.kinds import ModelName, model_named
from gonio.fitting.model_comparison import MODEL_NAMES, compare_readings
from gonio.fitting.selection import aicc, akaike_weights, combined_runs_probability, runs_probability

BASIC: dict[ModelName, list[float]] = {
    "published": [0.72, 0.04, np.log(100.0), 1.5],
    "phong": [0.7, 0.05, np.log(60.0)],
    "reciprocal": [0.7, 0.04, np.log(100.0), 1.5],
    "lambert": [0.7],
    "ggx": [0.7, 0.04, np.log(0.1), 1.5],
    "coupled": [0.75, 0.04, np.log(100.0), 1.5],
}


def simulated(
    name: ModelName, positions: Positions, aperture: Aperture, count: int, noise: float
) -> FloatArray:
    """Readings (n, count) of one surface with `noise` times the usual noise."""
    kind = model_named(name)
    model = kind.of(aperture, positions.theta_i_deg, positions.theta_o_deg, positions.polarization == "s")
    r = readings(model, np.tile(BASIC[name], (count, 1)))
    rng = np.random.default_rng(sum(map(ord, name)))
    return r + noise * instrument_noise(r) * rng.standard_normal(r.shape)


@pytest.mark.parametrize("name", [m for m in MODEL_NAMES if m != "lambert"])
def test_the_model_that_made_the_readings_is_chosen(
    name: ModelName, positions: Positions, aperture: Aperture
) -> None:
    r = simulated(name, positions, aperture, 4, 3.0)
    found = compare_readings(
        positions.theta_i_deg,
        positions.theta_o_deg,
        positions.polarization,
        r,
        instrument=aperture,
        models=MODEL_NAMES if name == "ggx" else (name, *(m for m in ("published", "ggx") if m != name)),
    )
    assert found.best == found.weights_from == name
    assert found.total_weights[name] > 0.999
    own = list(found.candidates).index(name)
    assert np.all(np.argmax(found.weights, axis=0) == own)
    for other, candidate in found.candidates.items():
        if other == name:
            assert candidate.runs_p_all > 1e-3
        else:
            assert candidate.runs_p_all < 1e-6, f"{other} leaves no trace in the residuals of {name}"
        # the same weights for all
        np.testing.assert_array_equal(candidate.fit.sigma, found.candidates[name].fit.sigma)
    text = found.table()
    assert text.splitlines()[1].startswith(name)
    assert f"residuals of '{name}'" in " ".join(text.split())


def test_without_a_lobe_the_models_with_one_are_lambert(positions: Positions, aperture: Aperture) -> None:
    r = simulated("lambert", positions, aperture, 6, 1.0)
    found = compare_readings(
        positions.theta_i_deg,
        positions.theta_o_deg,
        positions.polarization,
        r,
        instrument=aperture,
        models=("lambert", "published", "reciprocal"),
    )
    totals = found.total_aicc
    assert min(totals.values()) == pytest.approx(totals["lambert"], abs=1e-6)
    assert found.candidates["lambert"].runs_p_all > 1e-3
    check = found.candidates["lambert"].check
    assert check is not None
    assert check.reciprocity < 1e-12
    assert check.albedo == pytest.approx(0.7, rel=1e-3)


def test_the_comparison_says_what_the_surface_does_to_energy_and_reciprocity(
    positions: Positions, aperture: Aperture
) -> None:
    r = simulated("published", positions, aperture, 2, 1.0)
    found = compare_readings(
        positions.theta_i_deg,
        positions.theta_o_deg,
        positions.polarization,
        r,
        instrument=aperture,
        models=("published", "coupled"),
    )
    published, coupled = (found.candidates[m].check for m in ("published", "coupled"))
    assert published is not None
    assert coupled is not None
    assert published.reciprocity > 0.3
    assert published.albedo > 1.0
    assert coupled.reciprocity < 1e-11
    assert "76." in found.table()


def test_models_that_cannot_be_fitted_are_named(positions: Positions, aperture: Aperture) -> None:
    r = simulated("lambert", positions, aperture, 2, 1.0)
    at = (positions.theta_i_deg, positions.theta_o_deg, positions.polarization)
    found = compare_readings(
        *at, r, instrument=aperture, models=("phong", "published"), polarization="shared_n2"
    )
    assert list(found.candidates) == ["published"]
    assert "phong" in found.refused
    assert "not fitted" in found.table()
    with pytest.raises(FitError, match="none of the models"):
        compare_readings(*at, np.full_like(r, np.nan), instrument=aperture)


def test_aicc_is_the_textbook_value_and_refuses_too_few_readings() -> None:
    # n = 20, K = 3 with the scale: 20 ln(10/20) + 6 + 24/16
    assert float(aicc(10.0, 20, 2)) == pytest.approx(20.0 * np.log(0.5) + 6.0 + 1.5, rel=1e-14)
    assert np.isnan(aicc(10.0, 4, 2))
    assert np.isnan(aicc(0.0, 20, 2))


def test_akaike_weights_are_the_relative_evidence() -> None:
    w = akaike_weights(np.array([[3.0, np.nan, 1e6], [5.0, 2.0, 1e6 + 4.0], [np.nan, np.nan, np.nan]]))
    np.testing.assert_allclose(w[:, 0], [1.0 / (1.0 + np.exp(-1.0)), 1.0 / (1.0 + np.exp(1.0)), 0.0])
    np.testing.assert_allclose(w[:, 1], [0.0, 1.0, 0.0])
    np.testing.assert_allclose(np.sum(w, axis=0), 1.0)
    assert np.all(np.isnan(akaike_weights(np.full((2, 1), np.nan))))


def test_p_values_of_the_right_model_are_uniform(positions: Positions, aperture: Aperture) -> None:
    """Calibration under the null, residuals of a real fit included."""
    r = simulated("published", positions, aperture, 600, 1.0)
    found = compare_readings(
        positions.theta_i_deg,
        positions.theta_o_deg,
        positions.polarization,
        r,
        instrument=aperture,
        models=("published",),
    )
    p = found.candidates["published"].runs_p
    # four fitted parameters make residuals change sign a little more often than noise
    assert np.mean(p < 0.05) < 0.08
    assert np.mean(p < 0.01) < 0.025
    assert 0.45 < np.mean(p) < 0.62
    assert found.candidates["published"].runs_p_all > 0.01


def test_combined_p_values_are_uniform_and_see_what_single_ones_do_not(positions: Positions) -> None:
    rng = np.random.default_rng(8)
    at = (positions.theta_i_deg, positions.theta_o_deg, positions.polarization == "s")
    n = positions.theta_i_deg.size
    p = [combined_runs_probability(rng.standard_normal((n, 30)), *at) for _ in range(400)]
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    bent = 0.35 * np.sin(np.deg2rad(4.0 * positions.theta_o_deg))[:, None]
    residual = bent + rng.standard_normal((n, 121))
    assert np.median(runs_probability(residual, *at)) > 0.02
    assert combined_runs_probability(residual, *at) < 1e-8

"""Every model recovers its own truth from readings that its tables did not make, from any start."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_readings import Positions, instrument_noise
from surface_readings import surface_reading

from gonio.aperture import Aperture
from gonio.brdf import GGX, CoupledDiffuse, Lambert, ModifiedPhong, ReciprocalLobe, ScatteringModel
from gonio.fitting import fit_readings
from gonio.fitting.columns import FloatArray
from gonio.fitting.kinds import ModelName

TRUTHS: dict[ModelName, ScatteringModel] = {
    "phong": ModifiedPhong(0.6, 0.05, 80.0),
    "reciprocal": ReciprocalLobe(0.7, 0.9, 200.0, 1.5),
    "lambert": Lambert(0.8),
    "ggx": GGX(0.55, 1.1, 0.12, 1.6),
    "coupled": CoupledDiffuse(0.8, 1.0, 40.0, 1.35),
}


@pytest.fixture(scope="module")
def exact(positions: Positions, aperture: Aperture) -> dict[ModelName, FloatArray]:
    """r (292,) of every truth."""
    return {
        name: np.array(
            [
                surface_reading(surface, i, o, "s" if p == "s" else "p", aperture, panels=5)
                for i, o, p in zip(
                    positions.theta_i_deg, positions.theta_o_deg, positions.polarization, strict=True
                )
            ]
        )
        for name, surface in TRUTHS.items()
    }


@pytest.mark.parametrize("name", TRUTHS)
def test_exact_readings_give_the_truth(
    name: ModelName, exact: dict[ModelName, FloatArray], positions: Positions, aperture: Aperture
) -> None:
    surface = TRUTHS[name]
    result = fit_readings(
        positions.theta_i_deg,
        positions.theta_o_deg,
        positions.polarization,
        exact[name][:, None],
        instrument=aperture,
        model=name,
    )
    truth = [getattr(surface, p) for p in surface.parameter_names]
    assert result.parameters == surface.parameter_names
    np.testing.assert_allclose(result.value[0], truth, rtol=1e-6)
    k = result.hemispherical(8.0)
    for coefficient, albedo in ((k.k_d, surface.diffuse_albedo), (k.k_s, surface.specular_albedo)):
        expected = 0.5 * (float(albedo(8.0, "s")) + float(albedo(8.0, "p")))
        assert float(coefficient.value[0]) == pytest.approx(expected, rel=1e-7, abs=1e-12)


@pytest.mark.parametrize("name", TRUTHS)
def test_scatter_of_noisy_fits_is_what_the_standard_errors_say(
    name: ModelName, exact: dict[ModelName, FloatArray], positions: Positions, aperture: Aperture
) -> None:
    """400 wavelengths as replicas: mean and variance of (estimate - truth)/se."""
    rng = np.random.default_rng(12)
    replicas = 400
    sd = instrument_noise(exact[name])[:, None]
    r = exact[name][:, None] + sd * rng.standard_normal((sd.size, replicas))
    result = fit_readings(
        positions.theta_i_deg,
        positions.theta_o_deg,
        positions.polarization,
        r,
        instrument=aperture,
        model=name,
        r_sd=np.broadcast_to(sd, r.shape),
        weights="r_sd",
    )
    surface = TRUTHS[name]
    truth = np.array([getattr(surface, p) for p in surface.parameter_names])
    z = (result.value - truth) / result.se
    assert np.all(np.isfinite(z))
    # the mean of 400 has a standard deviation of 0.05, their standard deviation one of 0.035
    assert np.all(np.abs(np.mean(z, axis=0)) < 0.2)
    assert np.all(np.abs(np.std(z, axis=0) - 1.0) < 0.13)


def test_nothing_depends_on_a_start(aperture: Aperture, positions: Positions) -> None:
    """Truths over the whole range of shape and index, all found from the grid."""
    from gonio.fitting.columns import readings
    from gonio.fitting.models import FIT_MODELS
    from gonio.fitting.solve import refine

    rng = np.random.default_rng(3)
    is_s = positions.polarization == "s"
    for kind in FIT_MODELS.values():
        if not kind.shape:
            continue
        model = kind.of(aperture, positions.theta_i_deg, positions.theta_o_deg, is_s)
        count = 60
        inner = rng.uniform(0.35, 0.85, (count, len(kind.shape)))
        x = kind.low + (kind.high - kind.low) * inner
        if "n2" in kind.shape:
            x[:, -1] = rng.uniform(1.1, 3.0, count)
        basic = np.concatenate([rng.uniform(0.02, 0.8, (count, len(kind.linear))), x], axis=1)
        y = readings(model, basic)
        w = 1.0 / instrument_noise(y) ** 2
        solution = refine(model, y, w, model.start(y, w))
        assert np.all(solution.converged), kind.name
        assert np.max(solution.chi2) < 1e-8, kind.name

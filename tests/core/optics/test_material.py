from __future__ import annotations

import numpy as np
import pytest

from gonio.errors import GonioError
from gonio.material import Material


def spectrum() -> Material:
    at = np.arange(300.0, 1501.0, 10.0)
    return Material(
        "panel", at, 0.3 + 0.4 * (at > 500.0), np.full(at.size, 0.9), 60.0 + at / 20.0, 1.56 - at / 2e4
    )


def test_band_conserves_the_mean_coefficients() -> None:
    material = spectrum()
    band = material.band(380.0, 740.0)
    use = (material.wavelength_nm >= 380.0) & (material.wavelength_nm <= 740.0)
    at = material.wavelength_nm[use]

    def mean(values: np.ndarray) -> float:
        return float(np.trapezoid(values[use], at) / (at[-1] - at[0]))

    assert band.wavelength_nm.shape == (1,)
    assert float(band.k_d()[0]) == pytest.approx(mean(material.k_d()), rel=1e-12)
    total = 0.0
    for theta in material.theta_i_deg:
        for polarization in ("s", "p"):
            expected = mean(material.k_s(theta, polarization))
            assert float(band.k_s(theta, polarization)[0]) == pytest.approx(
                expected, abs=1e-4 * mean(material.k_s(theta, "s"))
            )
            total += float(band.k_s(theta, polarization)[0]) - expected
    assert abs(total) < 1e-6 * 8 * 0.04
    assert material.alpha[use].min() < band.alpha[0] < material.alpha[use].max()
    assert material.n2[use].min() < band.n2[0] < material.n2[use].max()


def test_band_of_equal_entries_is_that_entry() -> None:
    at = np.linspace(400.0, 700.0, 31)
    same = Material("same", at, *(np.full(31, x) for x in (0.72, 1.1, 90.0, 1.5)))
    band = same.band(400.0, 700.0, weight=lambda nm: nm)
    assert [float(x[0]) for x in (band.rho_d, band.rho_s, band.alpha, band.n2)] == pytest.approx(
        [0.72, 1.1, 90.0, 1.5], rel=1e-9
    )


def test_weight_picks_the_wavelengths_it_weighs() -> None:
    material = spectrum()
    band = material.band(300.0, 1500.0, weight=lambda nm: np.where(nm == 400.0, 1.0, 0.0))
    k = int(np.flatnonzero(material.wavelength_nm == 400.0)[0])
    assert float(band.rho_d[0]) == pytest.approx(material.rho_d[k], rel=1e-12)
    assert float(band.alpha[0]) == pytest.approx(material.alpha[k], rel=1e-9)


def test_lambert_is_the_same_at_every_wavelength() -> None:
    grey = Material.lambert(0.2)
    assert grey.band(380.0, 740.0) is grey
    assert float(grey.k_g(70.0)[0]) == 0.2
    assert float(grey.dsf(10.0, 60.0, "s")[0]) == pytest.approx(0.1 / np.pi, rel=1e-14)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Material.lambert(1.2), "albedo = 1.2 must lie between 0 and 1"),
        (lambda: spectrum().band(1600.0, 1700.0), "measured from 300 to 1500 nm"),
        (lambda: spectrum().band(700.0, 400.0), "swap them"),
        (lambda: spectrum().band(400.0, 700.0, weight=lambda nm: 0.0 * nm), "positive somewhere"),
        (
            lambda: Material("x", np.array([500.0]), *(np.array([v]) for v in (0.5, 1.0, 10.0, 0.9))),
            "n2 = 0.9 at 500 nm must be a number of at least 1",
        ),
        (
            lambda: Material("x", np.array([500.0]), *(np.array([v]) for v in (np.nan, 1.0, 10.0, 1.5))),
            "rho_d = nan at 500 nm",
        ),
    ],
)
def test_refusals(call: object, words: str) -> None:
    with pytest.raises(GonioError, match=words):
        call()  # type: ignore[operator]

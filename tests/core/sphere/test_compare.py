"""A fit beside the sphere: E_n by hand, what averages out and what does not, and what is said of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_fits import fitted

from gonio.fitting import FitResult
from gonio.sphere import Geometry, Sphere, SphereComparison, compare, e_n
from gonio.sphere.text import verdicts

NM = np.array([840.0, 850.0, 860.0, 870.0])


@pytest.fixture(scope="module")
def fit() -> FitResult:
    """Four wavelengths, the first two on one detector; k_g near 0.76."""
    return fitted(NM, detector_index=[0, 0, 1, 1])


def unwrapped(found: SphereComparison) -> str:
    """Return the table with its lines joined, for what may be broken anywhere."""
    return " ".join(found.table().split())


def sphere(fit: FitResult, value: object = 0.76, u: object = 0.0038, **known: object) -> Sphere:
    at = np.asarray(known.pop("wavelength_nm", fit.wavelength_nm), np.float64)
    values, standard = (np.broadcast_to(np.asarray(x, np.float64), at.shape) for x in (value, u))
    return Sphere(at, values, standard, **{"uncertainty": "1 % relative, k = 2", **known})


def with_modes(fit: FitResult, rho_d: object, names: tuple[str, ...]) -> FitResult:
    """Add common modes that shift rho_d alone, (g, m), to a fit and to its covariance."""
    shift = np.asarray(rho_d, np.float64)
    modes = np.zeros((*shift.shape, fit.basic.shape[1]))
    modes[:, :, 0] = shift
    covariance = fit.basic_covariance + np.einsum("gma,gmb->mab", modes, modes)
    return replace(fit, modes=modes, mode_names=names, basic_covariance=covariance)


def test_a_worked_example() -> None:
    # k = 0.684, U_fit = 0.003, U_common = 0.006; sphere 0.760 ± 1 % (k = 2) = 0.0076:
    # -0.076 / sqrt(9e-6 + 36e-6 + 57.76e-6) = -0.076 / 0.010137...
    assert e_n(-0.076, 0.003, 0.006, 0.0076) == pytest.approx(-7.4971, abs=2e-4)
    assert e_n(0.01, 0.01) == 1.0
    assert np.isnan(e_n(0.01, 0.0))
    assert np.isnan(e_n(np.nan, 1.0))
    assert np.isnan(e_n(0.01, np.nan, 0.1))
    np.testing.assert_allclose(e_n([0.03, -0.05], [0.03, 0.03], 0.04), [0.6, -1.0], rtol=1e-15)


def test_each_wavelength_by_hand(fit: FitResult) -> None:
    found = compare(fit, sphere(fit))
    k_g = fit.hemispherical(8.0).k_g
    for i in range(4):
        u_fit = 0.5 * (k_g.upper[i] - k_g.lower[i])
        assert found.difference[i] == pytest.approx(k_g.value[i] - 0.76, abs=1e-15)
        assert found.e_n[i] == pytest.approx((k_g.value[i] - 0.76) / np.sqrt(u_fit**2 + 0.0076**2), rel=1e-12)
    assert found.mode_names == ()
    np.testing.assert_array_equal(found.u_common, 0.0)


def test_a_mean_keeps_what_is_common_and_averages_the_rest(fit: FitResult) -> None:
    two = [[0.004] * 4, [0.003, -0.003, 0.003, -0.003]]  # the second cancels over two wavelengths
    found = compare(with_modes(fit, two, ("distance", "alignment")), sphere(fit))
    alone = fit.hemispherical(8.0).k_g
    np.testing.assert_allclose(found.u_common, 2.0 * 0.005, rtol=1e-9)  # sqrt(4^2 + 3^2) = 5
    np.testing.assert_allclose(found.u_fit, 0.5 * (alone.upper - alone.lower), rtol=1e-6)
    first, second = found.parts()
    u = found.u_fit
    assert first.u_fit == pytest.approx(np.hypot(u[0], u[1]) / 2.0, rel=1e-12)
    assert first.u_common == pytest.approx(2.0 * 0.004, rel=1e-9)
    assert first.u_sphere == pytest.approx(0.0076, rel=1e-12)
    total = np.sqrt(first.u_fit**2 + 0.008**2 + 0.0076**2)
    assert first.e_n == pytest.approx((np.mean(alone.value[:2]) - 0.76) / total, rel=1e-9)
    assert (first.low_nm, first.high_nm, second.low_nm, second.high_nm) == (840.0, 850.0, 860.0, 870.0)
    assert "U_common: distance, alignment" in unwrapped(found)


def test_detectors_are_never_mixed_and_neither_are_those_of_the_sphere(fit: FitResult) -> None:
    names = ("pmt", "ingaas")
    parts = compare(fit, sphere(fit), detector_names=names).parts()
    assert [(p.detector, p.low_nm, p.high_nm, p.count) for p in parts] == [
        ("pmt", 840.0, 850.0, 2), ("ingaas", 860.0, 870.0, 2)]  # fmt: skip
    own = compare(fit, sphere(fit, detector_change_nm=(845.0,)), detector_names=names)
    assert [(p.detector, p.low_nm, p.high_nm) for p in own.parts()] == [
        ("pmt", 840.0, 840.0), ("pmt", 850.0, 850.0), ("ingaas", 860.0, 870.0)]  # fmt: skip
    across = own.bands([(800.0, 870.0)])
    assert [(p.low_nm, p.high_nm) for p in across] == [(840.0, 840.0), (850.0, 850.0), (860.0, 870.0)]
    assert "the sphere's spectrometer changed its detector at 845 nm" in unwrapped(own)


def test_the_sphere_is_interpolated_but_not_extended_nor_joined_across_its_change(fit: FitResult) -> None:
    at = [845.0, 855.0, 865.0]
    found = compare(fit, sphere(fit, [0.70, 0.72, 0.80], [0.002, 0.004, 0.004], wavelength_nm=at))
    np.testing.assert_allclose(found.reference, [np.nan, 0.71, 0.76, np.nan], rtol=1e-12)
    np.testing.assert_allclose(found.u_sphere[1:3], [0.006, 0.008], rtol=1e-12)
    assert "interpolated between wavelengths up to 10 nm apart" in unwrapped(found)
    broken = compare(fit, sphere(fit, [0.70, 0.72, 0.80], wavelength_nm=at, detector_change_nm=(861.0,)))
    np.testing.assert_allclose(broken.reference, [np.nan, 0.71, np.nan, np.nan], rtol=1e-12)
    whole = compare(fit, sphere(fit, [0.70, 0.71, 0.80, 0.81], detector_change_nm=(855.0,)))
    np.testing.assert_array_equal(whole.reference, [0.70, 0.71, 0.80, 0.81])  # its own points need no line


def test_without_the_specular_beam_it_is_the_diffuse_coefficient_at_the_spheres_incidence(
    fit: FitResult,
) -> None:
    out = compare(fit, sphere(fit, geometry=Geometry(8.0, "excluded")))
    np.testing.assert_allclose(out.value, fit.hemispherical(8.0).k_d.value, rtol=1e-14)
    assert "gloss trap" in unwrapped(out)
    steep = compare(fit, sphere(fit, geometry=Geometry(60.0, "included")))
    np.testing.assert_allclose(steep.value, fit.hemispherical(60.0).k_g.value, rtol=1e-14)
    assert np.all(steep.value > compare(fit, sphere(fit)).value + 0.01)


def test_a_sphere_without_uncertainty_gives_differences_and_no_verdict(fit: FitResult) -> None:
    found = compare(fit, sphere(fit, u=np.nan))
    assert np.all(np.isfinite(found.difference))
    assert np.all(np.isnan(found.e_n))
    assert [p.judged for p in found.parts()] == [0, 0]
    assert "nothing can be said of agreement: state it with --sphere-u" in unwrapped(found)
    assert "what may cause it" not in unwrapped(found)


def test_nothing_in_common(fit: FitResult) -> None:
    found = compare(fit, sphere(fit, wavelength_nm=fit.wavelength_nm + 1000.0))
    assert found.parts() == ()
    assert "no wavelength in common (fit 840-870 nm, sphere 1840-1870 nm)" in unwrapped(found)


def test_a_wavelength_that_failed_takes_no_part(fit: FitResult) -> None:
    basic = fit.basic.copy()
    basic[0] = np.nan
    found = compare(replace(fit, basic=basic), sphere(fit))
    assert np.isnan(found.e_n[0])
    assert [p.count for p in found.parts()] == [1, 2]


def test_the_papers_finding_is_said_as_such() -> None:
    """Below the detector change the fit is 10 % low, above it agrees."""
    low = fitted(NM, detector_index=[0, 0, 1, 1], gain=[0.9, 0.9, 1.0, 1.0])
    truth = fitted(NM, detector_index=[0, 0, 1, 1]).hemispherical(8.0).k_g.value
    found = compare(low, sphere(low, truth, 0.005 * truth), detector_names=("pmt", "ingaas"))
    pmt, ingaas = found.parts()
    assert pmt.relative == pytest.approx(-0.10, abs=0.003)
    assert pmt.e_n < -5.0
    assert (pmt.within, pmt.judged) == (0, 2)
    assert abs(ingaas.e_n) < 1.0
    said = verdicts(found)
    assert said[0].startswith(
        "the fit is 10 % (relative) low, -7.6 %R over 840-850 nm (pmt), beyond both uncert"
    )
    assert said[1].startswith("fit and sphere agree over 860-870 nm (ingaas)")
    causes = "\n".join(said[2:])
    # -0.076 Omega / pi, Omega = 0.0509 sr: what each reading must be off by
    assert "a zero offset of -0.12 %R in each reading" in causes
    assert "a gain of -10 %" in causes
    assert "the detectors deviate differently" in causes
    assert "distance (" not in causes  # it cannot be: it would shift both


def test_a_wrong_distance_is_told_from_a_bad_detector() -> None:
    """All readings 10 % low: the distance, at fault by 5.4 %, since k goes with its square."""
    low = fitted(NM, detector_index=[0, 0, 1, 1], gain=[0.9] * 4)
    truth = fitted(NM, detector_index=[0, 0, 1, 1]).hemispherical(8.0).k_g.value
    causes = "\n".join(verdicts(compare(low, sphere(low, truth, 0.005 * truth))))
    assert "all detectors deviate alike: the aperture's distance (+5.4 % would do" in causes
    assert pytest.approx(1.0, abs=1e-3) == 0.9 * 1.054**2


def test_an_offset_is_told_from_a_gain_where_the_reflectance_varies() -> None:
    at = np.linspace(400.0, 700.0, 7)
    reference = np.linspace(0.3, 0.8, 7)
    found = compare(fitted(at, [0] * 7), sphere(fitted(at, [0] * 7), reference, 0.001))
    for value, words in (
        (0.9 * reference, "goes with the reflectance, as a gain's does"),
        (reference - 0.05, "the same for dark and bright, as an offset's is"),
        (0.96 * reference - 0.025, "look for neither"),
    ):
        causes = "\n".join(verdicts(replace(found, value=value)))
        assert (words in causes) == (words != "look for neither")
        assert ("goes with the refl" in causes or "the same for" in causes) == (words != "look for neither")
    flat = "\n".join(verdicts(replace(found, reference=np.full(7, 0.7), value=np.full(7, 0.6))))
    assert "goes with the refl" not in flat
    assert "the same for" not in flat


def test_a_black_sample_has_no_relative_difference(fit: FitResult) -> None:
    found = compare(fit, sphere(fit, 0.0, 0.002))
    assert all(np.isnan(part.relative) for part in found.parts())
    said = unwrapped(found)
    assert "the fit is high, +76 %R" in said
    assert "nan" not in said
    assert "a gain of" not in said


def test_no_line_is_wider_than_a_terminal(fit: FitResult) -> None:
    for u in (0.0001, 0.0038, np.nan):
        assert max(map(len, compare(fit, sphere(fit, 0.6, u)).table().splitlines())) <= 110


def test_the_fit_has_it_as_a_method(fit: FitResult) -> None:
    assert fit.compare(sphere(fit)).table() == compare(fit, sphere(fit)).table()

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio import angles, fresnel
from gonio.errors import GonioError

indices = st.floats(1.0, 5.0)
incidences = st.floats(0.0, 90.0)


def exact(n2: float, theta_i_deg: float, polarization: str) -> mp.mpf:
    """Equations 11 and 12 in 40 digits."""
    mp.mp.dps = 40
    n, c = mp.mpf(n2), mp.cos(mp.radians(mp.mpf(theta_i_deg)))
    q = mp.sqrt(n * n - 1 + c * c)
    r = (c - q) / (c + q) if polarization == "s" else (n * n * c - q) / (n * n * c + q)
    return r * r


@pytest.mark.parametrize("polarization", ["s", "p"])
@pytest.mark.parametrize("n2", [1.0 + 1e-9, 1.0001, 1.24, 1.5, 4.0])
@pytest.mark.parametrize("theta_i_deg", [0.0, 8.0, 20.0, 55.0, 75.0, 89.0, 89.9999])
def test_reflectance_keeps_all_digits(
    polarization: fresnel.Polarization, n2: float, theta_i_deg: float
) -> None:
    value = float(fresnel.reflectance(n2, theta_i_deg, polarization))
    assert value == pytest.approx(float(exact(n2, theta_i_deg, polarization)), rel=2e-13, abs=1e-32)


def test_closed_forms() -> None:
    assert float(fresnel.reflectance(1.5, 0.0, "s")) == pytest.approx(0.04, rel=1e-14)
    assert float(fresnel.reflectance(1.5, 0.0, "p")) == pytest.approx(0.04, rel=1e-14)
    n2 = np.array([1.2, 1.5, 2.4])
    assert np.all(fresnel.reflectance(n2, fresnel.brewster_deg(n2), "p") < 1e-30)
    # at Brewster's angle R_s = ((n^2 - 1)/(n^2 + 1))^2
    expected = ((n2**2 - 1.0) / (n2**2 + 1.0)) ** 2
    np.testing.assert_allclose(fresnel.reflectance(n2, fresnel.brewster_deg(n2), "s"), expected, rtol=1e-14)
    # at 45 degrees R_p = R_s^2
    r_s = fresnel.reflectance(n2, 45.0, "s")
    np.testing.assert_allclose(fresnel.reflectance(n2, 45.0, "p"), r_s**2, rtol=1e-13)


def test_exact_ends_without_nan() -> None:
    theta = np.linspace(0.0, 90.0, 181)
    for polarization in ("s", "p", "unpolarized"):
        assert np.all(fresnel.reflectance(1.0, theta, polarization) == 0.0)
        assert np.all(fresnel.reflectance([1.0 + 1e-12, 1.3, 7.0], 90.0, polarization) == 1.0)
        everywhere = fresnel.reflectance(np.linspace(1.0, 3.0, 41)[:, None], theta, polarization)
        assert np.all((everywhere >= 0.0) & (everywhere <= 1.0))


@given(
    n2=st.floats(1.01, 5.0),
    theta=st.floats(0.0, 89.0),
    polarization=st.sampled_from(["s", "p", "unpolarized"]),
)
def test_derivatives_are_those_of_the_functions(
    n2: float, theta: float, polarization: fresnel.Polarization
) -> None:
    h = 1e-6
    for function, derivative in (
        (fresnel.reflectance, fresnel.reflectance_dn2),
        (fresnel.reflectance_ratio, fresnel.reflectance_ratio_dn2),
    ):
        up, down = function(n2 + h, theta, polarization), function(n2 - h, theta, polarization)
        scale = float(function(n2, theta, "s")) / (n2 - 1.0)
        assert float(derivative(n2, theta, polarization)) == pytest.approx(
            float(up - down) / (2.0 * h), rel=1e-6, abs=1e-5 * scale
        )
    assert float(fresnel.reflectance_dn2(1.0, theta, polarization)) == 0.0


@given(n2=indices, theta=incidences)
def test_s_reflects_at_least_as_much_as_p(n2: float, theta: float) -> None:
    r_s, r_p = fresnel.reflectance(n2, theta, "s"), fresnel.reflectance(n2, theta, "p")
    assert r_s >= r_p - 1e-15
    assert float(fresnel.reflectance(n2, theta, "unpolarized")) == pytest.approx(
        float(r_s + r_p) / 2.0, rel=1e-15
    )


def test_refusals_name_the_value() -> None:
    with pytest.raises(GonioError, match=r"n2 = 0\.9 is below 1"):
        fresnel.reflectance(0.9, 20.0, "s")
    with pytest.raises(GonioError, match="theta_i = 91 deg is behind the sample"):
        fresnel.reflectance(1.5, 91.0, "s")
    with pytest.raises(GonioError, match="'x' is not known"):
        fresnel.reflectance(1.5, 20.0, "x")  # type: ignore[arg-type]


def test_the_papers_plan_ends_where_its_table_says() -> None:
    end = angles.theta_o_from_theta_mes(theta_mes_deg=[105, 114, 126, 141], theta_i_deg=[20, 30, 45, 55])
    assert end.tolist() == [85.0, 84.0, 81.0, 86.0]


@given(theta_o=st.floats(-90.0, 90.0), theta_i=incidences)
def test_arm_angle_round_trip(theta_o: float, theta_i: float) -> None:
    arm = angles.theta_mes_from_theta_o(theta_o_deg=theta_o, theta_i_deg=theta_i)
    back = angles.theta_o_from_theta_mes(theta_mes_deg=arm, theta_i_deg=theta_i)
    assert float(back) == pytest.approx(theta_o, abs=1e-12)


@given(angle=st.floats(-720.0, 720.0))
def test_sine_and_cosine_in_degrees(angle: float) -> None:
    assert float(angles.cos_deg(angle)) == pytest.approx(float(np.cos(np.deg2rad(angle))), abs=2e-14)
    assert float(angles.sin_deg(angle)) == pytest.approx(float(np.sin(np.deg2rad(angle))), abs=2e-14)


def test_sine_and_cosine_are_exact_at_right_angles() -> None:
    assert angles.cos_deg([90.0, -90.0, 270.0, 450.0, 0.0, 180.0]).tolist() == [0.0, 0.0, 0.0, 0.0, 1.0, -1.0]
    assert angles.sin_deg([0.0, 180.0, -180.0, 360.0, 90.0, -90.0]).tolist() == [
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
        -1.0,
    ]


@given(
    theta_i=incidences,
    theta_o=st.floats(0.0, 90.0),
    azimuth=st.floats(0.0, 180.0),
)
def test_angle_to_the_mirror_direction_is_that_of_the_vectors(
    theta_i: float, theta_o: float, azimuth: float
) -> None:
    i, o, a = np.deg2rad([theta_i, theta_o, azimuth])
    mirror = np.array([np.sin(i), 0.0, np.cos(i)])
    out = np.array([np.sin(o) * np.cos(a), np.sin(o) * np.sin(a), np.cos(o)])
    expected = 0.5 * np.sum((mirror - out) ** 2)  # 1 - cos of unit vectors
    assert float(angles.one_minus_cos_to_mirror(theta_i, theta_o, azimuth)) == pytest.approx(
        expected, abs=1e-14
    )
    # a negative theta_o is the same direction half a turn on
    assert float(angles.one_minus_cos_to_mirror(theta_i, -theta_o, 180.0 - azimuth)) == pytest.approx(
        expected, abs=1e-14
    )

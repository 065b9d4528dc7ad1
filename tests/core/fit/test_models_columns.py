"""The columns of every model against a quadrature of its dsf, their derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
from surface_readings import surface_reading

from gonio.aperture import Aperture, IncidentBeam, InPlaneAverage, InstrumentFunction, PointReceiver
from gonio.errors import FitError
from gonio.fitting.columns import FitModel, FloatArray, readings
from gonio.fitting.models import FIT_MODELS, FitCoupled, FitGGX, FitLambert, FitPhong, FitReciprocal

MODELS: tuple[type[FitModel], ...] = (FitReciprocal, FitGGX, FitCoupled, FitPhong, FitLambert)

# the mirror direction inside, at the rim and outside; backwards beyond 90 deg from it; cut by both horizons
POSITIONS = np.array(
    [
        *[(20.0, 20.0), (20.0, 29.0), (45.0, 52.77), (55.0, 86.0), (55.0, 40.0), (55.0, -28.0)],
        *[(55.0, -40.0), (30.0, -84.0), (70.0, 71.0), (0.0, 15.0), (75.0, 83.0), (10.0, -5.0)],
    ]
)
APERTURES = (Aperture(26.0, 18.0, 95.2353), Aperture(6.0, 40.0, 60.0))


def points(kind: type[FitModel], count: int, seed: int) -> FloatArray:
    """Shape parameters (count, k) over the whole range."""
    rng = np.random.default_rng(seed)
    low, high = kind.low.copy(), kind.high.copy()
    x = low + (high - low) * rng.random((count, low.size))
    if "n2" in kind.shape:
        x[:, -1] = 1.0 + np.exp(np.log(1e-3) + np.log(9e3) * rng.random(count))
    return x


def finest_deg(kind: type[FitModel], x: FloatArray) -> float:
    """A small part of the lobe's width."""
    if not x.size:
        return 0.0
    return float(
        np.rad2deg(0.1 * np.exp(x[0]) if "log_roughness" in kind.shape else 0.2 * np.exp(-0.5 * x[0]))
    )


@pytest.mark.parametrize("kind", MODELS, ids=lambda k: k.name)
@pytest.mark.parametrize("aperture", APERTURES, ids=["26x18", "6x40"])
def test_readings_are_the_integral_of_the_dsf_over_the_aperture(
    kind: type[FitModel], aperture: Aperture
) -> None:
    """1e-9 of the largest reading at that shape, s and p, over the whole range of shape and index."""
    theta_i, theta_o = POSITIONS.T
    shapes = points(kind, 3, 1)
    for is_s, polarization in ((True, "s"), (False, "p")):
        model = kind.of(aperture, theta_i, theta_o, np.full(theta_i.size, is_s))
        basic = np.concatenate([np.tile([0.3, 0.04][: len(kind.linear)], (len(shapes), 1)), shapes], axis=1)
        found = readings(model, basic)
        for k, x in enumerate(shapes):
            surface = kind.scattering(kind.published(basic[k : k + 1]))
            one = type(surface)(*(float(np.asarray(getattr(surface, p))[0]) for p in kind.parameters))
            finest = min(finest_deg(kind, x), 3.0)
            expected = np.array(
                [
                    surface_reading(one, i, o, polarization, aperture, panels=18, finest_deg=finest)
                    for i, o in POSITIONS
                ]
            )
            np.testing.assert_allclose(found[:, k], expected, rtol=0.0, atol=1e-9 * np.max(expected))


@pytest.mark.parametrize("kind", MODELS, ids=lambda k: k.name)
@pytest.mark.parametrize(
    "beam", [IncidentBeam(1.0, 1.0), IncidentBeam(6.0, 0.0), IncidentBeam(0.0, 25.0)], ids=str
)
def test_readings_with_a_beam_are_the_mean_over_its_spot(kind: type[FitModel], beam: IncidentBeam) -> None:
    """The mirror direction at the rim too; lobes wide enough for Gauss nodes over the spot."""
    positions = np.array([(20.0, 20.0), (45.0, 52.5), (55.0, 86.0), (30.0, -12.0), (60.0, 52.6)])
    theta_i, theta_o = positions.T
    aperture = APERTURES[0]
    shape = {"log_alpha": np.log(500.0), "log_roughness": np.log(0.06), "n2": 1.3}
    shapes = np.array([[shape[name] for name in kind.shape]])
    basic = np.concatenate([[[0.3, 0.04][: len(kind.linear)]], shapes], axis=1)
    model = kind.of(InstrumentFunction(aperture, beam), theta_i, theta_o, np.ones(theta_i.size, bool))
    surface = kind.scattering(kind.published(basic))
    one = type(surface)(*(float(np.asarray(getattr(surface, p))[0]) for p in kind.parameters))
    nodes, weights = np.polynomial.legendre.leggauss(8 if beam.width_mm == 1.0 else 24)
    expected = []
    for i, o in positions:
        spot = 0.5 * beam.width_mm / np.cos(np.deg2rad(i))
        xs = [(spot * t, 0.5 * w) for t, w in zip(nodes, weights, strict=True)] if spot else [(0.0, 1.0)]
        ys = [(0.5 * beam.height_mm * t, w) for t, w in zip(nodes, weights, strict=True) if t > 0.0]
        ys = ys if beam.height_mm else [(0.0, 1.0)]
        read = [
            a * b * surface_reading(one, i, o, "s", aperture, panels=5, x_mm=x, y_mm=y)
            for x, a in xs
            for y, b in ys
        ]
        expected.append(sum(read))
    np.testing.assert_allclose(readings(model, basic)[:, 0], expected, rtol=0.0, atol=1e-9 * np.max(expected))


def test_a_narrow_lobe_enters_over_the_spot() -> None:
    """alpha 1e6, 0.06 deg wide, at the rim: the part of a 6 mm spot whose mirror ray enters is counted."""
    aperture, beam = APERTURES[0], IncidentBeam(6.0, 0.0)
    theta_i = np.full(41, 30.0)
    theta_o = 30.0 + np.linspace(-10.0, 10.0, 41)
    log_alpha = FitReciprocal.high[0]
    model = FitReciprocal.of(InstrumentFunction(aperture, beam), theta_i, theta_o, np.ones(41, bool))
    narrow = model.columns(np.array([[log_alpha, 1.5]])).value[1][:, 0]
    d = np.deg2rad(theta_o - theta_i)
    spot = 3.0 / np.cos(np.deg2rad(30.0))
    # the mirror ray from x crosses the aperture's plane at R tan(-d) - x cos(theta_i)/cos(d) from its middle
    x = np.linspace(-spot, spot, 20001)
    at = aperture.distance_mm * np.tan(-d)[:, None] - x * np.cos(np.deg2rad(30.0)) / np.cos(d)[:, None]
    share = np.mean(np.abs(at) <= 13.0, axis=1)
    whole = narrow[20]
    assert share[20] == 1.0
    np.testing.assert_allclose(narrow / whole, share, rtol=0.0, atol=6e-3)


def test_a_divergent_beam_is_refused() -> None:
    receiver = InstrumentFunction(APERTURES[0], IncidentBeam(1.0, 1.0, 0.5))
    with pytest.raises(FitError, match=r"diverges by 0\.5 deg"):
        FitGGX.of(receiver, POSITIONS[:, 0], POSITIONS[:, 1], np.ones(len(POSITIONS), bool))


@pytest.mark.parametrize("kind", MODELS, ids=lambda k: k.name)
def test_approximate_receivers_read_the_dsf_in_the_plane(kind: type[FitModel]) -> None:
    theta_i, theta_o = POSITIONS.T
    shapes = points(kind, 5, 2)
    basic = np.concatenate([np.tile([0.3, 0.04][: len(kind.linear)], (len(shapes), 1)), shapes], axis=1)
    is_s = np.ones(theta_i.size, bool)
    surface = kind.scattering(kind.published(basic))
    point = kind.of(PointReceiver(0.05), theta_i, theta_o, is_s)
    expected = 0.05 * surface.dsf(theta_i[:, None], theta_o[:, None], "s")
    np.testing.assert_allclose(
        readings(point, basic), expected, rtol=0.0, atol=1e-9 * np.max(expected), err_msg="point"
    )
    half = 4.0
    average = readings(kind.of(InPlaneAverage(half, 0.05), theta_i, theta_o, is_s), basic)
    nodes, weights = np.polynomial.legendre.leggauss(16)
    for k in range(theta_i.size):
        finest = 0.002
        steps = np.concatenate([[0.0], np.geomspace(finest, 8.0, 60)])
        low, high = max(theta_o[k] - half, -90.0), min(theta_o[k] + half, 90.0)
        about = min(max(theta_i[k], low), high)
        edges = np.concatenate([about - steps, about + steps, [low, high, theta_i[k] - 90.0]])
        edges = np.unique(edges[(edges >= low) & (edges <= high)])
        width = 0.5 * np.diff(edges)[:, None]
        t = (edges[:-1, None] + width + width * nodes).ravel()
        dsf = surface.dsf(theta_i[k], t[:, None], "s")
        expected = 0.05 / (2.0 * half) * (width * weights).ravel() @ dsf
        np.testing.assert_allclose(average[k], expected, rtol=1e-9, atol=1e-9 * np.max(average))


@pytest.mark.parametrize("kind", MODELS[:4], ids=lambda k: k.name)
def test_derivatives_are_those_of_the_columns(kind: type[FitModel]) -> None:
    theta_i, theta_o = np.tile(POSITIONS, (2, 1)).T
    model = kind.of(APERTURES[0], theta_i, theta_o, np.arange(theta_i.size) < len(POSITIONS))
    x = points(kind, 8, 3)
    at = model.columns(x, order=2)
    for a in range(x.shape[1]):
        step = np.zeros_like(x)
        step[:, a] = 1e-4 * (x[:, a] - 1.0 if kind.shape[a] == "n2" else 1.0)
        x_in = np.clip(x, kind.low + step.max(), kind.high - step.max()) if kind.shape[a] != "n2" else x
        at = model.columns(x_in, order=2)
        up, down = model.columns(x_in + step, order=1), model.columns(x_in - step, order=1)
        for column in range(len(kind.linear)):
            scale = np.maximum(np.max(np.abs(at.value[column]), axis=0), 1e-300)
            change = (up.value[column] - down.value[column]) / 2.0
            slope = at.first[column][a]
            if slope is None:
                assert np.all(change == 0.0)
                continue
            h = step[:, a]
            # the difference itself leaves h^2 of the third derivative
            np.testing.assert_allclose(slope * h / scale, change / scale, atol=2e-10)
            for b in range(x.shape[1]):
                h_b = 1e-4 * (x[:, b] - 1.0) if kind.shape[b] == "n2" else np.full(len(x), 1e-4)
                ups, downs = up.first[column][b], down.first[column][b]
                twice = at.second[column][a][b]
                if ups is None or downs is None:
                    assert twice is None
                    continue
                bend = (ups - downs) / 2.0
                assert twice is not None
                np.testing.assert_allclose(twice * h * h_b / scale, bend * h_b / scale, atol=2e-13)


def test_columns_without_derivatives_are_the_same_and_repeated_points_too() -> None:
    theta_i, theta_o = POSITIONS.T
    for kind in MODELS:
        model = kind.of(APERTURES[0], theta_i, theta_o, theta_o > 30.0)
        x = points(kind, 4, 4)
        grid = np.repeat(x, 5, axis=0)
        plain, repeated, full = model.columns(x), model.columns(grid), model.columns(x, order=2)
        for k in range(len(kind.linear)):
            np.testing.assert_array_equal(plain.value[k], full.value[k])
            wide = np.broadcast_to(plain.value[k], (theta_i.size, 4))
            np.testing.assert_allclose(
                np.broadcast_to(repeated.value[k], (theta_i.size, 20)),
                np.repeat(wide, 5, axis=1),
                rtol=1e-12,
                atol=1e-15,
            )


def test_published_parameters_and_their_jacobian() -> None:
    for kind in FIT_MODELS.values():
        rng = np.random.default_rng(5)
        basic = np.concatenate([rng.uniform(0.02, 0.8, (3, len(kind.linear))), points(kind, 3, 5)], axis=1)
        known = kind.published(basic)
        surface = kind.scattering(known)
        assert surface.name == kind.name
        assert surface.parameter_names == kind.parameters
        jacobian = kind.published_jacobian(basic)
        for a in range(basic.shape[1]):
            step = np.zeros_like(basic)
            step[:, a] = 1e-6 * (basic[:, a] - 1.0 if a == 3 else np.abs(basic[:, a]))
            change = (kind.published(basic + step) - kind.published(basic - step)) / (
                2.0 * step[:, a : a + 1]
            )
            np.testing.assert_allclose(jacobian[:, :, a], change, rtol=1e-6, atol=1e-6)


def test_an_unknown_receiver_is_refused() -> None:
    class Other:
        solid_angle_sr = 0.05
        lobe_growth = 0.0

    with pytest.raises(FitError, match="Other cannot be integrated"):
        FitReciprocal.of(Other(), POSITIONS[:, 0], POSITIONS[:, 1], np.ones(len(POSITIONS), bool))  # type: ignore[arg-type]

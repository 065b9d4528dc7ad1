from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from gonio.aperture import Aperture
from gonio.brdf import PublishedLobe
from gonio.errors import SceneError
from gonio.facade import Band, Optics, Scene, Sky, Sun, parse_scene, simulate
from gonio.facade.bands import power_shares
from gonio.fitting import fit_readings

Canyon = Callable[..., Scene]
WAVELENGTH_NM = np.arange(350.0, 1101.0, 50.0)
HEAD = """
[sun]
azimuth_deg = 90.0
elevation_deg = 40.0
[irradiance]
dni_w_m2 = 800.0
dhi_w_m2 = 100.0
[materials.ground]
albedo = 0.2
[street]
azimuth_deg = 0.0
width_m = 10.0
length_m = 30.0
height_left_m = 8.0
height_right_m = 12.0
left = "wall"
right = "wall"
ground = "ground"
[[receivers]]
surface = "left"
rows = 1
columns = 1
[materials.wall]
"""
GREY = HEAD + "albedo = 0.5\n"
MEASURED = HEAD + 'scan = "wall.h5"\n'


def rho_d(wavelength_nm: float) -> float:
    return 0.3 + 4e-4 * (wavelength_nm - 350.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fits of a wall whose diffuse coefficient rises with the wavelength, joint and of S and P alone."""
    out = tmp_path_factory.mktemp("walls")
    theta_i = np.repeat([20.0, 30.0, 45.0, 55.0], 25)
    theta_o = theta_i + np.tile(np.linspace(-36.0, 36.0, 25), 4)
    theta_i, theta_o = (np.tile(a[theta_o < 88.0], 2) for a in (theta_i, theta_o))
    pol = np.repeat(["s", "p"], theta_i.size // 2)
    aperture = Aperture(26.0, 18.0, 95.2353)

    def r(at_nm: float) -> list[float]:
        lobe = PublishedLobe(rho_d(at_nm), 1.0, 40.0, 1.5)
        return [
            float(np.ravel(lobe.dsf(i, o, p))[0]) * aperture.solid_angle_sr
            for i, o, p in zip(theta_i, theta_o, pol, strict=True)
        ]

    readings = np.array([r(x) for x in WAVELENGTH_NM]).T
    for name, polarization, wavelengths in (
        ("wall", "s", slice(None)), ("wall", "joint", slice(None)), ("p", "p", slice(None)),
        ("laser", "joint", slice(4, 5)), ("narrow", "joint", slice(3, 6)),
    ):  # fmt: skip
        with h5py.File(out / f"{name}.h5", "a") as file:
            file.require_group("entry").attrs["NX_class"] = "NXentry"
        fit_readings(
            theta_i, theta_o, pol, readings[:, wavelengths], instrument=aperture, aperture="point",
            wavelength_nm=WAVELENGTH_NM[wavelengths], polarization=polarization, sample_name=name,
        ).save(out / f"{name}.h5")  # fmt: skip
    return out


def test_power_shares_follow_the_solar_spectrum() -> None:
    from pvlib.spectrum import get_reference_spectra

    table = get_reference_spectra(standard="ASTM G173-03")["global"]
    fine = np.linspace(380.0, 740.0, 36_001)
    limits = [(380.0, 433.3), (433.3, 600.0), (650.0, 740.0)]
    power = []
    for low, high in limits:
        at = fine[(fine >= low) & (fine <= high)]
        power.append(float(np.trapezoid(np.interp(at, table.index, table), at)))
    share = power_shares(limits)
    assert share == pytest.approx(np.array(power) / sum(power), rel=1e-4)
    assert float(np.sum(share)) == 1.0
    assert power_shares([(380.0, 740.0)]) == pytest.approx([1.0], abs=0.0)
    with pytest.raises(SceneError, match="band 4100-4200 nm has no power in AM1"):
        power_shares([(380.0, 740.0), (4100.0, 4200.0)])


def test_a_file_without_spectrum_has_the_papers_band(folder: Path) -> None:
    scene = parse_scene(MEASURED, folder=folder)
    assert scene.bands == ()
    assert scene.in_band(0) is scene
    wall = scene.materials["wall"]
    # flat mean of a straight line over 380...740 nm
    assert wall.rho_d == pytest.approx(rho_d(560.0), rel=1e-4)
    assert (wall.rho_s * 0.04, wall.alpha, wall.n2) == pytest.approx((0.04, 40.0, 1.5), rel=2e-2)
    (note,) = (n for n in scene.notes if "material 'wall'" in n and "sha256" in n)
    assert "fit point_joint, 380-740 nm weighed flat" in note
    assert "alone" not in note


def test_each_band_has_its_own_average_and_they_add_up(folder: Path) -> None:
    scene = parse_scene(MEASURED + "[spectrum]\nedges_nm = [400, 500, 700, 1000]\n", folder=folder)
    assert [(b.low_nm, b.high_nm) for b in scene.bands] == [(400, 500), (500, 700), (700, 1000)]
    for b, middle in zip(scene.bands, (450.0, 600.0, 850.0), strict=True):
        assert b.materials["wall"].rho_d == pytest.approx(rho_d(middle), rel=1e-4)
        assert b.materials["ground"] == Optics(0.2)
    assert [b.dni_share for b in scene.bands] == pytest.approx(
        power_shares([(400, 500), (500, 700), (700, 1000)])
    )
    mean = sum(b.dni_share * b.materials["wall"].rho_d for b in scene.bands)
    assert scene.materials["wall"].rho_d == pytest.approx(mean, rel=1e-12)
    assert any("3 bands with all of DNI / DHI in them, by the power of AM1.5G" in n for n in scene.notes)
    red = scene.in_band(2)
    assert red.materials == scene.bands[2].materials
    assert red.dni_w_m2 == pytest.approx(800.0 * scene.bands[2].dni_share)
    assert (red.broadband_w_m2, red.bands) == ((800.0, 100.0), ())
    assert sum(scene.in_band(i).dhi_w_m2 for i in range(3)) == pytest.approx(100.0, rel=1e-12)


def test_weights_and_shares_may_be_given(folder: Path) -> None:
    spectrum = '[spectrum]\nbands_nm = [[400, 500], [600, 1000]]\nweight = "am15g"\ndhi_share = [0.7, 0.3]\n'
    scene = parse_scene(MEASURED + spectrum, folder=folder)
    blue, red = scene.bands
    assert (blue.dhi_share, red.dhi_share) == pytest.approx((0.7, 0.3))
    assert blue.dni_share == pytest.approx(power_shares([(400, 500), (600, 1000)])[0])
    assert red.materials["wall"].rho_d < rho_d(800.0) - 0.003  # the sun is weaker towards 1000 nm
    assert any("dhi_share" in n and "as given, the other by AM1.5G" in n for n in scene.notes)
    eye = parse_scene(MEASURED + '[spectrum]\nweight = "photopic"\n', folder=folder)
    assert eye.materials["wall"].rho_d == pytest.approx(rho_d(560.0), abs=0.004)  # V is centred at 560 nm
    assert eye.bands == ()


@pytest.mark.parametrize(
    ("material", "words"),
    [
        (
            'scan = "wall.h5"\nfit = "point_s"',
            "fitted to S light alone; its rho_s and n2 stand for P light too",
        ),
        ('scan = "p.h5"', "fitted to P light alone; its rho_s and n2 stand for S light too"),
        ('scan = "laser.h5"', "its wavelengths cover 0 % of the band 380-740 nm"),
        ('scan = "narrow.h5"', "its wavelengths cover 28 % of the band 380-740 nm"),
        ('scan = "wall.h5"\nband_nm = [600, 800]', "600-800 nm weighed flat"),
    ],
)
def test_what_a_fit_stands_for_is_said(folder: Path, material: str, words: str) -> None:
    scene = parse_scene(HEAD + material + "\n", folder=folder)
    assert any(words in note for note in scene.notes)
    expected = rho_d(700.0) if "band_nm" in material else rho_d(550.0)
    assert scene.materials["wall"].rho_d == pytest.approx(expected, abs=0.005)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            MEASURED + "band_nm = [400, 500]\n[spectrum]\nedges_nm = [400, 500]\n",
            "band_nm is given, and so is",
        ),
        (
            MEASURED + "[spectrum]\nedges_nm = [1200, 1500]\n",
            "materials.wall.scan = 'wall.h5': band 1200...1500 nm",
        ),
        (GREY + "[spectrum]\nedges_nm = [400]\n", "has no band"),
        (GREY + "[spectrum]\nbands_nm = []\n", "has no band"),
        (GREY + "[spectrum]\nedges_nm = [500, 400]\n", "the band 500-400 nm does not follow 0 nm"),
        (GREY + "[spectrum]\nbands_nm = [[400, 500], [450, 600]]\n", "450-600 nm does not follow 500 nm"),
        (GREY + "[spectrum]\nedges_nm = [400, 500]\nbands_nm = [[400, 500]]\n", "both bands_nm and edges_nm"),
        (GREY + '[spectrum]\nweight = "moon"\n', "spectrum.weight = 'moon'"),
        (GREY + "[spectrum]\nedges_nm = [400, 500, 600]\ndni_share = [1.0]\n", "has 1 numbers for 2 bands"),
        (
            GREY + "[spectrum]\nedges_nm = [400, 500, 600]\ndni_share = [0.5, 0.4]\n",
            "dni_share adds up to 0.9",
        ),
        (GREY + "[spectrum]\nedges_nm = [5000, 6000]\n", "has no power in AM1.5G"),
    ],
)
def test_bands_that_cannot_be_are_refused(folder: Path, text: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        parse_scene(text, folder=folder)


ONE = {"left": Optics(0.5), "right": Optics(0.5), "ground": Optics(0.2)}


@pytest.mark.parametrize(
    ("bands", "message"),
    [
        ((Band(400, 500, 0.4, 0.5, ONE), Band(500, 600, 0.5, 0.5, ONE)), "dni_share add up to 0.9"),
        ((Band(400, 500, 0.5, 0.5, ONE), Band(450, 600, 0.5, 0.5, ONE)), "begins below 500 nm"),
        ((Band(500, 400, 1.0, 1.0, ONE),), "band 500-400 nm is no band"),
        (
            (Band(400, 500, -0.5, 0.5, ONE), Band(500, 600, 1.5, 0.5, ONE)),
            "dni_share = -0.5 is outside 0...1",
        ),
        ((Band(400, 500, 1.0, 1.0, {"left": Optics(0.5)}),), "other materials than the scene"),
        ((Band(400, 500, 0.5, 0.5, ONE), Band(500, 600, 0.5, 0.5, {})), "lacks the material 'left'"),
    ],
)
def test_bands_of_python_code_are_checked_too(canyon: Canyon, bands: tuple[Band, ...], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        canyon(wall=Optics(0.5), dhi=1.0, bands=bands)


def test_bands_sum_to_the_whole_for_a_grey_material(canyon: Canyon) -> None:
    materials = {
        "left": Optics(0.5, 1.0, 30.0, 1.5),
        "right": Optics(0.5, 1.0, 30.0, 1.5),
        "ground": Optics(0.2),
    }
    bands = tuple(
        Band(low, low + 100.0, share, share, materials)
        for low, share in ((400.0, 0.5), (500.0, 0.3), (600.0, 0.2))
    )
    whole = canyon(
        wall=materials["left"],
        sun=Sun(60.0, 50.0),
        dni=700.0,
        dhi=150.0,
        rows=3,
        bands=bands,
        sky=Sky("perez"),
    )
    parts = [simulate(whole.in_band(i), rel_tol=0.05, seed=4) for i in range(3)]
    one = canyon(wall=materials["left"], sun=Sun(60.0, 50.0), dni=700.0, dhi=150.0, rows=3, sky=Sky("perez"))
    together = simulate(one, rel_tol=0.05, seed=4)
    for name in ("left", "right", "ground"):
        total = sum(p[name].value for p in parts)
        assert total == pytest.approx(together[name].value, rel=1e-9)

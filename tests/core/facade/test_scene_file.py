from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from gonio.config import Strict
from gonio.errors import SceneError
from gonio.facade import Optics, Sky, load_irradiance, load_scene, parse_scene, scene_file, simulate

GOOD = """
title = "Test street"
[sun]
azimuth_deg = 90.0
elevation_deg = 40.0
[irradiance]
dni_w_m2 = 800.0
dhi_w_m2 = 100.0
[materials.wall]
rho_d = 0.6
rho_s = 1.0
alpha = 50.0
n2 = 1.5
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
rows = 2
columns = 3
[[boxes]]
name = "kiosk"
centre_m = [0.0, 5.0, 0.0]
size_m = [2.0, 2.0, 3.0]
material = "ground"
"""

SITE = """
[site]
latitude_deg = 45.19
longitude_deg = 5.72
altitude_m = 212.0
time = 2022-06-21T10:00:00+02:00
"""
NO_SUN = GOOD.replace("[sun]\nazimuth_deg = 90.0\nelevation_deg = 40.0\n", "")
CLEAR = NO_SUN.replace("[irradiance]\ndni_w_m2 = 800.0\ndhi_w_m2 = 100.0\n", "")


def test_a_good_file_is_read_completely() -> None:
    scene = parse_scene(GOOD)
    assert [s.name for s in scene.surfaces][:4] == ["left", "right", "ground", "kiosk.front"]
    assert len(scene.surfaces) == 9
    assert scene.materials["wall"] == Optics(0.6, 1.0, 50.0, 1.5)
    assert scene.materials["ground"] == Optics(0.2)
    assert [(r.name, r.rows, r.columns) for r in scene.receivers] == [("left", 2, 3)]
    assert (scene.direct_w_m2, scene.dhi_w_m2) == (800.0, 100.0)
    assert (scene.energy, scene.horizon, scene.infinite) == ("conserving", "absorb", False)
    assert scene.sun.direction == pytest.approx((math.cos(math.radians(40)), 0.0, math.sin(math.radians(40))))
    assert scene.text == GOOD
    assert any("DNI 800.0 W/m2" in note for note in scene.notes)
    assert any("exceeds 1" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("width_m = 10.0", "width_m = -10.0", "street.width_m = -10.0: input should be greater than 0"),
        ("width_m = 10.0", 'width_m = "10 m"', "street.width_m"),
        ("width_m = 10.0", "widht_m = 10.0", "did you mean 'width_m'"),
        ("rows = 2", "rows = 0", r"receivers\[1\].rows = 0"),
        ("rows = 2", "rows = 2.5", r"receivers\[1\].rows = 2.5"),
        ('surface = "left"', 'surface = "roof"', "'roof' is not a surface of the scene; choose among left"),
        ('left = "wall"', 'left = "gold"', "made of 'gold', which is not among the materials"),
        ("albedo = 0.2", "albedo = 1.2", "materials.ground.albedo = 1.2"),
        ("albedo = 0.2", "albedo = 0.2\nrho_d = 0.2", "gives albedo and coefficients; give exactly one"),
        ("albedo = 0.2", "albedo = 0.2\nk_s = 0.2", "gives albedo and hemispherical coefficients"),
        ("albedo = 0.2", "k_d = 0.2", "lacks k_s; give all of k_d, k_s"),
        ("albedo = 0.2", "k_d = 0.8\nk_s = 0.3", "k_d \\+ k_s = 1.1 returns more light than arrives"),
        ("[irradiance]", "[sky]\nextraterrestrial_w_m2 = 500\n[irradiance]", "sky.extraterrestrial_w_m2"),
        ("[irradiance]", "[reflection]\npolarised = 1\n[irradiance]", "reflection.polarised = 1"),
        ("n2 = 1.5", "", "lacks n2"),
        ("n2 = 1.5", "n2 = 0.9", "materials.wall.n2 = 0.9"),
        ("n2 = 1.5", "n2 = 1.5\nband_nm = [380, 740]", "belong to a material with a scan"),
        ("albedo = 0.2", 'scan = "no.h5"', "materials.ground.scan = 'no.h5': there is no such file"),
        ("albedo = 0.2", 'scan = "no.h5"\nband_nm = [740, 380]', "swap them"),
        ("dni_w_m2 = 800.0\n", "", "without a \\[site\\] there is no clear sky|needs both"),
        ("dni_w_m2 = 800.0", "dni_w_m2 = -1.0", "irradiance.dni_w_m2 = -1.0"),
        ("dni_w_m2 = 800.0", "dni_w_m2 = nan", "irradiance.dni_w_m2"),
        ("elevation_deg = 40.0", "", "needs both azimuth_deg and elevation_deg"),
        ("elevation_deg = 40.0", "elevation_deg = 140.0", "sun.elevation_deg = 140.0"),
        ("[irradiance]", "[sky]\nmodel = 3\n[irradiance]", "sky.model = 3"),
        ("[irradiance]", '[sky]\nmodel = "foggy"\n[irradiance]', "sky.model = 'foggy'"),
        ("[irradiance]", '[reflection]\nenergy = "free"\n[irradiance]', "reflection.energy = 'free'"),
        ("[irradiance]", SITE + "[irradiance]", "the sun is given twice"),
        ('name = "kiosk"', 'name = "my kiosk"', r"boxes\[1\].name = 'my kiosk'"),
        ("[[boxes]]", '[[receivers]]\nsurface = "left"\nrows = 1\ncolumns = 1\n[[boxes]]', "has a receiver"),
        ('ground = "ground"', 'ground = "ground"\ninfinite = true', "does not run along the infinite street"),
        ("title =", "title ", "is not valid TOML"),
    ],
)  # fmt: skip
def test_every_mistake_is_one_clear_message(old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(SceneError, match=message) as caught:
        parse_scene_as_file(GOOD.replace(old, new, 1))
    assert "scene.toml" in str(caught.value)
    assert len(str(caught.value).splitlines()) == (2 if "widht" in new else 1)  # and one missing


def parse_scene_as_file(text: str) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(text, encoding="utf-8")
        load_scene(path)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (SITE.replace("+02:00", ""), "has no offset from UTC"),
        (SITE.replace("2022-06-21T10:00:00+02:00", '"10 o\'clock"'), "is not a date and time"),
        (SITE.replace("45.19", "95.19"), "site.latitude_deg = 95.19"),
        ("", "where is the sun"),
    ],
)
def test_site_mistakes(table: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        parse_scene_as_file(NO_SUN.replace("[irradiance]", table + "[irradiance]"))


MESH = """
[[meshes]]
file = "tent.obj"
material = "wall"
"""
TENT = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl cloth\nf 1 2 3\nusemtl rope\nf 1 2 4\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"tent.obj"', '"no.obj"', r"meshes\[1\]: .*no.obj: there is no such file"),
        ('"tent.obj"', '""', r"meshes\[1\].file = ''"),
        ('material = "wall"\n', "", r"meshes\[1\].material is missing"),
        ('material = "wall"', "material = 3", r"meshes\[1\].material = 3: is no material; give a name"),
        ('material = "wall"', "material = {}", r"meshes\[1\].material: is no material; give a name"),
        ('material = "wall"', 'material = { cloth = "wall", sail = "wall" }', "'rope' is given no material"),
        ('material = "wall"', 'material = { sail = "wall", "*" = "wall" }', "object 'sail'; it has"),
        ('material = "wall"', 'material = "gold"', "mesh 'tent' is made of 'gold'"),
        ('material = "wall"', 'material = "wall"\nup = "x"', r"meshes\[1\].up = 'x'"),
        ('material = "wall"', 'material = "wall"\nsides = 3', r"meshes\[1\].sides = 3"),
        ('material = "wall"', 'material = "wall"\nmetres_per_unit = 0', r"meshes\[1\].metres_per_unit = 0"),
        ('material = "wall"', 'material = "wall"\nreceiver = "yes"', r"meshes\[1\].receiver = 'yes'"),
        ('material = "wall"', 'material = "wall"\nname = "left"', "surfaces or meshes are called 'left'"),
        ('material = "wall"', 'material = "wall"\nposition_m = [0, 0]', r"meshes\[1\].position_m"),
    ],
)  # fmt: skip
def test_mesh_mistakes(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "tent.obj").write_text(TENT, encoding="utf-8")
    assert old in MESH
    assert len(parse_scene(GOOD + MESH, folder=tmp_path).meshes[0].faces) == 2
    with pytest.raises(SceneError, match=message):
        parse_scene(GOOD + MESH.replace(old, new), folder=tmp_path)


def test_meshes_do_not_stand_in_endless_streets(tmp_path: Path) -> None:
    (tmp_path / "tent.obj").write_text(TENT, encoding="utf-8")
    endless = GOOD[: GOOD.index("[[boxes]]")].replace(
        'ground = "ground"', 'ground = "ground"\ninfinite = true'
    )
    with pytest.raises(SceneError, match="mesh 'tent' cannot repeat along an endless street"):
        parse_scene(endless + MESH, folder=tmp_path)


def test_two_coefficients_sky_and_polarization_are_read() -> None:
    text = GOOD.replace("albedo = 0.2", "k_d = 0.3\nk_s = 0.2").replace(
        "n2 = 1.5", "n2 = 1.5\n[reflection]\npolarised = true"
    )
    scene = parse_scene(text.replace("[irradiance]", '[sky]\nmodel = "cie7"\n[irradiance]'))
    assert scene.materials["ground"] == Optics(0.3, 0.2, 1e9, 1.0, constant=True)
    assert scene.materials["ground"].k_s([0.0, 60.0, 89.0]) == pytest.approx([0.2] * 3)
    assert scene.polarised
    assert scene.sky == Sky("cie7")
    plain = parse_scene(GOOD)
    assert (plain.polarised, plain.sky) == (False, Sky("isotropic"))
    perez = '[sky]\nmodel = "perez"\n[irradiance]'
    dated = parse_scene(CLEAR.replace("[materials.wall]", '[sky]\nmodel = "perez"\n[materials.wall]') + SITE)
    assert 1310.0 < dated.sky.extraterrestrial_w_m2 < 1330.0  # the earth is far from the sun in June
    given = parse_scene(
        GOOD.replace("[irradiance]", perez.replace('"perez"', '"perez"\nextraterrestrial_w_m2 = 1400'))
    )
    assert given.sky == Sky("perez", 1400.0)


def test_the_text_makes_the_scene_again(tmp_path: Path) -> None:
    (tmp_path / "bodies").mkdir()
    (tmp_path / "bodies" / "tent.obj").write_text(TENT, encoding="utf-8")
    text = GOOD + MESH.replace('"tent.obj"', '"bodies/tent.obj"\nreceiver = true')
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    scene = load_scene(tmp_path / "scene.toml")
    result = simulate(scene, rel_tol=0.1)
    result.save(tmp_path / "out.h5")
    again = parse_scene(load_irradiance(tmp_path / "out.h5").scene_text, folder=tmp_path)
    assert again.text == text
    assert (again.surfaces, again.materials, again.sun, again.notes) == (
        scene.surfaces, scene.materials, scene.sun, scene.notes
    )  # fmt: skip
    assert np.array_equal(again.meshes[0].vertices_m, scene.meshes[0].vertices_m)
    assert "tent.obj (sha256 " in scene.notes[0]
    repeated = simulate(again, rel_tol=0.1)
    assert np.array_equal(repeated["tent"].value, result["tent"].value)


def test_the_example_house_is_simulated() -> None:
    scene = load_scene(Path(__file__).parents[3] / "examples" / "scenes" / "gable.toml")
    assert len(scene.bands) == 3
    assert (scene.sky.model, scene.polarised, scene.meshes[0].sides) == ("perez", True, 1)
    assert [s.name for s in scene.receivers] == ["office.front", "window", "panel"]
    result = simulate(scene, rel_tol=0.05, seed=2)
    # cosine of the sun on the panel, by its angles
    sun, tilt = scene.sun, math.radians(35.0)
    zenith = math.radians(90.0 - sun.elevation_deg)
    cosine = math.cos(zenith) * math.cos(tilt)
    cosine += math.sin(zenith) * math.sin(tilt) * math.cos(math.radians(sun.azimuth_deg - 180.0))
    assert result["panel"].contributions["direct"].value == pytest.approx(780.0 * cosine, rel=1e-3)
    assert result["house"].value.shape == (16,)
    assert np.sum(result["house"].value == 0.0) == 2  # the base
    assert (
        "receiver 'house': 2 of 16 faces stand wholly on other surfaces; nothing reaches them" in scene.notes
    )


def test_several_mistakes_are_all_named() -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene_as_file(GOOD.replace("rows = 2", "rows = 0").replace("width_m = 10.0", "width_m = 0.0"))
    assert len(str(caught.value).splitlines()) == 2


def test_missing_file_and_scene_without_surfaces(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="there is no such file"):
        load_scene(tmp_path / "none.toml")
    head = GOOD[: GOOD.index("[street]")]
    with pytest.raises(SceneError, match=r"no surfaces; add \[street\], \[\[boxes\]\], \[\[meshes\]\]"):
        parse_scene(head + '[[receivers]]\nsurface = "left"\nrows = 1\ncolumns = 1\n')
    with pytest.raises(SceneError, match="where is the irradiance wanted"):
        parse_scene(GOOD[: GOOD.index("[[receivers]]")])
    with pytest.raises(SceneError, match="where is the irradiance wanted"):
        parse_scene("receivers = []\n" + GOOD[: GOOD.index("[[receivers]]")])


def test_a_file_without_a_fit_is_refused_by_name(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "bare.h5", "w") as file:
        file.create_group("entry")
    path = tmp_path / "scene.toml"
    path.write_text(GOOD.replace("albedo = 0.2", 'scan = "bare.h5"'), encoding="utf-8")
    with pytest.raises(SceneError, match=r"materials.ground.scan = 'bare.h5'"):
        load_scene(path)


def test_sun_of_grenoble_at_the_solstice() -> None:
    scene = parse_scene(CLEAR + SITE)
    # Independent: declination 23.435 deg, equation of time -1.9 min at 8 h UT, longitude 5.72 deg E.
    hour_angle = math.radians(15.0 * (8.0 + 5.72 / 15.0 - 1.9 / 60.0 - 12.0))
    latitude, declination = math.radians(45.19), math.radians(23.435)
    sine = math.sin(latitude) * math.sin(declination)
    sine += math.cos(latitude) * math.cos(declination) * math.cos(hour_angle)
    assert scene.sun.elevation_deg == pytest.approx(math.degrees(math.asin(sine)), abs=0.05)
    east = -math.cos(declination) * math.sin(hour_angle)
    assert scene.sun.direction[0] == pytest.approx(east, abs=2e-3)
    assert 600.0 < scene.dni_w_m2 < 950.0
    assert 50.0 < scene.dhi_w_m2 < 200.0
    assert any("clear sky by pvlib" in note for note in scene.notes)


def test_sun_below_the_horizon_leaves_the_sky_that_was_given() -> None:
    night = SITE.replace("10:00:00", "23:30:00")
    scene = parse_scene(NO_SUN + night)
    assert scene.sun.elevation_deg < -10.0
    assert scene.direct_w_m2 == 0.0
    assert any("below the horizon" in note and "800.0 W/m2 is not used" in note for note in scene.notes)
    result = simulate(scene, rel_tol=0.05)
    assert not np.any(result["left"].contributions["direct"].value)
    assert np.all(result["left"].contributions["sky"].value > 10.0)
    dark = simulate(parse_scene(CLEAR + night), rel_tol=0.05)
    assert not np.any(dark["left"].value)
    assert dark.converged


def test_the_example_street_is_valid_but_for_its_scan() -> None:
    path = Path(__file__).parents[3] / "examples" / "scenes" / "street.toml"
    with pytest.raises(SceneError, match=r"materials.cladding.scan = 'hpl.h5': there is no such file"):
        load_scene(path)
    text = path.read_text(encoding="utf-8")
    given = [line for line in text.splitlines() if not line.startswith(("scan", "band_nm"))]
    at = given.index("[materials.cladding]") + 1
    scene = parse_scene(
        "\n".join([*given[:at], "rho_d = 0.72", "rho_s = 1.0", "alpha = 100.0", "n2 = 1.5", *given[at:]])
    )
    result = simulate(scene, rel_tol=0.02, seed=1)
    left, right = result["left"], result["right"]
    assert not np.any(left.contributions["direct"].value)  # in the shade,
    assert float(right.mean_contributions["direct"].value) > 300.0  # opposite a lit facade,
    share = float(left.mean_contributions["specular"].value / left.mean.value)
    assert 0.08 < share < 0.25  # whose mirror reflection matters


def test_band_of_a_measured_material_becomes_optics() -> None:
    from gonio.material import Material

    wavelength_nm = np.arange(300.0, 1501.0, 50.0)
    measured = Material(
        "HPL", wavelength_nm, *(np.full(wavelength_nm.size, x) for x in (0.72, 1.0, 300.0, 1.5))
    )
    optics = Optics.from_material(measured.band(380.0, 740.0))
    assert (optics.rho_d, optics.rho_s, optics.n2) == pytest.approx((0.72, 1.0, 1.5), rel=1e-6)
    assert optics.alpha == pytest.approx(300.0, rel=1e-3)
    assert float(optics.k_s(8.0)) == pytest.approx(0.04, rel=1e-3)
    assert Optics.from_material(Material.lambert(0.3)) == Optics(0.3)


def test_every_key_is_on_its_page() -> None:
    page = (Path(__file__).parents[3] / "docs" / "scene.md").read_text(encoding="utf-8")
    words = {word for code in re.findall(r"`([^`]+)`", page) for word in re.findall(r"\w+", code)}
    tables = [t for t in vars(scene_file).values() if isinstance(t, type) and issubclass(t, Strict)]
    keys = {key for table in tables for key in table.model_fields}
    assert len(keys) > 50
    assert not keys - words

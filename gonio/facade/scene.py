"""What is simulated?  `Scene`, from a `scene.toml` or built from Python objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gonio.config import parse_toml, read_toml, validate
from gonio.errors import GonioError, SceneError
from gonio.facade import geometry
from gonio.facade.bands import Band
from gonio.facade.bands import check as check_bands
from gonio.facade.geometry import Mesh, Surface
from gonio.facade.optics import Energy, Horizon, Optics, excess_text
from gonio.facade.scene_file import MaterialTable, SceneTable
from gonio.facade.sun import Site, Sun, clear_sky, sun_at


@dataclass(frozen=True, slots=True)
class Scene:
    """Surfaces, materials and light, ready to be simulated.

    Parameters
    ----------
    surfaces
        Opaque rectangles; those with rows and columns are receivers.
    materials
        By the name the surfaces use.
    sun
        Position and size of the sun's disc, whose radiance is uniform.
    dni_w_m2, dhi_w_m2
        Direct normal and diffuse horizontal irradiance.  With the sun below the horizon the direct part is 0.
    infinite
        The street repeats for ever along `Surface.u_m`, which must then be common to all surfaces; patches
        are those of one cell.
    energy, horizon
        Completion of the published lobe (docs/decisions/facade-energy.md).
    text, notes
        The file the scene was read from, and what was assumed when it was read.
    meshes
        Opaque triangles; those with `receiver` are receivers, one patch for each face.
    bands
        None, or the bands whose sum is the light of the scene; `materials` is then their average.
    sky
        How the diffuse light is spread over the sky; None: evenly.
    polarised
        Whether light keeps its polarization from one lobe to the next.
    broadband_w_m2
        DNI and DHI of all bands together, which tell a clear sky from a cloudy one; None: those given above.

    Raises
    ------
    SceneError
        Surfaces without area or material, no receiver, negative or non-finite irradiance.
    """

    surfaces: tuple[Surface, ...]
    materials: Mapping[str, Optics]
    sun: Sun
    dni_w_m2: float
    dhi_w_m2: float
    title: str = ""
    infinite: bool = False
    energy: Energy = "conserving"
    horizon: Horizon = "absorb"
    text: str = ""
    notes: tuple[str, ...] = field(default=())
    meshes: tuple[Mesh, ...] = ()
    bands: tuple[Band, ...] = ()
    sky: Any = None
    polarised: bool = False
    broadband_w_m2: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        geometry.check(self.surfaces, self.materials, periodic=self.infinite)
        for name in ("dni_w_m2", "dhi_w_m2"):
            value = getattr(self, name)
            if not 0.0 <= value < float("inf"):
                raise SceneError(f"{name} = {value:g} W/m2 is not an irradiance; give zero or more")
        check_bands(self.bands, self.materials)
        if not self.receivers and not any(mesh.receiver for mesh in self.meshes):
            raise SceneError(
                "the scene has no receiver; give at least one surface rows and columns ([[receivers]])"
            )

    @property
    def receivers(self) -> tuple[Surface, ...]:
        """The surfaces with patches, in the order of `surfaces`."""
        return tuple(s for s in self.surfaces if s.rows > 0)

    @property
    def direct_w_m2(self) -> float:
        """Direct normal irradiance that counts: 0 with the centre of the sun below the horizon."""
        return self.dni_w_m2 if self.sun.is_up else 0.0

    def in_band(self, number: int) -> Scene:
        """Return the scene of one of `bands` alone: its share of the light, its materials.

        Without bands the scene itself is band 0.  `IndexError` for a number that no band has.
        """
        if not self.bands and number == 0:
            return self
        band = self.bands[number]
        return replace(
            self,
            materials=band.materials,
            dni_w_m2=self.dni_w_m2 * band.dni_share,
            dhi_w_m2=self.dhi_w_m2 * band.dhi_share,
            bands=(),
            broadband_w_m2=self.broadband_w_m2 or (self.dni_w_m2, self.dhi_w_m2),
        )


def load_scene(path: str | Path) -> Scene:
    """Return the scene of a `scene.toml`; scans named in it are found relative to the file.

    Raises
    ------
    SceneError
        One line for each mistake: what, value with unit, limit, what to do.
    """
    path = Path(path)
    try:
        read_toml(path)  # for its message if the file cannot be read
    except GonioError as error:
        raise SceneError(str(error)) from None
    return parse_scene(path.read_text(encoding="utf-8"), source=str(path), folder=path.parent)


def parse_scene(text: str, *, source: str = "scene.toml", folder: Path | None = None) -> Scene:
    """Return the scene of TOML text; scans are found relative to `folder`; errors as `load_scene`."""
    try:
        table = validate(SceneTable, parse_toml(text, source=source), source=source)
    except GonioError as error:
        raise SceneError(str(error)) from None
    surfaces = _surfaces(table, source)
    materials = {name: _optics(name, m, source, folder or Path()) for name, m in table.materials.items()}
    notes: list[str] = []
    sun, dni, dhi = _light(table, notes)
    for name, optics in materials.items():
        if any(s.material == name for s in surfaces):
            sentence = excess_text(name, optics, table.reflection.energy)
            if sentence:
                notes.append(sentence)
    try:
        return Scene(
            surfaces=surfaces,
            materials=materials,
            sun=sun,
            dni_w_m2=dni,
            dhi_w_m2=dhi,
            title=table.title,
            infinite=table.street is not None and table.street.infinite,
            energy=table.reflection.energy,
            horizon=table.reflection.horizon,
            text=text,
            notes=tuple(notes),
        )
    except SceneError as error:
        raise SceneError(f"{source}: {error}") from None


def _surfaces(table: SceneTable, source: str) -> tuple[Surface, ...]:
    surfaces: list[Surface] = []
    if table.street is not None:
        surfaces += geometry.street(**table.street.model_dump(exclude={"infinite"}))
    for b in table.boxes:
        surfaces += geometry.box(
            b.name, centre_m=b.centre_m, size_m=b.size_m, azimuth_deg=b.azimuth_deg, material=b.material
        )
    index = {s.name: i for i, s in enumerate(surfaces)}
    for number, r in enumerate(table.receivers, start=1):
        where = f"{source}: receivers[{number}].surface = '{r.surface}'"
        if r.surface not in index:
            raise SceneError(f"{where} is not a surface of the scene; choose among {', '.join(index)}")
        i = index[r.surface]
        if surfaces[i].rows:
            raise SceneError(f"{where} has a receiver already; keep one of the two grids")
        surfaces[i] = replace(surfaces[i], rows=r.rows, columns=r.columns)
    return tuple(surfaces)


def _optics(name: str, m: MaterialTable, source: str, folder: Path) -> Optics:
    if m.albedo is not None:
        return Optics(m.albedo)
    if m.scan is None:
        assert m.rho_d is not None
        assert m.rho_s is not None
        assert m.alpha is not None
        assert m.n2 is not None
        return Optics(m.rho_d, m.rho_s, m.alpha, m.n2)
    from gonio.material import Material

    where = f"{source}: materials.{name}.scan = '{m.scan}'"
    scan = folder / m.scan
    if not scan.is_file():
        raise SceneError(
            f"{where}: there is no such file beside the scene; measure and fit it first, or correct the name"
        )
    try:
        material = Material.from_file(scan, fit=m.fit).band(*m.band_nm)
        return Optics.from_material(material)
    except GonioError as error:
        raise SceneError(f"{where}: {error}") from None


def _light(table: SceneTable, notes: list[str]) -> tuple[Sun, float, float]:
    """Return sun, DNI and DHI, and note where they come from."""
    site = None
    if table.site is not None:
        site = Site(**table.site.model_dump())
        sun = sun_at(site, angular_diameter_deg=table.sun.angular_diameter_deg)
    else:
        assert table.sun.azimuth_deg is not None
        assert table.sun.elevation_deg is not None
        sun = Sun(table.sun.azimuth_deg, table.sun.elevation_deg, table.sun.angular_diameter_deg)
    notes.append(f"sun at azimuth {sun.azimuth_deg:.2f} deg, elevation {sun.elevation_deg:.2f} deg")
    dni, dhi = table.irradiance.dni_w_m2, table.irradiance.dhi_w_m2
    if dni is None or dhi is None:
        assert site is not None
        dni, dhi = clear_sky(site)
        notes.append(f"clear sky by pvlib (Ineichen): DNI {dni:.1f} W/m2, DHI {dhi:.1f} W/m2")
    else:
        notes.append(f"irradiance as given: DNI {dni:.1f} W/m2, DHI {dhi:.1f} W/m2")
    if not sun.is_up:
        ignored = f"; the given DNI of {dni:.1f} W/m2 is not used" if dni > 0.0 else ""
        notes.append(f"the sun is below the horizon: no direct light{ignored}")
    return sun, dni, dhi

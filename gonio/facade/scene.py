"""What is simulated?  `Scene`, from a `scene.toml` or built from Python objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from gonio.config import parse_toml, read_toml, validate
from gonio.errors import GonioError, SceneError
from gonio.facade.assembly import meshes_of, surfaces_of
from gonio.facade.bands import Band
from gonio.facade.bands import check as check_bands
from gonio.facade.checks import check_shapes
from gonio.facade.geometry import Mesh, Surface
from gonio.facade.materials import read_materials
from gonio.facade.optics import Energy, Horizon, Optics, excess_text
from gonio.facade.remarks import remarks
from gonio.facade.scene_file import SceneTable
from gonio.facade.sky import Sky
from gonio.facade.sun import Site, Sun, clear_sky, extraterrestrial, sun_at


@dataclass(frozen=True, slots=True)
class Scene:
    """Surfaces, materials and light, ready to be simulated.

    Parameters
    ----------
    surfaces
        Opaque rectangles; those with rows and columns are receivers.  Where some lie in one plane, the last
        one hides the others.
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
        How the diffuse light is spread over the sky; evenly by default.
    polarised
        Whether light keeps its polarization from one lobe to the next.
    broadband_w_m2
        DNI and DHI of all bands together, which tell a clear sky from a cloudy one; None: those given above.

    Raises
    ------
    SceneError
        No surface, surfaces or faces without area or material, no receiver, a name used twice, meshes in an
        endless street, bands that do not add up, negative or non-finite irradiance.
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
    sky: Sky = field(default_factory=Sky)
    polarised: bool = False
    broadband_w_m2: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_shapes(self.surfaces, self.meshes, self.materials, periodic=self.infinite)
        for name in ("dni_w_m2", "dhi_w_m2"):
            value = getattr(self, name)
            if not 0.0 <= value < float("inf"):
                raise SceneError(f"{name} = {value:g} W/m2 is not an irradiance; give zero or more")
        check_bands(self.bands, self.materials)
        if not self.receivers and not any(mesh.receiver for mesh in self.meshes):
            raise SceneError(
                "the scene has no receiver; give at least one surface rows and columns ([[receivers]]), or a "
                "mesh receiver = true"
            )

    @property
    def receivers(self) -> tuple[Surface, ...]:
        """The surfaces with patches, in the order of `surfaces`."""
        return tuple(s for s in self.surfaces if s.rows > 0)

    def remarks(self) -> tuple[str, ...]:
        """Return what is probably not meant: receivers under other surfaces or under the ground."""
        return remarks(self.surfaces, self.meshes, periodic=self.infinite)

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
    """Return the scene of TOML text; scans and meshes are found relative to `folder`; errors as `load_scene`.

    A result file keeps the text: ``parse_scene(irradiance.scene_text, folder=...)`` makes the scene again.
    """
    try:
        table = validate(SceneTable, parse_toml(text, source=source), source=source)
    except GonioError as error:
        raise SceneError(str(error)) from None
    folder = folder or Path()
    notes: list[str] = []
    surfaces = surfaces_of(table, source)
    meshes = meshes_of(table, folder, source, notes)
    materials, bands, sentences = read_materials(table.materials, table.spectrum, folder, source)
    notes += sentences
    sun, dni, dhi, sky = _light(table, notes)
    used = {s.material for s in surfaces}.union(*(m.materials for m in meshes))
    for name, optics in materials.items():
        sentence = excess_text(name, optics, table.reflection.energy) if name in used else None
        if sentence:
            notes.append(sentence)
    infinite = table.street is not None and table.street.infinite
    try:
        scene = Scene(
            surfaces=surfaces,
            materials=materials,
            sun=sun,
            dni_w_m2=dni,
            dhi_w_m2=dhi,
            title=table.title,
            infinite=infinite,
            energy=table.reflection.energy,
            horizon=table.reflection.horizon,
            text=text,
            meshes=meshes,
            bands=bands,
            sky=sky,
            polarised=table.reflection.polarised,
        )
    except SceneError as error:
        raise SceneError(f"{source}: {error}") from None
    return replace(scene, notes=(*notes, *scene.remarks()))


def _light(table: SceneTable, notes: list[str]) -> tuple[Sun, float, float, Sky]:
    """Return sun, DNI, DHI and sky, and note where they come from."""
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
    outside = table.sky.extraterrestrial_w_m2
    if outside is None and site is not None:
        outside = extraterrestrial(site)
    sky = Sky(table.sky.model) if outside is None else Sky(table.sky.model, outside)
    return sun, dni, dhi, sky

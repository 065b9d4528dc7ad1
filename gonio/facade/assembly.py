"""Which surfaces and meshes do the tables of a scene file describe?"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gonio.errors import SceneError
from gonio.facade import geometry, modules
from gonio.facade.geometry import Mesh, Surface
from gonio.facade.mesh import read_mesh
from gonio.facade.scene_file import ModuleTable, SceneTable


def surfaces_of(table: SceneTable, source: str) -> tuple[Surface, ...]:
    """Return street, boxes and modules in this order, with the grids of the receivers.

    `SceneError` for a receiver or a module on a surface that does not exist, or has a grid already, and for
    modules out of place.
    """
    surfaces: list[Surface] = []
    if table.street is not None:
        surfaces += geometry.street(**table.street.model_dump(exclude={"infinite"}))
    for b in table.boxes:
        surfaces += geometry.box(
            b.name, centre_m=b.centre_m, size_m=b.size_m, azimuth_deg=b.azimuth_deg, material=b.material
        )
    surfaces += _modules(table, surfaces, source)
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


def _modules(table: SceneTable, surfaces: list[Surface], source: str) -> list[Surface]:
    hosts = {s.name: s for s in surfaces}
    places: dict[str, list[modules.Place]] = {}
    found: list[Surface] = []
    for number, m in enumerate(table.modules, start=1):
        rows, columns = (m.rows, m.columns) if m.receiver else (0, 0)
        try:
            if m.surface is None:
                made = _free(m, rows, columns)
            else:
                if m.surface not in hosts:
                    raise SceneError(
                        f"surface = '{m.surface}' is not a surface of the scene; "
                        f"choose among {', '.join(hosts)}"
                    )
                assert m.at_m is not None
                host = hosts[m.surface]
                made = modules.module(
                    m.name,
                    host,
                    at_m=m.at_m,
                    size_m=m.size_m,
                    material=m.material,
                    rows=rows,
                    columns=columns,
                )
                if table.street is not None and table.street.infinite:
                    modules.check_spans(m.name, host, m.at_m, m.size_m)
                there = places.setdefault(host.name, [])
                there.append((m.name, m.at_m, m.size_m))
                modules.check_places(host, there)
        except SceneError as error:
            raise SceneError(f"{source}: modules[{number}]: {error}") from None
        hosts[m.name] = made
        found.append(made)
    return found


def _free(m: ModuleTable, rows: int, columns: int) -> Surface:
    assert m.centre_m is not None
    assert m.azimuth_deg is not None
    assert m.material is not None
    return modules.panel(
        m.name,
        centre_m=m.centre_m,
        size_m=m.size_m,
        azimuth_deg=m.azimuth_deg,
        tilt_deg=m.tilt_deg,
        material=m.material,
        rows=rows,
        columns=columns,
        sides=m.sides,
    )


def meshes_of(table: SceneTable, folder: Path, source: str, notes: list[str]) -> tuple[Mesh, ...]:
    """Return the meshes, their files found relative to `folder`, and add what was assumed to `notes`."""
    found: list[Mesh] = []
    for number, m in enumerate(table.meshes, start=1):
        options = m.model_dump(exclude={"file"})
        try:
            mesh, sentences = read_mesh(folder / m.file, options.pop("material"), **options)
        except SceneError as error:
            raise SceneError(f"{source}: meshes[{number}]: {error}") from None
        notes += sentences
        found.append(mesh)
    return tuple(found)

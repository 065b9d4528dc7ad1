from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from gonio.errors import SceneError
from gonio.facade import Mesh, Optics, Scene, Sun, Surface, box, read_mesh, simulate
from gonio.facade.pack import pack
from gonio.facade.winding import wind

MATT = {"matt": Optics(0.5), "dark": Optics(0.1)}
SIZE = np.array([2.0, 3.0, 4.0])

CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
FACES = np.array([
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6),
    (0, 6, 4), (1, 5, 7), (1, 7, 3),
])  # fmt: skip


def cuboid(
    size: np.ndarray = SIZE, centre: Sequence[float] = (0.0, 0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """A box standing on its centre, faces outwards."""
    return (CORNERS - [0.5, 0.5, 0.0]) * size + np.asarray(centre), FACES


def obj(path: Path, vertices: np.ndarray, faces: np.ndarray, head: str = "") -> Path:
    lines = [f"v {' '.join(f'{c:.17g}' for c in v)}" for v in vertices]
    lines += [f"f {' '.join(str(i + 1) for i in f)}" for f in faces]
    path.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def outward(mesh: Mesh, inside: np.ndarray) -> np.ndarray:
    """Say for each face of a mesh whether it looks away from a point."""
    corner = mesh.vertices_m[mesh.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.asarray(np.sum(normal * (corner.mean(axis=1) - inside), axis=1) > 0.0)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb"])
def test_every_format_gives_the_same_body(tmp_path: Path, suffix: str) -> None:
    import trimesh

    vertices, faces = cuboid()
    path = tmp_path / f"body.{suffix}"
    if suffix == "glb":  # whose y is up
        vertices = np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1)
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    mesh, (note,) = read_mesh(path, "matt", receiver=True)
    assert (mesh.name, mesh.sides, mesh.materials, mesh.receiver) == ("body", 1, ("matt",), True)
    assert len(mesh.vertices_m) == 8  # the corners of neighbours are joined
    assert mesh.faces.shape == (12, 3)
    assert mesh.vertices_m.min(axis=0) == pytest.approx([-1.0, -1.5, 0.0])
    assert mesh.vertices_m.max(axis=0) == pytest.approx([1.0, 1.5, 4.0])
    assert np.all(outward(mesh, np.array([0.0, 0.0, 2.0])))
    assert "12 faces, 2 x 3 x 4 m; closed, one side reflects" in note


def test_materials_follow_the_names_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "house.obj"
    lines = ["o house", *(f"v {x} {y} {z}" for x, y, z in CORNERS)]
    for group, material, first, last in (
        ("walls", "brick", 0, 4),
        ("walls", "glass", 4, 8),
        ("roof_1", "", 8, 12),
    ):
        lines += [f"g {group}", *([f"usemtl {material}"] if material else ["usemtl tile"])]
        lines += [f"f {' '.join(str(i + 1) for i in f)}" for f in FACES[first:last]]
    path.write_text("mtllib lost.mtl\n" + "\n".join(lines) + "\n", encoding="utf-8")

    def counts(material: dict[str, str]) -> dict[str, int]:
        mesh, _ = read_mesh(path, material)
        number = np.bincount(mesh.face_material, minlength=len(mesh.materials))
        return dict(zip(mesh.materials, (int(n) for n in number), strict=True))

    assert counts({"brick": "a", "glass": "b", "tile": "c"}) == {"a": 4, "b": 4, "c": 4}
    assert counts({"walls": "a", "roof_1": "b"}) == {"a": 8, "b": 4}
    assert counts({"walls": "a", "glass": "b", "*": "c"}) == {"a": 4, "b": 4, "c": 4}  # material first
    assert counts({"house": "a"}) == {"a": 12}
    with pytest.raises(
        SceneError, match="has no material, group or object 'gass'; it has brick, glass, tile"
    ):
        read_mesh(path, {"gass": "b", "*": "c"})
    with pytest.raises(SceneError, match=r"'glass' is given no material; name it, or give all others one by"):
        read_mesh(path, {"brick": "a", "tile": "c"})


def test_placed_scaled_and_turned_like_a_box(tmp_path: Path) -> None:
    path = obj(tmp_path / "b.obj", *cuboid(1000.0 * SIZE))
    centre = (512_345.25, 4_612_345.5, 210.0)
    mesh, _ = read_mesh(path, "matt", metres_per_unit=0.001, position_m=centre, azimuth_deg=30.0)
    faces = box("b", centre_m=centre, size_m=tuple(SIZE), azimuth_deg=30.0, material="matt")
    corners = np.unique(
        np.round([np.array(s.origin_m) + a * np.array(s.u_m) + b * np.array(s.v_m)
                  for s in faces for a in (0, 1) for b in (0, 1)], 6), axis=0
    )  # fmt: skip
    assert np.unique(np.round(mesh.vertices_m, 6), axis=0) == pytest.approx(corners, abs=2e-6)
    upright, _ = read_mesh(path, "matt", up="y", metres_per_unit=0.001)
    assert np.ptp(upright.vertices_m, axis=0) == pytest.approx(SIZE[[0, 2, 1]])


@pytest.mark.parametrize("seed", range(4))
def test_faces_of_closed_bodies_are_turned_outwards(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, faces = cuboid()
    b, _ = cuboid(SIZE / 2, (0.0, 0.0, 1.0))  # a room inside
    c, _ = cuboid(SIZE, (9.0, 0.0, 0.0))
    d, _ = cuboid(SIZE / 4, (0.0, 0.0, 1.5))  # a chest in the room
    vertices = np.concatenate([a, b, c, d])
    every = np.concatenate([faces + 8 * k for k in range(4)])
    shuffled = every[rng.permutation(len(every))]
    turn = rng.random(len(shuffled)) < 0.5
    mixed = np.where(turn[:, None], shuffled[:, ::-1], shuffled)
    found = wind(vertices, mixed)
    assert found.closed
    mesh = Mesh("m", vertices, found.faces, ("matt",), np.zeros(48, np.int64))
    middle = np.array([[0, 0, 2.0], [0, 0, 2.0], [9.0, 0, 2.0], [0, 0, 2.0]])[found.faces[:, 0] // 8]
    expected = found.faces[:, 0] // 8 != 1  # the room looks in
    assert np.array_equal(outward(mesh, middle), expected)
    assert found.turned == np.sum(np.any(found.faces != mixed, axis=1))


def test_bodies_with_an_edge_of_their_own_stay_as_they_are() -> None:
    vertices, faces = cuboid()
    inwards = faces[:, ::-1]
    for open_faces in (inwards[2:], np.concatenate([inwards, [[0, 1, 7]]])):
        found = wind(vertices, open_faces)
        assert not found.closed
        assert np.array_equal(found.faces, open_faces)
    # a Moebius strip has no sides to turn
    n = 7
    angle = 2 * np.pi * np.arange(n) / n
    middle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    across = np.stack(
        [np.cos(angle) * np.cos(angle / 2), np.sin(angle) * np.cos(angle / 2), np.sin(angle / 2)], 1
    )
    strip = np.concatenate([middle - 0.2 * across, middle + 0.2 * across])
    quads = [(i, i + 1, i + n + 1, i + n) for i in range(n - 1)] + [(n - 1, n, 0, 2 * n - 1)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    found = wind(strip, triangles)
    assert not found.closed
    assert np.array_equal(found.faces, triangles)


TWO = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0), (1, 1e-11, 0), (1, 1, 0)], float)


@pytest.mark.parametrize(
    ("faces", "left", "note"),
    [
        ([(0, 1, 2), (0, 1, 3)], 1, "1 faces without area left out, the first is face 1"),
        ([(0, 0, 1), (0, 1, 2)], 1, "1 faces without area left out, the first is face 0"),
        ([(0, 1, 2), (1, 2, 0)], 1, "1 faces left out that lie on another, the first is face 1"),
        ([(0, 1, 2), (0, 2, 1), (1, 5, 2)], 2, "1 faces left out that lie on another"),
    ],
)
def test_faces_left_out_are_named(tmp_path: Path, faces: list[tuple[int, ...]], left: int, note: str) -> None:
    mesh, (text,) = read_mesh(obj(tmp_path / "m.obj", TWO, np.array(faces)), "matt")
    assert len(mesh.faces) == left == len(mesh.face_material)
    assert note in text
    assert mesh.sides == 2
    assert "open, both sides reflect" in text


@pytest.mark.parametrize(
    ("faces", "options", "message"),
    [
        ([(0, 1, 2), (0, 3, 4)], {}, r"face 1 has almost no area \(edges up to 2, height 1e-11"),
        ([(0, 1, 3)], {}, "no face has any area"),
        ([(0, 1, 2), (0, 2, 1)], {"sides": 1}, "face 1 lies on another face that looks the other way"),
        ([(0, 1, 2)], {"metres_per_unit": 0.0}, "metres_per_unit = 0 is no length"),
    ],
)
def test_faces_that_cannot_be_traced_are_refused(
    tmp_path: Path, faces: list[tuple[int, ...]], options: dict[str, object], message: str
) -> None:
    path = obj(tmp_path / "m.obj", TWO, np.array(faces))
    with pytest.raises(SceneError, match=message):
        read_mesh(path, "matt", **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", None, "there is no such file"),
        ("a.txt", "hello", "cannot be read as a mesh .* give one of the formats .*obj"),
        ("a.stl", "solid\n", "cannot be read as a mesh|holds no faces"),
        ("a.obj", "v 0 0 0\nv 1 0 0\n", "holds no faces"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 nan\nf 1 2 3\n", "vertex 2 of '.*' has a coordinate that is not"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1e400 0\nf 1 2 3\n", "not a finite number"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot be read as a mesh"),
        ("a.obj", "v 0 0 0\nf one two three\n", "cannot be read as a mesh"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
         "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
         "0 0 0\n3 0 0 7\n",
         "a face of '.*' asks for vertex 7, of 1; the file is damaged"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
         "property float z\nend_header\n0 0 0\n", "holds no faces"),
    ],
)  # fmt: skip
def test_files_that_are_no_mesh_are_refused(
    tmp_path: Path, name: str, content: str | None, message: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_text(content, encoding="utf-8")
    with pytest.raises(SceneError, match=message):
        read_mesh(path, "matt")


def test_suspicious_sizes_and_coarse_coordinates_are_noted(tmp_path: Path) -> None:
    import trimesh

    path = obj(tmp_path / "m.obj", *cuboid())
    for scale in (1e4, 1e-4):
        _, (note,) = read_mesh(path, "matt", metres_per_unit=scale)
        assert f"is metres_per_unit = {scale:g} right?" in note
    far, faces = cuboid(centre=(5e5 + 1 / 3, 4.6e6, 0.0))
    trimesh.Trimesh(far, faces, process=False).export(tmp_path / "far.stl")  # single precision
    _, (note,) = read_mesh(tmp_path / "far.stl", "matt", sides=2)
    assert "stored in steps of 5.5e+02 mm" in note


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"faces": np.zeros((0, 3), np.int64), "face_material": np.zeros(0, np.int64)}, "has no faces"),
        ({"faces": FACES + 1}, "numbers of its 8 vertices"),
        ({"faces": FACES.astype(float)}, "numbers of its 8 vertices"),
        ({"faces": FACES[:, :2]}, r"give arrays of \(k, 3\) and \(f, 3\)"),
        ({"vertices_m": np.where(np.arange(8)[:, None] == 5, np.inf, CORNERS)}, "vertex 5 has a coordinate"),
        ({"vertices_m": CORNERS * [1, 1, 0]}, "face 0 has an area of 0 m2"),
        ({"face_material": np.full(12, 1)}, "numbers of its 1 materials"),
        ({"materials": ("gold",)}, "made of 'gold', which is not among the materials"),
        ({"sides": 3}, "has 3 sides"),
        ({"name": "floor"}, "two surfaces or meshes are called 'floor'"),
        ({"name": "a/b"}, "'a/b': a name needs a character and no '/'"),
    ],
)  # fmt: skip
def test_meshes_of_python_code_are_checked_too(change: dict[str, object], message: str) -> None:
    good = {"name": "m", "vertices_m": CORNERS, "faces": FACES, "materials": ("matt",),
            "face_material": np.zeros(12, np.int64)}  # fmt: skip
    floor = Surface("floor", (0, 0, 0), (1, 0, 0), (0, 1, 0), "matt", 1, 1)
    with pytest.raises(SceneError, match=message):
        Scene((floor,), MATT, Sun(0.0, 45.0), 1.0, 1.0, meshes=(Mesh(**(good | change)),))  # type: ignore[arg-type]


def standing(body: Sequence[Surface] | Mesh) -> Scene:
    """A body on a floor that sees sun and sky."""
    floor = Surface("floor", (-10, -10, 0), (20, 0, 0), (0, 20, 0), "dark", 4, 4)
    surfaces, meshes = ((floor,), (body,)) if isinstance(body, Mesh) else ((floor, *body), ())
    return Scene(surfaces, MATT, Sun(140.0, 40.0), 600.0, 200.0, meshes=meshes)


def test_a_mesh_of_a_box_is_a_box(tmp_path: Path) -> None:
    where = {"centre_m": (1.0, 2.0, 0.0), "size_m": tuple(SIZE), "azimuth_deg": 20.0}
    faces = box("b", **where, material="matt")  # type: ignore[arg-type]
    mesh, _ = read_mesh(
        obj(tmp_path / "b.obj", *cuboid()), "matt", name="b", position_m=(1.0, 2.0, 0.0), azimuth_deg=20.0
    )
    ours, theirs = (pack(s.surfaces, MATT, meshes=s.meshes) for s in (standing(faces), standing(mesh)))

    def sides(packed: object) -> dict[tuple[float, ...], float]:
        """Area by normal and distance from the origin."""
        g = packed.geometry  # type: ignore[attr-defined]
        world = g.origin + packed.centre_m  # type: ignore[attr-defined]
        found: dict[tuple[float, ...], float] = {}
        for k in range(len(g.area)):
            distance = float(g.normal[k] @ world[k])
            key = tuple(round(float(c), 9) + 0.0 for c in (*g.normal[k], distance))
            found[key] = found.get(key, 0.0) + float(g.area[k])
        return found

    a, b = sides(ours), sides(theirs)
    assert a.keys() == b.keys()
    assert list(a.values()) == pytest.approx([b[key] for key in a], rel=1e-12)
    assert len(set(theirs.geometry.plane)) == len(set(ours.geometry.plane)) == 6  # the base lies on the floor

    results = [simulate(s, rel_tol=0.01, seed=5)["floor"] for s in (standing(faces), standing(mesh))]
    error = np.hypot(results[0].standard_error, results[1].standard_error)
    assert np.all(np.abs(results[0].value - results[1].value) <= 4.5 * error + 1e-9)
    assert results[0].mean_contributions["direct"].value < 595 * np.sin(np.radians(40))  # there is a shadow


def test_receivers_may_be_meshes_alone(tmp_path: Path) -> None:
    mesh, _ = read_mesh(obj(tmp_path / "b.obj", *cuboid()), "matt", receiver=True)
    scene = Scene((), MATT, Sun(140.0, 40.0), 600.0, 200.0, meshes=(mesh,))
    assert pack((), MATT, meshes=(mesh,)).cells == 12
    assert scene.receivers == ()
    with pytest.raises(SceneError, match="has no receiver; give at least one surface rows and columns"):
        Scene((), MATT, Sun(140.0, 40.0), 600.0, 200.0, meshes=(read_mesh(tmp_path / "b.obj", "matt")[0],))
    with pytest.raises(SceneError, match="the scene is empty"):
        Scene((), MATT, Sun(140.0, 40.0), 600.0, 200.0)

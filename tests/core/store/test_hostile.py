"""Files that are broken, foreign or made to do harm: every command says what is wrong, and no more happens.

Where the HDF5 library itself might crash, hang or take memory, a process with limits reads them.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest

import gonio
from gonio.acquire import Runner, resume_scan
from gonio.acquire.journal import journal_path
from gonio.errors import GonioError, ScanStopped, StoreError
from gonio.fitting import load_fit
from gonio.plan import Plan, parse_plan
from gonio.report import write_any_report
from gonio.store import read_spectrum
from gonio.store.check import check_file
from gonio.store.heaps import endless_heap

HUGE = 2**62


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    path = Path(__file__).parents[3] / "benchmarks" / "store_fuzz.py"
    spec = importlib.util.spec_from_file_location("gonio_bench_store_fuzz", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(bench: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("originals")
    bench.make_originals(path)
    return path


@pytest.fixture(scope="module")
def small(memory: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("small") / "scan.h5"
    plan = parse_plan(memory.PLAN_TOML.replace("[15.0, 30.0, 40.0]", "[15.0]"))
    return Runner(memory.rig(), plan, path).run().read_bytes()


# -- damage by accident


def test_a_file_cut_at_every_512_bytes_is_an_error_that_names_it(small: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.h5"
    for length in range(0, len(small), 512):
        path.write_bytes(small[:length])
        with pytest.raises(
            StoreError, match=r"cut\.h5: (is empty|is not an HDF5 file|is damaged or cut short)"
        ):
            gonio.load(path)
        assert len(check_file(path).findings) == 1


@pytest.mark.parametrize(("kind", "files"), [("h5", 50), ("journal", 50), ("sealed", 120)])
def test_random_damage_is_a_clear_error_or_harmless(
    bench: ModuleType, folder: Path, kind: str, files: int
) -> None:
    counts: Counter[str] = Counter()
    for number, (outcome, told) in bench.outcomes(folder, kind, files, seed=2022):
        counts[outcome] += 1
        # a crash of the HDF5 library (1 in 1500 files with 2.0.0) is not ours to mend: see docs/file.md
        assert outcome in ("read", "refused", "hdf5 crash"), f"{kind}, seed {number}: {outcome}: {told}"
    assert counts["hdf5 crash"] <= (2 if kind == "h5" else 0)
    assert counts["read"] > 0
    assert counts["refused"] > 0


def test_a_heap_of_texts_without_end_is_refused_before_the_library_walks_it(
    folder: Path, tmp_path: Path
) -> None:
    data = bytearray((folder / "scan.h5").read_bytes())
    at = data.find(b"GCOL")
    data[at + 16 : at + 4096] = bytes(4080)  # an object of number 0 and size 0: the library would stay here
    path = tmp_path / "endless.h5"
    path.write_bytes(data)
    assert endless_heap(folder / "scan.h5") is None
    assert endless_heap(path) == at
    with pytest.raises(StoreError, match="would read for ever"):
        gonio.load(path)


# -- made to do harm


def dataset(name: str, **options: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file.create_dataset(name, **options)

    return change


def link(name: str, target: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file[name] = target

    return change


def view_of_another_file(file: h5py.File) -> None:
    layout = h5py.VirtualLayout(shape=(10, 5), dtype="f8")
    layout[...] = h5py.VirtualSource("secret.h5", "secret", shape=(10, 5))
    del file["entry/data/raw_signal"]
    file["entry/data"].create_virtual_dataset("raw_signal", layout)


def unknown_filter(file: h5py.File) -> None:
    del file["entry/data/r"]
    creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    creation.set_chunk((10, 5))
    creation.set_filter(32123, h5py.h5z.FLAG_OPTIONAL, (1, 2))
    space = h5py.h5s.create_simple((10, 5))
    made = h5py.h5d.create(file["entry/data"].id, b"r", h5py.h5t.NATIVE_DOUBLE, space, creation)
    made.write_direct_chunk((0, 0), bytes(10), filter_mask=0)


def one_chunk_bomb(file: h5py.File) -> None:
    """Few values in a chunk that is 4 GB once it is inflated: of 4 MB, or of nothing."""
    del file["entry/data/r"]
    file["entry/data"].create_dataset(
        "r", (10, 5), "f8", chunks=(2**20, 500), maxshape=(None, None), compression="gzip"
    )


def texts_of_one(file: h5py.File) -> None:
    """As many references to one long text."""
    del file["entry/events/message"]
    made = file["entry/events"].create_dataset("message", (3000,), h5py.string_dtype())
    made[0] = "x" * 60_000
    one = bytes(made.id.get_offset().to_bytes(8, "little")) if made.id.get_offset() else b""
    assert one
    at = int.from_bytes(one, "little")
    file.flush()
    with open(file.filename, "r+b") as raw:
        raw.seek(at)
        reference = raw.read(16)
        raw.seek(at)
        raw.write(reference * 3000)


def nested(file: h5py.File) -> None:
    here = file["entry"]
    for _ in range(200):
        here = here.create_group("deeper")


HOSTILE: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "huge, chunked": (
        dataset("entry/data/r", shape=(HUGE, 5), dtype="f4", chunks=(64, 5)),
        "more than are stored",
    ),
    "huge, gzip": (
        dataset("entry/data/r", shape=(2**50, 5), dtype="f8", chunks=(64, 5), compression="gzip"),
        "more than are stored",
    ),
    "huge, late": (dataset("entry/data/theta_i", shape=(2**58,), dtype="f8"), "more than are stored"),
    "huge text list": (
        dataset("entry/events/level", shape=(2**40,), dtype=h5py.string_dtype(), chunks=(64,)),
        "more than are stored",
    ),
    "huge in a fit": (dataset("entry/fit_x/value", shape=(2**45, 4), dtype="f8"), "more than are stored"),
    "one chunk bomb": (one_chunk_bomb, "is cut into chunks of"),
    "compact": (
        dataset("entry/data/theta_o", data=np.ones(3)),
        r"theta_o has shape \(3,\), expected \(10,\)",
    ),
    "null space": (dataset("entry/data/r", data=h5py.Empty("f8")), "r is not a dataset with values"),
    "text for numbers": (dataset("entry/data/theta_o", data=["a"] * 10), "theta_o holds object"),
    "number for text": (dataset("entry/plan", data=3.0), "/entry/plan is not a text"),
    "integers": (dataset("entry/data/r", data=np.ones((10, 5), "i4")), "r holds int32"),
    "complex": (dataset("entry/data/r", data=np.ones((10, 5), "c16")), "r holds complex128"),
    "references": (
        dataset("entry/data/r", shape=(10, 5), dtype=h5py.ref_dtype),
        "r holds object, expected a type of kind 'f'",
    ),
    "compound": (dataset("entry/data/r", data=np.zeros((10, 5), [("a", "f8"), ("b", "i4")])), "r holds"),
    "array type": (
        dataset("entry/data/theta_i", shape=(10,), dtype=np.dtype(("f8", (1000,)))),
        "theta_i holds",
    ),
    "half precision quality": (
        dataset("entry/data/quality", data=np.zeros((10, 5), "f2")),
        "quality holds float16",
    ),
    "external link": (
        link("entry/data/r", h5py.ExternalLink("secret.h5", "/secret")),
        "is a link to another file",
    ),
    "external link elsewhere": (
        link("entry/photo", h5py.ExternalLink("secret.h5", "/")),
        "is a link to another file",
    ),
    "entry elsewhere": (link("entry", h5py.ExternalLink("secret.h5", "/entry")), "is a link to another file"),
    "external link in a fit": (
        link("entry/fit_x/value", h5py.ExternalLink("secret.h5", "/secret")),
        "is a link to another file",
    ),
    "soft link": (link("entry/data/r", h5py.SoftLink("/entry/data/dark")), "is a link out of its place"),
    "dangling soft link": (
        link("entry/data/theta_i", h5py.SoftLink("/no/where")),
        "is a link out of its place",
    ),
    "soft link to itself": (link("entry/data", h5py.SoftLink("/entry/data")), "is a link out of its place"),
    "cycle": (link("entry/data", h5py.SoftLink("/entry/../entry")), "is a link out of its place"),
    "cycle of groups": (lambda f: link("entry/data", f["entry"])(f), "is missing"),
    "external storage": (
        dataset("entry/data/r", shape=(10, 5), dtype="f8", external=[("secret.raw", 0, h5py.h5f.UNLIMITED)]),
        "is kept in another place",
    ),
    "view of another file": (view_of_another_file, "is a view of another file"),
    "unknown filter": (unknown_filter, r"is damaged|cannot be read"),
    "many names of one text": (texts_of_one, "bytes of text"),
    "deeply nested": (nested, "nested too deeply"),
    "negative wavelength": (lambda f: f["entry/data/wavelength"].write_direct(-np.ones(5)), "not positive"),
    "NaN angles": (
        lambda f: f["entry/data/theta_i"].write_direct(np.full(10, np.nan)),
        "no position has been",
    ),
    "detector": (lambda f: f["entry/data/detector_index"].write_direct(np.full(5, 200, "u1")), "reaches 200"),
    "status is a number": (lambda f: f["entry"].attrs.__setitem__("scan_status", [1, 2, 3]), ""),
    "infinite r": (lambda f: f["entry/data/r"].__setitem__((0, 0), np.inf), "numbers that nothing measures"),
    "negative sd": (lambda f: f["entry/data/r_errors"].__setitem__((0, 0), -1.0), "negative uncertainties"),
    "far angle": (lambda f: f["entry/data/theta_mes"].__setitem__(3, 1e300), "holds angles beyond 360 deg"),
    "title is a table": (dataset("entry/title", data=np.zeros((3, 3))), "/entry/title is not a text"),
    "aperture is NaN": (lambda f: f["entry/instrument/aperture/width"].__setitem__((), np.nan), "aperture"),
    "named type": (link("entry/data/r", np.dtype("f8")), "r is not a dataset"),
}

COMMANDS = """
import json, resource, sys, warnings
import gonio.fitting, gonio.report.write, gonio.store.check
from gonio.cli import main
from pathlib import Path
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 700_000_000, resource.RLIM_INFINITY))
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
import contextlib, io
gonio.cli.check._bound_memory = lambda path: None
for line in sys.stdin:
    answers = []
    for command in (["fit"], ["report"], ["scan", "--resume"], ["check", "--here"]):
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                code = main([*command, line.strip()])
            except BaseException as error:
                code = f"{type(error).__name__}: {error}"
        answers.append((command[0], code, out.getvalue() + err.getvalue()))
    print(json.dumps(answers), flush=True)
"""


@pytest.fixture(scope="module")
def commands() -> Iterator[Callable[[Path], list[tuple[str, object, str]]]]:
    """Return what runs fit, report, resume and check on a file, in one process with little memory."""
    if sys.platform != "linux":
        pytest.skip("the memory of a process is limited by what Linux offers")
    process = subprocess.Popen(
        [sys.executable, "-c", "import gonio.cli.check\n" + COMMANDS],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip

    def run(path: Path) -> list[tuple[str, object, str]]:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(f"{path}\n")
        process.stdin.flush()
        line = process.stdout.readline()
        assert line, f"the process ended with {process.wait()}"
        return [tuple(answer) for answer in json.loads(line)]

    yield run
    process.communicate(timeout=30)


@pytest.mark.parametrize(("change", "told"), HOSTILE.values(), ids=HOSTILE.keys())
def test_a_hostile_file_is_refused_by_every_command(
    memory: ModuleType,
    original: Path,
    commands: Callable[[Path], list[tuple[str, object, str]]],
    tmp_path: Path,
    change: Callable[[h5py.File], None],
    told: str,
) -> None:
    path = Path(shutil.copy(original, tmp_path / "scan.h5"))
    with h5py.File(tmp_path / "secret.h5", "w") as file:  # what a link that is followed would show
        file["secret"] = np.ones((10, 5))
    with h5py.File(path, "r+") as file:
        change(file)
    secret = os.stat(tmp_path / "secret.h5").st_atime_ns
    if told:
        with pytest.raises(StoreError, match=told) as caught:
            gonio.load(path)
        assert str(caught.value).startswith(str(path))
    for name, code, text in commands(path):
        assert code in (0, 1), (name, code)
        assert "Traceback" not in text
        if told:
            assert code == 1, (name, text)
            assert str(path) in text
    assert os.stat(tmp_path / "secret.h5").st_atime_ns == secret


@pytest.fixture(scope="module")
def original(memory: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scan") / "scan.h5"
    world = memory.World(noise_dark_v=1e-6, noise_full=1e-4, gain_drift_s=1e-4)
    return Runner(memory.rig(world), parse_plan(memory.PLAN_TOML), path).run()


def test_a_cycle_beside_the_data_and_strange_names_harm_nothing(original: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(original, tmp_path / "scan.h5"))
    with h5py.File(path, "r+") as file:
        file["entry/again"] = file["entry"]
        file["entry/of mine"] = h5py.SoftLink("/no/where")
        file["entry"].create_group("line\nbreak \N{GREEK SMALL LETTER THETA}")
    assert gonio.load(path).finished
    assert check_file(path).findings == []


def test_links_in_what_stands_beside_the_scan_are_not_followed(original: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(original, tmp_path / "scan.h5"))
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file.create_group("entry").create_group("sphere").attrs["columns"] = ["wavelength_nm"]
    with h5py.File(path, "r+") as file:
        file["entry/sphere"] = h5py.ExternalLink("secret.h5", "/entry/sphere")
    for read in (
        lambda: read_spectrum(path, "sphere"),
        lambda: load_fit(path),
        lambda: write_any_report(path, tmp_path / "report"),
        lambda: gonio.load(path),
    ):
        with pytest.raises(StoreError, match=r"/entry/sphere is a link to another file \(secret\.h5\)"):
            read()


# -- what is no file


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_keeps_nobody_waiting(memory: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "pipe.h5"
    os.mkfifo(path)
    with pytest.raises(StoreError, match="is not an HDF5 file but a device or a pipe"):
        gonio.load(path)
    assert len(check_file(path).findings) == 1
    os.mkfifo(journal_path(tmp_path / "scan.h5"))
    done: list[BaseException] = []

    def resume() -> None:
        try:
            resume_scan(tmp_path / "scan.h5", memory.rig())
        except GonioError as error:
            done.append(error)

    thread = threading.Thread(target=resume, daemon=True)
    thread.start()
    thread.join(timeout=30)
    assert "is no file" in str(done[0])


def test_folders_and_impossible_names_are_named(memory: ModuleType, tmp_path: Path) -> None:
    for strange in (tmp_path, Path("a\x00b.h5"), tmp_path / "no" / "such.h5", tmp_path / ("x" * 300)):
        with pytest.raises(StoreError):
            gonio.load(strange)
        assert check_file(strange).findings
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="there is no such file"):
        gonio.load(tmp_path / "file" / "scan.h5")
    journal_path(tmp_path / "scan.h5").mkdir()
    with pytest.raises(StoreError, match=r"scan\.h5"):
        resume_scan(tmp_path / "scan.h5", memory.rig())


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write and read everything"
)
def test_a_file_without_rights_is_named(original: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(original, tmp_path / "scan.h5"))
    path.chmod(0o444)
    fit = gonio.fit(gonio.load(path))
    with pytest.raises(StoreError, match="cannot be opened for writing"):
        fit.save(path)
    path.chmod(0)
    with pytest.raises(StoreError, match="check its rights"):
        gonio.load(path)


# -- a journal made to do harm


def test_what_a_device_says_in_zero_bytes_is_stored_all_the_same(
    memory: ModuleType, plan: Plan, tmp_path: Path
) -> None:
    from gonio.errors import DeviceError

    world = memory.World()
    world.fail["measure"] = DeviceError("lock-in", "answers 'a\x00b\udcff'", "look at it")
    path = Runner(memory.rig(world), plan, tmp_path / "scan.h5").run()
    with h5py.File(path, "r") as file:
        assert any("a\N{SYMBOL FOR NULL}b?" in text for text in file["entry/events/message"].asstr()[...])


def test_a_journal_of_another_shape_is_refused_on_resuming(
    memory: ModuleType, plan: Plan, tmp_path: Path, bench: ModuleType
) -> None:
    path = tmp_path / "scan.h5"
    runner = Runner(memory.rig(), plan, path, on_snapshot=lambda s: runner.stop() if s.done == 3 else None)
    with pytest.raises(ScanStopped):
        runner.run()
    whole = journal_path(path).read_bytes()
    refused = 0
    for seed in range(25):
        journal_path(path).write_bytes(bench.sealed(whole, np.random.default_rng(seed)))
        with suppress(GonioError):  # anything else is a defect
            resume_scan(path, memory.rig()).run()
            path.unlink()
            continue
        refused += 1
    assert refused > 10

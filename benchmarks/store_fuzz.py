"""Does any damage to a file make gonio crash, hang, take memory, or read what was never measured?

A finished scan with a fit and a spectrum beside it, and the journal of an interrupted one, are damaged at
random: bytes changed, runs of bytes set to 0 or 255, numbers of extreme size, blocks exchanged, ends cut
off; payloads of the journal also with their checksum made right again.  Processes with 1.5 GB of address
space read each file as `gonio.load`, `gonio check`, `gonio fit` do, and every fourth as `gonio report` and
`gonio scan --resume`.

read          the file could be read, whatever the damage hit
refused       a clear error that names the file
wrong         a damaged journal gave readings that were never written: must be 0
unexpected    another exception: must be 0
memory        the limit of memory was hit: must be 0
hdf5 crash    the HDF5 library ended the process (a signal): nothing in Python can catch that
hung          no answer in time: must be 0

Run: python benchmarks/store_fuzz.py [--files N] [--seed S] [--only h5|journal|sealed]
Exit code 1 if anything is not 0, but for hdf5 crash.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import json
import os
import selectors
import shutil
import subprocess
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

KINDS = ("h5", "journal", "sealed")
TIMEOUT_S = 60.0
ADDRESS_SPACE = 1_500_000_000
EXTREMES = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63, 2**64 - 1)
OUTCOMES = ("read", "refused", "wrong", "unexpected", "memory", "hdf5 crash", "hung")
MUST_BE_NONE = ("wrong", "unexpected", "memory", "hung")


# -- damage -------------------------------------------------------------------------------------------------


def damaged(original: bytes, rng: np.random.Generator) -> bytes:
    """Return a file with damage of one kind, or of several."""
    data = bytearray(original)
    for _ in range(int(rng.integers(1, 4))):
        if not data:
            break
        at = int(rng.integers(0, len(data)))
        match int(rng.integers(0, 7)):
            case 0:
                for where in rng.integers(0, len(data), int(rng.integers(1, 40))):
                    data[where] = int(rng.integers(0, 256))
            case 1:
                data[at] ^= 1 << int(rng.integers(0, 8))
            case 2:
                length = int(rng.integers(1, 512))
                data[at : at + length] = bytes([int(rng.choice([0, 255]))]) * len(data[at : at + length])
            case 3:
                number = EXTREMES[int(rng.integers(0, len(EXTREMES)))].to_bytes(8, "little")
                width = int(rng.choice([1, 2, 4, 8]))
                data[at : at + width] = number[:width][: len(data) - at]
            case 4:
                other = int(rng.integers(0, len(data)))
                length = min(int(rng.integers(1, 256)), len(data) - max(at, other))
                data[at : at + length], data[other : other + length] = (
                    data[other : other + length],
                    data[at : at + length],
                )
            case 5:
                del data[at:]
            case _:
                del data[at : at + int(rng.integers(1, 64))]
    return bytes(data)


def sealed(original: bytes, rng: np.random.Generator) -> bytes:
    """Return a journal in which one payload is damaged and its checksum right all the same."""
    from gonio.acquire import journal

    payloads = [payload for _, payload in journal.frames(original)]
    which = int(rng.integers(0, len(payloads)))
    text, _, rest = payloads[which].partition(b"\n")
    if rng.random() < 0.7:
        fields = json.loads(text)
        _change(fields, rng)
        payloads[which] = json.dumps(fields).encode() + b"\n" + rest
    else:
        payloads[which] = damaged(payloads[which], rng)
    whole = bytearray(journal.MAGIC)
    for payload in payloads:
        length = len(payload).to_bytes(4, "little")
        check = zlib.crc32(payload, zlib.crc32(length)).to_bytes(4, "little")
        whole += b"\xf5rec" + length + check + payload
    return bytes(whole)


def _change(fields: Any, rng: np.random.Generator) -> None:
    """Change one value somewhere in the JSON of a record."""
    odd = [
        None,
        -1,
        10**30,
        "",
        "x" * 300,
        [],
        {},
        float("nan"),
        1e308,
        True,
        "start",
        3,
        "s",
        "dark",
        "\x00",
    ]
    while isinstance(fields, dict | list) and len(fields):
        keys = list(fields) if isinstance(fields, dict) else range(len(fields))
        key = keys[int(rng.integers(0, len(keys)))]
        inner = fields[key]
        if isinstance(inner, dict | list) and len(inner) and rng.random() < 0.7:
            fields = inner
            continue
        if isinstance(fields, dict) and rng.random() < 0.2:
            del fields[key]
        else:
            fields[key] = odd[int(rng.integers(0, len(odd)))]
        return


# -- the process that reads ---------------------------------------------------------------------------------


def serve(folder: Path) -> None:
    """Read jobs ``KIND SEED`` from standard input, and answer each with one line."""
    import resource
    import warnings

    from gonio import fitting  # all code is loaded before the limit counts
    from gonio.acquire.session import Session
    from gonio.report import content
    from gonio.store import check

    assert None not in (check, content, fitting, Session)
    warnings.simplefilter("ignore")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESS_SPACE, resource.RLIM_INFINITY))
    originals = {name: (folder / name).read_bytes() for name in ("scan.h5", "cut.h5", "cut.h5.journal")}
    with tempfile.TemporaryDirectory(dir=folder) as work:
        for line in sys.stdin:
            kind, seed = line.split()
            print(json.dumps(_outcome(kind, int(seed), originals, Path(work))), flush=True)


def _outcome(kind: str, seed: int, originals: dict[str, bytes], work: Path) -> list[str]:
    from gonio.errors import GonioError

    rng = np.random.default_rng([seed, KINDS.index(kind)])
    path = work / "x.h5"
    if kind == "h5":
        path.write_bytes(damaged(originals["scan.h5"], rng))
        readers: list[Callable[[Path], object]] = [_load, _check, _fits, _report]
    else:
        path.write_bytes(originals["cut.h5"])
        make = damaged if kind == "journal" else sealed
        (work / "x.h5.journal").write_bytes(make(originals["cut.h5.journal"], rng))
        readers = [_load_cut, _resume]
        if kind == "sealed":
            readers[0] = _load
    if seed % 4:
        readers.pop()  # the slowest of them reads every fourth file
    worst = ["read", ""]
    for read in readers:
        try:
            told = read(path)
            result = ["wrong", str(told)] if isinstance(told, str) else ["read", ""]
        except GonioError as error:
            named = "x.h5" in str(error)
            result = ["refused", ""] if named else ["unexpected", f"{read.__name__}: no file named: {error}"]
        except MemoryError as error:
            result = ["memory", f"{read.__name__}: {error}"]
        except Exception as error:
            where = error.__traceback__
            while where is not None and where.tb_next is not None:
                where = where.tb_next
            place = f"{Path(where.tb_frame.f_code.co_filename).name}:{where.tb_lineno}" if where else ""
            result = ["unexpected", f"{read.__name__}: {type(error).__name__}: {error} at {place}"]
        if OUTCOMES.index(result[0]) > OUTCOMES.index(worst[0]):
            worst = result
    for left in work.iterdir():
        left.unlink()
    return worst


def _load(path: Path) -> None:
    import gonio

    scan = gonio.load(path)
    assert scan.r.shape == (len(scan.position), len(scan.wavelength_nm))


def _load_cut(path: Path) -> str | None:
    """Load a scan from its damaged journal; say so if a reading is not one of those written."""
    import gonio

    scan = gonio.load(path)
    original = np.load(path.parent.parent / "cut.npz")
    rows = np.searchsorted(original["position"], scan.position)
    if np.any(original["position"][np.minimum(rows, len(original["position"]) - 1)] != scan.position):
        return "positions that were not measured"
    for name in ("raw_signal_v", "theta_i_deg", "theta_mes_deg", "polarization"):
        if not np.array_equal(getattr(scan, name), original[name][rows]):
            return f"{name} differs"
    return None


def _check(path: Path) -> None:
    from gonio.store.check import check_file

    for finding in check_file(path).findings:
        assert str(finding)


def _fits(path: Path) -> None:
    from gonio.fitting import load_fit
    from gonio.store import read_spectrum

    load_fit(path)
    read_spectrum(path, "sphere")


def _report(path: Path) -> None:
    from gonio.report.content import read_content

    read_content(path)


def _resume(path: Path) -> None:
    from gonio.acquire.journal import journal_path, read_header
    from gonio.acquire.session import Session
    from gonio.plan import parse_plan

    header = read_header(journal_path(path))
    parse_plan(header.plan_text, source=path.name)
    session, _ = Session.resume(path, header.rig)
    session.close()


# -- the process that counts --------------------------------------------------------------------------------


class Reader:
    """One reading process, started anew after a crash."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: subprocess.Popen[str] | None = None

    def ask(self, kind: str, seed: int) -> list[str]:
        """Return the outcome of one damaged file."""
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, __file__, "--serve", str(self._folder)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            )  # fmt: skip
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(f"{kind} {seed}\n")
            process.stdin.flush()
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            answered = selector.select(TIMEOUT_S)
        line = process.stdout.readline() if answered else ""
        if line:
            outcome: list[str] = json.loads(line)
            return outcome
        self.close()
        return ["hdf5 crash" if answered else "hung", f"exit code {process.returncode}"]

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def make_originals(folder: Path) -> None:
    """Write a finished scan with all that can stand beside it, and an interrupted one with its journal."""
    import gonio
    from gonio.acquire import Runner
    from gonio.errors import ScanStopped
    from gonio.plan import parse_plan
    from gonio.store import attach_csv_spectrum

    memory = _memory_rig()
    world = memory.World(noise_dark_v=1e-6, noise_full=1e-4)
    plan = parse_plan(memory.PLAN_TOML.replace("stop = 90.0, step = 60.0", "stop = 90.0, step = 10.0"))
    path = Runner(memory.rig(world), plan, folder / "scan.h5").run()
    gonio.fit(gonio.load(path)).save(path)
    (folder / "sphere.csv").write_text("wavelength_nm,k_g\n840,0.7\n880,0.72\n")
    attach_csv_spectrum(path, "sphere", folder / "sphere.csv")
    cut = folder / "cut.h5"
    runner = Runner(
        memory.rig(world), plan, cut, on_snapshot=lambda s: runner.stop() if s.done == 12 else None
    )
    with contextlib.suppress(ScanStopped):
        runner.run()
    scan = gonio.load(cut)
    np.savez(
        folder / "cut.npz",
        position=scan.position,
        raw_signal_v=scan.raw_signal_v,
        theta_i_deg=scan.theta_i_deg,
        theta_mes_deg=scan.theta_mes_deg,
        polarization=scan.polarization,
    )


def _memory_rig() -> Any:
    path = Path(__file__).parents[1] / "tests" / "core" / "acquire" / "memory_rig.py"
    spec = importlib.util.spec_from_file_location("memory_rig", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["memory_rig"] = module
    spec.loader.exec_module(module)
    return module


def outcomes(folder: Path, kind: str, files: int, seed: int) -> Iterator[tuple[int, list[str]]]:
    """Yield the seed and the outcome of each damaged file."""
    reader = Reader(folder)
    try:
        for number in range(seed, seed + files):
            yield number, reader.ask(kind, number)
    finally:
        reader.close()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--files", type=int, default=10_000, metavar="N", help="of each kind")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--only", choices=KINDS)
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve is not None:
        serve(options.serve)
        return 0
    defects = 0
    examples: dict[str, str] = {}
    folder = Path(tempfile.mkdtemp())
    try:
        make_originals(folder)
        print(f"{'file':<10}{'files':>8}" + "".join(f"{name:>12}" for name in OUTCOMES) + f"{'s':>7}")
        for kind in KINDS if options.only is None else (options.only,):
            began, counts = time.monotonic(), Counter[str]()
            for number, (outcome, told) in outcomes(folder, kind, options.files, options.seed):
                counts[outcome] += 1
                if outcome not in ("read", "refused"):
                    examples.setdefault(f"{outcome}: {told}"[:160], f"{kind}, seed {number}")
            defects += sum(counts[name] for name in MUST_BE_NONE)
            seconds = time.monotonic() - began
            print(
                f"{kind:<10}{options.files:>8}"
                + "".join(f"{counts[name]:>12}" for name in OUTCOMES)
                + f"{seconds:>7.0f}",
                flush=True,
            )
    finally:
        shutil.rmtree(folder)
    for told, where in examples.items():
        print(f"  {told} ({where})")
    return 1 if defects else 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())

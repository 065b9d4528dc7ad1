"""`gonio check`: is a file whole, and what gonio says it writes?

The file is looked at by a process of its own with bounded memory and time: a file made to do harm can crash
the HDF5 library, and must not take the caller with it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from gonio.errors import StoreError
from gonio.store.check import check_file
from gonio.store.findings import Finding

_LONGEST_S = 600.0
_RESTORE = "open it with no program, restore it from a copy"
_MEMORY_BYTES = 4_000_000_000  # beside three times the file


def check(paths: Sequence[Path]) -> int:
    """Check each file in a process of its own and print what is found; 1 if anything is."""
    return max(_guarded(path) for path in paths)


def check_here(path: Path) -> int:
    """Check a file in this process and print what is found; 1 if anything is."""
    _bound_memory(path)
    verdict = check_file(path)
    findings = [*verdict.findings, *_unreadable_fits(path, verdict.kind)]
    print(f"{path}: {verdict.kind}" + ("" if findings else "; nothing is wrong with it"))
    for finding in findings:
        place = "" if finding.place == str(path) else finding.place
        print(f"{path}{place and ':' + place}: {finding.problem}; {finding.remedy}")
    return 1 if findings else 0


def _guarded(path: Path) -> int:
    command = [sys.executable, "-m", "gonio.cli", "check", "--here", str(path)]
    try:
        done = subprocess.run(command, timeout=_LONGEST_S, capture_output=True, text=True)
    except subprocess.TimeoutExpired:
        print(f"{path}: was not read within {_LONGEST_S:.0f} s: it is damaged or made to do harm; {_RESTORE}")
        return 1
    except ValueError as error:
        raise StoreError(f"{path!s}: is no file name ({error}); check the path") from None
    print(done.stdout, end="")
    if done.returncode not in (0, 1) or (done.returncode == 1 and not done.stdout):
        what = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        print(f"{path}: reading it crashed ({what[0]}): it is damaged or made to do harm; {_RESTORE}")
        return 1
    return done.returncode


def _bound_memory(path: Path) -> None:
    if sys.platform == "win32":
        return
    import resource

    size = os.path.getsize(path) if path.is_file() else 0
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    wanted = _MEMORY_BYTES + 3 * size
    resource.setrlimit(resource.RLIMIT_AS, (wanted if hard < 0 else min(wanted, hard), hard))


def _unreadable_fits(path: Path, kind: str) -> list[Finding]:
    """Return a finding for each fit beside a scan that cannot be read back."""
    if not kind.startswith("scan"):
        return []
    from gonio.fitting import load_fit
    from gonio.store.read import opened

    found: list[Finding] = []
    try:
        with opened(path, "r") as file:
            names = [name for name in file["entry"] if name.startswith("fit_")]
        for name in names:
            try:
                load_fit(path, name)
            except StoreError as error:
                problem = (
                    str(error).removeprefix(f"{path}:/entry/{name}: ").removesuffix("; fit the scan again")
                )
                found.append(Finding(f"/entry/{name}", problem, f"fit the scan again: gonio fit {path}"))
    except StoreError:
        pass  # the check has said so
    return found

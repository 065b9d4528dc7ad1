"""`gonio facade`: simulate a scene, keep the result, go on with one that was interrupted or is too coarse."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from gonio.errors import ConfigError, SceneError, StoreError

if TYPE_CHECKING:
    from gonio.cli.progress import Bar
    from gonio.facade import Irradiance, Scene

DEFAULT_REL_TOL = 0.01
ESTIMATORS = ("auto", "rows", "paths", "backward")
_FOLDER = "scene_folder"  # from the result's folder to the scene's, so that both can move together
_GIVEN_ONCE = ("full", "estimator", "seed")


@dataclass(frozen=True, slots=True)
class FacadeRequest:
    """What the command line asks for; None: not given."""

    scene: Path | None
    output: Path | None
    resume: Path | None
    rel_tol: float | None
    full: bool
    estimator: str | None
    seed: int | None
    threads: int | None
    levels: bool


def add_facade_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gonio facade`."""
    parser.add_argument("scene", type=Path, nargs="?", metavar="SCENE.toml")
    parser.add_argument("-o", "--output", type=Path, metavar="OUT.h5")
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="OUT.h5",
        help="go on with an interrupted result, or add points to a finished one until --rel-tol is reached",
    )
    parser.add_argument(
        "--rel-tol",
        type=float,
        metavar="X",
        help=f"relative error (default {DEFAULT_REL_TOL}; of --resume: the one asked for before)",
    )
    parser.add_argument(
        "--full", action="store_true", help="leave nothing out, whatever the tolerance allows"
    )
    parser.add_argument(
        "--levels",
        action="store_true",
        help="what does the material change? a table of all material levels; writes no file",
    )
    parser.add_argument(
        "--estimator",
        choices=ESTIMATORS,
        help="rows: transport rows and a linear solve; paths: path by path; backward: the slow check on both "
        "(default: auto)",
    )
    parser.add_argument("--seed", type=int, metavar="N", help="same seed, same bits (default 0)")
    parser.add_argument("--threads", type=int, metavar="N", help="default: the processors of this machine")


def facade_request(options: argparse.Namespace) -> FacadeRequest:
    """Return what the options ask for."""
    return FacadeRequest(
        options.scene, options.output, options.resume, options.rel_tol, options.full, options.estimator,
        options.seed, options.threads, options.levels,
    )  # fmt: skip


def facade(request: FacadeRequest) -> int:
    """Simulate, or go on; return 0, or 130 if it was interrupted and its points are on disk."""
    if request.rel_tol is not None and not 0 < request.rel_tol < 1:
        raise ConfigError(
            f"--rel-tol {request.rel_tol:g} is not between 0 and 1; 0.01 asks for an error of 1 %"
        )
    if request.levels:
        return _levels(request)
    return _resume(request, request.resume) if request.resume is not None else _new(request)


def _levels(request: FacadeRequest) -> int:
    given = [name for name, value in (("-o", request.output), ("--resume", request.resume)) if value]
    if given:
        return _usage(f"--levels prints a table and writes no file; leave out {given[0]}")
    if request.scene is None:
        return _usage("which scene? give SCENE.toml --levels")
    from gonio.cli.facade_levels import facade_levels

    return facade_levels(
        request.scene,
        rel_tol=DEFAULT_REL_TOL if request.rel_tol is None else request.rel_tol,
        seed=request.seed or 0,
        threads=request.threads,
    )


def _new(request: FacadeRequest) -> int:
    if request.scene is None:
        return _usage("which scene? give SCENE.toml -o OUT.h5, or --resume OUT.h5")
    if request.output is None:
        return _usage("where to? give -o OUT.h5 (or --levels for a table only)")
    output = request.output
    if output.exists():
        raise StoreError(
            f"{output} exists already; choose another name with -o, remove it, or go on with "
            f"gonio facade --resume {output}"
        )
    _refuse_no_folder(output)
    from gonio.facade import load_scene

    return _run(
        load_scene(request.scene),
        request,
        output,
        rel_tol=DEFAULT_REL_TOL if request.rel_tol is None else request.rel_tol,
        folder=_relative(request.scene.parent, output.parent),
    )


def _resume(request: FacadeRequest, path: Path) -> int:
    """Go on with the points in a result; the file is replaced as a whole, never changed in place."""
    given = [f"--{name}" for name in _GIVEN_ONCE if getattr(request, name) not in (None, False)]
    if request.output is not None:
        given.append("-o")
    if given:
        return _usage(
            f"{', '.join(given)} cannot be changed by --resume, which goes on with the points "
            "of its own file; leave out, or simulate anew"
        )
    from gonio.facade import load_irradiance

    earlier = load_irradiance(path)
    rel_tol = earlier.rel_tol if request.rel_tol is None else request.rel_tol
    if earlier.converged and not earlier.interrupted and earlier.rel_tol <= rel_tol:
        print(earlier.table())
        print(f"{path} is finished at this tolerance; give a smaller --rel-tol to add points")
        return 0
    if earlier.state is None:
        raise StoreError(f"{path} holds no points to go on with; simulate the scene anew under another name")
    scene, folder = _scene_of(earlier, request.scene, path)
    options = earlier.options
    request = replace(
        request,
        seed=earlier.seed,
        estimator=options.get("estimator", "auto"),
        full=options.get("full") == "True",
    )
    return _run(scene, request, path, rel_tol=rel_tol, folder=folder, earlier=earlier)


def _scene_of(earlier: Irradiance, given: Path | None, path: Path) -> tuple[Scene, str]:
    """Return the scene of a result, and its folder seen from the result's."""
    from gonio.facade import load_scene, parse_scene

    if given is not None:
        return load_scene(given), _relative(given.parent, path.parent)
    folder = earlier.options.get(_FOLDER, "")
    if not earlier.scene_text:
        raise StoreError(
            f"{path}: its scene was built in Python; go on there with "
            "simulate(scene, state=load_irradiance(...).state)"
        )
    try:
        return parse_scene(earlier.scene_text, source=f"{path}:scene", folder=path.parent / folder), folder
    except SceneError as error:
        raise SceneError(
            f"{error}\nif the scene has moved: gonio facade SCENE.toml --resume {path}"
        ) from None


def _run(
    scene: Scene,
    request: FacadeRequest,
    output: Path,
    *,
    rel_tol: float,
    folder: str,
    earlier: Irradiance | None = None,
) -> int:
    from gonio.cli.progress import progress_bar, readable_duration
    from gonio.facade import simulate
    from gonio.facade.state_file import Checkpoints

    def complete(irradiance: Irradiance) -> Irradiance:
        return replace(irradiance, options={**irradiance.options, _FOLDER: folder})

    start = time.perf_counter()
    with progress_bar("facade", 1.0) as bar:
        irradiance = simulate(
            scene,
            rel_tol=rel_tol,
            seed=request.seed or 0,
            threads=request.threads,
            progress=_progress(bar),
            estimator=request.estimator or "auto",  # type: ignore[arg-type]
            full=request.full,
            state=earlier.state if earlier is not None else None,
            checkpoint=Checkpoints(output, complete),
        )
    complete(irradiance).save(output)
    print(irradiance.table())
    took = readable_duration(time.perf_counter() - start)
    if irradiance.interrupted:
        print(
            f"interrupted after {took}; the points so far are in {output}: go on with "
            f"gonio facade --resume {output}"
        )
        return 130
    print(f"{took}; stored in {output}")
    return 0


def _usage(text: str) -> int:
    """Say how the command is used; return the exit code of a wrong use."""
    print(f"gonio facade: {text}", file=sys.stderr)
    return 2


def _progress(bar: Bar) -> Callable[[float, str], None]:
    """Return how progress is shown; that the engine is being compiled is said at once, in a log too."""

    def show(done: float, text: str) -> None:
        if text.startswith("preparing"):
            bar.say(f"facade: {text}")
        bar.update(done, text)

    return show


def _refuse_no_folder(output: Path) -> None:
    """Say before a long run, not after it, that the result cannot be written."""
    folder = output.parent
    if not folder.is_dir():
        raise StoreError(f"{output}: there is no folder {folder}; make it, or choose another with -o")
    if not os.access(folder, os.W_OK):
        raise StoreError(f"{output}: {folder} cannot be written to; choose another folder with -o")


def _relative(folder: Path, start: Path) -> str:
    """Return the way from one folder to another, empty if there is none (two drives)."""
    try:
        return Path(os.path.relpath(folder, start)).as_posix()
    except ValueError:
        return ""

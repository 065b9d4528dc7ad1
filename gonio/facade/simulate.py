"""How is a scene simulated?  Options checked, estimator chosen, the run watched, its result put together.

An interrupted run (Ctrl-C) gives what it has, with the state from which `simulate` goes on to the same bits.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from typing import Literal, get_args

import numpy as np

from gonio.errors import ConfigError
from gonio.facade.banded import BandedPaths
from gonio.facade.decided import decide
from gonio.facade.lighting import light_notes
from gonio.facade.optics import EnergyWarning, excess_text
from gonio.facade.paths import MAX_RAYS, Progress, available_threads
from gonio.facade.provenance import now_utc, versions
from gonio.facade.reduce import glossy_materials
from gonio.facade.result import Irradiance
from gonio.facade.rows_run import PREPARING, RowsRun, suits
from gonio.facade.scene import Scene
from gonio.facade.state_file import State

Estimator = Literal["auto", "rows", "paths", "backward"]
Checkpoint = Callable[[Callable[[], Irradiance]], None]
"""Called after every batch with a function that returns the result so far."""


def simulate(
    scene: Scene,
    *,
    rel_tol: float = 0.01,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
    estimator: Estimator = "auto",
    full: bool = False,
    max_rays: int = MAX_RAYS,
    state: State | None = None,
    checkpoint: Checkpoint | None = None,
) -> Irradiance:
    """Return the irradiance of every receiver patch with its standard error, by contribution.

    Ctrl-C (`KeyboardInterrupt`, also one raised by `progress`) ends the run with the points it has: the
    result says `interrupted`, and `simulate` with its `state` goes on.  Before there is a first result the
    exception passes through.

    Parameters
    ----------
    scene
        From `load_scene`, or built from Python objects.
    rel_tol
        Wanted for every receiver: root mean square of its patches' standard errors over its mean, 1e-5...0.5.
    seed
        The same seed gives the same bits, whatever `threads`.
    threads
        Default: the processors this process may use.
    progress
        Called with the fraction done and a text; the first call of a program compiles the kernels (about ten
        seconds, kept on disk) and says so.
    estimator
        ``"rows"``: diffuse light by the exchange between patches, lobes by photons; ``"paths"``: paths and
        photons one by one, for scenes of many surfaces; ``"auto"`` chooses between them.  ``"backward"``:
        everything by backward paths, an independent check for broad lobes, slow and with heavy tails for
        narrow ones.
    full
        Leave nothing out; otherwise the planner leaves out what the tolerance allows, and says it.
    max_rays
        No round begins that would go beyond, after the first; the result then says that it has not converged.
    state
        Of an earlier result of the same scene, seed and estimator, interrupted or finished: its points are
        taken over.  The bits are those of a run that was not stopped.
    checkpoint
        See `gonio.facade.state_file.Checkpoints`.

    Raises
    ------
    ConfigError
        An option outside its range.
    SceneError
        A state of another scene.
    """
    if not 1e-5 <= rel_tol <= 0.5:
        raise ConfigError(
            f"rel_tol = {rel_tol:g} is outside 1e-5...0.5; give a relative standard error such as 0.01"
        )
    if not 0 <= seed < 2**63:
        raise ConfigError(f"seed = {seed} is outside 0...2^63 - 1; choose another")
    if threads is not None and threads < 1:
        raise ConfigError(f"threads = {threads} is not a number of threads; give 1 or more, or leave it out")
    if estimator not in get_args(Estimator):
        names = ", ".join(get_args(Estimator))
        raise ConfigError(f"estimator = '{estimator}' is not known; choose among {names}")
    notes = [*scene.notes, *light_notes(scene), *_excesses(scene)]
    started_s = time.monotonic()
    threads = threads or available_threads()
    if progress is not None and _compiles_in_pilots(scene):
        progress(0.0, PREPARING)
    decided = decide(
        scene, rel_tol, seed=seed, threads=threads, planned=estimator != "backward", full=full, state=state
    )
    notes += decided.notes
    run = engine_of(decided.scene, estimator, seed=seed, threads=threads, progress=progress)
    spent_s = 0.0
    if state is not None:
        run.restore(state)
        spent_s = float(state["spent_s"])
    omitted = decided.relative

    def result(reached: float, *, interrupted: bool) -> Irradiance:
        duration_s = spent_s + time.monotonic() - started_s
        return Irradiance(
            receivers=run.receivers(),
            energy=run.energy(),
            title=scene.title,
            scene_text=scene.text,
            seed=seed,
            rel_tol=rel_tol,
            relative_error=run.relative_error(),
            converged=reached <= rel_tol,
            rays=run.rays + decided.rays,
            duration_s=duration_s,
            notes=(*notes, *_afterthoughts(run, reached, rel_tol, max_rays, interrupted=interrupted)),
            omissions=decided.omissions,
            method=run.method,
            levels=decided.levels,
            bands=run.bands(),
            exchange=run.exchange(),
            interrupted=interrupted,
            state={**run.state(), **decided.state(), "spent_s": np.array(duration_s)},
            floor_w_m2=run.floor_w_m2,
            versions=versions(),
            options={"estimator": estimator, "full": str(full)},
            date=now_utc(),
        )

    def between() -> None:
        if checkpoint is not None and run.begun:
            checkpoint(lambda: result(math.inf, interrupted=True))

    try:
        reached = run.until(rel_tol, max_rays, between, omitted)
    except KeyboardInterrupt:
        if not run.begun:
            raise
        return result(math.inf, interrupted=True)
    return result(reached, interrupted=False)


def _compiles_in_pilots(scene: Scene) -> bool:
    """Say whether the planner's pilots, which report nothing, will be the first to need the compiler."""
    from gonio.facade import kernels

    return bool(glossy_materials(scene)) and not kernels.photons.signatures


def engine_of(
    scene: Scene, estimator: Estimator, *, seed: int, threads: int, progress: Progress | None = None
) -> RowsRun | BandedPaths:
    """Return the engine of an estimator, for the scene as it is; "auto": rows where few patches suffice."""
    if estimator == "rows" or (estimator == "auto" and suits(scene)):
        return RowsRun(scene, seed=seed, threads=threads, progress=progress)
    return BandedPaths(scene, seed=seed, threads=threads, progress=progress, whole=estimator == "backward")


def _excesses(scene: Scene) -> list[str]:
    """Warn of materials that create energy, and return the sentences that are not yet among the notes."""
    found: list[str] = []
    if scene.energy == "published":
        for name, optics in scene.materials.items():
            sentence = excess_text(name, optics, scene.energy)
            if sentence is not None:
                warnings.warn(sentence, EnergyWarning, stacklevel=3)
                if sentence not in scene.notes:
                    found.append(sentence)
    return found


def _afterthoughts(
    run: RowsRun | BandedPaths, reached: float, rel_tol: float, max_rays: int, *, interrupted: bool
) -> list[str]:
    notes: list[str] = []
    if reached > rel_tol and not interrupted:
        # the engine of rows also ends where only finer patches would help and there may be no more of them
        remedy = "allow more rays" if 2 * run.rays >= max_rays else 'use estimator = "paths"'
        notes.append(
            f"stopped after {run.rays:.3g} rays at a relative error of {reached:.2g}, above the {rel_tol:g} "
            f"asked; {remedy} or a larger rel_tol"
        )
    lost = run.lost_w_m2()
    if lost > 0.0:
        notes.append(
            f"paths of more than 10 000 reflections were given up; they carried at most {lost:.2g} W/m2"
        )
    return notes

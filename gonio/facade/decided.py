"""What was decided to leave out, so that a run that goes on later decides the same?"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.facade import planner
from gonio.facade.reduce import Level, at_level
from gonio.facade.result import Omission
from gonio.facade.scene import Scene
from gonio.facade.state_file import DIGEST, State, check_digest, digest_of

_KEY, _GIVEN = "decided", "given"


@dataclass(frozen=True, slots=True)
class Decided:
    """The scene to simulate, and what separates it from the one given.

    `relative` holds the sum of the bounds on each receiver, relative to its mean.
    """

    scene: Scene
    omissions: tuple[Omission, ...]
    levels: Mapping[str, Level]
    one_band: bool
    text: str
    rays: int = 0
    given: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))

    @property
    def relative(self) -> dict[str, float]:
        """Sum of the bounds of each receiver, relative to its mean."""
        found: dict[str, float] = {}
        for omission in self.omissions:
            found[omission.receiver] = found.get(omission.receiver, 0.0) + omission.bound_percent / 100.0
        return found

    @property
    def notes(self) -> list[str]:
        """The planner's decisions, a line each."""
        return [f"planner: {line}" for line in self.text.splitlines()]

    def state(self) -> dict[str, NDArray[Any]]:
        """Return this as an array, for `decide`."""
        kept = {
            "omissions": [asdict(o) for o in self.omissions],
            "levels": dict(self.levels),
            "one_band": self.one_band,
            "text": self.text,
            "rays": self.rays,
        }
        return {_KEY: np.frombuffer(json.dumps(kept).encode(), np.uint8).copy(), _GIVEN: self.given}


def decide(
    scene: Scene, rel_tol: float, *, seed: int, threads: int, planned: bool, full: bool, state: State | None
) -> Decided:
    """Return what to simulate: as decided before, the scene itself, everything, or the planner's choice."""
    given = _digest(scene)
    if state is not None and _KEY in state:
        check_digest({DIGEST: state[_GIVEN]}, given)
        kept = json.loads(bytes(np.asarray(state[_KEY], np.uint8)))
        reduced = at_level(scene, kept["levels"], one_band=kept["one_band"])
        omissions = tuple(Omission(**o) for o in kept["omissions"])
        return Decided(
            reduced, omissions, kept["levels"], kept["one_band"], kept["text"], kept["rays"], given
        )
    if not planned:
        return Decided(scene, (), {}, False, "", 0, given)
    if full:
        choice = planner.full(scene, rel_tol)
    else:
        choice = planner.choose(scene, rel_tol, seed=seed, threads=threads)
    one_band = bool(scene.bands) and not choice.scene.bands
    return Decided(choice.scene, choice.omissions, choice.levels, one_band, choice.text, choice.rays, given)


def _digest(scene: Scene) -> NDArray[np.uint8]:
    """Return what tells a scene from another one, before anything is left out of it."""
    meshes = [
        (m.name, m.vertices_m, m.faces, repr(m.materials), m.face_material, m.receiver, m.sides)
        for m in scene.meshes
    ]
    rest = (
        scene.surfaces, dict(scene.materials), scene.sun, scene.dni_w_m2, scene.dhi_w_m2, scene.infinite,
        scene.energy, scene.horizon, scene.bands, scene.sky, scene.polarised, scene.broadband_w_m2,
    )  # fmt: skip
    return digest_of(repr(rest), meshes)

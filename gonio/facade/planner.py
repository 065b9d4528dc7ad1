"""What may be left out of a scene for the stated tolerance, and what does that cost at most?

The reference is everything: all bands, every lobe, polarised.  Starting from it the planner tries one
simplification after the other (bands to their average, no polarization, materials to Lambert or to two
coefficients), each compared with the scene before it in a short run of the engine with the same random
numbers (`gonio.facade.pilot`).  A simplification is kept if its bound still fits beside those before it into
half of the tolerance, on every receiver.  Bounds of a chain add up to a bound of the whole (triangle
inequality), so

    total error = sqrt(statistical^2 + (sum of bounds)^2) <= rel_tol,

and the statistical tolerance is what remains.  What changes nothing (`gonio.facade.reach`) is left out
without a run: a scene without a working lobe and with one band is decided at once.

All reflections are always followed (linear solve, or paths to their end): nothing is left out there.  Patches
and samples are chosen by the engine, inside the statistical tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.facade.bounds import Difference
from gonio.facade.pilot import Engine, Outcome, compared, engine, means
from gonio.facade.reach import is_grey, lobe_meets_lobe
from gonio.facade.reduce import Level, at_level, glossy_materials, sphere_coefficients, used_materials
from gonio.facade.result import Omission

if TYPE_CHECKING:
    from gonio.facade.scene import Scene

FloatArray = NDArray[np.float64]

SHARE = 0.5
"""Part of the tolerance that omissions may take; the statistical part then needs a third more samples."""

TIERS = (0.5, 0.1, 0.02, 0.004)
"""Statistical tolerances of the pilots, tried one after the other while a bound is undecided; the first asks
for the first points only."""

WORTH = 0.25
"""Part of the whole run's rays that finer pilots may cost together."""

POWER = 4.0 / 3.0
"""Rays grow as error^-4/3: the variance of scrambled Sobol points falls about as points^-1.5."""

DARK = 1e-3
"""A receiver with less than this part of DNI + DHI is held to that part (as in the engine)."""


@dataclass(frozen=True, slots=True)
class Choice:
    """What to simulate instead of the scene, and what that leaves out.

    Parameters
    ----------
    scene
        Simplified; its `polarised` says whether polarization is carried.
    stat_tol
        Statistical tolerance that remains, relative.
    omissions
        For each omission and receiver the bound in W/m2 and in % of its mean; what is exactly nothing is not
        among them but in `text`.
    levels
        Level of each used material.
    text
        One line for each decision.
    rays
        Spent on the pilots.
    """

    scene: Scene
    polarised: bool
    stat_tol: float
    omissions: tuple[Omission, ...]
    levels: Mapping[str, Level]
    text: str
    rays: int = 0


def full(scene: Scene, rel_tol: float) -> Choice:
    """Return the scene with everything in it: every lobe, polarised, all bands; nothing is left out."""
    glossy = glossy_materials(scene)
    whole = at_level(scene, dict.fromkeys(glossy, "polarised"))
    levels: dict[str, Level] = {
        name: "polarised" if name in glossy else "diffuse" for name in used_materials(scene)
    }
    return Choice(whole, whole.polarised, rel_tol, (), levels, "nothing is left out")


def choose(
    scene: Scene,
    rel_tol: float,
    run: Engine | None = None,
    *,
    seed: int = 0,
    threads: int | None = None,
) -> Choice:
    """Return the cheapest scene whose omissions fit into the tolerance.

    Parameters
    ----------
    scene
        As given: with its bands.
    rel_tol
        Wanted for every receiver: ``sqrt(statistical^2 + (sum of bounds)^2)`` relative to its mean.
    run
        ``run(scene, rel_tol) -> Outcome`` (`gonio.facade.pilot.Engine`): the engine without planner, always
        with the same seed; not called if there is nothing to decide.  Default: `gonio.facade.pilot.engine`
        with `seed` and `threads`.
    """
    return _Plan(scene, rel_tol, run or engine(seed=seed, threads=threads)).decide()


@dataclass
class _Plan:
    original: Scene
    rel_tol: float
    run: Engine
    lines: list[str] = field(default_factory=list)
    omissions: list[Omission] = field(default_factory=list)
    levels: dict[str, Level] = field(default_factory=dict)
    rays: int = 0
    one_band: bool = False
    _outcome_of_all: Outcome = field(init=False)
    floor: FloatArray = field(init=False)
    spent: FloatArray = field(init=False)
    _outcomes: dict[tuple[object, ...], Outcome] = field(default_factory=dict)

    def decide(self) -> Choice:
        scene = self.original
        glossy = glossy_materials(scene)
        self.levels = {name: "polarised" if name in glossy else "diffuse" for name in used_materials(scene)}
        if not glossy:
            self.lines.append("no surface has a lobe: all are Lambert, exactly")
        elif not lobe_meets_lobe(scene):
            self._set(glossy, "lobe")
            self.lines.append("no light goes from lobe to lobe: polarization changes nothing")
        if scene.bands and is_grey(scene):
            self.one_band = True
            self.lines.append("all bands have the same materials: one band is exact")
        bands = bool(scene.bands) and not self.one_band
        if not bands and not glossy:
            return self._choice(np.zeros(1))
        first = self._outcome_of_all = self._outcome(TIERS[0])
        mean, error = means(first)
        light = scene.direct_w_m2 + scene.dhi_w_m2
        # A relative bound needs a mean from below; the error of the pilot's is taken off.
        self.floor = np.maximum(np.maximum(mean - 3.0 * error, 0.5 * mean), DARK * light)
        self.spent = np.zeros(len(mean))
        if not np.any(self.floor > 0.0):
            self.lines.append("there is no light")
            self._set(glossy, "diffuse")
            self.one_band = True
            return self._choice(self.spent)
        if bands:
            self._try(f"{len(scene.bands)} bands as one average", [], None, one_band=True)
        polarised = [name for name in glossy if self.levels[name] == "polarised"]
        if polarised:
            self._try("polarization between lobes", polarised, "lobe")
        self._lower(sorted(glossy, key=self._weight))
        return self._choice(self.spent / self.floor)

    # -- trying

    def _lower(self, names: Sequence[str]) -> None:
        """Make as many materials diffuse as fit: all together, else each half by itself, else a mirror."""
        if not names:
            return
        if self._try(_lobes(names, "diffuse (Lambert k_g)"), names, "diffuse"):
            return
        if len(names) == 1:
            self._try(_lobes(names, "a mirror of constant k_s"), names, "mirror")
            return
        middle = (len(names) + 1) // 2
        self._lower(names[:middle])
        self._lower(names[middle:])

    def _try(self, what: str, names: Sequence[str], level: Level | None, *, one_band: bool = False) -> bool:
        """Simplify if the bound of what is lost fits on every receiver; say so or why not."""
        before = dict(self.levels), self.one_band
        budget = SHARE * self.rel_tol * self.floor - self.spent
        found: Difference | None = None
        for tier in TIERS:
            if found is not None and not self._worth(tier):
                break
            self.levels, self.one_band = dict(before[0]), before[1]
            reference = self._outcome(tier)
            self._set(names, level)
            self.one_band = self.one_band or one_band
            found = compared(self._outcome(tier), reference)
            if np.all(found.bound <= budget):
                self._keep(what, found)
                return True
            if np.any(found.least > budget):
                break  # more samples would not change the answer
        assert found is not None
        self.levels, self.one_band = before
        self._refuse(what, found, certain=bool(np.any(found.least > budget)))
        return False

    def _worth(self, tier: float) -> bool:
        """Say whether two more pilots at `tier` cost less than a part of the whole run."""
        first = self._outcome_of_all.irradiance
        reached = max(first.relative_error, 1e-9)
        whole = first.rays * max(1.0, (reached / self.rel_tol) ** POWER)
        pilots = 2.0 * first.rays * max(1.0, (min(reached, TIERS[0]) / tier) ** POWER)
        return tier > self.rel_tol and self.rays + pilots <= WORTH * whole

    def _refuse(self, what: str, found: Difference, *, certain: bool) -> None:
        reach = found.least if certain else found.bound
        worst = int(np.argmax(reach / self.floor))
        verb = "changes" if certain else "may change"
        limit = "at least" if certain else "up to"
        self.lines.append(
            f"kept: {what} {verb} '{self._names()[worst]}' by {limit} {reach[worst]:.3g} W/m2 "
            f"({100.0 * reach[worst] / self.floor[worst]:.2g} %)"
        )

    def _keep(self, what: str, found: Difference) -> None:
        self.spent = self.spent + found.bound
        for name, bound, floor in zip(self._names(), found.bound, self.floor, strict=True):
            self.omissions.append(Omission(what, float(bound), float(100.0 * bound / floor), name))
        worst = int(np.argmax(found.bound / self.floor))
        self.lines.append(
            f"left out: {what}; at most {found.bound[worst]:.3g} W/m2 "
            f"({100.0 * found.bound[worst] / self.floor[worst]:.2g} %) on '{self._names()[worst]}'"
        )

    def _set(self, names: Sequence[str], level: Level | None) -> None:
        if level is not None:
            self.levels |= dict.fromkeys(names, level)

    def _names(self) -> list[str]:
        return [r.name for r in next(iter(self._outcomes.values())).irradiance.receivers]

    def _weight(self, name: str) -> float:
        """Return how much a material is likely to matter: its mirror reflectance times its area."""
        area = sum(s.area_m2 for s in self.original.surfaces if s.material == name)
        return (area + 1e-3) * sphere_coefficients(self.original.materials[name])[1]

    # -- running

    def _scene(self, *, shy: bool) -> Scene:
        return at_level(self.original, self.levels, one_band=self.one_band, shy=shy)

    def _outcome(self, tolerance: float) -> Outcome:
        key = (tuple(self.levels.items()), self.one_band, tolerance)
        if key not in self._outcomes:
            # While lobes remain, those taken away leave a trace, so that photons start where they did.
            glossy = any(level != "diffuse" for level in self.levels.values())
            self._outcomes[key] = self.run(self._scene(shy=glossy), tolerance)
            self.rays += self._outcomes[key].irradiance.rays
        return self._outcomes[key]

    def _choice(self, spent: FloatArray) -> Choice:
        scene = self._scene(shy=False)
        worst = float(np.max(spent))
        return Choice(
            scene,
            scene.polarised,
            math.sqrt(self.rel_tol**2 - worst**2),
            tuple(self.omissions),
            dict(self.levels),
            "\n".join(self.lines),
            self.rays,
        )


def _lobes(names: Sequence[str], level: str) -> str:
    if len(names) == 1:
        return f"lobe of '{names[0]}' as {level}"
    shown = ", ".join(f"'{name}'" for name in names[:4]) + (", ..." if len(names) > 4 else "")
    return f"lobes of {shown} as {level}"

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
from gonio.facade.pilot import TIERS, Engine, Outcome, Screen, compared, means, pilots
from gonio.facade.reach import is_grey, lobe_meets_lobe
from gonio.facade.reduce import Level, at_level, glossy_materials, sphere_coefficients, used_materials
from gonio.facade.result import Omission

if TYPE_CHECKING:
    from gonio.facade.scene import Scene

FloatArray = NDArray[np.float64]

SHARE = 0.5
"""Part of the tolerance that omissions may take; the statistical part then needs a third more samples."""

SURE = 3.0
"""A material whose lobes throw this many times the share of the tolerance, relative to DNI + DHI, onto a
receiver, is not tried as diffuse."""

GUESS = 0.05
"""Relative error of a pilot of the first tier, until one has been run."""

WORTH = 0.35
"""Part of the whole run's cost, roughly guessed, that pilots may cost; the first look at what may be small is
free of it."""

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
    return _Plan(scene, rel_tol, run or pilots(scene, seed=seed, threads=threads)).decide()


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
    unseen: list[str] = field(default_factory=list)  # what was not tried
    cost: float = 0.0  # of the pilots, in those of the first tier
    floor: FloatArray | None = None  # (receivers,) W/m2 that relative errors refer to
    spent: FloatArray = field(default_factory=lambda: np.zeros(0))  # (receivers,) sum of bounds so far
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
        light = scene.direct_w_m2 + scene.dhi_w_m2
        if not light > 0.0:
            self._set(glossy, "diffuse")
            self.one_band = True
            self.lines.append("there is no light")
            return self._choice()
        if scene.bands and not self.one_band:
            what = f"{len(scene.bands)} bands as one average"
            self._try(what, [], None, one_band=True, anyway=True)
        if glossy:
            small = self._small(sorted(glossy, key=self._weight), light)
            self._lower(small, anyway=True)
            polarised = [name for name in glossy if self.levels[name] == "polarised"]
            if polarised:
                self._try("polarization between lobes", polarised, "lobe")
            for name in glossy:
                if self.levels[name] != "diffuse":
                    self._try(_lobes([name], "a mirror of constant k_s"), [name], "mirror")
        return self._choice()

    def _small(self, glossy: Sequence[str], light: float) -> list[str]:
        """Return the materials whose lobes may be negligible; say of the others what they do at least."""
        if not isinstance(self.run, Screen):
            return list(glossy)
        found = []
        for name in glossy:
            least = float(np.max(self.run.first_light(name), initial=0.0))
            if least > SURE * SHARE * self.rel_tol * light:
                self.lines.append(f"kept: lobe of '{name}'; it throws {least:.3g} W/m2 or more on a receiver")
            else:
                found.append(name)
        return found

    # -- trying

    def _lower(self, names: Sequence[str], *, anyway: bool = False) -> None:
        """Make as many materials diffuse as fit: all together, else each half by itself."""
        if not names:
            return
        if self._try(_lobes(names, "diffuse (Lambert k_g)"), names, "diffuse", anyway=anyway):
            return
        if len(names) == 1:
            return
        middle = (len(names) + 1) // 2
        self._lower(names[:middle])
        self._lower(names[middle:])

    def _try(
        self,
        what: str,
        names: Sequence[str],
        level: Level | None,
        *,
        one_band: bool = False,
        anyway: bool = False,
    ) -> bool:
        """Simplify if the bound of what is lost fits on every receiver; say so or why not.

        With `anyway` the first pilots are run whatever they cost.
        """
        before = dict(self.levels), self.one_band
        found: Difference | None = None
        for tier in TIERS:
            if not (anyway and found is None) and not self._worth(tier):
                break
            self.levels, self.one_band = dict(before[0]), before[1]
            reference = self._outcome(tier)
            self._set(names, level)
            self.one_band = self.one_band or one_band
            found = compared(self._outcome(tier), reference)
            budget = self._budget()
            if np.all(found.bound <= budget):
                self._keep(what, found)
                return True
            if np.any(found.least > budget):
                break  # more samples would not change the answer
        self.levels, self.one_band = before
        if found is None:
            self.unseen.append(what)
        else:
            self._refuse(what, found, certain=bool(np.any(found.least > self._budget())))
        return False

    def _budget(self) -> FloatArray:
        """Return what a further omission may cost, (receivers,) W/m2; the first call looks at the means."""
        if self.floor is None:
            mean, error = means(self._first)
            light = self.original.direct_w_m2 + self.original.dhi_w_m2
            # A relative bound needs a mean from below; the error of the pilot's is taken off.
            self.floor = np.maximum(np.maximum(mean - 3.0 * error, 0.5 * mean), DARK * light)
            self.spent = np.zeros(len(mean))
        return SHARE * self.rel_tol * self.floor - self.spent

    def _worth(self, tier: float) -> bool:
        """Say whether two pilots at `tier` cost less than a part of the whole run."""
        reached = GUESS
        if self._outcomes:
            reached = self._first.irradiance.relative_error
        whole = max(1.0, (reached / self.rel_tol) ** POWER)
        pilots = 2.0 * max(1.0, (TIERS[0] / tier) ** POWER)
        return tier > self.rel_tol and self.cost + pilots <= WORTH * whole

    @property
    def _floor(self) -> FloatArray:
        assert self.floor is not None
        return self.floor

    @property
    def _first(self) -> Outcome:
        return next(iter(self._outcomes.values()))

    def _refuse(self, what: str, found: Difference, *, certain: bool) -> None:
        reach = found.least if certain else found.bound
        worst = int(np.argmax(reach / self._floor))
        verb = "changes" if certain else "may change"
        limit = "at least" if certain else "up to"
        self.lines.append(
            f"kept: {what} {verb} '{self._names()[worst]}' by {limit} {reach[worst]:.3g} W/m2 "
            f"({100.0 * reach[worst] / self._floor[worst]:.2g} %)"
        )

    def _keep(self, what: str, found: Difference) -> None:
        self.spent = self.spent + found.bound
        percent = 100.0 * found.bound / self._floor
        for name, bound, part in zip(self._names(), found.bound, percent, strict=True):
            self.omissions.append(Omission(what, float(bound), float(part), name))
        worst = int(np.argmax(percent))
        self.lines.append(
            f"left out: {what}; at most {found.bound[worst]:.3g} W/m2 "
            f"({percent[worst]:.2g} %) on '{self._names()[worst]}'"
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

    def _outcome(self, tier: float) -> Outcome:
        key = (tuple(self.levels.items()), self.one_band, tier)
        if key not in self._outcomes:
            # While lobes remain, those taken away leave a trace, so that photons start where they did.
            glossy = any(level != "diffuse" for level in self.levels.values())
            self._outcomes[key] = self.run(self._scene(shy=glossy), tier)
            self.rays += self._outcomes[key].irradiance.rays
            self.cost += max(1.0, (TIERS[0] / tier) ** POWER)
        return self._outcomes[key]

    def _choice(self) -> Choice:
        scene = self._scene(shy=False)
        if self.unseen:
            more = f" and {len(self.unseen) - 3} more" if len(self.unseen) > 3 else ""
            self.lines.append(
                f"kept without a look, which costs as much as they do: {'; '.join(self.unseen[:3])}{more}"
            )
        worst = 0.0 if self.floor is None else float(np.max(self.spent / self.floor))
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

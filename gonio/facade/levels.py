"""What does the material change?  The same scene at each material level, and the differences.

The paper's question as a table: every glossy material of the scene at one level after the other, all bands,
the same random numbers.  A difference is formed replica by replica, so its standard error is its own and
mostly much smaller than those of the two values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.facade.pilot import Engine, Outcome, compared, engine, means
from gonio.facade.planner import DARK
from gonio.facade.reach import lobe_meets_lobe
from gonio.facade.reduce import LEVELS, Level, at_level, glossy_materials
from gonio.facade.scene import Scene

FloatArray = NDArray[np.float64]

NAMES: Mapping[Level, str] = {
    "diffuse": "diffuse only",
    "mirror": "two coefficients",
    "lobe": "full lobe",
    "polarised": "polarised",
}
"""As the issue and the paper call them."""

SIGNIFICANT = 3.0
"""Standard errors from which a difference counts as seen."""


@dataclass(frozen=True, slots=True)
class LevelResult:
    """One level: means of the receivers, and their differences to the highest level, W/m2, (receivers,) each.

    `patch_rms` is the root mean square over a receiver's patches of the difference, noise included;
    `same_as` names a level that is this one exactly, so that no rays were spent.
    """

    level: Level
    value: FloatArray
    standard_error: FloatArray
    difference: FloatArray
    difference_error: FloatArray
    patch_rms: FloatArray
    duration_s: float
    rays: int
    same_as: Level | None = None


@dataclass(frozen=True, slots=True)
class LevelTable:
    """All levels of one scene; `receivers` are its names in the order of the arrays."""

    receivers: tuple[str, ...]
    levels: tuple[LevelResult, ...]
    rel_tol: float
    glossy: tuple[str, ...]
    floor_w_m2: float

    def __getitem__(self, level: str) -> LevelResult:
        """Return one level; `KeyError` for an unknown one."""
        for result in self.levels:
            if result.level == level:
                return result
        raise KeyError(f"no level '{level}'; there are {', '.join(r.level for r in self.levels)}")

    def percent(self, result: LevelResult) -> FloatArray:
        """Return the differences of a level in % of the highest level's means.

        A mean below 0.1 % of DNI + DHI is replaced by that, as in the engine.
        """
        reference = np.maximum(self.levels[-1].value, self.floor_w_m2)
        return 100.0 * result.difference / np.maximum(reference, 1e-300)

    def sufficient(self, number: int) -> Level:
        """Return the lowest level that a receiver's mean needs: difference and 3 standard errors fit."""
        reference = max(float(self.levels[-1].value[number]), self.floor_w_m2)
        for result in self.levels[:-1]:
            reach = abs(result.difference[number]) + SIGNIFICANT * result.difference_error[number]
            if reach <= self.rel_tol * reference:
                return result.level
        return self.levels[-1].level

    def text(self) -> str:
        """Return the table and what follows from it."""
        head = f"{'receiver':<16}{'level':<18}{'W/m2':>19}"
        lines = [head + f"{'difference W/m2':>21}{'%':>9}{'patches %':>11}{'s':>8}"]
        for number, name in enumerate(self.receivers):
            reference = max(float(self.levels[-1].value[number]), self.floor_w_m2, 1e-300)
            for result in self.levels:
                value = f"{result.value[number]:.2f} ± {result.standard_error[number]:.2f}"
                if result is self.levels[-1]:
                    rest = f"{'reference':>21}{'':>9}{'':>11}"
                else:
                    error = result.difference_error[number]
                    patches = 100.0 * result.patch_rms[number] / reference
                    rest = (
                        f"{_signed(result.difference[number], error):>21}"
                        f"{self.percent(result)[number]:>+9.3f}{patches:>11.3f}"
                    )
                seconds = f"= {result.same_as}" if result.same_as else f"{result.duration_s:.2f}"
                title = name if result is self.levels[0] else ""
                lines.append(f"{title:<16}{NAMES[result.level]:<18}{value:>19}{rest}{seconds:>8}")
        lines.append("mean ± standard error; differences to the last level with standard errors of their own")
        lines.append("patches: root mean square of the patches' differences, noise included")
        return "\n".join([*lines, *self._sentences()])

    def _sentences(self) -> list[str]:
        if not self.glossy:
            return ["no surface has a lobe: all levels are the same scene"]
        found: dict[Level, list[str]] = {}
        for number, name in enumerate(self.receivers):
            found.setdefault(self.sufficient(number), []).append(name)
        within = f"within {100.0 * self.rel_tol:g} %"
        return [
            f"{within}: '{NAMES[level]}' is enough for the mean of {_listed(found[level])}"
            for level in LEVELS
            if level in found
        ]


def compare_levels(
    scene: Scene,
    *,
    rel_tol: float = 0.01,
    seed: int = 0,
    threads: int | None = None,
    run: Engine | None = None,
) -> LevelTable:
    """Return the scene's irradiance at each material level.

    Parameters
    ----------
    scene
        All its bands are computed at every level.
    rel_tol
        Statistical tolerance of each level, as in `simulate`.
    run
        Default: the engine without planner.
    """
    run = run or engine(seed=seed, threads=threads)
    glossy = glossy_materials(scene)
    wanted: tuple[Level, ...] = LEVELS if glossy else ("diffuse",)
    # Once with few points, so that no level's time holds the compilation or the reading of its cache.
    run(at_level(scene, dict.fromkeys(glossy, wanted[-1])), 0.5)
    outcomes: dict[Level, Outcome] = {}
    same: dict[Level, Level] = {}
    meet = lobe_meets_lobe(scene)
    for level in wanted:
        if level == "polarised" and not meet:
            same[level] = "lobe"
            outcomes[level] = outcomes["lobe"]
        else:
            outcomes[level] = run(at_level(scene, dict.fromkeys(glossy, level)), rel_tol)
    reference = outcomes[wanted[-1]]
    results = []
    for level in wanted:
        value, error = means(outcomes[level])
        found = compared(outcomes[level], reference)
        results.append(
            LevelResult(
                level,
                value,
                error,
                found.mean,
                found.standard_error,
                found.rms,
                outcomes[level].irradiance.duration_s,
                outcomes[level].irradiance.rays,
                same.get(level),
            )
        )
    light = scene.direct_w_m2 + scene.dhi_w_m2
    names = tuple(r.name for r in reference.irradiance.receivers)
    return LevelTable(names, tuple(results), rel_tol, tuple(glossy), DARK * light)


def _signed(value: float, error: float) -> str:
    return f"{value:+.3f} ± {error:.3f}"


def _listed(names: list[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names[:8])
    return shown + (f" and {len(names) - 8} more" if len(names) > 8 else "")

"""The plan file: which positions, polarizations and wavelengths are measured, in which order.

Order of measuring: sweep by sweep as listed, within a sweep polarization by polarization as listed, within
these the detector angles as listed.  The polarizer so turns once per sweep and polarization, and an incidence
is complete before the sample turns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import tomli_w
from pydantic import BeforeValidator, field_validator, model_validator

from gonio.config import Count, Number, Positive, Strict, parse_toml, read_toml, validate
from gonio.devices import FloatArray, Polarization
from gonio.plan.grid import explain_grid, grid_values

MAX_POSITIONS = 1_000_000
MAX_READINGS = 1_000_000_000

When = Literal["start", "end"]


@dataclass(frozen=True, slots=True)
class Position:
    """One position to measure; `index` counts from zero in measuring order."""

    index: int
    theta_i_deg: float
    theta_mes_deg: float
    polarization: Polarization

    @property
    def theta_o_deg(self) -> float:
        """Observation angle from the sample normal, positive on the specular side."""
        return self.theta_mes_deg - self.theta_i_deg


def _a_list(what: str, example: str) -> Callable[[Any], Any]:
    """Make a validator that asks for a list in a TOML user's words, not in Python's."""

    def check_list(value: Any) -> Any:
        if not isinstance(value, list | tuple):
            raise ValueError(f"must be a list of {what}, such as {example}")
        return value

    return check_list


def _once(values: tuple[str, ...], what: str) -> tuple[str, ...]:
    if not values:
        raise ValueError(f"the list of {what} is empty; give at least one")
    repeated = [value for value, count in Counter(values).items() if count > 1]
    if repeated:
        raise ValueError(f"'{repeated[0]}' is listed twice; remove one")
    return values


class Sample(Strict):
    """What lies in the sample holder."""

    name: str = "unnamed"
    description: str = ""


class WavelengthRange(Strict):
    """Wavelengths from `start_nm` to `stop_nm` inclusive, or a list."""

    start_nm: Positive | None = None
    stop_nm: Positive | None = None
    step_nm: Number | None = None
    values_nm: Annotated[
        tuple[Positive, ...] | None, BeforeValidator(_a_list("wavelengths", "[550.0, 560.0]"))
    ] = None

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        problem = explain_grid(
            self.values_nm, self.start_nm, self.stop_nm, self.step_nm,
            what="wavelength", unit="nm", suffix="_nm",
        )  # fmt: skip
        if problem:
            raise ValueError(problem)
        return self

    def values(self) -> FloatArray:
        """Return the wavelengths in nm, (k,) float64."""
        return grid_values(self.values_nm, self.start_nm, self.stop_nm, self.step_nm)


class Angles(Strict):
    """Angles from `start` to `stop` inclusive, degrees; a plain list stands for `values`."""

    start: Number | None = None
    stop: Number | None = None
    step: Number | None = None
    values: Annotated[tuple[Number, ...] | None, BeforeValidator(_a_list("angles", "[15.0, 18.0]"))] = None

    @model_validator(mode="before")
    @classmethod
    def _list_or_table(cls, value: Any) -> Any:
        if isinstance(value, list | tuple):
            return {"values": value}
        if not isinstance(value, dict | Angles):
            raise ValueError(
                "must be a range such as { start = 15.0, stop = 105.0, step = 3.0 } or a list such as "
                "[15.0, 18.0], in degrees"
            )
        return value

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        problem = explain_grid(
            self.values, self.start, self.stop, self.step, what="angle", unit="deg", suffix=""
        )
        if problem:
            raise ValueError(problem)
        return self

    def values_deg(self) -> FloatArray:
        """Return the angles in degrees, (k,) float64."""
        return grid_values(self.values, self.start, self.stop, self.step)


class Sweep(Strict):
    """The detector angles at one incidence."""

    theta_i_deg: Number
    theta_mes_deg: Angles

    @field_validator("theta_i_deg")
    @classmethod
    def _above_the_surface(cls, value: float) -> float:
        if not -90.0 < value < 90.0:
            raise ValueError("is no incidence on the sample's front; give an angle between -90 and 90 deg")
        return value


class Reading(Strict):
    """How often each reading is repeated and averaged."""

    averages: Count = 1


class References(Strict):
    """When the dark signal and the direct beam (100 %) are measured, and how often each reading is repeated.

    With `averages` = 1 nothing is known of the noise, and no uncertainty can be stored beside `r`.  The
    error of the dark reading is common to all positions, and a white panel gives r = 1 %: a dark reading
    deserves more averages than the strong direct beam.
    """

    dark: Annotated[tuple[When, ...], BeforeValidator(_a_list("'start' and 'end'", '["start", "end"]'))] = (
        "start",
        "end",
    )
    baseline: Annotated[
        tuple[When, ...], BeforeValidator(_a_list("'start' and 'end'", '["start", "end"]'))
    ] = ("start", "end")
    averages: Count = 4
    dark_averages: Count | None = None  # like `averages` if not given

    def averages_of(self, kind: Literal["dark", "baseline"]) -> int:
        """Return how many readings are averaged for a dark or a baseline."""
        return self.dark_averages or self.averages if kind == "dark" else self.averages

    @field_validator("dark", "baseline")
    @classmethod
    def _at_least_once(cls, value: tuple[When, ...]) -> tuple[str, ...]:
        return _once(value, "times (r needs a dark and a baseline reading)")


class Plan(Strict):
    """A validated `plan.toml`; all of it has a default but `sweeps` and `wavelengths`."""

    title: str = "Goniospectrophotometer scan"
    polarization: Annotated[
        tuple[Polarization, ...], BeforeValidator(_a_list("'s' and 'p'", '["s", "p"]'))
    ] = ("s", "p")
    sample: Sample = Sample()
    wavelengths: Annotated[tuple[WavelengthRange, ...], BeforeValidator(_a_list("tables", "[[wavelengths]]"))]
    sweeps: Annotated[tuple[Sweep, ...], BeforeValidator(_a_list("tables", "[[sweeps]]"))]
    reading: Reading = Reading()
    references: References = References()

    @field_validator("polarization")
    @classmethod
    def _each_once(cls, value: tuple[Polarization, ...]) -> tuple[str, ...]:
        return _once(value, "polarizations")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for key, entries in (("wavelengths", self.wavelengths), ("sweeps", self.sweeps)):
            if not entries:
                raise ValueError(f"{key} is empty; add at least one [[{key}]] table")
        wavelength_nm = self.wavelength_nm
        step = np.diff(wavelength_nm)
        if np.any(step <= 0):
            at = int(np.flatnonzero(step <= 0)[0])
            first, second = wavelength_nm[at], wavelength_nm[at + 1]
            if first == second:
                raise ValueError(
                    f"wavelengths: {first:g} nm is listed twice; leave it out of one of the ranges or lists"
                )
            raise ValueError(
                f"wavelengths: {second:g} nm comes after {first:g} nm; list wavelengths in ascending order, "
                "once each"
            )
        n_positions = self.n_positions
        if n_positions > MAX_POSITIONS:
            raise ValueError(
                f"sweeps: {n_positions} positions are more than {MAX_POSITIONS}; take larger steps or divide "
                "the plan"
            )
        n_readings = n_positions * len(wavelength_nm) * self.reading.averages
        if n_readings > MAX_READINGS:
            raise ValueError(
                f"{n_positions} positions x {len(wavelength_nm)} wavelengths x {self.reading.averages} "
                f"averages are {n_readings} readings, more than {MAX_READINGS}; divide the plan"
            )
        self._refuse_repeated_positions()
        return self

    def _refuse_repeated_positions(self) -> None:
        seen: dict[tuple[float, float], int] = {}
        for number, sweep in enumerate(self.sweeps, start=1):
            for theta_mes in sweep.theta_mes_deg.values_deg():
                key = (sweep.theta_i_deg, float(theta_mes))
                if key in seen:
                    raise ValueError(
                        f"sweeps[{number}]: theta_i = {key[0]:g} deg, theta_mes = {key[1]:g} deg is already "
                        f"in sweeps[{seen[key]}]; list each position once"
                    )
                seen[key] = number

    @property
    def wavelength_nm(self) -> FloatArray:
        """The wavelengths in measuring order, (m,) float64, ascending."""
        return np.concatenate([entry.values() for entry in self.wavelengths])

    @property
    def n_positions(self) -> int:
        """Number of positions, all polarizations counted."""
        per_polarization = sum(len(sweep.theta_mes_deg.values_deg()) for sweep in self.sweeps)
        return per_polarization * len(self.polarization)

    def positions(self) -> tuple[Position, ...]:
        """Return every position in measuring order."""
        found: list[Position] = []
        for sweep in self.sweeps:
            theta_mes_deg = sweep.theta_mes_deg.values_deg().tolist()
            for polarization in self.polarization:
                for theta_mes in theta_mes_deg:
                    found.append(Position(len(found), sweep.theta_i_deg, theta_mes, polarization))
        return tuple(found)

    def to_toml(self) -> str:
        """Return the plan as the text of a `plan.toml` that `parse_plan` reads back equal."""
        tables = self.model_dump(exclude_none=True)
        for sweep in tables["sweeps"]:
            angles = sweep["theta_mes_deg"]
            sweep["theta_mes_deg"] = angles.get("values", angles)
        return tomli_w.dumps(tables)

    @classmethod
    def paper(cls) -> Plan:
        """Return the plan of the paper's HPL measurement: 146 positions, S and P, 121 wavelengths."""
        text = resources.files("gonio").joinpath("data/hpl.toml").read_text(encoding="utf-8")
        return parse_plan(text, source="hpl.toml (built in)")


def load_plan(path: str | Path) -> Plan:
    """Return the validated plan file; `ConfigError` lists every mistake."""
    path = Path(path)
    return validate(Plan, read_toml(path), source=str(path))


def parse_plan(text: str, *, source: str = "plan.toml") -> Plan:
    """Return validated plan text; `ConfigError` lists every mistake, `source` names the text."""
    return validate(Plan, parse_toml(text, source=source), source=source)

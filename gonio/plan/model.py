"""The plan: which positions, polarizations and wavelengths are measured, in which order.

A `Plan` needs no rig.  What depends on one (which detector measures a wavelength, what order is fastest, what
is refused, how long it takes) is asked in `channels`, `optimise`, `check` and `timetable` beside this module.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Self

import numpy as np
import tomli_w
from pydantic import BeforeValidator, Field, field_validator, model_validator

from gonio.config import NotNegative, parse_toml, read_toml, validate
from gonio.devices import FloatArray, Polarization
from gonio.plan.listing import with_files
from gonio.plan.order import Place, arrange
from gonio.plan.tables import (
    Order,
    PlanTable,
    PositionList,
    Reading,
    References,
    Repeats,
    Sample,
    Source,
    Sweep,
    WavelengthRange,
    When,
    a_list,
    once,
)

__all__ = ["Plan", "Position", "When", "load_plan", "parse_plan"]

MAX_POSITIONS = 1_000_000
MAX_READINGS = 1_000_000_000
MAX_OVERLAP_NM = 200.0


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


class Plan(PlanTable):
    """A validated `plan.toml`; all of it has a default but `wavelengths` and one of `sweeps`, `positions` and
    `source`.
    """

    title: str = "Goniospectrophotometer scan"
    polarization: Annotated[
        tuple[Polarization, ...], BeforeValidator(a_list("'s' and 'p'", '["s", "p"]'))
    ] = ("s", "p")
    overlap_nm: Annotated[NotNegative, Field(le=MAX_OVERLAP_NM)] = 0.0
    sample: Sample = Sample()
    wavelengths: Annotated[tuple[WavelengthRange, ...], BeforeValidator(a_list("tables", "[[wavelengths]]"))]
    sweeps: Annotated[tuple[Sweep, ...], BeforeValidator(a_list("tables", "[[sweeps]]"))] = ()
    positions_listed: Annotated[
        tuple[PositionList, ...], BeforeValidator(a_list("tables", "[[positions]]"))
    ] = Field(default=(), alias="positions")
    reading: Reading = Reading()
    references: References = References()
    source: Source | None = None
    order: Order = Order()
    repeats: Repeats = Repeats()

    @field_validator("polarization")
    @classmethod
    def _each_once(cls, value: tuple[Polarization, ...]) -> tuple[str, ...]:
        return once(value, "polarizations")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.wavelengths:
            raise ValueError("wavelengths is empty; add at least one [[wavelengths]] table")
        if not self.sweeps and not self.positions_listed and self.source is None:
            raise ValueError("sweeps is missing; add at least one [[sweeps]] or [[positions]] table")
        self._refuse_disorder()
        n_positions = self.n_positions
        if n_positions > MAX_POSITIONS:
            raise ValueError(
                f"sweeps: {n_positions} positions are more than {MAX_POSITIONS}; take larger steps or divide "
                "the plan"
            )
        per_pass = sum(
            len(entry.values()) * (entry.averages or self.reading.averages) for entry in self.wavelengths
        )
        if n_positions * per_pass > MAX_READINGS:
            m = len(self.wavelength_nm)
            raise ValueError(
                f"{n_positions} positions x {m} wavelengths with up to "
                f"{max(entry.averages or self.reading.averages for entry in self.wavelengths)} averages are "
                f"{n_positions * per_pass} readings, more than {MAX_READINGS}; divide the plan"
            )
        self._refuse_repeated_positions()
        return self

    def _refuse_disorder(self) -> None:
        wavelength_nm = self.wavelength_nm
        step = np.diff(wavelength_nm)
        if not np.any(step <= 0):
            return
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

    def _refuse_repeated_positions(self) -> None:
        seen: dict[Place, str] = {}
        for where, place in self._places_as_written():
            if place in seen:
                raise ValueError(
                    f"{where}: theta_i = {place.theta_i_deg:g} deg, theta_mes = {place.theta_mes_deg:g} "
                    f"deg is already in {seen[place]}; list each position once, and use [repeats] count to "
                    "measure it several times"
                )
            if place.polarization not in self.polarization:
                raise ValueError(
                    f"{where}: polarization '{place.polarization}' is not in the plan's polarization = "
                    f"{list(self.polarization)}, for which baselines are measured; add it there"
                )
            seen[place] = where

    def _places_as_written(self) -> Iterator[tuple[str, Place]]:
        """Yield every position once, in the order written, and where it is written."""
        for number, sweep in enumerate(self.sweeps, start=1):
            theta_mes_deg = sweep.theta_mes_deg.values_deg().tolist()
            for polarization in self.polarization:
                for theta_mes in theta_mes_deg:
                    yield f"sweeps[{number}]", Place(sweep.theta_i_deg, theta_mes, polarization)
        for number, entry in enumerate(self.positions_listed, start=1):
            angles = list(zip(entry.theta_i_deg, entry.theta_mes_deg, strict=True))
            given = entry.polarization
            passes = [given] if given is not None else [(each,) * len(angles) for each in self.polarization]
            for polarizations in passes:
                for row, (pair, polarization) in enumerate(zip(angles, polarizations, strict=True), start=1):
                    yield f"positions[{number}] row {row}", Place(*pair, polarization)

    @property
    def wavelength_nm(self) -> FloatArray:
        """The wavelengths that are asked for, (m,) float64, ascending.

        With `overlap_nm` a rig measures some of them with two detectors: see `gonio.plan.channels`.
        """
        return np.concatenate([entry.values() for entry in self.wavelengths])

    @property
    def n_positions(self) -> int:
        """Number of positions, all polarizations and repeats counted."""
        each = len(self.polarization)
        once_each = sum(len(sweep.theta_mes_deg.values_deg()) for sweep in self.sweeps) * each + sum(
            len(entry.theta_i_deg) * (each if entry.polarization is None else 1)
            for entry in self.positions_listed
        )
        return once_each * self.repeats.count

    def positions(self) -> tuple[Position, ...]:
        """Return every position in measuring order."""
        places = arrange(
            [place for _, place in self._places_as_written()],
            self.order, repeats=self.repeats.count, of=self.repeats.of,
        )  # fmt: skip
        return tuple(Position(index, *place) for index, place in enumerate(places))

    def to_toml(self) -> str:
        """Return the plan as the text of a `plan.toml` that `parse_plan` reads back equal."""
        tables = self.model_dump(exclude_none=True, by_alias=True)
        for sweep in tables["sweeps"]:
            angles = sweep["theta_mes_deg"]
            sweep["theta_mes_deg"] = angles.get("values", angles)
        for key in ("sweeps", "positions"):
            if not tables[key]:
                del tables[key]
        return tomli_w.dumps(tables)

    @classmethod
    def paper(cls) -> Plan:
        """Return the plan of the paper's HPL measurement: 146 positions, S and P, 121 wavelengths."""
        text = resources.files("gonio").joinpath("data/hpl.toml").read_text(encoding="utf-8")
        return parse_plan(text, source="hpl.toml (built in)")


def load_plan(path: str | Path) -> Plan:
    """Return the validated plan file with the position lists it names; `ConfigError` lists every mistake."""
    path = Path(path)
    return validate(Plan, with_files(read_toml(path), path.absolute().parent), source=str(path))


def parse_plan(text: str, *, source: str = "plan.toml") -> Plan:
    """Return validated plan text; `ConfigError` lists every mistake, `source` names the text."""
    return validate(Plan, parse_toml(text, source=source), source=source)

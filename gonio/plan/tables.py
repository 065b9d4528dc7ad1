"""The tables of a plan file: what each key is called, which values it may have, and what is wrong with
others.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from gonio.config import Count, Number, Positive, Strict
from gonio.devices import FloatArray, Polarization
from gonio.plan.grid import MAX_VALUES, explain_grid, grid_values

When = Literal["start", "end"]
Kind = Literal["dark", "baseline"]
Axis = Literal["theta_i", "polarization", "theta_mes"]

DEFAULT_NESTING: tuple[Axis, Axis, Axis] = ("theta_i", "polarization", "theta_mes")
"""Outermost first: an incidence is complete before the sample turns, and the polarizer turns once in it."""

_OUT_OF_PLANE = frozenset({"phi_o_deg", "phi_i_deg", "phi_deg", "azimuth_deg", "azimuth_o_deg"})


def refuse_out_of_plane(keys: Mapping[str, Any] | list[str]) -> None:
    """Raise `ValueError` if something is asked for outside the plane of incidence."""
    for key in keys:
        if key in _OUT_OF_PLANE:
            raise ValueError(
                f"{key} asks for a direction outside the plane of incidence, which this instrument "
                "cannot measure: its two axes turn the sample (theta_i_deg) and the detector arm "
                "(theta_mes_deg) in one plane, phi_o = 0 deg on the specular side (theta_mes > theta_i) "
                f"and 180 deg on the other (theta_mes < theta_i); leave {key} out and give theta_i_deg and "
                "theta_mes_deg"
            )


def a_list(what: str, example: str) -> Callable[[Any], Any]:
    """Make a validator that asks for a list in a TOML user's words, not in Python's."""

    def check_list(value: Any) -> Any:
        if value is not None and not isinstance(value, list | tuple):
            raise ValueError(f"must be a list of {what}, such as {example}")
        return value

    return check_list


def once(values: tuple[str, ...], what: str) -> tuple[str, ...]:
    """Return the values if there is at least one and none is listed twice."""
    if not values:
        raise ValueError(f"the list of {what} is empty; give at least one")
    repeated = [value for value, count in Counter(values).items() if count > 1]
    if repeated:
        raise ValueError(f"'{repeated[0]}' is listed twice; remove one")
    return values


def _incidence(value: float) -> float:
    if not -90.0 < value < 90.0:
        raise ValueError("is no incidence on the sample's front; give an angle between -90 and 90 deg")
    return value


class PlanTable(Strict):
    """Base of the plan's tables."""

    @model_validator(mode="before")
    @classmethod
    def _in_plane(cls, value: Any) -> Any:
        if isinstance(value, dict):
            refuse_out_of_plane(value)
        return value


class Sample(PlanTable):
    """What lies in the sample holder."""

    name: str = "unnamed"
    description: str = ""


class Source(PlanTable):
    """Who chooses the positions: ``python`` for the script that runs the scan, or the name of an entry point
    of the group ``gonio.sources``.
    """

    name: Annotated[str, Field(min_length=1)]


class WavelengthRange(PlanTable):
    """Wavelengths from `start_nm` to `stop_nm` inclusive, or a list, and how long each is measured.

    `averages` readings are averaged, or as many as it takes to average over `integration_s`; without either
    those of ``[reading]``.
    """

    start_nm: Positive | None = None
    stop_nm: Positive | None = None
    step_nm: Number | None = None
    values_nm: Annotated[
        tuple[Positive, ...] | None, BeforeValidator(a_list("wavelengths", "[550.0, 560.0]"))
    ] = None
    averages: Count | None = None
    integration_s: Positive | None = None

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        problem = explain_grid(
            self.values_nm, self.start_nm, self.stop_nm, self.step_nm,
            what="wavelength", unit="nm", suffix="_nm",
        )  # fmt: skip
        if problem:
            raise ValueError(problem)
        if self.averages is not None and self.integration_s is not None:
            raise ValueError(_ONE_OF_BOTH)
        return self

    def values(self) -> FloatArray:
        """Return the wavelengths in nm, (k,) float64."""
        return grid_values(self.values_nm, self.start_nm, self.stop_nm, self.step_nm)


_ONE_OF_BOTH = (
    "give either averages (a number of readings) or integration_s (a time that they fill), not both"
)


class Angles(PlanTable):
    """Angles from `start` to `stop` inclusive, degrees; a plain list stands for `values`."""

    start: Number | None = None
    stop: Number | None = None
    step: Number | None = None
    values: Annotated[tuple[Number, ...] | None, BeforeValidator(a_list("angles", "[15.0, 18.0]"))] = None

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


class Sweep(PlanTable):
    """The detector angles at one incidence."""

    theta_i_deg: Number
    theta_mes_deg: Angles

    @field_validator("theta_i_deg")
    @classmethod
    def _above_the_surface(cls, value: float) -> float:
        return _incidence(value)


class PositionList(PlanTable):
    """Positions one by one, as columns of equal length.

    `file` names a CSV file with these columns beside the plan; `load_plan` replaces it by what it holds, and
    `copied_from` then says where the columns came from.  Without `polarization` each is measured in every
    polarization of the plan.
    """

    file: str | None = None
    copied_from: str | None = None
    theta_i_deg: Annotated[tuple[Number, ...], BeforeValidator(a_list("angles", "[20.0, 30.0]"))] = ()
    theta_mes_deg: Annotated[tuple[Number, ...], BeforeValidator(a_list("angles", "[40.0, 60.0]"))] = ()
    polarization: Annotated[
        tuple[Polarization, ...] | None, BeforeValidator(a_list("'s' and 'p'", '["s", "p"]'))
    ] = None

    @field_validator("theta_i_deg")
    @classmethod
    def _above_the_surface(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        for row, angle in enumerate(value, start=1):
            try:
                _incidence(angle)
            except ValueError as error:
                raise ValueError(f"theta_i_deg[{row}] = {angle:g} deg {error}") from None
        return value

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        columns = {"theta_i_deg": self.theta_i_deg, "theta_mes_deg": self.theta_mes_deg}
        if self.file is not None:
            if any(columns.values()) or self.polarization is not None:
                raise ValueError(f"give either file = '{self.file}' or the columns themselves, not both")
            raise ValueError(
                f"file = '{self.file}' is read only when the plan itself is read from a file; load it with "
                "load_plan (or positions_from_csv in Python), or write the columns theta_i_deg and "
                "theta_mes_deg out"
            )
        lengths = {name: len(column) for name, column in columns.items()}
        if self.polarization is not None:
            lengths["polarization"] = len(self.polarization)
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {count}" for name, count in lengths.items())
            raise ValueError(f"the columns have different lengths ({listed}); give one value per position")
        if not self.theta_i_deg:
            raise ValueError("lists no position; give theta_i_deg and theta_mes_deg, or file")
        if len(self.theta_i_deg) > MAX_VALUES * 10:
            raise ValueError(
                f"lists {len(self.theta_i_deg)} positions, more than {MAX_VALUES * 10}; divide it"
            )
        return self


class Reading(PlanTable):
    """How often each reading is repeated and averaged, where a wavelength range says nothing else."""

    averages: Count = 1
    integration_s: Positive | None = None  # in its place: as many readings as fill this time

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if self.integration_s is not None and "averages" in self.model_fields_set and self.averages != 1:
            raise ValueError(_ONE_OF_BOTH)
        return self


class References(PlanTable):
    """When the dark signal and the direct beam (100 %) are measured, and how often each reading is repeated.

    With `averages` = 1 nothing is known of the noise, and no uncertainty can be stored beside `r`.  The
    error of the dark reading is common to all positions, and a white panel gives r = 1 %: a dark reading
    deserves more averages than the strong direct beam.  Between start and end, the kinds in `periodic` are
    measured again after `every_minutes` of instrument time or `every_positions` positions.
    """

    dark: Annotated[tuple[When, ...], BeforeValidator(a_list("'start' and 'end'", '["start", "end"]'))] = (
        "start",
        "end",
    )
    baseline: Annotated[
        tuple[When, ...], BeforeValidator(a_list("'start' and 'end'", '["start", "end"]'))
    ] = ("start", "end")
    averages: Count = 4
    dark_averages: Count | None = None  # like `averages` if not given
    every_minutes: Positive | None = None
    every_positions: Count | None = None
    periodic: Annotated[
        tuple[Kind, ...] | None, BeforeValidator(a_list("'dark' and 'baseline'", '["baseline"]'))
    ] = None  # both if not given

    def averages_of(self, kind: Kind) -> int:
        """Return how many readings are averaged for a dark or a baseline."""
        return self.dark_averages or self.averages if kind == "dark" else self.averages

    @property
    def periodic_kinds(self) -> tuple[Kind, ...]:
        """What is measured again between start and end; empty without a period."""
        if self.every_minutes is None and self.every_positions is None:
            return ()
        return ("dark", "baseline") if self.periodic is None else self.periodic

    @field_validator("dark", "baseline")
    @classmethod
    def _at_least_once(cls, value: tuple[When, ...]) -> tuple[str, ...]:
        return once(value, "times (r needs a dark and a baseline reading)")

    @field_validator("periodic")
    @classmethod
    def _each_once(cls, value: tuple[Kind, ...] | None) -> tuple[str, ...] | None:
        return None if value is None else once(value, "periodic references")

    @model_validator(mode="after")
    def _one_period(self) -> Self:
        if self.every_minutes is not None and self.every_positions is not None:
            raise ValueError("give either every_minutes or every_positions, not both")
        if self.periodic is not None and not self.periodic_kinds:
            raise ValueError("periodic says what is measured again, but not when; add every_minutes or "
                             "every_positions")  # fmt: skip
        return self


class Order(PlanTable):
    """In which order the positions are measured; see `gonio.plan.order`."""

    kind: Literal["as_written", "nested", "serpentine", "random", "optimised"] = "as_written"
    nesting: Annotated[
        tuple[Axis, ...] | None,
        BeforeValidator(a_list("axes, the slowest first", '["theta_i", "polarization", "theta_mes"]')),
    ] = None
    descending: bool | None = None  # the detector angles fall: nested only, and serpentine's first sweep
    seed: Annotated[int, Field(strict=True, ge=0, le=2**63 - 1)] | None = None
    alternate_wavelengths: Annotated[bool, Field(strict=True)] = False  # every second pass runs backwards

    @model_validator(mode="before")
    @classmethod
    def _seeded(cls, value: Any) -> Any:
        # a random order must come out the same when the scan is resumed: the seed is part of the plan
        if isinstance(value, dict) and value.get("kind") == "random" and value.get("seed") is None:
            return {**value, "seed": 0}
        return value

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Self:
        for key in ("nesting", "descending"):
            if getattr(self, key) is not None and self.kind not in ("nested", "serpentine"):
                raise ValueError(f"{key} has no meaning with kind = '{self.kind}'; it needs 'nested' or "
                                 "'serpentine'")  # fmt: skip
        if self.seed is not None and self.kind != "random":
            raise ValueError(f"seed has no meaning with kind = '{self.kind}'; it needs 'random'")
        if self.nesting is not None and sorted(self.nesting) != sorted(DEFAULT_NESTING):
            raise ValueError(
                "nesting must name theta_i, polarization and theta_mes once each, the slowest first"
            )
        return self


class Repeats(PlanTable):
    """How often everything is measured: the whole plan again and again, or each position several times."""

    count: Count = 1
    of: Literal["plan", "position"] = "plan"

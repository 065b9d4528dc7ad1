"""Read the TOML files a user writes and turn every mistake into one clear message.

The schema of each file is a pydantic model derived from `Strict`: unknown keys are refused (with the nearest
known key as a suggestion), numbers must be numbers (no ``"20"``, no ``true``, no ``nan``), and units are
part of the names.
"""

from __future__ import annotations

import difflib
import inspect
import tomllib
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gonio.errors import ConfigError

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
Count = Annotated[int, Field(strict=True, ge=1)]


class Strict(BaseModel):
    """Base of every table in a user's file: immutable, unknown keys refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; `ConfigError` names the line of a syntax error."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path}: there is no such file; check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from None
    return parse_toml(text, source=str(path))


def parse_toml(text: str, *, source: str) -> dict[str, Any]:
    """Return the tables of TOML text; `source` names it in messages."""
    try:
        return tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, and a number of thousands of digits
        raise ConfigError(f"{source}: is not valid TOML: {error}; correct that line") from None
    except RecursionError:
        raise ConfigError(f"{source}: is not valid TOML: nested a thousand deep; correct it") from None


def validate(model: type[Model], table: Mapping[str, Any], *, source: str, prefix: str = "") -> Model:
    """Return `table` as a `model`; `ConfigError` lists every mistake, one line each."""
    try:
        return model.model_validate(dict(table))
    except ValidationError as error:
        lines = [_explain(model, table, dict(item), prefix) for item in error.errors()]
        raise ConfigError("\n".join(f"{source}: {line}" for line in lines)) from None


def _explain(model: type[BaseModel], table: Mapping[str, Any], item: dict[str, Any], prefix: str) -> str:
    loc: tuple[int | str, ...] = item["loc"]
    where = dotted((prefix, *loc) if prefix else loc)
    kind, message = item["type"], item["msg"]
    if kind == "extra_forbidden":
        known = _known_keys(model, loc[:-1])
        near = difflib.get_close_matches(str(loc[-1]), known, n=1, cutoff=0.5)
        hint = f"did you mean '{near[0]}'? " if near else ""
        return f"{where} is an unknown key; {hint}known keys here: {', '.join(sorted(known))}"
    if kind == "missing":
        return f"{where} is missing; add it"
    message = message.removeprefix("Value error, ")
    value = item.get("input")
    shown = f" = {value!r}" if isinstance(value, str | int | float | bool) else ""
    return f"{where}{shown}: {message[0].lower()}{message[1:]}" if where else message


def dotted(loc: tuple[int | str, ...]) -> str:
    """Return ``("sweeps", 1, "theta_i_deg")`` as ``sweeps[2].theta_i_deg`` (entries are counted from one)."""
    text = ""
    for part in loc:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        else:
            text += f".{part}" if text else part
    return text


def _known_keys(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Keys of the nested model that `loc` leads to."""
    current: type[BaseModel] = model
    for part in loc:
        if isinstance(part, int):
            continue
        field = next((f for name, f in current.model_fields.items() if part in (name, f.alias)), None)
        found = _model_in(field.annotation) if field is not None else None
        if found is None:
            continue  # a tag of a union, or a mapping's key
        current = found
    return [field.alias or name for name, field in current.model_fields.items()]


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return annotation
    for inner in typing.get_args(annotation):
        found = _model_in(inner)
        if found is not None:
            return found
    return None

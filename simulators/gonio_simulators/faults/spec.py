"""What a fault specification says: ``NAME[@TARGET]:WHEN[:KEY=VALUE...]``.

``late-reply:0.01``, ``stall@theta_mes:nth=3``, ``lamp-drift:at=120:size=-0.05``.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from gonio.errors import ConfigError
from gonio_simulators.faults.catalogue import CATALOGUE, Key, Kind, Value

Mode = Literal["probability", "nth", "every", "at", "rate"]

COUNTS, TIMES = ("nth", "every"), ("at", "rate")

_FORM = "write NAME[@TARGET]:WHEN[:KEY=VALUE...], for example late-reply:0.01 or stall@theta_mes:nth=3"
_WHEN = "WHEN is a probability 0...1, nth=K, every=K, at=T (bench seconds) or rate=R (per bench hour)"


@dataclass(frozen=True, slots=True)
class When:
    """Probability per opportunity, the K-th opportunity, every K-th, a bench time, or a rate per hour."""

    mode: Mode
    value: float


@dataclass(frozen=True, slots=True)
class FaultSpec:
    """One specification, checked against the catalogue; `target` is None for everywhere it applies."""

    kind: Kind
    target: str | None
    when: When
    options: Mapping[str, Value]
    text: str


def parse_fault(text: str) -> FaultSpec:
    """Return what a specification says.

    Raises
    ------
    ConfigError
        Unknown name or key, malformed or impossible number; the message lists what there is.
    """
    head, *fields = [part.strip() for part in text.split(":")]
    name, at, target = head.partition("@")
    kind = CATALOGUE.get(name)
    if kind is None:
        raise ConfigError(f"fault '{text}': there is no fault '{name}'; {suggest(name, CATALOGUE)}")
    if at and not target:
        raise ConfigError(f"fault '{text}': the target after '@' is missing; name it, or leave '@' out")
    if not fields:
        raise ConfigError(f"fault '{text}': WHEN is missing; {_WHEN}")
    options: dict[str, Value] = {name: key.default for name, key in kind.keys.items()}
    for field in fields[1:]:
        key_name, equals, value = field.partition("=")
        key = kind.keys.get(key_name)
        if not equals:
            raise ConfigError(f"fault '{text}': '{field}' is not KEY=VALUE; {_FORM}")
        if key is None:
            known = suggest(key_name, kind.keys) if kind.keys else f"{name} has no keys"
            raise ConfigError(f"fault '{text}': {name} has no key '{key_name}'; {known}")
        options[key_name] = _value(text, key_name, key, value)
    return FaultSpec(kind, target or None, _when(text, fields[0]), options, text)


def suggest(word: str, known: Iterable[str]) -> str:
    """Return ``did you mean 'x'? there are: ...``."""
    names = list(known)
    near = difflib.get_close_matches(word, names, n=1, cutoff=0.5)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"{hint}there are: {', '.join(names)}"


def _when(text: str, field: str) -> When:
    name, equals, value = field.partition("=")
    if not equals:
        number = _number(text, "the probability", field)
        if not 0 <= number <= 1:
            raise ConfigError(f"fault '{text}': the probability {field} is outside 0...1; {_WHEN}")
        return When("probability", number)
    if name in COUNTS:
        if not (value.isascii() and value.isdigit() and int(value) >= 1):
            raise ConfigError(
                f"fault '{text}': {name} = {value} is not a whole number from 1 on; {name}=3 counts "
                "opportunities"
            )
        return When("nth" if name == "nth" else "every", float(value))
    if name in TIMES:
        number = _number(text, name, value)
        if number < 0:
            raise ConfigError(f"fault '{text}': {name} = {value} is below 0; {_WHEN}")
        return When("at" if name == "at" else "rate", number)
    raise ConfigError(f"fault '{text}': '{field}' does not say when; {_WHEN}")


def _value(text: str, name: str, key: Key, value: str) -> Value:
    if isinstance(key.default, bool):
        if value not in ("true", "false"):
            raise ConfigError(f"fault '{text}': {name} = {value} is neither true nor false; write one")
        return value == "true"
    if isinstance(key.default, str):
        if value not in key.choices:
            raise ConfigError(f"fault '{text}': {name} = {value} is unknown; {suggest(value, key.choices)}")
        return value
    number = _number(text, name, value)
    if not key.low <= number <= key.high:
        raise ConfigError(
            f"fault '{text}': {name} = {value} is outside {key.low:g}...{key.high:g}; choose one between"
        )
    if isinstance(key.default, int):
        if number != int(number):
            raise ConfigError(f"fault '{text}': {name} = {value} must be a whole number; correct it")
        return int(number)
    return number


def _number(text: str, name: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"fault '{text}': {name} = '{value}' is not a number; {_FORM}")
    return number

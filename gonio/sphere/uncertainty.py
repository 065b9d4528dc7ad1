"""What does the user say of the sphere's uncertainty?  A number, of what, and with which coverage.

    1 % relative, k=2        U = 1 % of the value
    1 % absolute, k=1        u = 0.01 in reflectance, one of a hundred percent of R
    0.005 absolute, 95 %     U = 0.005 in reflectance
    column k_g_u, k=1        a column of the CSV file, in its unit

"1 %" alone, as the paper gives it, means four different things; it is refused with the four numbers.
A level of 95 % without k is taken as k = 2, as certificates do (1.96 for a normal distribution).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigError

FloatArray = NDArray[np.float64]
Kind = Literal["relative", "absolute", "column"]

OPTION = "--sphere-u"
COVERAGE = 2.0
"""Coverage factor of everything that is called expanded."""
_LARGEST_COVERAGE = 10.0
_LARGEST = 1.0
_LONGEST = 200

_KINDS = {"relative": "relative", "rel": "relative", "absolute": "absolute", "abs": "absolute"}
_NUMBER = r"(?:\d+(?:[.,]\d+)?|[.,]\d+)(?:e[+-]?\d+)?"
_COVERAGE = re.compile(rf"\bk\s*=\s*({_NUMBER})")
_LEVEL = re.compile(
    rf"(?:\b(?:level|confidence|coverage|probability)(?:\s+of)?\s*[:=]?\s*)?\b({_NUMBER})\s*%\s*"
    r"(?:level|confidence|coverage|probability|interval|ci)?(?:\s+level|\s+interval)?\s*$"
)
_AMOUNT = re.compile(
    rf"^\s*(?:u\s*=\s*)?(?:±|\+/-|\+-)?\s*({_NUMBER})\s*(%\s*r\b|%|percent\b|percentage\s+points?\b|pp\b)?"
)
_FILLING = re.compile(
    r"\b(?:relative|rel|absolute|abs|expanded|standard|uncertainty|of|the|value|in|reflectance|r)\b"
    r"|[\s,;.()%±]"
)
_COLUMN = re.compile(r"^\s*column\s+(.+?)\s*$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class SphereUncertainty:
    """A stated uncertainty: `value` relative, or in reflectance as a fraction, or of a column of the file."""

    kind: Kind
    value: float
    coverage: float
    text: str
    column: str = ""

    def standard(
        self, reflectance: FloatArray, columns: Mapping[str, FloatArray] | None = None, factor: float = 1.0
    ) -> FloatArray:
        """Return the standard uncertainty (coverage factor 1) in reflectance, (k,).

        `columns` are those of the file, `factor` turns them into a fraction.  `ConfigError` if the column is
        missing or holds no uncertainty somewhere.
        """
        if self.kind == "relative":
            return self.value / self.coverage * np.abs(reflectance)
        if self.kind == "absolute":
            return np.full(reflectance.shape, self.value / self.coverage)
        values = (columns or {}).get(self.column)
        if values is None:
            have = ", ".join(columns or {}) or "none beside wavelength and reflectance"
            raise ConfigError(
                f"{OPTION} '{self.text}': the file has no column '{self.column}'; it has {have}"
            )
        if not np.all(np.isfinite(values) & (values > 0.0)):
            raise ConfigError(
                f"{OPTION} '{self.text}': the column '{self.column}' is empty or not positive at "
                f"{np.count_nonzero(~(np.isfinite(values) & (values > 0.0)))} of {values.size} wavelengths; "
                "fill it"
            )
        return np.asarray(values * factor / self.coverage)

    def describe(self) -> str:
        """Return the statement in full."""
        if self.kind == "column":
            return f"column {self.column} of the file, k = {self.coverage:g}"
        if self.kind == "relative":
            return f"{100 * self.value:g} % relative, k = {self.coverage:g}"
        return f"{100 * self.value:g} %R absolute ({self.value:g} in reflectance), k = {self.coverage:g}"


def parse_uncertainty(text: str, reflectance: FloatArray | None = None) -> SphereUncertainty:
    """Return what a statement says.

    Parameters
    ----------
    text
        As in the module's examples.
    reflectance
        The spectrum, (k,), for the numbers that an ambiguous statement could mean.

    Raises
    ------
    ConfigError
        The statement leaves something open, contradicts itself, or is none; with what it could mean.
    """
    if len(text) > _LONGEST:
        raise ConfigError(f"{OPTION}: {len(text)} characters state no uncertainty; write '1 % relative, k=2'")
    rest = text.strip().lower()
    coverage, rest = _coverage(text, rest)
    kinds = {_KINDS[word] for word in re.findall(r"[a-z]+", rest) if word in _KINDS}
    if len(kinds) > 1:
        raise ConfigError(f"{OPTION} '{text}': says relative and absolute; say one of them")
    kind = kinds.pop() if kinds else None

    named = _COLUMN.match(_without_coverage(text))
    if named is not None:
        if coverage is None:
            raise ConfigError(
                f"{OPTION} '{text}': with which coverage? write k=1 for standard uncertainties, k=2 for "
                "expanded ones"
            )
        return SphereUncertainty("column", 1.0, coverage, text.strip(), named.group(1).rstrip(", ;"))

    amount = _AMOUNT.match(rest)
    if amount is None:
        raise ConfigError(
            f"{OPTION} '{text}': begins with no number; write it like '1 % relative, k=2' or "
            "'0.005 absolute, k=1'"
        )
    value = float(amount.group(1).replace(",", "."))
    unit = amount.group(2) or ""
    value = value / 100.0 if unit else value
    if kind == "relative" and unit not in ("", "%", "percent"):
        raise ConfigError(
            f"{OPTION} '{text}': '{unit}' is a part of the reflectance itself, and so absolute; write "
            f"'{100 * value:g} % relative' or '{100 * value:g} % absolute'"
        )
    left = _FILLING.sub("", rest[amount.end() :])
    if left:
        raise ConfigError(f"{OPTION} '{text}': '{left}' is not understood; write it like '1 % relative, k=2'")
    if coverage is None and re.search(r"\bstandard\b", rest):
        coverage = 1.0
    if kind is None or coverage is None:
        raise ConfigError(_readings(text, value, kind, coverage, reflectance))
    if not 0.0 < value <= _LARGEST:
        raise ConfigError(
            f"{OPTION} '{text}': {value:g} is no uncertainty of a reflectance; give more than 0 and at most "
            "1 (100 %)"
        )
    return SphereUncertainty("relative" if kind == "relative" else "absolute", value, coverage, text.strip())


def _coverage(text: str, rest: str) -> tuple[float | None, str]:
    """Return the coverage factor, None if none is said, and the statement without it."""
    found = _COVERAGE.findall(rest)
    rest = _COVERAGE.sub("", rest).strip(" ,;")
    factor = None
    if len({float(f.replace(",", ".")) for f in found}) > 1:
        raise ConfigError(f"{OPTION} '{text}': says two coverage factors; say one of them")
    if found:
        factor = float(found[0].replace(",", "."))
        if not 0.0 < factor <= _LARGEST_COVERAGE:
            raise ConfigError(
                f"{OPTION} '{text}': k = {factor:g} is no coverage factor; give 1 for a standard "
                "uncertainty, 2 for an expanded one"
            )
    level = _LEVEL.search(rest)
    if level is not None and level.start() > 0:  # at the start it is the number itself
        percent = float(level.group(1).replace(",", "."))
        if not 94.0 < percent < 96.0:
            raise ConfigError(
                f"{OPTION} '{text}': a level of {percent:g} % is not known here; state the coverage factor, "
                "such as k=2"
            )
        rest = rest[: level.start()].rstrip(" ,;")
        if factor is None:
            factor = COVERAGE
        elif not 1.9 <= factor <= 2.1:
            raise ConfigError(
                f"{OPTION} '{text}': k = {factor:g} and {percent:g} % contradict each other; say one of them"
            )
    return factor, rest


def _without_coverage(text: str) -> str:
    """Return a statement without its coverage, its letters as they were written."""
    return re.sub(_COVERAGE.pattern, "", text, flags=re.IGNORECASE).strip(" ,;")


def _readings(
    text: str, value: float, kind: str | None, coverage: float | None, reflectance: FloatArray | None
) -> str:
    """Return what an ambiguous statement could mean, in numbers for this spectrum."""
    kinds = ("relative", "absolute") if kind is None else (kind,)
    factors = (1.0, 2.0) if coverage is None else (coverage,)
    open_ = [what for what, is_open in (
        ("relative or absolute", kind is None), ("with which coverage", coverage is None)
    ) if is_open]  # fmt: skip
    level = 0.5 if reflectance is None or not reflectance.size else float(np.mean(reflectance))
    where = "a reflectance" if reflectance is None else "this spectrum's mean reflectance"
    lines = [f"{OPTION} '{text}': {' and '.join(open_)}? At {where} of {level:.4g} it could mean"]
    for word in kinds:
        for factor in factors:
            expanded = COVERAGE / factor * value * (abs(level) if word == "relative" else 1.0)
            lines.append(f"  '{100 * value:g} % {word}, k={factor:g}':  {level:.4g} ± {expanded:.4g} at 95 %")
    lines.append("write the one that the sphere's certificate or manual means")
    return "\n".join(lines)

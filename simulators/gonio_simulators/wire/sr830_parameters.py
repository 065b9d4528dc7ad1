"""What an SR830 takes as parameters: its ranges, defaults and number forms."""

from __future__ import annotations

import math
from dataclasses import dataclass

SENSITIVITY_V = tuple(m * 10.0**e for e in range(-9, 1) for m in (1, 2, 5))[1:28]
"""Full scale by the index of SENS: 2 nV (0) to 1 V (26)."""

TIME_CONSTANT_S = tuple(m * 10.0**e for e in range(-5, 5) for m in (1, 3))
"""Time constant by the index of OFLT: 10 us (0) to 30 ks (19)."""


class Illegal(Exception):
    """No such command, or not in this form."""


class OutOfRange(Exception):
    """A parameter the instrument does not take."""


@dataclass(frozen=True, slots=True)
class Choice:
    """An integer setting with its default and its range."""

    default: int
    low: int
    high: int


# Defaults are the standard settings of the manual, which *RST restores.
CHOICES = {
    "FMOD": Choice(1, 0, 1),  # 0: external reference, the chopper
    "RSLP": Choice(0, 0, 2),
    "HARM": Choice(1, 1, 19999),
    "ISRC": Choice(0, 0, 3),
    "IGND": Choice(0, 0, 1),
    "ICPL": Choice(0, 0, 1),
    "ILIN": Choice(0, 0, 3),
    "SENS": Choice(26, 0, 26),
    "RMOD": Choice(2, 0, 2),
    "OFLT": Choice(8, 0, 19),
    "OFSL": Choice(1, 0, 3),
    "SYNC": Choice(0, 0, 1),
    "OUTX": Choice(0, 0, 1),  # 0: answers go to RS-232
    "LOCL": Choice(0, 0, 2),
    "OVRM": Choice(1, 0, 1),
    "KCLK": Choice(1, 0, 1),
    "ALRM": Choice(1, 0, 1),
    "SRAT": Choice(4, 0, 14),
    "SEND": Choice(1, 0, 1),
    "TSTR": Choice(0, 0, 1),
    "FAST": Choice(0, 0, 2),  # a transfer of its own on GPIB only
    "*PSC": Choice(1, 0, 1),
}


def whole(text: str) -> int:
    """Return a whole number, which the instrument also takes as ``4.000``."""
    value = numbers([text])[0]
    if value != int(value):
        raise OutOfRange
    return int(value)


def numbers(texts: list[str]) -> list[float]:
    """Return finite numbers."""
    try:
        values = [float(t) for t in texts]
    except ValueError:
        raise Illegal from None
    if not all(math.isfinite(v) for v in values):
        raise Illegal
    return values


def wholes(texts: list[str]) -> list[int]:
    """Return several whole numbers."""
    return [whole(text) for text in texts]


def number(parameters: list[str], low: float, high: float) -> float:
    """Return the only parameter, a number within a range."""
    if len(parameters) != 1:
        raise Illegal
    value = numbers(parameters)[0]
    if not low <= value <= high:
        raise OutOfRange
    return value


def item_of(parameters: list[str], count: int, low: int, high: int) -> int:
    """Check the number of parameters and return the first, which names an item."""
    if len(parameters) != count:
        raise Illegal
    item = whole(parameters[0])
    if not low <= item <= high:
        raise OutOfRange
    return item

"""What does the ordinate of a spectrum say it is: reflectance, and in percent or as a fraction?

Nothing is guessed from the values: 0.9 may be a fraction of white or the percentage of a black.  What the
label leaves open, the user states (`STATED`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from gonio.errors import StoreError

Quantity = Literal["reflectance", "transmittance", "absorbance", "unknown"]

STATED = {"%R": 0.01, "R": 1.0}
"""What a user may state: reflectance in percent, or as a fraction; with the factor to a fraction."""
OPTION = "--sphere-reads"

_PERCENT = re.compile(r"%|percent|prozent|pour ?cent|(?<![a-z])pct(?![a-z])")
_FRACTION = re.compile(
    r"\[\s*[1-]\s*\]\s*$|\(\s*-\s*\)\s*$|/\s*1\s*$|fraction|(?<![0-9])0\s*(?:\.\.\.?|-|to)\s*1(?![0-9])"
)  # not "(1)", which counts samples
_WORDS: dict[str, Quantity] = {
    "r": "reflectance", "rho": "reflectance", "t": "transmittance", "tau": "transmittance", "a": "absorbance",
    "od": "absorbance", "kubelka": "absorbance",
}  # fmt: skip
_STEMS: dict[str, Quantity] = {
    "refl": "reflectance", "réfl": "reflectance", "trans": "transmittance", "absorb": "absorbance",
    "extin": "absorbance", "abs": "absorbance",
}  # fmt: skip
_OURS = {"k_g", "k_d"}
"""Columns of gonio's own files: ratios, by the rule that a name without unit is one."""


@dataclass(frozen=True, slots=True)
class Ordinate:
    """What a label says: `factor` turns the values into a fraction, None where percent or not is open."""

    label: str
    quantity: Quantity
    factor: float | None


def ordinate_of(label: str) -> Ordinate:
    """Return what a label says, such as ``%R``, ``Reflectance (%)``, ``k_g`` or ``A``."""
    text = label.strip().lower()
    if text in _OURS:
        return Ordinate(label, "reflectance", 1.0)
    factor = 0.01 if _PERCENT.search(text) else 1.0 if _FRACTION.search(text) else None
    if "log" in text:  # log(1/R) names R, but is none
        return Ordinate(label, "absorbance", factor)
    marked = re.search(r"%\s*([rta])(?![a-zé])", text)
    words = [marked.group(1)] if marked else re.findall(r"[a-zé]+", _PERCENT.sub(" ", text))
    kinds = {kind for word in words if (kind := _kind(word)) is not None}
    quantity: Quantity = kinds.pop() if len(kinds) == 1 else "unknown"
    return Ordinate(label, quantity, factor)


def _kind(word: str) -> Quantity | None:
    if word in _WORDS:
        return _WORDS[word]
    return next((kind for stem, kind in _STEMS.items() if word.startswith(stem)), None)


def factor_of(ordinate: Ordinate, stated: str | None, where: str) -> tuple[float, str]:
    """Return the factor from the file's values to reflectance as a fraction, and a remark, often empty.

    Parameters
    ----------
    stated
        One of `STATED`, or None: what the user says the values are.
    where
        The file and the place of the label, for messages.

    Raises
    ------
    StoreError
        The ordinate is no reflectance, its scale is open, or the user contradicts the file.
    """
    said = f"{where}: the ordinate is '{ordinate.label}'"
    if stated is not None and stated not in STATED:
        raise StoreError(
            f"'{stated}' is no ordinate of a reflectance; state %R (percent) or R (a fraction) with {OPTION}"
        )
    if ordinate.quantity == "absorbance":
        raise StoreError(
            f"{said}, an absorbance: minus the logarithm of a ratio that may be reflectance or "
            "transmittance; export the spectrum again as %R"
        )
    if ordinate.quantity == "transmittance" and stated is None:
        raise StoreError(
            f"{said}, a transmittance, which says nothing of reflectance; give the sphere's reflectance, or, "
            "if the sample stood at the reflectance port and only the instrument's ordinate was left so, "
            f"state {OPTION} %R"
        )
    if stated is None:
        if ordinate.quantity == "unknown":
            raise StoreError(
                f"{said}, which does not say what the values are; state {OPTION} %R (reflectance in percent) "
                f"or {OPTION} R (a fraction), or correct the label"
            )
        if ordinate.factor is None:
            raise StoreError(
                f"{said}, which leaves open whether 0.5 means 50 % or 0.5 %; state {OPTION} %R (percent) or "
                f"{OPTION} R (a fraction)"
            )
        return ordinate.factor, ""
    if ordinate.factor is not None and ordinate.factor != STATED[stated]:
        scale = "percent" if ordinate.factor == 0.01 else "a fraction"
        raise StoreError(
            f"{said}, {scale}, but {OPTION} {stated} was stated; leave {OPTION} out, or correct the file"
        )
    if ordinate.quantity == "transmittance":
        return STATED[stated], f"the file says '{ordinate.label}'; the user states that it is reflectance"
    if ordinate.quantity == "unknown" or ordinate.factor is None:
        return STATED[stated], f"the file says '{ordinate.label}'; the user states {stated}"
    return STATED[stated], ""

"""Which settings of the lock-in change what X means, and are they as they must be?

An offset is part of X, a harmonic is another signal than the chopped one, and a current is no voltage.  Each
is asked for on connecting, set where that is safe, and asked for again after each pass.  Reference: Stanford
Research Systems, SR830 manual, chapter 5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gonio.errors import DeviceError
from gonio_drivers.decimals import decimal

GUARDS = {
    "ISRC?": "ISRC?",
    "HARM?": "HARM 1;HARM?",
    "OEXP? 1": "OEXP 1,0,0;OEXP? 1",
    "OEXP? 2": "OEXP 2,0,0;OEXP? 2",
    "PHAS?": "PHAS?",
}
"""What is sent on connecting, by the question; clones that lack a statement leave out its answer."""

FIELDS = {"ISRC?": 1, "HARM?": 1, "OEXP? 1": 2, "OEXP? 2": 2, "PHAS?": 1}
"""How many numbers an answer has."""

_WANTED = {"HARM?": "1", "OEXP? 1": "0,0", "OEXP? 2": "0,0"}
_CURRENTS = ([2.0], [3.0])  # ISRC; volts are 0 (A) and 1 (A-B)
_RESOLUTION = 0.02  # of the phase, degrees; the others are whole numbers


def numbers_of(answer: str) -> list[float]:
    """Return the numbers of an answer, none if there is anything else in it."""
    try:
        return [decimal(field) for field in answer.split(",")]
    except ValueError:
        return []


def check_guards(device: str, answers: Mapping[str, str]) -> None:
    """Raise `DeviceError` if X would not be the voltage of the chopped signal."""
    source = answers.get("ISRC?", "0")
    if numbers_of(source) in _CURRENTS:
        raise DeviceError(
            device,
            f"measures a current (ISRC {source}): its ranges and readings are amperes, not volts",
            "set its input to A or A-B at the panel, where the detector's preamplifier is connected",
        )
    for question, wanted in _WANTED.items():
        answer = answers.get(question, wanted)
        if not _agree(answer, wanted):
            raise DeviceError(
                device,
                f"answers {question} with {answer} although it was told {wanted}: X would be a wrong voltage",
                "switch harmonic, offset and expand off at its panel, then repeat",
            )


def check_unchanged(device: str, before: Mapping[str, str], answers: Sequence[str]) -> None:
    """Raise `DeviceError` if a later answer to the same questions is another one."""
    for (question, expected), answer in zip(before.items(), answers, strict=True):
        if not _agree(answer, expected):
            raise DeviceError(
                device,
                f"answers {question} with {answer}, although it was {expected} before: it was set at its "
                "panel",
                "leave it alone while it measures, then repeat",
            )


def _agree(answer: str, expected: str) -> bool:
    got, wanted = numbers_of(answer), numbers_of(expected)
    return len(got) == len(wanted) and all(
        abs(a - b) <= _RESOLUTION for a, b in zip(got, wanted, strict=True)
    )

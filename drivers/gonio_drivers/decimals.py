"""Is this a number as an instrument prints it?

Python's own `float` and `int` also take ``nan``, ``1e999``, ``1_000``, digits of other scripts and, `int`,
fail on thousands of digits.  None of these was ever said by an instrument: on a line without a checksum they
are the trace of noise, and as a reading they would be worse than none.
"""

from __future__ import annotations

import math
import re

_DECIMAL = re.compile(r" *[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)? *", re.ASCII)
_FIXED = re.compile(r" *[+-]?\d{1,10}(\.\d*)? *", re.ASCII)
_WHOLE = re.compile(r" *[+-]?\d{1,10} *", re.ASCII)  # ten digits hold every 32-bit number


def decimal(text: str) -> float:
    """Return the finite number that `text` shows; `ValueError` for anything else."""
    if _DECIMAL.fullmatch(text) is None:
        raise ValueError(f"'{text[:40]}' is not a number")
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"'{text[:40]}' is beyond all numbers")
    return value


def fixed(text: str) -> float:
    """Return the number without exponent, of 32 bits, that `text` shows; `ValueError` for anything else."""
    if _FIXED.fullmatch(text) is None:
        raise ValueError(f"'{text[:40]}' is not a number of at most ten digits")
    return float(text)


def whole(text: str) -> int:
    """Return the whole number that `text` shows, ten digits at most; `ValueError` for anything else."""
    if _WHOLE.fullmatch(text) is None:
        raise ValueError(f"'{text[:40]}' is not a whole number")
    return int(text)

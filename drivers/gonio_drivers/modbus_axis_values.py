"""How does a number become Modbus registers and back: 16 and 32 bits, signed or not, or a single float.

Modbus itself knows only 16-bit registers; which half of a longer number has the lower address is up to the
maker (``word_order``).  Within a register the high byte always comes first.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Literal

from gonio_drivers.modbus import WordOrder

IntegerType = Literal["s16", "u16", "s32", "u32"]
NumberType = Literal["s16", "u16", "s32", "u32", "float32"]

_FORMATS = {"s16": ">h", "u16": ">H", "s32": ">i", "u32": ">I", "float32": ">f"}
_RANGES = {
    "s16": (-(1 << 15), (1 << 15) - 1),
    "u16": (0, (1 << 16) - 1),
    "s32": (-(1 << 31), (1 << 31) - 1),
    "u32": (0, (1 << 32) - 1),
}
_LARGEST_FLOAT32 = 3.4028234e38


def width(kind: NumberType) -> int:
    """Return how many registers a number takes."""
    return 1 if kind in ("s16", "u16") else 2


def limits(kind: NumberType) -> tuple[float, float]:
    """Return the smallest and the largest number that fit."""
    return (-_LARGEST_FLOAT32, _LARGEST_FLOAT32) if kind == "float32" else _RANGES[kind]


def encode(value: float, kind: NumberType, word_order: WordOrder) -> list[int]:
    """Return the registers of a number, rounded if the type is an integer; it must be within `limits`."""
    packed = struct.pack(_FORMATS[kind], value if kind == "float32" else round(value))
    words = list(struct.unpack(f">{len(packed) // 2}H", packed))
    return words if word_order == "big" else words[::-1]


def decode(words: Sequence[int], kind: NumberType, word_order: WordOrder) -> float:
    """Return the number in registers; a float may be NaN or infinite."""
    ordered = words if word_order == "big" else words[::-1]
    (value,) = struct.unpack(_FORMATS[kind], struct.pack(f">{len(ordered)}H", *ordered))
    return float(value)

"""What happens to bytes on a line: flipped bits, noise, pieces."""

from __future__ import annotations

import random
import re

_LINE = re.compile(rb"[^\r\n]*[\r\n]+|[^\r\n]+")
_SHOWN = 48


def changed(data: bytes, unit: str, rng: random.Random) -> bytes:
    """Return the bytes with one bit or one byte changed."""
    i = rng.randrange(len(data))
    flip = 1 << rng.randrange(8) if unit == "bit" else rng.randrange(1, 256)
    return data[:i] + bytes([data[i] ^ flip]) + data[i + 1 :]


def with_noise(data: bytes, size: int, place: str, rng: random.Random) -> bytes:
    """Return the bytes with `size` random ones before, within or after them."""
    inner = rng.randrange(1, len(data)) if len(data) > 1 else 0
    i = {"before": 0, "within": inner, "after": len(data)}[place]
    return data[:i] + rng.randbytes(size) + data[i:]


def pieces(data: bytes, size: int) -> list[bytes]:
    """Return the bytes cut into pieces of `size`, the last one maybe shorter."""
    return [data[i : i + size] for i in range(0, len(data), size)]


def lines(data: bytes) -> list[bytes]:
    """Return the lines with their ends (CR, LF or both); the last one may have none."""
    return _LINE.findall(data)


def shown(data: bytes) -> str:
    """Return the bytes for a log, the middle of long ones left out."""
    if len(data) <= _SHOWN:
        return repr(data)
    return f"{data[: _SHOWN // 2]!r}...{data[-_SHOWN // 2 :]!r} ({len(data)} bytes)"

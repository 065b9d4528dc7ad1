"""What a bad line does to bytes: single bits, lost and doubled characters, truncation, splices, noise, and
pieces that come late.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from random import Random

LONGEST_NOISE = 9000  # more than a line's buffer holds without a terminator

WORDS = tuple(
    word.encode("utf-8")
    for word in (
        *(
            "nan",
            "NaN",
            "-inf",
            "inf",
            "1e999",
            "-1e400",
            "1e308",
            "0x10",
            "1_000",
            "٣",
            "²",
            "½",
            "−5",
            "\0",
        ),
        *("9" * 30, "-" + "9" * 19, "2147483648", "-2147483649", "FFFFFFFF", "80000000", "", " ", "\r", "\n"),
        *(
            "-0",
            "+5",
            "1.",
            ".5",
            "1e",
            "--",
            "@",
            "!",
            "#",
            ":",
            ",",
            ";",
            "?",
            "é",
            "\u2028",
            "\x1c",
            "\x85",
        ),
    )
)
"""Numbers that are none, numbers that no instrument shows, and characters with a meaning in some protocol."""


def mutate(rng: Random, data: bytes, others: Sequence[bytes] = ()) -> bytes:
    """Return `data` after one to three damages; `others` are messages that may be spliced in."""
    for _ in range(1 if rng.random() < 0.7 else rng.randint(2, 3)):
        data = _DAMAGES[int(rng.random() * len(_DAMAGES))](rng, data, others)
    return data


def _flip_bit(rng: Random, data: bytes, _: Sequence[bytes]) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    changed[int(rng.random() * len(data))] ^= 1 << int(rng.random() * 8)
    return bytes(changed)


def _change_byte(rng: Random, data: bytes, _: Sequence[bytes]) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    changed[int(rng.random() * len(data))] = int(rng.random() * 256)
    return bytes(changed)


def _delete(rng: Random, data: bytes, _: Sequence[bytes]) -> bytes:
    start = int(rng.random() * (len(data) + 1))
    return data[:start] + data[start + rng.randint(1, 4) :]


def _insert(rng: Random, data: bytes, _: Sequence[bytes]) -> bytes:
    start = int(rng.random() * (len(data) + 1))
    return data[:start] + rng.randbytes(rng.randint(1, 4)) + data[start:]


def _insert_word(rng: Random, data: bytes, _: Sequence[bytes]) -> bytes:
    start = int(rng.random() * (len(data) + 1))
    end = start if rng.random() < 0.5 else start + rng.randint(1, 9)
    return data[:start] + rng.choice(WORDS) + data[end:]


def _double(rng: Random, data: bytes, _: Sequence[bytes]) -> bytes:
    start = int(rng.random() * (len(data) + 1))
    end = start + rng.randint(1, 12)
    return data[:end] + data[start:]


def _swap(rng: Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """Two neighbouring bytes change places, which a plain sum does not notice."""
    if len(data) < 2:
        return data
    i = int(rng.random() * (len(data) - 1))
    return data[:i] + data[i + 1 : i + 2] + data[i : i + 1] + data[i + 2 :]


def _truncate(rng: Random, data: bytes, _: Sequence[bytes]) -> bytes:
    cut = int(rng.random() * (len(data) + 1))
    return data[:cut] if rng.random() < 0.5 else data[cut:]


def _splice(rng: Random, data: bytes, others: Sequence[bytes]) -> bytes:
    if not others:
        return data + data
    other = rng.choice(others)
    if rng.random() < 0.5:
        return other + data if rng.random() < 0.5 else data + other
    return data[: int(rng.random() * (len(data) + 1))] + other[int(rng.random() * (len(other) + 1)) :]


def _noise(rng: Random, data: bytes, _: Sequence[bytes]) -> bytes:
    n = rng.randint(1, 40) if rng.random() < 0.97 else rng.randint(1000, LONGEST_NOISE)
    noise = rng.randbytes(n) if rng.random() < 0.7 else bytes([int(rng.random() * 256)]) * n
    return rng.choice((noise, noise + data, data + noise))


def _number(rng: Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """Replace a run of digits by something else."""
    i = int(rng.random() * (len(data) + 1))
    while i < len(data) and not 0x30 <= data[i] <= 0x39:
        i += 1
    end = i
    while end < len(data) and 0x30 <= data[end] <= 0x39:
        end += 1
    huge = str(rng.randint(0, 9)) * rng.choice((1, 5, 12, 40, 4090, 5000)) if rng.random() < 0.1 else ""
    return data[:i] + (huge.encode("ascii") or rng.choice(WORDS)) + data[end:]


_DAMAGES = (
    *(_flip_bit, _flip_bit, _change_byte, _change_byte, _delete, _insert, _insert_word, _double, _swap),
    *(_truncate, _splice, _noise, _number),
)


def pieces(rng: Random, data: bytes) -> list[tuple[float, bytes]]:
    """Return `data` as it comes: (seconds after the piece before, bytes); often in parts, sometimes late."""
    draw = rng.random()
    first_s = 0.002 if draw < 0.8 else rng.uniform(0.0, 0.3) if draw < 0.9 else rng.uniform(0.3, 7.0)
    if rng.random() < 0.6 or len(data) < 2:
        return [(first_s, data)]
    cuts = sorted({int(rng.random() * len(data)) for _ in range(rng.randint(1, 4))} | {0, len(data)})
    gap_s = rng.choice((0.0, 0.001, 0.03))
    return [(first_s if start == 0 else gap_s, data[start:end]) for start, end in itertools.pairwise(cuts)]

"""What can become of one input, and counting it."""

from __future__ import annotations

import enum
from collections import Counter
from dataclasses import dataclass, field
from random import Random
from typing import Protocol

from fuzzing.virtual_time import VirtualTime


class Verdict(enum.Enum):
    """How one call with one input ended."""

    RIGHT = "right"  # the true answer
    EARLIER = "earlier"  # a true answer to the same question, asked before in the same call
    VALID_OTHER = "valid other"  # another answer, in a frame whose checksum is right: nobody could tell
    UNASKED = "unasked"  # a whole old reply that came once more, unasked: RTU has no number to tell it by
    UNPROTECTED = "unprotected"  # another answer, and the protocol has no checksum
    CORRUPT = "corrupt"  # another answer although the checksum was wrong: a defect
    ABSURD = "absurd"  # not a number, or one that the instrument cannot have shown: a defect


DEFECTS = (Verdict.CORRUPT, Verdict.ABSURD)


class Target(Protocol):
    """A parser with something that feeds it."""

    name: str

    def __init__(self, time: VirtualTime) -> None: ...

    def one(self, rng: Random) -> Result:
        """Feed one input."""
        ...


@dataclass(frozen=True, slots=True)
class Result:
    """What became of one input: a verdict, or the name of the error that refused it."""

    verdict: Verdict | None = None
    refused: str | None = None
    reads: int = 0
    forged: bool = False  # the valid frame that was accepted had been made on purpose


@dataclass
class Tally:
    """Counts of one target."""

    name: str
    inputs: int = 0
    verdicts: Counter[Verdict] = field(default_factory=Counter)
    forged: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    unexpected: Counter[str] = field(default_factory=Counter)
    most_reads: int = 0
    examples: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, result: Result, where: str) -> None:
        """Count one input."""
        self.inputs += 1
        self.most_reads = max(self.most_reads, result.reads)
        if result.refused is not None:
            self.refused[result.refused] += 1
        if result.verdict is not None:
            self.verdicts[result.verdict] += 1
            self.forged += result.forged and result.verdict is Verdict.VALID_OTHER
            if result.verdict in DEFECTS and len(self.examples) < 20:
                self.examples.append(f"{where}: {result.verdict.value}")

    def add_unexpected(self, error: BaseException, where: str) -> None:
        """Count an input that raised what no caller expects."""
        self.inputs += 1
        kind = type(error).__name__
        self.unexpected[kind] += 1
        if self.unexpected[kind] <= 3:
            self.examples.append(f"{where}: {kind}: {str(error)[:200]}")

    @property
    def defects(self) -> int:
        """Inputs that show a defect."""
        return sum(self.verdicts[v] for v in DEFECTS) + sum(self.unexpected.values())

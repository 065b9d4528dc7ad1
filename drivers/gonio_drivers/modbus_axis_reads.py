"""In which reads is the state of a drive asked for, and which read proves that a line is in step again?

Registers that stand side by side are read at once: one reply is the state of one instant.  Where they do not,
the status is read before the position, so that an axis seen at rest was at rest when its position was taken.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from gonio_drivers.modbus import Canary, ReadFunction

_LONGEST: dict[ReadFunction, int] = {1: 2000, 2: 2000, 3: 125, 4: 125}  # Modbus V1.1b3, 6.1 to 6.4


@dataclass(frozen=True, slots=True, order=True)
class Span:
    """Registers (functions 3 and 4) or bits (1 and 2) side by side."""

    function: ReadFunction
    address: int
    count: int

    @property
    def end(self) -> int:
        """The first address behind it."""
        return self.address + self.count

    def overlaps(self, other: Span) -> bool:
        """Say whether the two have a register in common."""
        return self.function == other.function and self.address < other.end and other.address < self.end

    def contains(self, other: Span) -> bool:
        """Say whether the other lies in this one."""
        return self.function == other.function and self.address <= other.address and other.end <= self.end


def plan_reads(wanted: Iterable[Span], position: Span, *, bridge: int) -> tuple[Span, ...]:
    """Return the fewest reads that cover everything, the one with the position last.

    Parameters
    ----------
    wanted
        What the status is made of; none of them is ever cut in two.
    position
        Where the position is.
    bridge
        So many registers that nobody asked for may be read along to save a read.  Many drives answer a read
        that touches a register they do not have with an exception, so this is for the user to allow.
    """
    return tuple(
        sorted(joined((*wanted, position), bridge=bridge), key=lambda block: block.contains(position))
    )


def joined(spans: Iterable[Span], *, bridge: int = 0) -> list[Span]:
    """Return the fewest reads that cover the spans, in ascending order; arguments as for `plan_reads`."""
    blocks: list[Span] = []
    for span in sorted(set(spans)):
        last = blocks[-1] if blocks else None
        if last is not None and last.function == span.function and span.address <= last.end + bridge:
            together = max(last.end, span.end) - last.address
            if together <= _LONGEST[span.function]:
                blocks[-1] = Span(last.function, last.address, together)
                continue
        blocks.append(span)
    return blocks


def choose_canary(runs: Iterable[Span], parts: Iterable[Span], reads: Iterable[Span]) -> Canary | None:
    """Return a read whose reply has a length that none of the `reads` has, None if there is none.

    It is the beginning of one of the `runs`, which are registers that the drive has, up to the end of one of
    the `parts`, so that no number is cut in two: some drives refuse half a parameter.
    """
    parts = tuple(parts)
    taken = {(read.function, read.count) for read in reads}
    candidates = [
        Canary(run.function, run.address, count)
        for run in runs
        if run.function in (3, 4)
        for count in {part.end - run.address for part in parts if run.contains(part)}
        if (run.function, count) not in taken
    ]
    if not candidates:
        return None
    best = max(candidates, key=lambda canary: canary.count)
    # A canary may be late itself: the next attempt then takes another length.
    spare = {c.count for c in candidates if (c.function, c.address) == (best.function, best.address)}
    return replace(best, spare=tuple(sorted(spare - {best.count}, reverse=True)))

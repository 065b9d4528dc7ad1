"""What is done when a device fails: try again, then pause, skip or give up; and how long to wait between."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gonio.errors import ConfigError

Then = Literal["pause", "skip", "abort"]

LONGEST_WAIT_S = 60.0


@dataclass(frozen=True, slots=True)
class FaultPolicy:
    """What a runner does when a device fails at a step.

    Before each further attempt every device is brought back to a known state (`gonio.rig.Rig.recover`: line
    opened anew, settings read back, axes homed whose count is in doubt), and the step is measured anew from
    its beginning.

    Attributes
    ----------
    retries
        Further attempts at one step.
    then
        When they are used up: ``pause`` waits, shutter closed and motors at rest, until somebody resumes or
        stops the scan; ``skip`` records the position as skipped, with NaN for every reading, and goes on
        (references are never skipped: without them nothing can be corrected, so they abort); ``abort`` ends
        the run, which can be resumed later.
    first_wait_s
        Real seconds before the first further attempt; twice as long before each that follows, at most
        `LONGEST_WAIT_S`: a device that restarts needs its time.
    silence_s
        Real seconds without a sign of life (a reading, a motion that ended, a step) after which everything is
        stopped and the step counts as failed.
    """

    retries: int = 3
    then: Then = "abort"
    first_wait_s: float = 0.5
    silence_s: float = 900.0

    def __post_init__(self) -> None:
        if self.retries < 0:
            raise ConfigError(f"retries = {self.retries}: give 0 or more further attempts")
        if not self.silence_s > 0:
            raise ConfigError(f"silence_s = {self.silence_s:g}: give real seconds above zero")
        if self.then not in ("pause", "skip", "abort"):
            raise ConfigError(f"on fault = '{self.then}': give pause, skip or abort")

    def wait_s(self, attempt: int) -> float:
        """Return the real seconds to wait before a further attempt, counted from 1."""
        return float(min(self.first_wait_s * 2.0 ** (attempt - 1), LONGEST_WAIT_S))


def attempts(count: int) -> str:
    """Return a number of failed attempts in words."""
    return "a failed attempt" if count == 1 else f"{count} failed attempts"
